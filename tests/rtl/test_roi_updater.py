"""ROI updater against its model: a position that keeps its fraction, limited to the sensor at every border."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.batch import clamp_roi, crop_position
from cmfpga.config import Config
from cmfpga.reference.integer.roi_updater import roi_updater
from cmfpga.rtl.roi_updater import RoiUpdater

from .bench import CONFIGS, ODD, TINY, corners, edge_integers, held, integers_at_edges, np, play, random_value

SHAPES = {
    **{name: CONFIGS[name] for name in ("default", "narrow", "odd", "tiny")},
    # The ROI is the sensor: it cannot move. One column and one row of freedom. A gain without fraction bits.
    "whole": Config(roi_width=240, roi_height=180),
    "one": Config(**TINY).replace(sensor_width=3, sensor_height=3),
    "whole gain": Config(**ODD, v_frac=1, roi_gain_frac=0),
}


def check(config, batches, seed=0):
    """Batches of (corner to load or None, v, gain, whether to move); compares corner and flag in every cycle."""
    rng = np.random.default_rng(seed)
    block = RoiUpdater(config)
    script, position, clamped = [], (0, 0), False
    timeline = {0: ((0, 0), False)}

    def cycle(**values):
        # Nothing counts without its strobe.
        noise = {"x": random_value(config.x_bits, rng), "y": random_value(config.y_bits, rng)}
        noise |= {"v": random_value(block.v.shape(), rng), "roi_gain": random_value(config.roi_gain_format.width, rng)}
        noise["load"] = 0 if "new_batch" in values else int(rng.integers(2))
        script.append({**noise, **values})

    def note(at):
        timeline[at] = tuple(crop_position(config, axis) for axis in position), clamped

    cycle()
    for load, v, gain, move in batches:
        clamped = False
        if load is None:
            cycle(new_batch=1)
        else:
            cycle(new_batch=1, load=1, x=load[0], y=load[1])
            corner, clamped = clamp_roi(config, load)
            position = tuple(axis << config.roi_x_format.f for axis in corner)
        note(len(script))
        for _ in range(int(rng.integers(3))):
            cycle()
        if move:
            start = len(script)
            # v and the gain stand from `move` on.
            for number in range(block.latency):
                cycle(**({"move": 1} if number == 0 else {}), v={"x": v[0], "y": v[1]}, roi_gain=gain)
            position, limited = roi_updater(config, position, v, roi_gain=gain)
            clamped |= limited
            note(start + block.latency)
        cycle()
    recording = play(block, script, flows=(), watch=("roi", "clamped")).watch
    for number, wanted in enumerate(held(timeline, len(script))):
        roi = recording["roi"][number]
        assert ((roi["x"], roi["y"]), bool(recording["clamped"][number])) == wanted, f"cycle {number}"
    return list(timeline.values())


def random_batches(config, rng, count):
    batches = []
    for _ in range(count):
        load = None
        if rng.random() < 0.3:
            load = int(rng.integers(config.sensor_width)), int(rng.integers(config.sensor_height))
        fast = rng.random() < 0.3
        limits = (config.v.min, config.v.max) if fast else (-2 << config.v_frac, 2 << config.v_frac)
        gain = edge_integers(rng, 0, config.roi_gain_format.max, 1)[0]
        batches.append((load, tuple(edge_integers(rng, *limits, 2).tolist()), int(gain), rng.random() < 0.8))
    return batches


@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, rng):
    timeline = check(SHAPES[name], random_batches(SHAPES[name], rng, 150))
    assert {clamped for _, clamped in timeline} == {False, True}


@pytest.mark.parametrize("name", SHAPES)
def test_clamps_at_every_border(name):
    """To the first and last column and row, from one unit short of it to far beyond; the flag for a unit too much."""
    config = SHAPES[name]
    unit = 1 << config.roi_gain_frac  # gain 1
    small, whole = 1, 1 << config.v_frac
    batches = []
    for corner in [(x, y) for x in (0, config.roi_x_max) for y in (0, config.roi_y_max)]:
        for v in (small, whole, -small, -whole, config.v.max, config.v.min):
            batches += [
                (corner, (v, 0), unit, True),
                (corner, (0, v), unit, True),
                (corner, (v, -v - (v < 0)), unit, True),
            ]
            # Exactly back to the border sets no flag.
            batches += [(corner, (0, 0), unit, True), (corner, (0, 0), 0, True)]
    check(config, batches)


def test_load_out_of_range():
    """Every corner beyond the last one is limited and flagged; the last one is not."""
    config = SHAPES["odd"]
    loads = [(config.roi_x_max + dx, config.roi_y_max + dy) for dx in (0, 1, 2) for dy in (0, 1, 2)]
    loads += [(63, 0), (0, 31), (63, 31), (0, 0)]
    timeline = check(config, [(load, (0, 0), 0, False) for load in loads])
    wanted = [load[0] > config.roi_x_max or load[1] > config.roi_y_max for load in loads]
    assert [clamped for _, clamped in timeline[1:]] == wanted


def test_flag_sticks_until_the_next_batch():
    config = SHAPES["odd"]
    still = (None, (0, 0), 16, True)
    # Loaded out of range, then a move that stays inside: still flagged. The next batch clears it.
    timeline = check(config, [((60, 0), (-4096, 0), 16, True), still, (None, (config.v.max, 0), 63, True), still])
    assert [clamped for _, clamped in timeline] == [False, True, True, False, False, False, True, False, False]


def test_slow_motion_adds_up_and_halves_round_up():
    """An eighth of a pixel per batch: the corner follows after four batches, and moves once in eight."""
    config = SHAPES["default"]
    eighth = 1 << (config.v_frac - 3)
    gain = 1 << config.roi_gain_frac
    timeline = check(config, [((10, 20), (0, 0), gain, False), *[(None, (eighth, -eighth), gain, True)] * 20])
    corners = [corner for corner, _ in timeline[2:]][1::2]
    # 10 + n/8 rounds up at the half; 20 − n/8 stays until it is below the half.
    assert [x for x, _ in corners] == [10 + (n + 4) // 8 for n in range(1, 21)]
    assert [y for _, y in corners] == [20 + (4 - n) // 8 for n in range(1, 21)]


def test_latency():
    """``move`` takes ``latency`` cycles, ``new_batch`` one (asserted in every cycle by ``check``)."""
    assert RoiUpdater.latency == 3
    check(SHAPES["default"], [((50, 50), (8192, 8192), 32, True)])


@corners
@given(st.data())
def test_corners(data):
    config = SHAPES[data.draw(st.sampled_from(sorted(SHAPES)))]
    velocity = integers_at_edges(config.v.min, config.v.max)
    load = st.tuples(integers_at_edges(0, config.sensor_width - 1), integers_at_edges(0, config.sensor_height - 1))
    batch = st.tuples(
        st.one_of(st.none(), load),
        st.tuples(velocity, velocity),
        integers_at_edges(0, config.roi_gain_format.max),
        st.booleans(),
    )
    check(config, data.draw(st.lists(batch, min_size=5, max_size=20)))
