"""The page by itself: complete, self-contained, small; and the commands that write it."""

import html
import json
import re
import sys

import numpy as np
import pytest

from cmfpga import report, track
from cmfpga.config import preset
from cmfpga.events import generate
from cmfpga.report import page
from cmfpga.report.kept import FILE
from cmfpga.report.story import Story

from .conftest import keep


def own(text):
    """The page without plotly.js."""
    return text.replace(page.plotly_script(), "")


def test_nothing_is_loaded_from_elsewhere(turning):
    text = own(page.render(turning, 210.0))
    assert len(text) < 400_000
    assert "http" not in text.replace("http-equiv", "").replace("HTTP", "")
    assert not re.search(r"(src|href)=[\"'](?!data:)", text) and "default-src 'none'" in text
    assert "{{" not in text and "}}" not in text.replace("}}}", "")


def test_what_it_says_and_holds(flagged):
    text = page.render(flagged, 99.5)
    story = Story(flagged, 99.5)
    assert html.escape(story.lead) in text and all(html.escape(note) in text for note in story.notes)
    assert "</script><b>" not in text and "&lt;/script&gt;&lt;b&gt;" in text  # the recording's name
    head = json.loads(re.search(r'id="head">(.*?)</script>', text)[1])
    assert head["columns"]["contrast"] == flagged.column("contrast")
    for name, value in flagged.config.to_dict().items():
        assert re.search(rf"<code>{name}</code></th><td>{re.escape(str(value))}[ <]", text), name
    assert "<dd>99.5 MHz</dd>" in text and "<dt>amaranth</dt>" in text


def test_the_same_track_gives_the_same_page(turning):
    assert page.render(turning, 210.0) == page.render(turning, 210.0)


def test_two_hundred_batches_are_below_ten_megabytes():
    """As dense as the star recording, in a full-sized ROI; noise does not compress."""
    scene = generate(
        seed=9, texture="dense", size=(60, 60), position=(60.0, 90.0), velocity=(120.0, 0.0), duration_us=1_000_000,
        noise=0.5, contrast=40.0,
    )  # fmt: skip
    config = preset("fast").replace(cold="0:0", warm="0:0", roi_gain=0.0)
    kept = keep(config, scene.recording(), roi=(40, 60), size=5000, batches=200, motion=scene.motion)
    assert len(kept.rows) == len(kept.details) == 200
    assert np.median(kept.numbers("roi_events")) > 800
    assert 5_000_000 < len(page.render(kept, 210.0).encode()) < 10_000_000


def test_without_plotly(monkeypatch, command, tmp_path, turning):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    turning.save(tmp_path / FILE)
    message = "report: plotly is not installed; pip install 'cmfpga[report]'"
    assert command(report, tmp_path).error == message
    assert command(track, "--report", "--engine", "model", "--out", tmp_path / "new").error == message
    assert not (tmp_path / "new" / "report.html").exists()


@pytest.mark.parametrize("engine", ["model", "float"])
def test_track_writes_it_and_report_writes_it_again(command, tmp_path, engine):
    options = ["--preset", "fast", "--engine", engine, "--batches", 3, "--no-picture", "--out", tmp_path]
    done = command(track, *options, "--report", "--clock", 123)
    assert done.status == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "track.csv", "track.npz"]
    assert done.out.count("wrote ") == 3 and f"wrote {tmp_path / 'report.html'}\n" in done.out
    first = (tmp_path / "report.html").read_bytes()
    done = command(report, tmp_path, "--clock", 123, "--out", tmp_path / "again.html")
    assert (done.status, done.out) == (0, f"wrote {tmp_path / 'again.html'}\n")
    assert (tmp_path / "again.html").read_bytes() == first and b"123 MHz" in first
    done = command(report, tmp_path)
    assert done.out == f"wrote {tmp_path / 'report.html'}\n" and b"210 MHz" in (tmp_path / "report.html").read_bytes()


def test_files_are_listed_as_json(command, tmp_path):
    done = command(
        track,
        "--preset",
        "fast",
        "--engine",
        "model",
        "--batches",
        1,
        "--no-picture",
        "--report",
        "--json",
        "--out",
        tmp_path,
    )
    names = ["track.csv", "track.npz", "report.html"]
    assert json.loads(done.out)["files"] == [str(tmp_path / name) for name in names]


def test_from_python(tmp_path):
    import cmfpga

    scene = generate(seed=1, velocity=(150.0, 100.0), duration_us=100_000)
    tracking = cmfpga.track(scene, preset="fast", engine="model", batch_events=1500, batches=2)
    tracking.report(tmp_path / "a.html", clock_mhz=77)
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "77 MHz" in text and tracking._kept.column("vx")[1] in text
