"""Decoders and the sensor gate against their models: well-formed streams, damaged ones, real ones."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.events.arrays import Events
from cmfpga.protocol.registers import FORMATS
from cmfpga.protocol.words import encode
from cmfpga.reference.wire import Beat, Token, decode, sensor_gate, to_beats
from cmfpga.rtl.shell.decoder import Decoder
from cmfpga.rtl.shell.sensor_gate import SensorGate
from support.axi_streams import FLOWS, pass_through

CONFIG = Config()
PULSES = {"format_error": "format_errors", "other": "other_words", "back": "time_high_back"}


def payload(beat):
    return {"data": beat.data, "keep": beat.keep, "last": int(beat.last), "user": 0}


def as_token(value):
    """A token of the hardware; what has no meaning without an event left out."""
    if not value["event"]:
        return Token(0, 0, 0, False, False, bool(value["end"]))
    return Token(value["t"], value["x"], value["y"], bool(value["known"]), True, bool(value["end"]))


def check(form, beats, flow, rng, config=CONFIG):
    expected, counts = decode(config, beats, form)
    passage = pass_through(
        Decoder(config), [payload(beat) for beat in beats], flow, rng, expect=len(expected), pulses=PULSES,
        inputs={"format": FORMATS[form]},
    )  # fmt: skip
    assert [as_token(value) for value in passage.values] == expected
    assert {counter: passage.count(pulse) for pulse, counter in PULSES.items()} == counts
    return passage, expected, counts


def some_events(rng, count, *, width=240, height=180, step=40):
    """Rows of neighbours among single events, many with one time stamp, over several time words."""
    t = np.cumsum(rng.integers(0, step, count) * (rng.random(count) < 0.3)) + int(rng.integers(1 << 34))
    x = rng.integers(0, width, count)
    runs = rng.random(count) < 0.6
    for k in range(1, count):
        if runs[k]:
            x[k] = (x[k - 1] + rng.integers(1, 4)) % width
    y = np.where(runs, np.roll(rng.integers(0, height, count), 1), rng.integers(0, height, count))
    y[1:] = np.where(runs[1:], y[:-1], y[1:])
    return Events(t, x, y, np.where(rng.random(count) < 0.1, 0, 1))


def any_beats(rng, count):
    """Words of every type, TKEEP of every kind, TLAST anywhere; EVT 2.0 and 2.1 alike."""
    beats = [Beat(1 << 60 | 1 << 28)] * 3  # events, and no time word before them
    for _ in range(count):
        halves = [int(rng.choice([0, 1, 8, 10, 14, 15, *range(16)])) << 28 | int(rng.integers(1 << 28)) for _ in "ab"]
        low = int(rng.choice([0, 1, 1 << 31, 0xFFFFFFFF, halves[0], halves[0] & 0x1111]))
        keep = int(rng.choice([0xFF, 0xFF, 0xFF, 0xFF, 0x0F, 0xF0, 0, rng.integers(256)]))
        beats.append(Beat(halves[1] << 32 | low, keep, bool(rng.random() < 0.2)))
    return beats


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("form", FORMATS)
def test_events(form, flow, rng):
    events = some_events(rng, 150)
    beats = to_beats(encode(events, form))
    _, tokens, counts = check(form, beats, flow, rng)
    mask = (1 << CONFIG.time_bits) - 1
    assert [(k.t, k.x, k.y) for k in tokens if k.event] == list(
        zip((events.t & mask).tolist(), events.x.tolist(), events.y.tolist(), strict=True)
    )
    assert all(token.known for token in tokens if token.event) and not sum(counts.values())
    assert [token.end for token in tokens] == [False] * (len(tokens) - 1) + [True]


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("form", FORMATS)
def test_anything_on_the_wire(form, flow, rng):
    """Unknown types, events before the first time word, partial TKEEP, TLAST in odd places: counted, never stuck."""
    _, tokens, counts = check(form, any_beats(rng, 200), flow, rng)
    assert counts["format_errors"] > 10 and sum(token.end for token in tokens) > 10
    if form != "PACKED":
        assert counts["other_words"] > 10 and counts["time_high_back"] > 1
        assert any(not token.known for token in tokens if token.event)


@pytest.mark.parametrize("form", ["EVT21", "EVT20"])
@pytest.mark.parametrize("flow", ["free", "both"])
def test_after_damage_all_is_well(form, flow, rng):
    events = some_events(rng, 60)
    beats = [*any_beats(rng, 30), *to_beats(encode(events, form))]
    _, tokens, _ = check(form, beats, flow, rng)
    assert [(k.x, k.y) for k in tokens if k.event][-60:] == list(zip(events.x.tolist(), events.y.tolist(), strict=True))


@pytest.mark.parametrize("bits", [8, 31, 32])
def test_time_wraps_and_steps_back(bits, rng):
    """2^34 µs follow 0; a time word that is a little smaller counts, one that is much smaller is a wrap."""
    config = Config(time_bits=bits, span_bits=7)
    t = np.array([(1 << 34) - 3, (1 << 34) - 1, (1 << 34) + 1, (1 << 34) + 900, (1 << 34) + 500, 700, 100])
    events = Events(t, [1] * 7, [2] * 7, [1] * 7)
    for form in ("EVT21", "EVT20"):
        _, tokens, counts = check(form, to_beats(encode(events, form)), "free", rng, config)
        assert [token.t for token in tokens if token.event] == (t & ((1 << bits) - 1)).tolist()
        assert counts["time_high_back"] == 2  # 900 to 500, 700 to 100


# ---------------------------------------------------------------- cycles


def test_evt21_gives_one_event_per_cycle(rng):
    """Vectors of 1 to 32 events without a bubble between them; a time word costs its own cycle."""
    config = Config()
    words = (
        [8 << 60 | 5 << 32] + [1 << 60 | 3 << 32 | (1 << k) - 1 for k in range(1, 33)] + [1 << 60 | 3 << 32 | 1] * 20
    )
    passage, tokens, _ = check("EVT21", to_beats(words, last=False), "free", rng, config)
    cycles = [cycle for cycle, _ in passage.out]
    assert len(tokens) == 32 * 33 // 2 + 20
    assert cycles == list(range(cycles[0], cycles[0] + len(tokens)))
    assert cycles[0] - passage.taken[1] == Decoder.latency


def test_evt20_gives_one_word_per_cycle(rng):
    words = [1 << 60 | 8 << 28 | 7] + [1 << 60 | 1 << 28] * 30
    passage, tokens, _ = check("EVT20", to_beats(words, last=False), "free", rng)
    cycles = [cycle for cycle, _ in passage.out]
    assert len(tokens) == 61 and cycles == list(range(cycles[0], cycles[0] + 61))
    assert passage.taken[2] - passage.taken[1] == 2


def test_packed_gives_one_event_per_cycle(rng):
    passage, _, _ = check("PACKED", to_beats(range(50), last=False), "free", rng)
    assert passage.taken == list(range(50))
    assert [cycle - Decoder.latency for cycle, _ in passage.out] == passage.taken


# ---------------------------------------------------------------- the gate


@pytest.mark.parametrize("flow", FLOWS)
def test_sensor_gate(flow, rng):
    tokens = [
        Token(int(rng.integers(1 << 32)), int(x), int(y), bool(rng.random() < 0.8), bool(event), bool(end))
        for x, y, event, end in zip(
            rng.choice([0, 100, 239, 240, 65535], 200),
            rng.choice([0, 100, 179, 180, 65535], 200),
            rng.random(200) < 0.8,
            rng.random(200) < 0.3,
            strict=True,
        )
        if event or end
    ]
    expected, counts = sensor_gate(CONFIG, tokens)
    items = [{name: int(value) for name, value in token._asdict().items()} for token in tokens]
    pulses = {"event": "events_in", "before_time": "before_time", "outside": "out_of_sensor"}
    passage = pass_through(SensorGate(CONFIG), items, flow, rng, expect=len(expected), pulses=pulses)
    got = [(v["event"], v["end"], *((v["t"], v["x"], v["y"]) if v["event"] else ())) for v in passage.values]
    assert got == [(k.event, k.end, *((k.t, k.x, k.y) if k.event else ())) for k in expected]
    assert {counter: passage.count(pulse) for pulse, counter in pulses.items()} == counts
    assert min(counts.values()) > 10


# ---------------------------------------------------------------- broken ones are found


def breaks(monkeypatch, form, target, name, value, rng):
    monkeypatch.setattr(target, name, value)
    with pytest.raises(AssertionError):
        check(form, any_beats(rng, 100), "both", rng)
        check(form, to_beats(encode(some_events(rng, 80), form)), "free", rng)


@pytest.mark.parametrize("form", ["EVT21", "EVT20"])
def test_mutants(form, monkeypatch, rng):
    from cmfpga.rtl.shell import decoder
    from cmfpga.rtl.shell.time_high import TimeHigh

    for name, value in (("EVENT_TYPES", (0,)), ("OTHER_TYPES", (0xA, 0xE)), ("TIME_HIGH", 9)):
        with monkeypatch.context() as patched:
            breaks(patched, form, decoder, name, value, rng)

    def ignores_load(self, platform):
        m = self.whole(platform)
        m.d.comb += self.back.eq(0)
        return m

    with monkeypatch.context() as patched:
        patched.setattr(TimeHigh, "whole", TimeHigh.elaborate, raising=False)
        breaks(patched, form, TimeHigh, "elaborate", ignores_load, rng)
