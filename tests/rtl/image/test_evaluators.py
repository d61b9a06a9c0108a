"""Evaluators and their images against the models: every sum of rounds beside any centre, one after the other."""

import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from cmfpga.config.schedule import DISTANCES
from cmfpga.protocol.confidence import beside
from cmfpga.reference.integer.image import accumulator, gradient_reader, voter, warp
from cmfpga.rtl import payloads
from cmfpga.rtl.image import evaluators, image_of, one_pass_gradient, one_pass_image
from cmfpga.rtl.sliding.placer import placed_event
from support.bench import play
from support.configs import ROUNDS
from support.mutation import break_blocks
from support.values import edge_integers, tensor


class Rounds(wiring.Component):
    def __init__(self, config, event=None):
        self.evaluators, self.image = evaluators.Evaluators(config, event), image_of(config)(config, in_flight=9)
        super().__init__(
            {name: self.evaluators.signature.members[name] for name in ("i", "centre", "distance", "level")}
            | {"next": In(1), "complete": Out(1), "squares": Out(payloads.squares(config))}
            | {"o": self.image.signature.members["sums"]}
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.evaluators, m.submodules.image = block, image = self.evaluators, self.image
        for name in ("centre", "distance", "level"):
            m.d.comb += getattr(block, name).eq(getattr(self, name))
        connect(m, flipped(self.i), block.i)
        votes = [image.votes] if len(block.o) == 1 else image.votes
        for o, taken in zip(block.o, votes, strict=True):
            connect(m, o, taken)
        connect(m, image.sums, flipped(self.o))
        m.d.comb += [image.next.eq(self.next), self.complete.eq(image.complete), self.squares.eq(image.squares)]
        return m


def rounds(config, rng, count, around=0):
    """``(x, y, dt, centre, number of the distance, level)`` of so many rounds of one to many events."""
    one, half, fmt = 1 << config.dt_frac, (1 << config.dither_frac) >> 1, config.formats.v
    for k in range(count):
        n = (1, 40, 2, 5)[k % 4]
        places = [
            edge_integers(rng, -half - around, ((size - 1) << config.dither_frac) + max(0, half - 1) + around, n)
            for size in (config.roi_width, config.roi_height)
        ]
        if k % 4 == 1:  # all in one place
            places = [place[:1].repeat(n) for place in places]
        # At the format's ends the four velocities are beyond it.
        centre = edge_integers(rng, fmt.min, fmt.max, 2) if k % 2 else rng.integers(-one >> 2, one >> 2, 2)
        dt = edge_integers(rng, -one, one, n)
        yield *places, dt, tuple(centre.tolist()), int(rng.integers(5)), int(rng.integers(config.max_level + 1))


def wanted(config, x, y, dt, centre, number, level):
    """Sums, and Σ I², of each of a round's evaluations."""
    x, y, dt = (tensor(one.tolist()) for one in (x, y, dt))
    for v in beside(centre, DISTANCES[number] << (config.v_frac - 2)):
        images = accumulator(config, voter(config, *warp(config, x, y, dt, v, level), dt, level))
        sums = gradient_reader(images)
        assert not sums.dx and not sums.dy
        yield sums.named(config), int((images.i**2).sum())


def check(config, rng, count=8, slides=False):
    """Cycles from a round's last evaluation to its last sums, when it has been compared."""
    block, around = Rounds(config), 0
    if slides:
        placed = placed_event(config)
        rest = {name: placed[name].shape for name in ("x", "y", "last")}
        block = Rounds(config, payloads.layout(dt=payloads.Fixed(config.formats.dt), **rest))
        around = min(config.roi_width, config.roi_height) << config.dither_frac
    pace, idle = 1 << config.geometry.turn_bits, config.one_pass.latency
    script = [{}] * (2 * config.geometry.bank_depth)  # the sweep after a reset
    right, ends = [], []
    for x, y, dt, centre, number, level in rounds(config, rng, count, around):
        begin = len(script)
        script.append({"centre": dict(zip("xy", centre, strict=True)), "distance": number, "next": 1})
        for k, event in enumerate(zip(dt.tolist(), x.tolist(), y.tolist(), strict=True)):
            payload = dict(zip(("dt", "x", "y"), event, strict=True)) | {"last": k == len(x) - 1}
            script += [{"i.valid": 1, "i.payload": payload}, *[{}] * (pace - 1)]
        ends.append(len(script) - 1 + block.evaluators.latency + block.image.latency)
        script += [{}] * idle
        script[begin:] = [cycle | {"level": level} for cycle in script[begin:]]
        right += wanted(config, x, y, dt, centre, number, level)
    recording = play(block, script, watch=("squares", "complete"))
    assert recording.values() == [sums for sums, _ in right]
    cycles = recording.cycles()
    assert cycles == [end - 3 + k for end in ends for k in range(4)]
    assert [recording.watch["squares"][cycle] for cycle in cycles] == [squares for _, squares in right]
    complete = [cycle for cycle, value in enumerate(recording.watch["complete"]) if value]
    assert complete == [end - block.image.latency for end in ends]


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("name", ROUNDS)
def test_sums_are_the_models(name, count, rng):
    check(ROUNDS[name].replace(evaluators=count), rng)


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("name", ROUNDS)
def test_events_around_the_image_of_a_window_that_slides(name, count, rng):
    check(ROUNDS[name].replace(evaluators=count), rng, slides=True)


MUTANTS = {  # evaluators, module, old, new
    "three times dt": (4, evaluators, "(event.dt << 1) + event.dt", "(event.dt << 1) + 1"),
    "distances of a power of two": (1, evaluators, "dt << quarters.bit_length() - 1", "dt << quarters.bit_length()"),
    "other distances": (4, evaluators, "three << (quarters // 3).bit_length() - 1", "three"),
    "above and below": (4, evaluators, '("_below", ""), ("_above", "")', '("_above", ""), ("_below", "")'),
    "x for y": (4, evaluators, '("", "_below"), ("", "_above")', '("_below", ""), ("", "_above")'),
    "signs in turn": (1, evaluators, "Mux(below, -beside_s2, beside_s2)", "Mux(below, beside_s2, -beside_s2)"),
    "turns of y": (1, evaluators, "m.If(~own)", "m.If(0)"),
    "an event does not stay": (1, evaluators, "0b1111", "0b0111"),
    "one image for all": (1, evaluators, "Cat(number_s1, vote.address)", "vote.address << 2"),
    "last too early": (1, evaluators, "last & ~left[1]", "last"),
    "sums of another turn": (1, one_pass_gradient, "self._turns - 1, name=", "self._turns, name="),
    "begins for one alone": (1, one_pass_gradient, "over &= turn == self._turns - 1", "over &= 1"),
    "ΣI of another turn": (1, one_pass_gradient, "(self.latency - 2) % self", "(self.latency - 1) % self"),
    "an image for all sums": (4, one_pass_image, "select(turn, [image.sums", "select(0 * turn, [image.sums"),
    "squares of one image": (4, one_pass_image, "select(turn, [image.squares", "select(0 * turn, [image.squares"),
    "no other tag": (4, one_pass_image, "image.next.eq(self.next)", "image.next.eq(0)"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_what_is_broken_is_noticed(name, monkeypatch, rng):
    count, *change = MUTANTS[name]
    break_blocks(monkeypatch, *change)
    with pytest.raises(AssertionError):
        check(ROUNDS["fast odd"].replace(evaluators=count, roi_width=39, roi_height=29), rng)
