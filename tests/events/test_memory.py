"""No reader holds a recording in memory."""

import json
import subprocess
import sys
import tracemalloc

import h5py
import numpy as np
import pytest

from cmfpga.events import BatchCutter, Events, open_recording
from support.recordings import aedat2_words, write_aedat2, write_by_faery

COUNT = 1_500_000
COLUMN_BYTES = COUNT * (8 + 2 + 2 + 1)
CHUNK = 50_000


@pytest.fixture(scope="module")
def columns():
    k = np.arange(COUNT)
    x, y = (k * 7 % 240).astype(np.uint16), (k * 11 % 180).astype(np.uint16)
    return {"t": k * 3, "x": x, "y": y, "p": (k % 2).astype(np.uint8)}


@pytest.fixture(scope="module")
def large(columns, tmp_path_factory):
    """Files of COUNT events by format; the text has a tenth."""
    folder = tmp_path_factory.mktemp("large")
    with h5py.File(folder / "a.h5", "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"events/{name}", data=values, chunks=(1 << 16,), compression="lzf")
    np.savez_compressed(folder / "a.npz", **columns)
    np.savez(folder / "table.npz", np.stack(list(columns.values())).astype(np.int32).T)
    np.save(folder / "a.npy", np.stack(list(columns.values())).astype(np.int32).T)
    rows = zip(*(values[: COUNT // 10].tolist() for values in columns.values()), strict=True)
    (folder / "a.txt").write_text("".join(f"{t * 1e-6:.6f} {x} {y} {p}\n" for t, x, y, p in rows))
    yield folder
    for path in folder.iterdir():
        path.unlink()


def peak(work):
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def read(path, **options):
    with open_recording(path) as recording:
        return sum(map(len, recording.chunks(**options)))


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("name, options, count, limit", [
    *((name, {"size": CHUNK}, COUNT, limit) for name, limit in
      (("a.h5", 8), ("a.npz", 8), ("table.npz", 12), ("a.npy", 12))),
    ("a.txt", {"size": CHUNK}, COUNT // 10, 30),
    ("a.npz", {"start": COUNT - 10}, 10, 8),  # to skip events of a streamed archive takes no memory either
])  # fmt: skip
def test_reading(large, name, options, count, limit):
    """Peak in MB, of NumPy's and Python's memory; all events would be 20 MB (text: 4 MB of 150,000 lines in blocks)."""
    found = []
    assert peak(lambda: found.append(read(large / name, **options))) < limit * 1e6
    assert found == [count]


def test_the_limits_mean_something(large):
    def all_at_once():
        with open_recording(large / "a.h5") as recording:
            list(recording.chunks(size=CHUNK))

    assert peak(all_at_once) > COLUMN_BYTES


@pytest.mark.parametrize("options", [dict(events=5000), dict(duration_us=9999), dict(roi_events=800)])
def test_cutting(large, options):
    def work():
        with open_recording(large / "a.h5") as recording:
            cutter = BatchCutter(recording, max_events=60_000, **options)
            while cutter.next((100, 60, 64, 64)) is not None:
                pass

    assert peak(work) < 12e6


@pytest.fixture(scope="module")
def camera_files(columns, tmp_path_factory):
    """Files of COUNT events in the cameras' own formats."""
    folder = tmp_path_factory.mktemp("cameras")
    events = Events(**columns)
    for name in ("a.aedat4", "a.raw", "a.dat", "a.es"):
        write_by_faery(folder / name, events, zero_t0=False)
    write_aedat2(folder / "a.aedat", aedat2_words(events))
    yield folder
    for path in folder.iterdir():
        path.unlink()


@pytest.mark.parametrize("name", ["a.h5", "a.aedat4", "a.raw", "a.dat", "a.es", "a.aedat"])
def test_whole_process(name, request):
    """What libraries allocate by themselves counts too: the resident size grows by less than the columns take."""
    pytest.importorskip("resource")
    folder = request.getfixturevalue("large" if name == "a.h5" else "camera_files")
    program = (
        "import resource, sys\n"
        "from cmfpga.events import open_recording\n"
        "rss = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "with open_recording(sys.argv[1]) as recording:\n"
        "    next(recording.chunks(size=50_000))\n"
        "    before = rss()\n"
        "    print(sum(map(len, recording.chunks(size=50_000))), rss() - before)\n"
    )
    command = [sys.executable, "-c", program, folder / name]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    count, growth = map(int, done.stdout.split())
    assert count == COUNT
    unit = 1 if sys.platform == "darwin" else 1024
    assert growth * unit < COLUMN_BYTES / 3


PEAK = """
import resource, sys
from cmfpga import cli
from cmfpga.cli import command
status = cli.run(command.main, sys.argv[1:])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)
sys.exit(status)
"""


def run(*arguments):
    """Peak resident size of a command in a process of its own, in bytes, and its JSON."""
    command = [sys.executable, "-c", PEAK, *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return int(done.stderr.split()[-1]) * (1 if sys.platform == "darwin" else 1024), json.loads(done.stdout)


@pytest.fixture(scope="module")
def lengths(tmp_path_factory):
    """Peak, summary and file of a recording of some 0.5 million events, and of one eight times as long."""
    pytest.importorskip("resource")
    folder = tmp_path_factory.mktemp("lengths")
    options = ["--texture", "dense", "--contrast", 8, "--velocity", "80,0", "--there-and-back"]
    made = {}
    for repeat in (3, 24):
        path = folder / f"{repeat}.h5"
        made[repeat] = (*run("generate", path, *options, "--repeat", repeat), path)
    yield made
    for *_, path in made.values():
        path.unlink()


def test_writing_takes_no_more_memory_for_longer_recordings(lengths):
    (short_peak, short, _), (long_peak, long, _) = lengths[3], lengths[24]
    assert long["events"] == 8 * short["events"] > 3_000_000
    assert long_peak - short_peak < (long["events"] - short["events"]) * 13 / 4


@pytest.mark.parametrize("name", ["track", "info"])
def test_commands_take_no_more_memory_for_longer_recordings(lengths, tmp_path, name):
    """13 bytes an event would be all of them; what grows with each batch is a line of the CSV, and little else."""
    options = ["--preset", "fast"]
    if name == "track":
        options += ["--roi", "88,58", "--engine", "model", "--batch-us", 50_000, "--set", "cold=0:1:1", "--set",
                    "warm=0:1:1", "--set", "thinning=20", "--out", tmp_path]  # fmt: skip
    else:
        options += ["--start-event", 0]
    peaks, events = [], []
    for _, written, path in lengths.values():
        peak, summary = run(name, path, *options)
        peaks.append(peak)
        events.append(written["events"])
        if name == "track":
            assert summary["batches"] > written["duration_us"] / 50_000 - 2
        else:
            assert summary["events"] == written["events"]
    # A proposal looks at two million events at most, which the short recording has not.
    looked_at = 2_000_000 if name == "info" else 0
    assert peaks[1] - peaks[0] < (events[1] - events[0]) * 13 / 4 + looked_at * 13
