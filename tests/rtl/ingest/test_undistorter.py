"""Undistorter against its model, and the model against the camera's equations."""

import dataclasses

import numpy as np
import pytest

from cmfpga.config import Config, preset
from cmfpga.errors import ConfigError
from cmfpga.imaging.camera import Camera, node_table, node_writes, undistort
from cmfpga.rtl.ingest import undistorter
from support.bench import GAPS, check_latency, flow_script, play
from support.configs import NARROW, ODD, TINY
from support.mutation import break_blocks
from support.values import random_gaps

ON = {"undistortion": "on"}
SHAPES = {
    "odd": Config(**ODD, **ON),
    "narrow": Config(**NARROW, **ON, undistortion_cell=4, undistortion_frac=8, hot_pixels=1, background=1),
    "tiny": Config(**TINY, **ON, undistortion_cell=1, undistortion_frac=1),
    # The sensor is less than a cell; a node of it has two more bits than a pixel has.
    "one cell": Config(**TINY, **ON, undistortion_cell=6, undistortion_frac=2),
}
#: Measured, of a DAVIS 240C: the barrel that a wide lens has.
DAVIS = (199.092367, 198.82882, 132.192071, 110.71266, -0.368436, 0.150947, -0.000296, -0.000759, 0.0)


def lens_of(config):
    """A camera that moves events at the sensor's border by a tenth of its width."""
    width, height = config.sensor_width, config.sensor_height
    return (0.9 * width, 0.95 * width, 0.47 * width, 0.55 * height, -0.3, 0.08, 0.002, -0.001, 0.01)


def scripted(config, table):
    """The script that writes a table of nodes, int64 [2, rows, columns]."""
    _, rows, columns = table.shape
    return [
        {"write.valid": 1, "write.payload": {"column": c, "row": r, "x": int(table[0, r, c]), "y": int(table[1, r, c])}}
        for r in range(rows)
        for c in range(columns)
    ]


def through(config, rng, events, gap, before, enable=1):
    """What comes out for (x, y) of ``events``: raw positions, without the half pixel that the filter wants."""
    block = undistorter.Undistorter(config)
    marks = {name: 1 for name in block.i.payload.shape().members if name not in ("t", "x", "y", "last")}
    items = [{"t": k % 200, "x": x, "y": y, "last": k % 2, **marks} for k, (x, y) in enumerate(events)]
    script, pushed = flow_script(block, items, random_gaps(rng, len(items), gap), rng)
    begin = [*before, {"start": 1, "enable": enable}]
    recording = play(block, [*begin, *script])
    pushed = [len(begin) + cycle for cycle in pushed]
    recording.flows["o"] = [item for item in recording.flows["o"] if item[0] >= pushed[0]]
    check_latency(block, pushed, recording)
    came = recording.values()
    assert [{**one, "x": None, "y": None} for one in came] == [{**one, "x": None, "y": None} for one in items]
    half = 1 << (config.undistortion_frac - 1)
    return [(one["x"] - half, one["y"] - half) for one in came]


def anywhere(config, rng, count=150):
    """Events in any order; the sensor's corners, and neighbours across the borders of cells, among them."""
    x, y = rng.integers(config.sensor_width, size=count), rng.integers(config.sensor_height, size=count)
    side = 1 << config.undistortion_cell
    x[:40] = np.minimum(x[:40] // side * side + rng.integers(-1, 1, 40).clip(-x[:40] // side), config.sensor_width - 1)
    x, y = x.clip(0), y.clip(0)
    x[-4:], y[-4:] = (0, config.sensor_width - 1) * 2, (0, 0, config.sensor_height - 1, config.sensor_height - 1)
    return list(zip(x.tolist(), y.tolist(), strict=True))


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_hardware_is_the_model(name, gap, rng):
    config = SHAPES[name]
    lens, events = lens_of(config), anywhere(config, rng)
    found = through(config, rng, events, GAPS[gap], scripted(config, node_table(config, lens)))
    wanted = undistort(config, lens, *np.array(events).T)
    assert found == list(zip(*(axis.tolist() for axis in wanted), strict=True))
    assert len(node_writes(config, lens)) == config.geometry.node_columns * config.geometry.node_rows


@pytest.mark.parametrize("name", SHAPES)
def test_any_table_the_largest_numbers_too(name, rng, monkeypatch):
    """As software may write it: no sum overflows, whatever four nodes say."""
    config, formats = SHAPES[name], SHAPES[name].formats
    size = config.geometry.node_rows, config.geometry.node_columns
    table = np.stack([rng.choice([fmt.min, fmt.max, -1, 0, 1], size) for fmt in (formats.node_x, formats.node_y)])
    monkeypatch.setattr("cmfpga.imaging.camera.motion.node_table", lambda *_: table)
    events = anywhere(config, rng)
    wanted = undistort(config, (1,), *np.array(events).T)
    assert through(config, rng, events, 0.0, scripted(config, table)) == list(
        zip(*map(np.ndarray.tolist, wanted), strict=True)
    )


@pytest.mark.parametrize("name", SHAPES)
def test_without_a_camera_nothing_moves_whatever_the_table_holds(name, rng):
    config = SHAPES[name]
    events, frac = anywhere(config, rng), config.undistortion_frac
    assert through(config, rng, events, 0.3, scripted(config, node_table(config, lens_of(config))), enable=0) == [
        (x << frac, y << frac) for x, y in events
    ]
    for lens in ((), (100.0, 90.0, 3.0, 4.0) + (0.0,) * 5):  # none; one without distortion
        found = undistort(config, lens, *np.array(events).T)
        assert list(zip(*map(np.ndarray.tolist, found), strict=True)) == [(x << frac, y << frac) for x, y in events]


def test_a_batch_keeps_what_it_began_with(rng):
    config = SHAPES["odd"]
    block, lens = undistorter.Undistorter(config), lens_of(config)
    script = [*scripted(config, node_table(config, lens)), {"start": 1, "enable": 1}, {"enable": 0}]
    recording = play(block, [*script, {"i.valid": 1, "i.payload": {"t": 0, "x": 3, "y": 4, "last": 0}}, *[{}] * 9])
    wanted = [int(axis[0]) + 8 for axis in undistort(config, lens, [3], [4])]
    assert [(one["x"], one["y"]) for one in recording.values()[-1:]] == [tuple(wanted)]


MUTANTS = {
    "even columns only": ("((column + 1 - odd_column) >> 1)", "(column >> 1)"),
    "even rows only": ("(row + 1 - odd_row) >> 1", "row >> 1"),
    "left is right": ("Mux(from_odd_column, *pair)", "Mux(~from_odd_column, *pair)"),
    "above is below": ("Mux(from_odd_row, *pair)", "Mux(~from_odd_row, *pair)"),
    "a neighbour's place": ('delay(m, event.x[:cell], 4, name="right")', 'delay(m, event.x[:cell], 3, name="right")'),
    "an earlier event's row": ('delay(m, event.y[:cell], 6, name="down")', 'delay(m, event.y[:cell], 5, name="down")'),
    "rounded down": ("(1 << (drop - 1))", "0"),
    "not in the middle": ("Const(1 << (frac - 1), frac)", "Const(0, frac)"),
    "written everywhere": ("& (put.column[0] == odd_column)", ""),
    "always on": ("Mux(enabled, moved, 0)", "Mux(1, moved, 0)"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, rng, monkeypatch):
    old, new = MUTANTS[name]
    break_blocks(monkeypatch, undistorter, old, new)
    with pytest.raises(AssertionError):
        test_hardware_is_the_model("odd", "gaps", rng)
        test_without_a_camera_nothing_moves_whatever_the_table_holds("odd", rng)


def errors(config, camera):
    """Distance of the table's positions from the camera's, px, of all pixels that are seen on the sensor."""
    y, x = (axis.ravel() for axis in np.mgrid[0 : config.sensor_height, 0 : config.sensor_width])
    true = camera.undistorted(x, y)
    found = np.stack(undistort(config, dataclasses.astuple(camera), x, y)) * 2.0**-config.undistortion_frac
    size = np.array([[config.sensor_width], [config.sensor_height]])
    there = ((true > -0.5) & (true < size - 0.5)).all(axis=0)
    return np.hypot(*(found - true))[there]


def test_positions_are_the_cameras_within_a_tenth_of_a_pixel():
    """Figures of docs/motion.md. Rounding alone to 1/16 px: 0.044 px at most, 0.026 px rms."""
    found = errors(preset("fast").replace(**ON), Camera(*DAVIS))
    assert len(found) > 30_000 and found.max() < 0.13 and 0.025 < np.sqrt((found**2).mean()) < 0.032


def test_a_finer_table_and_finer_fractions_come_closer():
    config = preset("fast").replace(**ON)
    means = [
        np.sqrt((errors(config.replace(undistortion_cell=cell, undistortion_frac=frac), Camera(*DAVIS)) ** 2).mean())
        for cell, frac in ((5, 4), (4, 4), (3, 4), (2, 6))
    ]
    assert means == sorted(means, reverse=True) and means[-1] < 0.009


def test_a_distortion_without_inverse_is_refused():
    with pytest.raises(
        ConfigError, match=r"^camera: f = 100, 100 px, centre 120, 90 px, k1 = -0\.9: no ray is seen at "
    ):
        node_table(preset("fast").replace(**ON), (100.0, 100.0, 120.0, 90.0, -0.9, 0.0, 0.0, 0.0, 0.0))
