"""``cmfpga info``: what it says of made-up and of real recordings."""

import json
import re
import shlex
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from studies.accuracy.real import WINDOWS

from cmfpga.cli import info, track
from cmfpga.events import Events, generate, open_recording, write_hdf5
from support.recordings import aedat2_words, write_aedat2

FAST = ["--preset", "fast"]
NONE = "No proposal: nothing moves clearly and far enough in any 64×64 px."
DOCS = Path(__file__).parents[2] / "docs" / "recordings.md"


@pytest.fixture(scope="module")
def scene():
    return generate(seed=1, velocity=(80.0, 40.0), position=(80.0, 60.0), duration_us=500_000, hot_pixels=3, noise=0.1)


@pytest.fixture(scope="module")
def recording(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("info") / "my scene.h5"
    write_hdf5(path, scene.events, 240, 180)
    return path


def test_text(command, scene, recording):
    done = command(info, recording, *FAST)
    assert (done.status, done.err) == (0, "")
    events = scene.events
    for line in (
        f"{recording}: HDF5", "sensor      240×180 px",
        f"events      {len(events):,}, {events.p.mean():.0%} of them ON",
        f"span        {(events.t[-1] - events.t[0]) / 1e6:.6g} s, from {events.t[0]:,} µs to {events.t[-1]:,} µs",
        "time unit   us (the format or the file says so)",
        f"rate        {len(events) / (events.t[-1] - events.t[0]) * 1e6:,.0f} events/s on average; each sign is ",
        "hot pixels  ", "Proposal: ROI ", "  because the image moves at ", "  cmfpga track ",
    ):  # fmt: skip
        assert f"\n{line}" in f"\n{done.out}", line
    (bars,) = [line for line in done.out.splitlines() if re.fullmatch(r" {12}[ ▁-█]+  0 to [\d,]+", line)]
    assert 30 <= len(bars.partition("  0")[0].strip()) <= 60


def test_the_frame(command, scene, recording):
    """The object, and nothing else, is dark; the ROI's corners stand around it."""
    frame = [line[1:-1] for line in command(info, recording, *FAST).out.splitlines() if line.startswith("|")]
    assert len(frame) == 29 and {len(line) for line in frame} == {78}
    dark = [(x, y) for y, line in enumerate(frame) for x, sign in enumerate(line) if sign in "#%@"]
    x, y = np.array(dark).T * np.array([[240 / 78], [180 / 29]])
    assert 60 < x.min() < x.max() < 145 and 35 < y.min() < y.max() < 105
    assert sum(line.count(corner) for line in frame for corner in "┌┐└┘") == 4
    assert not any(line.startswith("|") for line in command(info, recording, *FAST, "--no-frame").out.splitlines())


def test_json(command, scene, recording):
    report = json.loads(command(info, recording, *FAST, "--json", "--check", 3).out)
    events = scene.events
    assert (report["file"], report["format"], report["sensor"]) == (str(recording), "HDF5", [240, 180])
    assert (report["events"], report["on_events"]) == (len(events), int(events.p.sum()))
    assert (report["t_first_us"], report["t_last_us"]) == (events.t[0], events.t[-1])
    assert len(report["hot_pixels"]) == 3 and report["roi_size"] == [64, 64]
    total = sum(rate * report["rate_bin_us"] / 1e6 for rate in report["rate_per_s"][:-1])
    assert 0.9 * len(events) < total < len(events)
    (found,) = report["proposals"]
    np.testing.assert_allclose(found["px_per_s"], (80, 40), atol=10)
    assert 3 <= found["px_per_half_batch"] <= 5 and len(found["checked_px_per_half_batch"]) == 3
    assert all(3 <= px <= 5 for px in found["checked_px_per_half_batch"])
    assert found["checked_trusted"] == [True] * 3
    with open_recording(recording) as again:
        assert again.num_events > found["start_event"] + found["batch_events"]


def test_the_command_that_it_proposes_works(command, rows, recording, tmp_path):
    (found,) = json.loads(command(info, recording, *FAST, "--json").out)["proposals"]
    words = shlex.split(found["command"])
    assert words[:3] == ["cmfpga", "track", str(recording)]
    how = ["--engine", "model", "--no-picture", "--batches", 3, "--out", tmp_path]
    done = command(track, *words[2:], *how)
    assert done.status == 0 and done.err.startswith("note: hot pixels ") and done.err.count("\n") == 1
    told = rows(tmp_path)
    done = command(track, recording, "--roi", "auto", *FAST, *how, "--json")
    assert done.status == 0 and "\nnote: track: ROI " in done.err and done.err.count("\n") == 2
    summary = json.loads(done.out)
    assert rows(tmp_path) == told
    for name in ("roi", "batch_events", "start_event", "fields"):
        assert summary[name] == found[name]
    assert 3 <= summary["median_px_per_half_batch"] <= 5


def test_batches_that_are_told_stay(command, rows, recording, tmp_path):
    options = [*FAST, "--engine", "model", "--no-picture", "--batches", 2, "--out", tmp_path]
    done = command(track, recording, "--roi", "auto", "--batch-events", 1234, *options)
    assert done.status == 0 and {row["events"] for row in rows(tmp_path)} == {"1234"}
    done = command(track, recording, "--roi", "auto", "--set", "thinning=1", *options, "--json")
    assert json.loads(done.out)["config"]["thinning"] == 1


def test_options_of_the_recording_are_in_the_command(command, scene, tmp_path):
    path = tmp_path / "a.npz"
    events = scene.events
    np.savez(path, t=events.t * 1000, x=events.x, y=events.y, p=events.p)
    done = command(info, path, "--sensor", "240,180", "--time-unit", "ns", *FAST, "--set", "roi_width=48", "--json")
    words = json.loads(done.out)["proposals"][0]["command"]
    assert words.endswith("--sensor 240,180 --time-unit ns --preset fast --set roi_width=48")


def test_a_sensor_that_nobody_tells(command, scene, tmp_path):
    np.savez(tmp_path / "a.npz", t=scene.events.t, x=scene.events.x, y=scene.events.y, p=scene.events.p)
    done = command(info, tmp_path / "a.npz", *FAST)
    covered = f"{scene.events.x.max() + 1}×{scene.events.y.max() + 1}"
    told = f"sensor      not said; the events cover {covered} px: taking 240×180 px; say"
    assert done.status == 0 and told in done.out
    assert "time unit   us (guessed)\n" in done.out and "Proposal: ROI " in done.out


def test_a_picture(command, recording, tmp_path):
    for more, red in (([], True), (["--no-proposal"], False)):  # tab:red
        assert command(info, recording, *FAST, *more, "--png", tmp_path / "a.png").status == 0
        pixels = matplotlib.image.imread(tmp_path / "a.png")[..., :3]
        share = (np.abs(pixels - (0.8392, 0.1529, 0.1569)).max(axis=2) < 0.02).mean()
        assert pixels.shape[0] > 500 and (share > 1e-4 if red else share == 0)


@pytest.mark.usefixtures("long_tools")
def test_two_objects(command, tmp_path):
    events = Events.merge(
        generate(seed=k, position=place, velocity=speed, duration_us=400_000).events
        for k, (place, speed) in enumerate((((60.0, 50.0), (70.0, 0.0)), ((170.0, 130.0), (0.0, -110.0))))
    )
    path = tmp_path / "two.h5"
    write_hdf5(path, events, 240, 180)
    done = command(info, path, *FAST, "--objects", 2)
    assert "Proposal 0: ROI " in done.out and "Proposal 1: ROI " in done.out
    assert "┌0" in done.out and "┌1" in done.out
    done = command(info, path, *FAST, "--objects", 3, "--no-frame")
    assert done.status == 0 and done.out.endswith("Only 2 of 3 objects move clearly at one time.\n")


@pytest.mark.usefixtures("long_tools")
def test_nothing_that_moves(command, tmp_path):
    rng = np.random.default_rng(1)
    count = 8_000
    noise = Events(np.arange(count), *rng.integers(100, size=(2, count)), [0] * count)
    write_hdf5(tmp_path / "noise.h5", noise, 100, 100)
    done = command(info, tmp_path / "noise.h5", *FAST)
    assert done.status == 0 and done.out.endswith(f"\n{NONE}\n")
    assert "Proposal" not in command(info, tmp_path / "noise.h5", "--no-proposal").out
    done = command(track, tmp_path / "noise.h5", "--roi", "auto", *FAST, "--engine", "model", "--out", tmp_path)
    assert done.error.endswith("px in half of a batch); --roi X,Y is needed")
    assert done.out == ""


def test_a_truncated_file_is_described_and_refused(command, scene, tmp_path):
    """What there is, is told; then one line, and status 2."""
    path, before = write_aedat2(tmp_path / "a.aedat", aedat2_words(scene.events)), len(scene.events) - 1
    path.write_bytes(path.read_bytes()[:-3])
    done = command(info, path, *FAST)
    assert f"events      {before:,}, " in done.out and "Proposal: ROI " in done.out
    told = f"truncated: 5 of 8 bytes of the last record are there; the {before} events before were read"
    assert done.error == f"{path}: {told}"


@pytest.mark.parametrize("arguments, message", [
    (["missing.h5"], "missing.h5: no such file"),
    ([], "the following arguments are required: RECORDING"),
    (["PATH", "--objects", "5"], "argument --objects: '5': 1 to 4 is needed"),
    (["PATH", "--start-event", "99999999"], "PATH: first event 99999999; 0 to "),
    (["PATH", "--png", "FOLDER/a.png"], "FOLDER/a.png: No such file or directory"),
    (["PATH", "--preset", "x"], "preset 'x': one of "),
    (["PATH", "--sensor", "100,100"], "PATH: x of event "),
])  # fmt: skip
def test_mistakes(command, recording, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    given = (part.replace("PATH", str(recording)) for part in arguments)
    done = command(info, *given, *FAST[: 2 * ("x" not in arguments)])
    assert done.error.startswith(message.replace("PATH", str(recording)))


def test_check_asks_for_torch(process, recording):
    done = process("info", recording, *FAST, "--check", 1, without=["torch"])
    assert done.error == "--check: torch is not installed; pip install 'cmfpga[reference]'"


def test_the_rest_needs_no_torch(process, recording):
    done = process("info", recording, *FAST, without=["torch", "matplotlib"], PYTHONIOENCODING="ascii")
    assert (done.status, done.err) == (0, "") and "Proposal: ROI" in done.out


ROW = re.compile(r"^\| `(\S+\.\w+)` \| (.*) \|$", re.MULTILINE)


def documented():
    """``[(file, cells of its row)]`` of the table of real recordings in the documentation."""
    return [(name, rest.split(" | ")) for name, rest in ROW.findall(DOCS.read_text(encoding="utf-8"))]


def row_of(found):
    """Cells of the documentation's table for a proposal."""
    px = found["checked_px_per_half_batch"]
    return [
        "{},{}".format(*found["roi"]), f"{found['start_event']:,}", f"{found['batch_events']:,}",
        f"{found['batch_us'] / 1e3:,.3g}", "{:,.0f}, {:,.0f}".format(*found["px_per_s"]),
        f"{np.median(px):.1f} ({min(px):.1f} to {max(px):.1f}; {len(px)})",
    ]  # fmt: skip


def test_the_table_has_rows():
    """Those of the accuracy suites among them; which other recordings a folder holds is its owner's."""
    names = [name for name, _ in documented()]
    assert len(names) == len({*names}) and {*names} >= {windows.file for windows in WINDOWS}


@pytest.mark.parametrize("name, cells", documented(), ids=[name for name, _ in documented()])
def test_the_table_is_what_the_command_says(command, data_dir, name, cells):
    path = next(folder / name for folder in (data_dir, data_dir / "original_formats") if (folder / name).exists())
    done = command(info, path, "--preset", "fast", "--check", 10, "--json")
    if "needs the package" in done.err:
        pytest.skip(done.err)
    proposals = json.loads(done.out)["proposals"]
    if cells[0] == "none":
        assert not proposals
        return
    (found,) = proposals
    assert row_of(found) == cells
    checked = sorted(found["checked_px_per_half_batch"])
    assert 3 <= checked[len(checked) // 2] <= 5


def test_a_sensor_smaller_than_the_roi(command, dot):
    done = command(info, dot, "--no-frame")
    assert (done.status, done.err) == (0, "") and NONE in done.out
