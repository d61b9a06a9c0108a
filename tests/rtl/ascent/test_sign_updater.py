"""Sign updater against its model: a step of the schedule by the sign of G, each axis by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.reference.integer.updater import sign_updater
from cmfpga.rtl.ascent.sign_updater import SignUpdater
from support.bench import held, play
from support.configs import LEVELS
from support.values import corners, edge_integers, integers_at_edges, random_value

SHAPES = {
    **{name: LEVELS[name] for name in ("fast", "fast tiny", "fast wide")},
    # Four values of v on each side of zero.
    "few bits": LEVELS["fast"].replace(v_int=1, v_frac=1, cold="0:0", warm="0:-1"),
    # G wider than 64 bits would be refused; this is as wide as it gets here.
    "full-frame": LEVELS["fast"].replace(roi_width=240, roi_height=180, buffer_events=8192, tag_bits=10),
}


def check(config, batches, *, spacing=0, seed=0):
    """Batches of (start or None to keep v, list of (shift, Gx, Gy)); compares everything in every cycle."""
    rng = np.random.default_rng(seed)
    block = SignUpdater(config)
    script, entered, v, saturated = [], [], (0, 0), False
    timeline = {0: (v, saturated)}

    def cycle(**values):
        # Neither a gradient nor a start velocity counts without its strobe; the step counts one cycle after one.
        noise = {
            name: random_value(port.shape(), rng)
            for name, port in (("i.payload", block.i.payload), ("start", block.start), ("shift", block.shift))
        }
        script.append(noise | values)

    def xy(pair):
        return dict(zip("xy", pair, strict=True))

    for start, steps in batches:
        cycle(new_batch=1)
        saturated = False
        timeline[len(script)] = v, saturated
        if start is not None:
            cycle(load=1, start=xy(start))
            v = start
            timeline[len(script)] = v, saturated
        cycle()
        for shift, *g in steps:
            entered.append(len(script))
            # As in the core: the entry's step stands from before the gradient until v has changed.
            cycle(**{"i.valid": 1, "i.payload": xy(g), "shift": shift})
            for _ in range(block.latency - 1):
                cycle(shift=shift)
            moved = [
                sign_updater(config, axis_v, axis_g, log2_step=shift - config.formats.v.f)
                for axis_v, axis_g in zip(v, g, strict=True)
            ]
            v = moved[0][0], moved[1][0]
            saturated |= moved[0][1] or moved[1][1]
            timeline[entered[-1] + block.latency] = v, saturated
            for _ in range(spacing):
                cycle()
        for _ in range(3):
            cycle()

    recording = play(block, script, flows=(), watch=("v", "saturated", "updating", "done")).watch
    for number, wanted in enumerate(held(timeline, len(script))):
        velocity = recording["v"][number]
        got = (velocity["x"], velocity["y"]), bool(recording["saturated"][number])
        assert got == wanted, f"cycle {number}"
    for name, after in (("done", block.latency), ("updating", block.latency - 1)):
        assert [n for n, value in enumerate(recording[name]) if value] == [n + after for n in entered]
    return list(timeline.values())


def random_g(config, rng):
    """Anything from one unit to the bound, and zero."""
    if rng.random() < 0.3:
        return int(rng.choice([0, -1, 1, config.widths.g_max, -config.widths.g_max]))
    return int(2.0 ** rng.uniform(0, config.widths.g_bits - 1)) * int(rng.choice([-1, 1]))


def random_batches(config, rng, count, iterations=15):
    batches = []
    for number in range(count):
        start = (
            tuple(edge_integers(rng, config.formats.v.min, config.formats.v.max, 2).tolist()) if number % 3 else None
        )
        steps = [
            (int(rng.integers(config.formats.v.width - 1)), random_g(config, rng), random_g(config, rng))
            for _ in range(iterations)
        ]
        batches.append((start, steps))
    return batches


@pytest.mark.parametrize("spacing", [0, 3])
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, spacing, rng):
    config = SHAPES[name]
    timeline = check(config, random_batches(config, rng, 8), spacing=spacing)
    assert len({v for v, _ in timeline}) > 10 and {flag for _, flag in timeline} == {False, True}


@pytest.mark.parametrize("name", SHAPES)
def test_every_step_from_every_end(name):
    """Steps of every size from zero and from both ends of v, up, down and not at all; limited to the unit."""
    config = SHAPES[name]
    low, high = config.formats.v.min, config.formats.v.max
    batches = []
    for shift in range(config.formats.v.width - 1):
        step = 1 << shift
        for start in {0, low, high, *(high - step + near for near in (0, 1)), *(low + step + near for near in (-1, 0))}:
            start = min(max(start, low), high)
            batches += [((start, -1 - start), [(shift, sign, -sign)]) for sign in (-1, 0, 1)]
    timeline = check(config, batches)
    assert {v[0] for v, _ in timeline} >= {low, high}


def test_the_axes_are_independent():
    """The sign of one axis and its saturation leave the other alone; each of them raises the flag."""
    config = SHAPES["fast"]
    top = config.formats.v.max
    for axis in (0, 1):
        for sign in (-1, 1):
            g, start = [0, 0], [7, 7]
            g[axis], start[axis] = sign, top if sign > 0 else config.formats.v.min
            timeline = check(config, [(tuple(start), [(3, *g)])])
            assert timeline[-1] == (tuple(start), True)


def test_the_flag_sticks_and_v_stays(rng):
    """Saturation is remembered until the next batch; without ``load`` v goes on from where it was."""
    config = SHAPES["fast"]
    top = config.formats.v.max
    timeline = check(
        config, [((top - 1, 0), [(2, 1, 1), (0, -1, 0), (0, 0, 0)]), (None, [(0, -1, 1)]), ((5, 6), [(1, 1, -1)])]
    )
    assert timeline[-1] == ((7, 4), False) and ((top - 2, 5), False) in timeline
    assert [flag for _, flag in timeline[3:7]] == [True, True, True, False]


@corners
@given(st.data())
def test_corners(data):
    config = SHAPES[data.draw(st.sampled_from(sorted(SHAPES)))]
    velocity = integers_at_edges(config.formats.v.min, config.formats.v.max)
    g = integers_at_edges(-config.widths.g_max, config.widths.g_max)
    step = st.tuples(st.integers(0, config.formats.v.width - 2), g, g)
    batch = st.tuples(st.one_of(st.none(), st.tuples(velocity, velocity)), st.lists(step, min_size=1, max_size=6))
    check(config, data.draw(st.lists(batch, min_size=1, max_size=4)), spacing=data.draw(st.integers(0, 2)))
