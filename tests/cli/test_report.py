"""``track --report`` and ``cmfpga report``: their files, and what they refuse."""

import json
import re
import sys

import numpy as np
import pytest

from cmfpga.cli import report, track
from cmfpga.errors import ConfigError
from cmfpga.tracking.columns import COLUMNS
from cmfpga.tracking.kept import FILE, Kept

FAST = ["--preset", "fast", "--no-picture"]


@pytest.fixture(scope="module")
def kept(command, tmp_path_factory):
    """What a short track keeps, as bytes."""
    folder = tmp_path_factory.mktemp("kept")
    done = command(track, *FAST, "--engine", "model", "--batches", 2, "--report", "--out", folder)
    assert (done.status, done.err) == (0, "")
    return (folder / FILE).read_bytes()


@pytest.mark.parametrize("engine", ["model", "float"])
def test_track_writes_it_and_report_writes_it_again(command, tmp_path, engine):
    done = command(track, *FAST, "--engine", engine, "--batches", 3, "--out", tmp_path, "--report", "--clock", 123)
    assert done.status == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "track.csv", "track.npz"]
    assert done.out.count("wrote ") == 3 and f"wrote {tmp_path / 'report.html'}\n" in done.out
    first = (tmp_path / "report.html").read_bytes()
    done = command(report, tmp_path, "--clock", 123, "--out", tmp_path / "again.html")
    assert (done.status, done.out) == (0, f"wrote {tmp_path / 'again.html'}\n")
    assert (tmp_path / "again.html").read_bytes() == first and b"123 MHz" in first
    done = command(report, tmp_path)
    assert done.out == f"wrote {tmp_path / 'report.html'}\n" and b"210 MHz" in (tmp_path / "report.html").read_bytes()


def test_several_objects(command, tmp_path):
    """Each has its page; ``report`` writes all of them."""
    rois = ["--roi", "a=40,60", "--roi", "track=60,60"]
    done = command(track, *FAST, "--engine", "model", "--batches", 1, *rois, "--report", "--out", tmp_path)
    assert (done.status, done.err) == (0, "")
    pages = {name: (tmp_path / name).read_bytes() for name in ("report-a.html", "report-track.html")}
    for name in pages:
        (tmp_path / name).unlink()
    done = command(report, tmp_path)
    assert done.out == "".join(f"wrote {tmp_path / name}\n" for name in pages)
    assert {name: (tmp_path / name).read_bytes() for name in pages} == pages
    told = command(report, tmp_path, "--out", tmp_path / "x.html").error
    assert told == f"--out: {tmp_path} has 2 tracks; their pages can only be written there"


def test_files_are_listed_as_json(command, tmp_path):
    done = command(track, *FAST, "--engine", "model", "--batches", 1, "--report", "--json", "--out", tmp_path)
    told, names = json.loads(done.out), ["track.csv", "track.npz", "report.html"]
    assert told["files"] == [str(tmp_path / name) for name in names] and told["batches"] == 1


@pytest.mark.usefixtures("long_tools")
def test_the_clock_is_that_of_the_summary(command, tmp_path):
    done = command(track, *FAST, "--batches", 1, "--clock", 42, "--out", tmp_path)
    cycles = int(re.search("^([0-9,]+) clock", done.out, re.MULTILINE)[1].replace(",", ""))
    assert f"{cycles / 42e3:.3f} ms at an assumed clock of 42 MHz" in done.out


def test_without_plotly(monkeypatch, command, tmp_path, kept):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    (tmp_path / FILE).write_bytes(kept)
    message = "report: plotly is not installed; pip install 'cmfpga[report]'"
    assert command(report, tmp_path).error == message
    assert command(track, "--report", "--engine", "model", "--out", tmp_path / "new").error == message
    assert list((tmp_path / "new").iterdir()) == []


def test_as_users_run_it(process, tmp_path, kept):
    (tmp_path / FILE).write_bytes(kept)
    done = process("report", ".", without=["torch", "matplotlib"])
    assert (done.status, done.out, done.err) == (0, "wrote report.html\n", "")
    assert (tmp_path / "report.html").stat().st_size > 4_000_000


def test_damaged_files(kept, tmp_path, command):
    path = tmp_path / FILE
    path.write_bytes(kept)
    with np.load(path) as file:
        data = dict(file)
    for content in (b"", b"nonsense", kept[: len(kept) // 2], kept[:-30]):
        path.write_bytes(content)
        assert command(report, tmp_path).error == f"{path}: damaged, or not written by track --report"
    for name in ("rows", "since", "levels"):
        np.savez(path, **{key: value for key, value in data.items() if key != name})
        assert "damaged" in command(report, tmp_path).error
    np.savez(path, **{**data, "rows": data["rows"][:, : len(COLUMNS) - 1]})
    assert "damaged" in command(report, tmp_path).error
    head = json.loads(str(data["head"]))
    for change, message in (
        ({"version": 99}, "version 99: 4 is needed"),
        ({"config": {"roi_width": -1}}, "roi_width = -1"),
    ):
        np.savez(path, **{**data, "head": np.array(json.dumps({**head, **change}))})
        with pytest.raises(ConfigError, match=message):
            Kept.load(path)


def test_mistakes(tmp_path, command, kept):
    assert command(report, tmp_path / "none").error.startswith(f"{tmp_path / 'none'}: no such folder")
    assert command(report, tmp_path).error == f"{tmp_path}: has no track.npz; track again with --report"
    for clock in ("0", "-5", "fast", "inf", "nan", "20000"):
        error = command(report, tmp_path, "--clock", clock).error
        assert "a number of MHz, more than 0, at most 10000, is needed" in error
    (tmp_path / FILE).write_bytes(kept)
    assert "No such file" in command(report, tmp_path, "--out", tmp_path / "no" / "where.html").error
