"""Sweeps of motions beyond translation: rates beside v, the recording's calibration, and what a rotation lacks."""

import numpy as np
import pandas
import pytest

import cmfpga
from cmfpga.cli import generate
from cmfpga.imaging.camera import RATES
from support.sweeping import run_here

MODEL = ["--engine", "model", "--batch-events", "1500", "--batches", "2"]


@pytest.fixture(scope="module")
def turn(tmp_path_factory):
    """A camera that turns, with its calibration."""
    path = tmp_path_factory.mktemp("turn") / "turn.h5"
    told = ["--sensor", "96,64", "--camera", "80,80,47,31,-0.1,0,0,0", "--bars", "12", "--duration-us", "60000"]
    assert generate.main([str(path), "--rotation", "1,-2,0.5", *told]) == 0
    return path


def test_a_rotation_needs_neither_an_roi_nor_a_camera(turn, tmp_path):
    """Its calibration and the whole sensor are taken, as by ``track``; all rates are those of a track."""
    done = run_here(turn, "--preset", "rotation", *MODEL, "--vary", "schedule_entries=96,128", "--out", tmp_path)
    assert (done.status, done.err) == (0, "")
    lines = pandas.read_csv(tmp_path / "results.csv")
    assert lines["status"].tolist() == ["ok", "ok"] and lines["roi_x"].tolist() == lines["roi_y"].tolist() == [0, 0]
    assert (lines["config.roi_width"] == 96).all() and lines["config.camera"].notna().all()
    tracked = cmfpga.track(turn, preset="rotation", engine="model", batch_events=1500, batches=2)
    every = pandas.read_csv(tmp_path / "batches.csv")
    for name in RATES["rotation"]:
        found = getattr(tracked, name)
        np.testing.assert_allclose(every[name][:2], found, rtol=1e-9)
        np.testing.assert_allclose(lines[f"{name}_median"], np.median(found), rtol=1e-9)
    # Moved back by all parameters, the image is sharper.
    assert (every["gain"] > 1.1).all() and every["error_px"].isna().all()


def test_a_similarity_has_its_own_columns(tmp_path):
    path = tmp_path / "grow.h5"
    told = ["--velocity", "40,-20", "--zoom", "1.5", "--roll", "1", "--size", "90,90", "--duration-us", "60000"]
    assert generate.main([str(path), *told]) == 0
    done = run_here(path, "--preset", "similarity", *MODEL, "--out", tmp_path / "out")
    assert (done.status, done.err) == (0, "")
    lines, every = (pandas.read_csv(tmp_path / "out" / f"{name}.csv") for name in ("results", "batches"))
    assert {f"{name}_median" for name in RATES["similarity"]} <= set(lines) and "wx_rad_per_s_median" not in lines
    # The truth is of (vx, vy) alone.
    error = np.hypot(every["vx"] - every["true_vx"], every["vy"] - every["true_vy"])
    np.testing.assert_allclose(every["error_px"], error, rtol=1e-6)


def test_without_a_calibration_a_row_has_no_result(turn, tmp_path):
    path = tmp_path / "plain.h5"
    assert generate.main([str(path), "--sensor", "96,64", "--duration-us", "20000"]) == 0
    done = run_here(path, turn, "--preset", "rotation", *MODEL, "--out", tmp_path / "out")
    lines = pandas.read_csv(tmp_path / "out" / "results.csv").set_index("recording")
    assert lines.loc[str(path), "status"] == "failed" and lines.loc[str(turn), "status"] == "ok"
    assert "holds no calibration, which motion = rotation needs: --set camera=" in lines.loc[str(path), "reason"]
    assert done.status == 0
