"""What a window tells: the flow of known scenes, counts, positions, the events moved back."""

import csv
import dataclasses
import io

import numpy as np
import pytest

from cmfpga.dense.window import BORDER, TABLE, Window
from cmfpga.imaging.camera import seen
from cmfpga.imaging.iwe import dithered, image_of_warped_events
from cmfpga.protocol.confidence import CALIBRATED_AT, uncertainty
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import BatchResult
from support.flowing import CAMERA, OMEGA, VELOCITY, measured


def errors(window, true):
    """Of trusted tiles, px per half window."""
    return np.hypot(*(window.px_per_s - true)[window.trusted].T) * window.half_s


def true_turn(window):
    return 100.0 * np.einsum("akn,k->na", CAMERA.rotation(*CAMERA.rays(*window.centres.T)), OMEGA)


@pytest.mark.parametrize("engine", ["model", "float"])
def test_the_flow_of_what_slides(sliding, engine):
    window = measured(sliding.recording(), engine=engine, window_events=9000, windows=1)[0][0]
    found = errors(window, VELOCITY)
    assert len(found) >= 20 and np.median(found) < 0.35 and (found < 1).mean() >= 0.9
    assert abs(window.moved - np.hypot(*VELOCITY) * window.half_s) < 0.3


def test_the_flow_of_a_turning_camera(turned):
    found = errors(turned, true_turn(turned))
    assert len(found) >= 10 and np.median(found) < 0.35 and (found < 1).mean() >= 0.9
    # No single velocity is near all of them.
    assert np.median(errors(turned, np.median(true_turn(turned), axis=0))) > 2 * np.median(found)


def in_tiles(window, x, y):
    """Of each tile which events are in it."""
    for left, top in window.tiles.corners:
        yield (x >= left) & (x < left + 32) & (y >= top) & (y < top + 32)


def test_counts_are_those_of_the_events_in_each_tile(slid):
    outcomes = slid.tiles.of(slid.result)
    for inside, outcome in zip(in_tiles(slid, slid.events.x, slid.events.y), outcomes, strict=True):
        assert outcome.roi_events + outcome.thinned + outcome.overflow == inside.sum()
    assert [one.roi_events for one in outcomes] == slid.counts.tolist() and slid.outside == 0


def test_what_a_tile_states_is_wider_than_a_region_that_follows(slid):
    root = np.sqrt([one.roi_events + one.thinned + one.overflow for one in slid.tiles.of(slid.result)])
    assert np.isnan(slid.covariance[~slid.sure]).all()
    sure = slid.sure & ~slid.short  # those have a bias beside
    assert sure.any()
    wanted = BORDER / CALIBRATED_AT**0.5 * root[sure, None] * slid.uncertainty[sure]
    assert slid.covariance[sure] == pytest.approx(wanted)
    size = np.array(
        [uncertainty(slid.config, one) for one, yes in zip(slid.tiles.of(slid.result), sure, strict=True) if yes]
    )
    assert slid.uncertainty[sure] == pytest.approx(size / slid.half_s**2)


def test_centres_are_means_of_the_events_positions(turned):
    at = seen(turned.config, turned.events)
    inside_each = in_tiles(turned, *(np.floor(axis + 0.5) for axis in (at.x, at.y)))
    for inside, centre in zip(inside_each, turned.centres, strict=True):
        assert centre == pytest.approx((at.x[inside].mean(), at.y[inside].mean()), abs=1e-6)


def test_the_flow_between_tiles_is_bilinear_and_fills_what_is_not_trusted(slid):
    rising = [dataclasses.replace(one, v=(0.01 * x, -0.02 * y), flags=Flag(0)) for one, (x, y) in
              zip(slid.tiles.of(slid.result), slid.tiles.corners, strict=True)]  # fmt: skip
    lost = 9  # inside of the grid
    rising[lost] = dataclasses.replace(rising[lost], v=(9.0, 9.0), flags=Flag.DOUBTFUL)
    told = dataclasses.replace(slid.result, regions=(*slid.result.regions[: -len(slid.tiles)], *rising))
    made = Window(0, slid.config, slid.events, told, slid.tiles)
    x, y = np.array([15.5, 40.0, 111.5, 200.0, 15.5]), np.array([15.5, 47.5, 20.0, 15.5, -50.0])
    vx, vy = made.flow_at(x, y)
    assert vx[0] == pytest.approx(0.0) and vx[2:4] == pytest.approx([0.96, 0.96]) and vx[4] == pytest.approx(0.0)
    assert vy[[0, 2, 3, 4]] == pytest.approx([0, -0.02 * 4.5, 0, 0])
    left, top = slid.tiles.corners[lost]
    filled = made.flow_at(np.array([left + 15.5]), np.array([top + 15.5]))[:, 0]
    assert filled == pytest.approx((0.01 * left, -0.02 * top), abs=0.01)


def test_moved_back_the_events_are_nearly_as_sharp_as_at_the_true_motion(slid):
    still, moved = slid.images()
    x, y = dithered(slid.events.x, slid.events.y)
    dt = 2 * (slid.events.t - slid.events.t[0]) / slid.result.span - 1
    v = np.multiply(VELOCITY, slid.half_s)
    best = image_of_warped_events(x, y, dt, v, width=128, height=96)
    assert moved.var() - still.var() > 0.8 * (best.var() - still.var()) > 0.1
    assert 0.9 * len(slid.events) < moved.sum() <= len(slid.events) + 1e-6


def test_rows_are_those_of_the_tiles(slid):
    file = io.StringIO()
    csv.writer(file).writerows([[*TABLE], *slid.rows()])
    rows = [*csv.DictReader(io.StringIO(file.getvalue()))]
    assert [*rows[0]] == [*TABLE] and len(rows) == len(slid.tiles)
    for k, row in enumerate(rows):
        assert (int(row["x"]), int(row["y"])) == slid.tiles.corners[k]
        assert (row["width"], row["height"], int(row["events"])) == ("32", "32", slid.counts[k])
        assert float(row["t_ref_us"]) == slid.t_ref
        degenerate = "degenerate" in row["flags"].split("|")
        assert degenerate == (row["vx_px_per_s"] == "") == (row["confidence"] == "")
        if not degenerate:
            assert float(row["vy_px_per_s"]) == pytest.approx(slid.px_per_s[k, 1], abs=1e-3)


def test_a_window_without_events(slid):
    nothing = BatchResult.nothing(*[{"roi": one.roi, "roi_next": one.roi, "v": one.v} for one in slid.result.regions])
    empty = Window(3, slid.config, slid.events[:0], nothing, slid.tiles)
    assert empty.t_ref is None and empty.moved is None and not empty.trusted.any()
    assert all(row[1] == "" and row[-1] == "degenerate" for row in empty.rows())
    assert all((image == 0).all() for image in empty.images())
