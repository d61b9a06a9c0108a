"""No reader holds a recording in memory."""

import subprocess
import sys
import tracemalloc

import h5py
import numpy as np
import pytest

from cmfpga.events import BatchCutter, open_recording

COUNT = 3_000_000
COLUMN_BYTES = COUNT * (8 + 2 + 2 + 1)
CHUNK = 50_000


@pytest.fixture(scope="module")
def columns():
    index = np.arange(COUNT)
    return dict(
        t=index * 3,
        x=(index * 7 % 240).astype(np.uint16),
        y=(index * 11 % 180).astype(np.uint16),
        p=(index % 2).astype(np.uint8),
    )


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


@pytest.mark.parametrize("name, limit", [("a.h5", 8), ("a.npz", 8), ("table.npz", 12), ("a.npy", 12), ("a.txt", 30)])
def test_reading(large, name, limit):
    """Peak in MB, of NumPy's and Python's memory; all events would be 39 MB (text: 8 MB of 300,000 lines in blocks)."""
    found = []
    assert peak(lambda: found.append(read(large / name, size=CHUNK))) < limit * 1e6
    assert found == [COUNT // 10 if name == "a.txt" else COUNT]


def test_the_limits_mean_something(large):
    def all_at_once():
        with open_recording(large / "a.h5") as recording:
            list(recording.chunks(size=CHUNK))

    assert peak(all_at_once) > COLUMN_BYTES


def test_starting_late(large):
    """Skipping the events before the start of a streamed archive takes no memory either."""
    found = []
    assert peak(lambda: found.append(read(large / "a.npz", start=COUNT - 10))) < 8e6
    assert found == [10]


@pytest.mark.parametrize("options", [dict(events=5000), dict(duration_us=9999), dict(roi_events=800)])
def test_cutting(large, options):
    def work():
        with open_recording(large / "a.h5") as recording:
            cutter = BatchCutter(recording, max_events=60_000, **options)
            while cutter.next((100, 60, 64, 64)) is not None:
                pass

    assert peak(work) < 12e6


def test_whole_process(large):
    """What libraries allocate by themselves counts too: the resident size grows by less than the columns take."""
    resource = pytest.importorskip("resource")
    del resource
    program = (
        "import resource, sys\n"
        "from cmfpga.events import open_recording\n"
        "rss = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "with open_recording(sys.argv[1]) as recording:\n"
        "    next(recording.chunks(size=50_000))\n"
        "    before = rss()\n"
        "    print(sum(map(len, recording.chunks(size=50_000))), rss() - before)\n"
    )
    output = subprocess.run(
        [sys.executable, "-c", program, large / "a.h5"], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    count, growth = map(int, output.split())
    assert count == COUNT
    unit = 1 if sys.platform == "darwin" else 1024
    assert growth * unit < COLUMN_BYTES / 3
