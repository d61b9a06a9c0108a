"""``python -m studies.accuracy --flow``: what it counts, and the bars on real recordings; ``--study large``."""

import numpy as np
import pytest
from studies.accuracy.yardstick import best_contrast

from studies.accuracy import dense, large
from support.flowing import OMEGA, VELOCITY


def test_the_searched_flow_is_that_of_the_tiles_own_events(slid):
    chosen = np.arange(len(slid.tiles)) == int(np.argmax(slid.kappa))
    found = dense.searched(slid, chosen, iter)
    assert np.isnan(found[~chosen]).all()
    assert found[chosen][0] == pytest.approx(np.multiply(VELOCITY, slid.half_s), abs=0.35)
    (x, y), region = slid.tiles.corners[int(chosen.argmax())], slid.tiles.regions[-1]
    events = slid.events
    inside = (events.x >= x) & (events.x < x + 32) & (events.y >= y) & (events.y < y + 32)
    dt = 2 * (events.t - events.t[0]) / slid.result.span - 1
    left, top = region.corner(slid.config)
    plain, _ = best_contrast((events.x - x + left)[inside], (events.y - y + top)[inside], dt[inside], rounds=2)
    assert tuple(found[chosen][0]) == plain


def test_a_turning_cameras_field(turned):
    field = dense.turned(turned, OMEGA)
    away = np.hypot(*(turned.v - field)[turned.trusted].T)
    assert np.median(away) < 0.35 < 1 < np.median(np.hypot(*field.T))


@pytest.mark.usefixtures("long_tools")
def test_without_recordings_it_is_the_scene_alone(written, capsys):
    (kept,) = written("--flow")["results"].values()
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert len(lines) == 3 and lines[2].startswith("| synthetic")
    assert kept["scores"]["tiles"] == len(kept["values"]) > 140
    assert kept["scores"]["median_px"] == pytest.approx(np.median(kept["values"]))
    assert kept["scores"]["median_px"] < 0.31


def test_the_bars_on_real_recordings(written, data_dir, monkeypatch):
    monkeypatch.setattr(dense, "VARIANTS", dense.VARIANTS[:0])
    found = written("--flow", "--data", data_dir)["results"]
    poster, *others = (found[f"flow, {name}"]["scores"] for name in dense.WINDOWS)
    assert poster["median_px"] <= 0.2 and poster["below_1_px"] >= 0.98 and poster["degenerate"] == 0
    assert poster["rotation_off_deg_per_s"] <= 2 + 0.04 * 37.7
    for scores in others:
        assert scores["trusted"] >= 0.55 and scores["trusted_below_0.5_px"] >= 0.9


def test_half_of_a_window_and_smaller_tiles(written, data_dir, monkeypatch):
    monkeypatch.setattr(dense, "WINDOWS", {"davis240c_poster_rotation_0.6s.h5": True})
    found = written("--flow", "--data", data_dir)["results"]
    _, whole, half, small = (one["scores"] for one in found.values())
    assert small["tiles"] > 1.5 * whole["tiles"] >= 1.5 * half["tiles"]
    assert min(half["median_px"], small["median_px"]) > 1.2 * whole["median_px"]


@pytest.mark.usefixtures("long_tools")
def test_on_large_sensors_what_is_wrong_goes_and_what_is_right_stays(written, monkeypatch, capsys):
    """The tiles around take it out."""
    monkeypatch.setattr(large, "SENSORS", ((480, 360, 0.55),))
    monkeypatch.setattr(large, "FIELDS", {name: large.FIELDS[name] for name in ("zoom", "two motions")})
    told = written("--study", "large", "--batches", "1", "--seeds", "1-2")
    found = told["results"]["large, sum, 480×360, 0.55"]["scores"]
    assert found["right_before"] < 0.85 * found["before"], "the scene has tiles that are wrong"
    assert found["right_after"] > 0.9 * found["after"] and found["right_after"] > 0.85 * found["right_before"]
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert len(lines) == 2 + 3 and lines[-1].startswith("| sum")
