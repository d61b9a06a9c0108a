"""``python -m studies.accuracy --motion``: batches of known rotation and similarity, and a recording of a rotation."""

from types import SimpleNamespace

import numpy as np
import pytest
from studies.accuracy.table import Report

from cmfpga.config import preset
from studies.accuracy import motions


@pytest.mark.parametrize("kind", motions.MOTIONS)
def test_the_suite(kind, written, capsys):
    found = written("--motion", kind, "--batches", 3)
    assert f"Synthetic batches, {kind}, cold, model: px per half batch" in capsys.readouterr().out
    assert found["config"]["motion"] == kind
    kept = found["results"][f"{kind}, rms over the ROI"]
    assert len(kept["values"]) == kept["scores"]["batches"] == 3 and kept["scores"]["median"] < 0.6
    kept = found["results"][f"{kind}, confidence, rms over the ROI"]
    error, kappa, sure = np.array(kept["values"]).T
    assert len(error) == 12 and (kappa[sure > 0] >= preset(kind).confidence_limit).all()  # and none of them is short
    assert 0 < sure.mean() < 1
    wrong = error > 0.6
    assert kept["scores"]["auc"] == pytest.approx(np.mean([(right > kappa[wrong]).mean() for right in kappa[~wrong]]))
    assert kept["scores"]["trusted"] == pytest.approx(sure.mean())


def test_the_error_is_that_of_the_flow():
    config = motions.motion_config("similarity", preset("similarity"))
    assert motions.flow_errors(config, (1.0, 0.0, 0.0, 0.0), np.zeros(4)) == pytest.approx((1.0, 1.0))
    _, largest = motions.flow_errors(config, (0.0, 0.0, 0.0, 2.0), np.zeros(4))
    assert largest == pytest.approx(2.0 * 63.5 * 2**0.5 / 64)


def test_a_scene_has_the_events_and_the_motion_that_were_drawn():
    config = motions.motion_config("rotation", preset("rotation"))
    events, true = motions.scene(config, 1, 0)
    (low, high), most, _ = motions.SCENES["rotation"]
    assert 0.8 * low < len(events) < 1.2 * high and (np.abs(true) <= most).all()
    assert not np.array_equal(true, motions.scene(config, 1, 1)[1])


def test_real_rotations(run, data_dir, capsys, monkeypatch):
    monkeypatch.setattr(motions, "ROTATIONS", motions.ROTATIONS[1:])
    monkeypatch.setattr(motions, "run_panned", lambda *_: None)
    assert run("--motion", "rotation", "--batches", 1, "--data", data_dir) == 0
    lines = capsys.readouterr().out.splitlines()
    real = next(line for line in lines if "| davis240c_shapes" in line)  # before the table of slices
    *_, away, allowed, ms, _ = real.split("|")
    assert float(away) <= float(allowed) and 1 < float(ms) < 4  # of 20,000 events


def test_a_camera_that_pans(data_dir, capsys, monkeypatch):
    """By what its events tell of the lens, ωy follows the gyroscope better than without."""
    monkeypatch.setattr(motions, "K1", (0.0, -0.3))
    monkeypatch.setattr(motions, "PAN_BATCHES", (None,))
    monkeypatch.setattr(motions, "PAN_EVENTS", 40_000)
    options = SimpleNamespace(data=data_dir, engine="model")
    motions.run_panned(options, motions.motion_config("rotation", preset("rotation")), Report())
    lines = (line for line in capsys.readouterr().out.splitlines() if line.startswith(("| 0 ", "| -0.3 ")))
    (_, plain), (_, bent), found, searched, better, _ = (line.split("|")[1:-1] for line in lines)
    assert float(bent) > float(plain)
    for _, _, who, batches, _, _, _, apart in (found, better):
        assert who.strip() == "model" and int(batches) >= 6
        assert float(apart) < 0.5  # deg/s; the search has no better one
    assert float(found[5]) == pytest.approx(1, abs=0.1)
    assert float(found[4]) > float(searched[4]) - 0.05
    assert float(better[4]) >= 0.95 > float(found[4]) > 0.85
