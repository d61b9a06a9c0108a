"""``track`` with several ``--roi``: each object has its core, its CSV and its picture, as if it were alone."""

import json
import math

import numpy as np
import pytest

from cmfpga import cli
from cmfpga.cli import track
from cmfpga.events import Events, generate, write_hdf5
from support.recordings import WRITERS, columns, write_by_faery

OPTIONS = ["--preset", "fast", "--engine", "model", "--no-picture"]
TWO = ["--roi", "29,29", "--roi", "139,99"]


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """A recording with two objects, one moving to the right and a faster one moving up; and their velocities."""
    scenes = [
        generate(seed=1, position=(60.0, 60.0), velocity=(80.0, 0.0), duration_us=400_000),
        generate(seed=2, position=(170.0, 130.0), velocity=(0.0, -160.0), duration_us=400_000),
    ]
    path = tmp_path_factory.mktemp("two") / "two.h5"
    write_hdf5(path, Events.merge(scene.events for scene in scenes), 240, 180)
    return path, [scene.roi_start(64, 64) for scene in scenes]


def roi(place, name=""):
    return f"--roi={name}{place[0]},{place[1]}"


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("size", [["--batch-events", "4000"], ["--batch-us", "50000"]])
def test_each_is_tracked_as_if_alone(command, tmp_path, two, size):
    """On the same hardware, by itself."""
    path, places = two
    options = ["--preset", "objects", "--no-picture", "--engine", "model", *size, "--batches", 4]
    done = command(track, path, roi(places[0], "slow="), roi(places[1]), *options, "--out", tmp_path / "both")
    assert done.status == 0 and all(line.startswith("note: ") for line in done.err.splitlines())
    assert sorted(file.name for file in (tmp_path / "both").iterdir()) == ["track-1.csv", "track-slow.csv"]
    heads = [line.split(" batches tracked ")[0] for line in done.out.splitlines() if " batches tracked " in line]
    assert heads == ["slow: 4", "1: 4"]
    for place, name in zip(places, ("slow", "1"), strict=True):
        command(track, path, roi(place), *options, "--out", tmp_path / "alone")
        alone = (tmp_path / "alone" / "track.csv").read_bytes()
        assert alone == (tmp_path / "both" / f"track-{name}.csv").read_bytes()
        assert alone.count(b"\n") == 5


def test_batches_suit_the_fastest(command, tmp_path, two):
    """Without an option, and by default on a table of regions that the preset has not."""
    path, places = two
    summary = json.loads(command(track, path, *map(roi, places), *OPTIONS, "--json", "--out", tmp_path).out)
    slow, fast = (entry["median_px_per_half_batch"] for entry in summary["objects"])
    assert 3 <= fast <= 5 and slow == pytest.approx(fast / 2, rel=0.1)
    config = summary["config"]
    assert [config[name] for name in ("regions", "units", "store_style", "max_batch_events")] == [32, 2, "ultra", 65535]


def test_summary_and_pictures(command, tmp_path, two):
    """What is shared is told once."""
    path, places = two
    how = ["--preset", "fast", "--engine", "model", "--batch-us", 50_000, "--batches", 2, "--json", "--out", tmp_path]
    summary = json.loads(command(track, path, *map(roi, places), *how).out)
    assert list(summary) == ["engine", "batches", "cycles", "objects", "config"]
    assert (summary["batches"], summary["cycles"]) == (2, None)
    for k, entry in enumerate(summary["objects"]):
        assert (entry["name"], entry["roi"], entry["batches"]) == (str(k), list(places[k]), 2) and "cycles" not in entry
        assert entry["files"] == [str(tmp_path / f"track-{k}.{suffix}") for suffix in ("csv", "png")]
        assert all((tmp_path / f"track-{k}.{suffix}").stat().st_size > 100 for suffix in ("csv", "png"))


def test_a_stride_is_told(command, tmp_path, two):
    """Object 1 has twice as many events as object 0; all are counted."""
    path, places = two
    options = ["--set", "when_full=drop", "--set", "buffer_events=900", "--batch-events", 6600, "--batches", 3]
    done = command(track, path, *map(roi, places), *OPTIONS, *options, "--out", tmp_path)
    told = [line for line in done.err.splitlines() if "stored" in line]
    assert told == [
        f"note: {k}: one of {stride} events in the ROI was stored, so that buffer_events hold them"
        for k, stride in ((0, 4), (1, 8))
    ]
    table = np.genfromtxt(tmp_path / "track-1.csv", delimiter=",", names=True, dtype=None, encoding=None)
    assert all("thinned" in one and "overflow" not in one for one in table["flags"])
    assert (table["roi_events"] > 400).all()


def test_cycles_are_the_accelerators(command, compiler, tmp_path, two):
    """More than those of either object in its unit, for events are taken in first; fewer than twice as many."""
    path, places = two
    options = ["--preset", "objects", "--no-picture", "--batch-events", 4000, "--batches", 2, "--out", tmp_path]
    done = command(track, path, *map(roi, places), *options, "--json")
    units = [np.genfromtxt(tmp_path / f"track-{k}.csv", delimiter=",", names=True)["cycles"].sum() for k in range(2)]
    total = json.loads(done.out)["cycles"]
    assert 8000 + max(units) < total < 8000 + 2 * max(units)
    told = command(track, path, *map(roi, places), *options).out
    assert f"{total / 2:,.0f} clock cycles a batch on average" in told


@pytest.mark.parametrize("how", ["objects", "repeated", "one"])
def test_two_that_are_found(command, tmp_path, two, how):
    """In batches that suit the faster one; where one is told, the other is looked for at the same time."""
    path, places = two
    found_alone = how == "one"
    asked = {"objects": ["--objects", 2], "repeated": ["--roi", "auto"], "one": [roi(places[0])]}[how]
    done = command(track, path, "--roi", "auto", *asked, *OPTIONS, "--batches", 2, "--json", "--out", tmp_path)
    assert done.status == 0
    notes = [line for line in done.err.splitlines() if line.startswith("note: track-")]
    found = json.loads(done.out)["objects"]
    objects = [entry for entry in found if "batch_events" in entry]
    assert len(notes) == len(objects) == 2 - found_alone
    assert 3 <= max(entry["median_px_per_half_batch"] for entry in found) <= 5
    for entry in objects:
        place = min(places, key=lambda place: math.dist(place, entry["roi"]))
        assert math.dist(place, entry["roi"]) < 16
    if not found_alone:
        slow, fast = sorted(objects, key=lambda entry: -entry["batch_events"])
        assert slow["batch_events"] > 1.4 * fast["batch_events"]
        assert slow["roi"][0] < 100 < fast["roi"][0]
        lines = (tmp_path / f"track-{fast['name']}.csv").read_text().splitlines()
        assert int(lines[1].split(",")[2]) == fast["batch_events"]
        assert f"note: {fast['batch_events']} events in the first batch, from event 0 on" in done.err


@pytest.mark.parametrize("asked, message", [
    (["--roi", "a=1,2", "--roi", "a=3,4"], "--roi: the name 'a' is given twice; each object needs a name"),
    (["--roi", "1=1,2", "--roi", "3,4"], "--roi: the name '1' is given twice"),
    (["--roi", "a/b=1,2"], "argument --roi: 'a/b=1,2': a name of letters, digits, '-' and '_' is needed"),
    (["--roi", "=1,2"], "argument --roi: '=1,2': a name of letters"),
    (["--roi", "-a=1,2"], "argument --roi: expected one argument"),
    (["--roi", "a=auto2"], "argument --roi: 'auto2': X,Y, two whole numbers, is needed"),
    (["--roi", "1,2", "--roi", "500,2"], "ROI at 500,2: 0,0 to 176,116 is needed"),
    (["--roi", "0,116", "--roi", "1,116"], "ROI at 0,116: none of the events is in it, in 2 batches; an ROI with"),
    (["--roi", "auto"] + ["--roi", "auto"] * 3, "PATH: --roi auto: only 2 of 4 objects move clearly and far enough "),
    (["--roi", "auto", "--start-event", "999999", "--batches", "1"], "PATH: first event "),
    (["--roi", "1,2", "--objects", "2"], "--objects: one --roi auto, of which it says how many are to be found, is"),
    (["--roi", "auto", "--roi", "auto", "--objects", "2"], "--objects: one --roi auto"),
    (["--roi", "auto", "--objects", "5"], "argument --objects: '5': 1 to 4 is needed"),
    ([*TWO, "--wave", "0"], "--wave: waveforms are those of a core of one ROI; one --roi, and no regions, are needed"),
    ([*TWO, "--engine", "serial:/dev/x"], "serial port /dev/x: "),
    ([*TWO, "--preset", "paper"], "several objects are regions of one hardware, which this cannot have: regions = 32: "
     "gradient = one_pass is needed; without --preset and --set it can, and with one --roi it need not"),
    ([*TWO, "--preset", "objects", "--set", "regions=1"], "regions = 1: 2 objects need as many; --set regions=2"),
    ([*TWO, "--set", "max_batch_events=1000"], "--batch-events 1500: at most 1000 is allowed (max_batch_events)"),
    ([*TWO, "--batch-roi-events", 900], "--batch-roi-events: regions share their batches; --batch-events or"),
])  # fmt: skip
def test_mistakes(command, tmp_path, two, asked, message):
    size = ["--batch-events", 1500, "--batches", 2] if "--batch-roi-events" not in asked else []
    done = command(track, two[0], *OPTIONS, *size, "--out", tmp_path, *asked)
    assert done.error.startswith(message.replace("PATH", str(two[0])))
    assert done.out == ""


@pytest.mark.parametrize("size", [["--batch-events", "700"], ["--batch-us", "30001"]])
@pytest.mark.parametrize("suffix", [".h5", ".npz", ".es", ".txt"])
def test_the_bar_knows_how_many_batches_come(command, tmp_path, monkeypatch, size, suffix):
    """Where that is known soon: not of text."""
    events = generate(seed=1, velocity=(60.0, 0.0), duration_us=200_000).events
    path = tmp_path / f"a{suffix}"
    if suffix == ".es":
        write_by_faery(path, events, zero_t0=False)
    elif suffix == ".txt":
        np.savetxt(path, np.stack(columns(events), axis=1), fmt="%d")
    else:
        WRITERS[suffix[1:]](path, *columns(events))
    totals, counted = [], cli.expected
    monkeypatch.setattr(cli, "expected", lambda *given: totals.append(counted(*given)) or totals[-1])
    monkeypatch.setattr(cli, "shows_bar", lambda: True)
    options = [*OPTIONS, *"--sensor 240,180 --time-unit us --roi 88,58 --set cold=0:1:1 --set warm=0:1:1".split()]
    for start, most in ((0, None), (1234, None), (0, 2)):
        part = ["--start-event", start, *(["--batches", most] if most else [])]
        done = command(track, path, *options, *size, *part, "--out", tmp_path)
        batches = (tmp_path / "track.csv").read_text().count("\n") - 1
        assert done.status == 0 and batches > 1
        assert totals.pop() == (batches if suffix != ".txt" or most else None)
