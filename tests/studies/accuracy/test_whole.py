"""Whole recordings by ``track --roi auto``, and a grid of ROIs on the slider: the rail's truth, and what is needed."""

from itertools import pairwise

import numpy as np

from cmfpga import cli
from studies import accuracy
from studies.accuracy import whole


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
