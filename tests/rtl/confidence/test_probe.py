"""The probe against the velocities that it names, in their cycle; and what it keeps of the last iteration."""

import pytest

from cmfpga.config import preset
from cmfpga.protocol.confidence import probe_velocities
from cmfpga.rtl import payloads
from cmfpga.rtl.confidence import probe as module
from cmfpga.rtl.confidence.probe import Probe
from support.bench import play
from support.mutation import mutated
from support.values import random_value

CONFIG = preset("fast")
FMT = CONFIG.formats.v
EDGES = [(0, 0), (FMT.max, FMT.min), (FMT.min, FMT.max), (FMT.max - 48, FMT.min + 48), (FMT.max - 47, FMT.min + 47)]


def played(probe, rng):
    """``(recording, expected)`` of v at the edges of its format and anywhere; iterations complete between them."""
    script, expected = [], []
    for x, y in EDGES + rng.integers(FMT.min, FMT.max + 1, (20, 2)).tolist():
        v = {"v": {"x": x, "y": y}}
        script += [v | {"complete": 1}, {}, {"complete": 1}, {}, {}, {}]
        wanted = [*probe_velocities((x, y), 3 << (FMT.f - 2), FMT.min, FMT.max), (x, y)]
        for k, (name, one) in enumerate(zip(["begin"] + ["complete"] * 4, wanted, strict=True)):
            expected.append((len(script) + probe.latency - 1, dict(zip("xy", one, strict=True)), k < 4))
            script += [{name: 1}, *[{}] * 5]
    return play(probe, script, watch=("more",)), expected


def check(probe, rng):
    recording, expected = played(probe, rng)
    assert recording.flows["o"] == [(cycle, velocity) for cycle, velocity, _ in expected]
    more = {cycle for cycle, value in enumerate(recording.watch["more"]) if value}
    begun = [cycle for cycle, _, probed in expected if probed]
    # From the cycle after ``begin`` on, while less than four probes are complete.
    assert more == {c - 1 + k for n, c in enumerate(begun) if n % 4 < 3 for k in range(6)}


def test_four_velocities_on_either_side_of_v(rng):
    check(Probe(CONFIG), rng)


def test_the_last_iteration_is_kept(rng):
    sums = [random_value(payloads.sums(CONFIG), rng) for _ in range(4)]
    script = [
        {"sums.payload": one, "squares": k, "sums.valid": valid, "iterating": iterating}
        for k, (one, valid, iterating) in enumerate(zip(sums, (1, 1, 0, 1), (1, 1, 1, 0), strict=True), 1)
    ]
    recording = play(Probe(CONFIG), [*script, {}, {"new_batch": 1}, {}], watch=("last", "last_squares"))
    assert recording.watch["last_squares"] == [0, 1, 2, 2, 2, 2, 0]
    assert recording.watch["last"][1:6] == [sums[0], *[sums[1]] * 4] and not any(recording.watch["last"][6].values())


@pytest.mark.parametrize(
    "old, new",
    [
        ("saturate(probed, fmt.min, fmt.max)", "probed"), ("turn[:3].any()", "turn[:2].any()"),
        ("Mux(below, -distance,", "Mux(below, distance,"), ("3 << (", "2 << ("), ("turn << 1", "turn << 2"),
        ("self.complete & turn.any()", "self.complete & turn[:3].any()"), ("& turn.any()", "& 1"),
    ],
)  # fmt: skip
def test_another_probe_would_be_noticed(old, new, rng):
    mutant = mutated(module, old, new)
    with pytest.raises(AssertionError):
        check(mutant.Probe(CONFIG), rng)
