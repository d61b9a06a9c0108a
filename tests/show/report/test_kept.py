"""What a track keeps for its report."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.events import Events, MemoryRecording
from cmfpga.imaging.iwe import image_of_warped_events
from cmfpga.show.report import render
from cmfpga.tracking import kept as module
from cmfpga.tracking.kept import FILE, Kept
from support.reporting import keep


def test_details_give_the_contrast_of_the_csv(turning):
    for detail in turning.details:
        span = turning.spans[detail.batch]
        dt = (2 * detail.since.astype(float) - span) / span
        image = image_of_warped_events(detail.x, detail.y, dt, detail.v[-1], width=64, height=64)
        assert f"{image.var():.6f}" == turning.column("contrast")[detail.batch]
        assert detail.frame.sum() == float(turning.column("events")[detail.batch]) and detail.frame.shape == (180, 240)
        assert len(detail.levels) == len(detail.v) - 1 == int(turning.column("iterations")[detail.batch])
    assert [detail.batch for detail in turning.details] == list(range(len(turning.rows)))
    assert {int(level) for detail in turning.details for level in detail.levels} == {0, 1, 2}


@pytest.mark.parametrize("name", ["turning", "flagged", "panning", "growing"])
def test_saved_and_loaded(name, request, tmp_path):
    kept = request.getfixturevalue(name)
    kept.save(tmp_path / FILE)
    again = Kept.load(tmp_path / FILE)
    assert again.config == kept.config and again.rows == kept.rows and again.roi_next == tuple(kept.roi_next)
    assert again.details[0].v.shape == (len(kept.details[0].levels) + 1, len(kept.config.motion_model.names))
    assert render(again, 150.0) == render(kept, 150.0)


def test_long_tracks_keep_every_second_batch(monkeypatch):
    rng = np.random.default_rng(5)
    t = np.arange(40_000) * 10
    events = Events(t, rng.integers(0, 240, 40_000), rng.integers(0, 180, 40_000), t % 2)
    recording = MemoryRecording(events, 240, 180)
    config = preset("fast").replace(cold="0:1:1", warm="0:1:1")
    monkeypatch.setattr(module, "BUDGET", 20_000)
    kept = keep(config, recording, roi=(0, 0), size=1000)
    assert len(kept.rows) == 40 and 2 < len(kept.details) < 20
    kinds = {after.batch - before.batch for before, after in zip(kept.details, kept.details[1:], strict=False)}
    assert kinds in ({2}, {4}, {8}, {16}) and kept.details[0].batch == 0
    assert sum(detail.size for detail in kept.details) <= 20_000


def test_of_a_track_without_an_end_the_first_batches_are_kept(monkeypatch, tmp_path):
    t = np.arange(2000) * 100
    config = preset("fast").replace(cold="0:1:1", warm="0:1:1")
    monkeypatch.setattr(module, "MOST_ROWS", 15)
    kept = keep(config, MemoryRecording(Events(t, t % 240, t % 180, t % 2), 240, 180), roi=(0, 0), size=100)
    kept.save(tmp_path / FILE)
    for one in (kept, Kept.load(tmp_path / FILE)):
        assert (len(one.rows), len(one.spans), one.left_out, one.details[-1].batch) == (15, 15, 5, 14)
        assert "<li>5 batches after these are left out.</li>" in render(one, 150.0)


def test_large_sensors_are_binned():
    t = np.arange(2000) * 100
    events = Events(t, t % 1280, t % 719, t % 2)
    config = preset("fast").replace(sensor_width=1280, sensor_height=720, cold="0:1:1", warm="0:1:1")
    kept = keep(config, MemoryRecording(events, 1280, 720), roi=(600, 300), size=1000)
    assert kept.frame_bin == 4 and kept.details[0].frame.shape == (180, 320)
    assert kept.details[1].frame.sum() == 1000
