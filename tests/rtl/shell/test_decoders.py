"""Decoders and the sensor gate against their models: well-formed streams, damaged ones, real ones."""

import numpy as np
import pytest

from cmfpga.config import Config, preset
from cmfpga.events.arrays import Events
from cmfpga.events.evt import EvtDecoder
from cmfpga.protocol.registers import FORMATS
from cmfpga.protocol.words import encode, read_raw
from cmfpga.reference.wire import Beat, Token, decode, sensor_gate, to_beats
from cmfpga.rtl.shell import decoder
from cmfpga.rtl.shell.decoder import Decoder, TimeHigh
from cmfpga.rtl.shell.evt3_decoder import Evt3Decoder
from cmfpga.rtl.shell.input_path import SensorGate, VectorSplitter
from support.axi_streams import FLOWS, pass_through

CONFIG = Config()
EVT3 = preset("fast").replace(evt3=1)
END = Token(0, 0, 0, False, False, True)
PULSES = {"format_error": "format_errors", "other": "other_words", "back": "time_high_back"}


def as_tokens(value):
    """A token of the hardware, an event each; what has no meaning without an event left out."""
    x, end = value["x"], bool(value["end"])
    columns = [x + k for k in range(12) if value.get("vector", 1) >> k & 1] if value["event"] else []
    assert columns or end
    rest = value["y"], bool(value.get("known", True)), True
    return [Token(value["t"], x, *rest, end and x == columns[-1]) for x in columns] or [END]


def check(form, beats, flow, rng, config=CONFIG, swap=0):
    expected, counts = decode(config, beats, form, swap=bool(swap))
    block, inputs, tail = Decoder(config), {"format": FORMATS[form]}, 12
    if form == "EVT30":
        block, inputs, tail = Evt3Decoder(config.replace(evt3=1)), {}, 8 * len(beats) + 40
    items = [{**beat._asdict(), "last": int(beat.last), "user": 0} for beat in beats]
    passage = pass_through(
        block, items, flow, rng, expect=0 if form == "EVT30" else len(expected),
        pulses=PULSES, inputs=inputs | {"swap": swap}, tail=tail,
    )  # fmt: skip
    assert [token for value in passage.values for token in as_tokens(value)] == expected
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


def any_beats(rng, count, form=None):
    """Words of every type, TKEEP of every kind, TLAST anywhere; EVT 2.0 and 2.1 alike.

    Of EVT 3.0 in no order: ahead of the first time, too, which then steps on and back, and wraps.
    """
    if form == "EVT30":
        kinds = rng.choice([0, 2, 3, 4, 4, 5, 6, 8, *range(16)], 4 * count)
        kinds[:32][kinds[:32] == 8] = 4
        high = np.cumsum((kinds == 8) * rng.choice([0, 1, 40, 1500, 2047, 2048, 3000, -1, -300], 4 * count))
        words = np.where((kinds == 8) & (rng.random(4 * count) < 0.9), high, rng.integers(0, 1 << 12, 4 * count))
        words = (kinds << 12 | words & 0xFFF).astype("<u2").view("<u8")
        keeps = rng.choice([0xFF, 0xFF, 0xFF, 0xFF, 0x3F, 0x0F, 0x03, 0xF3, 0, *range(256)], count)
        return [Beat(*map(int, both), bool(rng.random() < 0.2)) for both in zip(words, keeps, strict=True)]
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
    _, tokens, counts = check(form, to_beats(encode(events, form)), flow, rng)
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
    _, tokens, counts = check(form, any_beats(rng, 200, form), flow, rng, swap=int(flow == "gaps"))
    assert counts["format_errors"] > 10 and sum(token.end for token in tokens) > 10
    if form != "PACKED":
        assert counts["other_words"] > 10 and counts["time_high_back"] > 1
        assert any(not token.known for token in tokens if token.event)


@pytest.mark.parametrize("form", ["EVT21", "EVT20", "EVT30"])
@pytest.mark.parametrize("flow", ["free", "both"])
def test_after_damage_all_is_well(form, flow, rng):
    events = some_events(rng, 60)
    beats = [*any_beats(rng, 30, form), *to_beats(encode(events, form))]
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


@pytest.mark.parametrize("bits", [16, 24, 32])
def test_loops_of_evt30_time(bits, rng):
    """As the reader has them, in as many bits as the core does."""
    high = np.cumsum(rng.choice([0, 1, 40, 2047, 2048, 2049, -1, -40], 400))
    words = [0x8000 | high & 0xFFF, 0x6000 | rng.integers(0, 4096, 400), 0x2007 + 0 * high, 0x4FFF + 0 * high]
    words = np.stack(words, axis=1).astype("<u2")
    beats = to_beats(words.view("<u8").reshape(-1))
    _, tokens, counts = check("EVT30", beats, "free", rng, CONFIG.replace(time_bits=bits, span_bits=7))
    t, *_ = EvtDecoder("3.0")(words.tobytes())
    assert [token.t for token in tokens if token.event] == (t % (1 << bits)).tolist()
    assert t.max() > 4 << 24 and counts["time_high_back"] > 20


def test_a_real_file_of_evt30(data_dir, rng):
    _, words = read_raw(data_dir / "original_formats" / "prophesee_driving_1280x720_evt3.raw")
    t, x, y, _ = EvtDecoder("3.0")(words[:2500].astype("<u8").tobytes())
    _, tokens, counts = check("EVT30", to_beats(words[:2500]), "free", rng)
    found = [token[:3] for token in tokens if token.event and token.known]
    assert found == list(zip(t.tolist(), x.tolist(), y.tolist(), strict=True)) and len(t) > 5000
    assert not counts["format_errors"]


VECTORS = [1 << 60 | 3 << 32 | (1 << k) - 1 for k in range(1, 33)]
#: Form, words, how many tokens; the word that gives the first of them.
RATES = {
    # A vector too, whatever is in it; words behind the last one of a packet take none.
    "a word of EVT 3.0": (
        "EVT30", [*np.array([0x8001, 5, 0x3003, 0x6001, *[0x4FFF, 0x4001, 0x5FFF, 0x2808] * 20], "<u2").view("<u8"),
                  Beat(0x2001, 0x03, True), *to_beats([0x2001_2001_2001_2001])], 85, 1,
    ),
    # Vectors of 1 to 32 events without a bubble between them; a time word costs its own cycle.
    "an event of EVT 2.1": ("EVT21", [8 << 60 | 5 << 32, *VECTORS, *VECTORS[:1] * 20], 32 * 33 // 2 + 20, 1),
    "a word of EVT 2.0": ("EVT20", [1 << 60 | 8 << 28 | 7, *[1 << 60 | 1 << 28] * 30], 61, 0),
    "a packed event": ("PACKED", range(50), 50, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", RATES)
def test_one_per_cycle(name, rng):
    form, words, count, first = RATES[name]
    beats = [word if isinstance(word, Beat) else Beat(int(word)) for word in words]
    passage, *_ = check(form, beats, "free", rng)
    cycles = [cycle for cycle, _ in passage.out]
    assert cycles == [*range(cycles[0], cycles[0] + count)]
    if form == "EVT20":
        assert passage.taken[2] - passage.taken[1] == 2
    else:
        assert cycles[0] - passage.taken[first] == (Evt3Decoder if form == "EVT30" else Decoder).latency
    assert form != "PACKED" or passage.taken == [*range(50)]


@pytest.mark.parametrize("flow", FLOWS)
def test_sensor_gate(flow, rng):
    places = (rng.choice([0, 100, side - 1, side, 65535], 200) for side in (240, 180))
    tokens = [
        Token(int(rng.integers(1 << 32)), int(x), int(y), bool(rng.random() < 0.8), bool(event), bool(end))
        for x, y, event, end in zip(*places, rng.random(200) < 0.8, rng.random(200) < 0.3, strict=True)
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


@pytest.mark.parametrize("flow", FLOWS)
def test_sensor_gate_of_vectors(flow, rng):
    """Across the border, and with an end behind what is dropped."""
    items = vectors(rng, 300)
    expected, _ = sensor_gate(CONFIG, [token for item in items for token in as_tokens(item)])
    passage = pass_through(SensorGate(EVT3), items, flow, rng, expect=0, tail=1500)
    found = [token._replace(known=True) for value in passage.values for token in as_tokens(value)]
    assert found == [token if token.event else END._replace(known=True) for token in expected]


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("roi", [(61, 7), (0, 100), (176, 116)])
def test_splitter(flow, roi, rng):
    """No part crosses the ROI's border, and of each it is known on which side it is."""
    items = []
    for item in vectors(rng, 300):
        x, y = (int(first + rng.choice([-12, -11, -5, -1, 0, 1, 20, 52, 53, 60, 63, 64])) for first in roi)
        if 0 <= x < 228 and 0 <= y < 180:
            items.append({**item, "x": x, "y": y})
            del items[-1]["known"]
    inputs = {"roi": dict(zip("xy", roi, strict=True))}
    passage = pass_through(VectorSplitter(EVT3), items, flow, rng, expect=0, inputs=inputs, tail=1500)
    found = [as_tokens(value) for value in passage.values]
    assert [token for tokens in found for token in tokens] == [token for item in items for token in as_tokens(item)]
    for value, tokens in zip(passage.values, found, strict=True):
        outside = {not (0 <= x - roi[0] < 64 and 0 <= y - roi[1] < 64) for _, x, y, _, event, _ in tokens if event}
        assert outside == ({bool(value["outside"])} if value["event"] else set())
        assert value["events"] == len(tokens) * value["event"]
    assert len(items) + 5 < len(found) < 2 * len(items)


def vectors(rng, count):
    columns = [0, 1, 50, 60, 63, 123, 124, 170, 227, 228, 229, 239, 240, 4096]
    rows = [0, 7, 70, 71, 100, 179, 180, 2047]
    items = []
    for _ in range(count):
        vector = int(rng.choice([1, 0xFFF, rng.integers(1, 1 << 12)]))
        event, end = rng.random() < 0.9, rng.random() < 0.3
        if event or end:
            place = {"t": int(rng.integers(1 << 32)), "x": int(rng.choice(columns)), "y": int(rng.choice(rows))}
            said = {"known": int(rng.random() < 0.8), "event": int(event), "end": int(end)}
            items.append({**place, **said, "vector": vector * event})
    return items


def never_back(block, platform, whole=TimeHigh.elaborate):
    m = whole(block, platform)
    m.d.comb += block.back.eq(0)
    return m


MUTANTS = {  # owner, name, value
    "only falling edges": (decoder, "EVENT_TYPES", (0,)),
    "a type too few": (decoder, "OTHER_TYPES", (0xA, 0xE)),
    "another time word": (decoder, "TIME_HIGH", 9),
    "time never steps back": (TimeHigh, "elaborate", never_back),
}


@pytest.mark.parametrize("mutant", MUTANTS)
@pytest.mark.parametrize("form", ["EVT21", "EVT20"])
def test_mutants(form, mutant, monkeypatch, rng):
    monkeypatch.setattr(*MUTANTS[mutant])
    with pytest.raises(AssertionError):
        check(form, any_beats(rng, 200), "both", rng)
        check(form, to_beats(encode(some_events(rng, 80), form)), "free", rng)
