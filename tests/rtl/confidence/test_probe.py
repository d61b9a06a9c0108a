"""The probe against the velocities that it names, in their cycle; and what it keeps of the last iteration."""

import pytest

from cmfpga.config import preset
from cmfpga.protocol.confidence import probes_towards_zero
from cmfpga.rtl import payloads
from cmfpga.rtl.confidence import probe
from support.bench import play
from support.mutation import break_blocks
from support.values import random_value

CONFIG = preset("similarity")


def anywhere(config, rng):
    """``(v, what is probed of it)``: at the edges of its format, around 0, and anywhere."""
    parameters, distance = config.motion_model.parameters, 3 << (config.v_frac - 2)
    for kind in range(25):
        v = [(p.fmt.min, p.fmt.max, 0, -1)[kind] if kind < 4 else int(rng.integers(p.fmt.min, p.fmt.max + 1))
             for p in parameters]  # fmt: skip
        yield v, probes_towards_zero(v, distance)


def check(block, rng):
    script, expected, names = [], [], block.config.motion_model.names
    for v, probed in anywhere(block.config, rng):
        script += [{"v": dict(zip(names, v, strict=True)), "complete": 1}, {}, {"complete": 1}, {}, {}, {}]
        for k, (name, one) in enumerate(zip(["begin"] + ["complete"] * block.count, [*probed, v], strict=True)):
            expected.append((len(script) + block.latency - 1, dict(zip(names, one, strict=True)), k < block.count))
            script += [{name: 1}, *[{}] * 5]
    recording = play(block, script, watch=("more",))
    assert recording.flows["o"] == [(cycle, velocity) for cycle, velocity, _ in expected]
    more = {cycle for cycle, value in enumerate(recording.watch["more"]) if value}
    begun = [cycle for cycle, _, probed in expected if probed]
    # From the cycle after ``begin`` on, while less than all probes are complete.
    assert more == {c - 1 + k for n, c in enumerate(begun) if (n + 1) % block.count for k in range(6)}


@pytest.mark.parametrize("motion", ["similarity", "rotation"])
def test_velocities_beside_v(motion, rng):
    check(probe.Probe(preset(motion)), rng)


def test_the_last_iteration_is_kept(rng):
    sums = [random_value(payloads.sums(CONFIG), rng) for _ in range(4)]
    script = [
        {"sums.payload": one, "squares": k, "sums.valid": valid, "iterating": iterating}
        for k, (one, valid, iterating) in enumerate(zip(sums, (1, 1, 0, 1), (1, 1, 1, 0), strict=True), 1)
    ]
    recording = play(probe.Probe(CONFIG), [*script, {}, {"new_batch": 1}, {}], watch=("last", "last_squares"))
    assert recording.watch["last_squares"] == [0, 1, 2, 2, 2, 2, 0]
    assert recording.watch["last"][1:6] == [sums[0], *[sums[1]] * 4] and not any(recording.watch["last"][6].values())


@pytest.mark.parametrize("old, new", [
    ("turn[:-1].any()", "turn[:-2].any()"), ("3 << (", "2 << ("), ("turn << 1", "turn << 2"),
    ("self.complete & turn.any()", "self.complete & turn[:3].any()"), ("& turn.any()", "& 1"),
    ("Mux(v[-1], distance", "Mux(~v[-1], distance"), ("Mux(turn[k],", "Mux(turn[0],"),
])  # fmt: skip
def test_another_probe_would_be_noticed(old, new, monkeypatch, rng):
    break_blocks(monkeypatch, probe, old, new)
    with pytest.raises(AssertionError):
        check(probe.Probe(CONFIG), rng)
