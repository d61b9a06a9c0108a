"""The GenX320's parallel port: words from pins, on a clock of their own; nothing is lost without being counted."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from cmfpga.protocol.link import CPI_COUNTERS
from cmfpga.protocol.words import encode_evt20
from cmfpga.rtl.shell.cpi import PADDING, CpiPort
from support.genx320 import levels, to_bytes

TIME, EVENT = 0x8000_0001, 0x1000_0000


def stream(rng, count):
    t = np.sort(rng.integers(0, 60 * count, count))
    words = encode_evt20(t, rng.integers(0, 320, count), rng.integers(0, 320, count), rng.integers(0, 2, count))
    return [int(word) for word in np.asarray(words, "<u8").view("<u4")]


class Port:
    """A port in a simulation; ``words`` and the final ``counts`` are what came of it.

    ``pins`` are played at ``clock`` times the clock of the port's other side, which takes words in the cycles that
    ``takes`` says, and sets ``inputs``, ``{cycle of the pins: {name: value}}``.
    """

    def __init__(self, pins, *, clock=0.83, depth=16, inputs=(), takes=lambda cycle: True, start=True):
        self.words, self._done = [], False
        block = CpiPort(depth=depth)
        inputs = dict(inputs)

        async def sensor(ctx):
            ctx.set(block.enable, int(start))
            for name, value in inputs.pop(None, {}).items():
                ctx.set(getattr(block, name), value)
            pins_idle = pins[:1].repeat(8, axis=0)
            for cycle, (data, hsync, vsync) in enumerate(np.concatenate([pins_idle, pins]).tolist(), -8):
                for name, value in inputs.get(cycle, {}).items():
                    ctx.set(getattr(block, name), value)
                ctx.set(block.data, data)
                ctx.set(block.hsync, hsync)
                ctx.set(block.vsync, vsync)
                await ctx.tick("cpi")
            await ctx.tick("cpi").repeat(8)
            await ctx.tick().repeat(2 * depth + 20)
            self._done = True

        async def other_side(ctx):
            cycle = 0
            while not self._done or ctx.get(block.o.valid):
                ctx.set(block.o.ready, int(self._done or takes(cycle)))
                if ctx.get(block.o.ready) and ctx.get(block.o.valid):
                    self.words.append(ctx.get(block.o.payload.data) & 0xFFFFFFFF)
                    assert ctx.get(block.o.payload.data) >> 32 == PADDING
                    assert (ctx.get(block.o.payload.keep), ctx.get(block.o.payload.last)) == (0x0F, 0)
                await ctx.tick()
                cycle += 1
            self.counts = {name: ctx.get(block.counted[name]) for name in CPI_COUNTERS}

        simulator = Simulator(block)
        simulator.add_clock(1e-6)
        simulator.add_clock(1e-6 / clock, phase=0.3e-6, domain="cpi")
        simulator.add_testbench(sensor)
        simulator.add_testbench(other_side)
        simulator.run()


def counts(**some):
    return dict.fromkeys(CPI_COUNTERS, 0) | some


@pytest.mark.parametrize("clock", [0.21, 0.83, 1.0, 2.9])
@pytest.mark.parametrize("big_endian", [False, True])
def test_words_come_in_order(clock, big_endian, rng):
    words = stream(rng, 90)
    pins = levels(to_bytes(words, big_endian=big_endian), gaps=rng)
    port = Port(pins, clock=clock, inputs={None: {"big_endian": int(big_endian)}})
    assert port.words == words
    assert port.counts == counts(words=len(words), padding=-len(words) % 16)


@pytest.mark.parametrize("low", [(False, True), (True, False), (True, True)])
def test_levels_that_are_active_low(low, rng):
    words = stream(rng, 30)
    inputs = {None: {"hsync_low": int(low[0]), "vsync_low": int(low[1])}}
    assert Port(levels(to_bytes(words), low=low), inputs=inputs).words == words


@pytest.mark.parametrize("packet", [5, 6, 7, 320])
def test_words_that_packets_split(packet, rng):
    """As long as frames hold whole words."""
    words = stream(rng, 80)[:80]
    port = Port(levels(to_bytes(words), packet=packet, packets=4, pad=False))
    assert port.words == words and port.counts == counts(words=80)


def test_a_word_that_a_frames_start_cuts_is_counted():
    """And a time word may have been in it: what follows waits for the next one."""
    words = [TIME, EVENT + 1, EVENT + 2, TIME + 1, EVENT + 3]
    frames = to_bytes(words[:2]) + b"\x77\x77", to_bytes(words[2:])
    port = Port(np.concatenate([levels(frame, pad=False) for frame in frames]))
    assert port.words == [TIME, EVENT + 1, TIME + 1, EVENT + 3]
    assert port.counts == counts(words=4, skipped=1, broken=1)


def test_padding_is_no_word():
    words = [TIME, PADDING, EVENT, PADDING, PADDING, EVENT + 1, 0xF0000000]
    port = Port(levels(to_bytes(words)))
    assert port.words == [TIME, EVENT, EVENT + 1, 0xF0000000]
    assert port.counts == counts(words=4, padding=3 + 9)


def test_nothing_passes_before_the_first_time_word():
    port = Port(levels(to_bytes([EVENT, EVENT + 1, TIME, EVENT + 2, 0xA0000000])))
    assert port.words == [TIME, EVENT + 2, 0xA0000000] and port.counts == counts(words=3, skipped=2, padding=11)


@pytest.mark.parametrize("clock", [0.5, 2.9])
def test_what_does_not_fit_is_counted(clock, rng):
    """The other side stops for a while: each word comes, or is counted; none comes with a lost time."""
    words = stream(rng, 400)
    stopped = range(150, 700)
    port = Port(levels(to_bytes(words)), clock=clock, takes=lambda cycle: cycle not in stopped)
    lost = port.counts["overflow"] + port.counts["skipped"]
    assert port.counts["overflow"] >= 1 and len(port.words) + lost == len(words)
    assert port.counts == counts(
        words=len(port.words), padding=-len(words) % 16, **{k: port.counts[k] for k in ("overflow", "skipped")}
    )
    _times_are_right(port.words, words)


def _times_are_right(got, sent):
    """Each event behind the time word that it was sent behind."""

    def timed(words):
        time, found = None, []
        for word in words:
            time = word if word >> 28 == 8 else time
            if word >> 28 < 2:
                found.append((time, word))
        return found

    rest = iter(timed(sent))
    assert all(event in rest for event in timed(got)), "an event has another time, or is out of order"


@pytest.mark.parametrize("slip", ["lost", "doubled"])
def test_an_edge_that_is_lost_or_doubled(slip, rng):
    """What follows is dropped from the first word on that cannot be, up to the next frame; few come before it."""
    words = stream(rng, 900)
    frames, pins = [words[k : k + 64] for k in range(0, len(words), 64)], []
    for k, frame in enumerate(frames):
        clean = levels(to_bytes(frame), packet=64, packets=4)
        at = int(rng.choice(np.flatnonzero(clean[:, 1])[8:-100]))
        changed = np.delete(clean, at, axis=0) if slip == "lost" else np.insert(clean, at, clean[at], axis=0)
        pins.append(changed if k % 2 == 0 and len(frame) == 64 else clean)
    slips = -(-(len(words) // 64) // 2)
    port, sent = Port(np.concatenate(pins), depth=64), iter(words)
    wrong = [word for word in port.words if word not in words]
    assert len(wrong) < slips and slips <= port.counts["broken"] <= 2 * slips and not port.counts["overflow"]
    assert all(word in sent for word in port.words if word in words), "out of order"
    assert sum(frame[-1] in port.words for frame in frames) >= len(frames) // 2 - 1


WRONG = {
    "type": 0x4000_0000,
    "column": EVENT + (320 << 11),
    "row": EVENT + 320,
    "back": TIME - 1,
    "far": TIME + (1 << 16),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_word_that_cannot_be_is_counted_at_once(wrong):
    """And what follows, until a frame begins and a time word comes."""
    frame, rest = [TIME, EVENT, WRONG[wrong], EVENT + 1, TIME + 1, EVENT + 2], [EVENT + 3, TIME + 9, EVENT + 4]
    assert Port(levels(to_bytes(frame), pad=False)).counts == counts(words=2, broken=1, skipped=3)
    port = Port(np.concatenate([levels(to_bytes(part), pad=False) for part in (frame, rest)]))
    assert port.words == [TIME, EVENT, TIME + 9, EVENT + 4] and port.counts == counts(words=4, broken=1, skipped=4)


def test_times_that_wrap():
    words = [0x8FFF_FFFF, EVENT, 0x8000_0000, EVENT + 1, 0x8000_FFFF, EVENT + 2]
    assert Port(levels(to_bytes(words), pad=False)).words == words


def test_pause_and_resume(rng):
    words = stream(rng, 200)
    pins = levels(to_bytes(words))
    port = Port(pins, inputs={300: {"enable": 0}, 600: {"enable": 1}})
    assert 0 < port.counts["skipped"] == len(words) - len(port.words) and port.counts["words"] == len(port.words)
    # 300 cycles of the sensor's clock are some 73 words, and up to a time word.
    assert 50 < port.counts["skipped"] < 110
    _times_are_right(port.words, words)
    assert port.words[-1] == words[-1]
    asleep = Port(pins, start=False)
    assert asleep.words == [] and asleep.counts == counts(skipped=len(words), padding=-len(words) % 16)
