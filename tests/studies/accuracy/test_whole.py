"""Whole recordings by ``track --roi auto``, and a grid of ROIs on the slider: the rail's truth, and what is needed."""

import json
from itertools import pairwise

import numpy as np

from cmfpga import cli
from studies import accuracy
from studies.accuracy import known, whole


def test_the_slider_by_auto(data_dir):
    """The rail moves along x alone: no trusted window is off along y, and those that are compared share no time."""
    tracking = whole._tracked(data_dir / whole.SLIDER, "model", roi="auto")
    assert tracking.trusted.sum() > 30 and np.abs(tracking.vy[tracking.trusted]).max() < whole.WRONG
    found = whole.apart(tracking)
    assert len(found) >= 3 and all(tracking.trusted[k] for k, *_ in found)
    assert all(one[2] <= two[1] + 1 for one, two in pairwise(found))


def test_the_grid_reaches_all_borders():
    places = np.array(whole.grid((240, 180)))
    assert len({*map(tuple, places)}) == 45 and places.min() == 0
    assert (places.max(axis=0) + whole.ROI == (240, 180)).all()


def test_a_folder_is_needed(capsys, monkeypatch):
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    for study in ("slider", "auto"):
        assert cli.run(accuracy.main, ["--study", study, "--batches", "1"]) == 2
        assert f"--study {study}: --data, a folder of recordings, is needed" in capsys.readouterr().err


def test_drawn_scenes(capsys, monkeypatch, tmp_path):
    """Each seed has its own; what is wrong is counted by the motion that was drawn."""
    monkeypatch.setattr(known, "DRAWN_SIZE", (24, 41))
    monkeypatch.setattr(whole, "PRESETS", ("fast",))
    file = tmp_path / "scores.json"
    assert cli.run(accuracy.main, ["--study", "drawn", "--batches", "2", "--seeds", "1-2", "--json", str(file)]) == 0
    assert "| fast   | 4 " in capsys.readouterr().out
    told = json.loads(file.read_text())["results"]["drawn, fast"]["scores"]
    assert told["batches"] > 20 and told["trusted"] > 0.6 * told["batches"] and told["wrong_of_trusted"] <= 1
    one, two, again = (next(known.drawn(1, seed)) for seed in (1, 2, 1))
    assert one.name == again.name != two.name and one.rois == again.rois
