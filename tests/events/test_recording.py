"""What holds for recordings of every format."""

import gc
import os
import re
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from studies.accuracy.real import WINDOWS

from cmfpga.errors import RecordingError
from cmfpga.events import Events, Format, MemoryRecording, formats, open_recording
from cmfpga.events import recording as recording_module
from cmfpga.events.units import guess_unit
from support.recordings import assert_reads, assert_same, columns, make_events, read_all, refusal

GOOD = dict(t=[10, 20, 20, 35], x=[0, 5, 239, 7], y=[0, 9, 179, 8], p=[0, 1, 1, 0])


def test_reads_back(write, rng):
    events = make_events(rng)
    path = write(*columns(events))
    assert assert_reads(path, events, sensor=(240, np.int64(180))).height == 180
    recording = assert_reads(path, events)
    assert recording.num_events in (None, len(events))
    assert (recording.width, recording.height, recording.time_unit_source) == (None, None, "assumed")
    with pytest.raises(RecordingError, match="closed"):
        recording.chunks()
    recording.close()


@pytest.mark.parametrize("start, size", [(0, 1), (0, 999), (0, 1000), (0, 5000), (1, 7), (333, 100), (999, 10)])
def test_chunks_of_any_start_and_size(write, rng, start, size):
    events = make_events(rng)
    with open_recording(write(*columns(events))) as recording:
        chunks = list(recording.chunks(start=start, size=size))
    assert [len(chunk) for chunk in chunks[:-1]] == [size] * (len(chunks) - 1)
    assert 1 <= len(chunks[-1]) <= size
    assert_same(Events.concatenate(chunks), events[start:])


def test_iterators_side_by_side(write, rng):
    events = make_events(rng)
    with open_recording(write(*columns(events))) as recording:
        pairs = list(zip(recording.chunks(size=100), recording.chunks(start=500, size=50), strict=True))
    for k, start in enumerate((0, 500)):
        assert_same(Events.concatenate(pair[k] for pair in pairs), events[start:])


@pytest.mark.parametrize("given, read", [
    *(({"p": p}, {"p": [0, 1, 1, 0]}) for p in
      ([0, 1, 1, 0], [-1, 1, 1, -1], [False, True, True, False], [0.0, 1.0, 1.0, 0.0])),
    ({"t": [-1_500_001, -20, 0, 7]}, {"t": [-1_500_001, -20, 0, 7]}),
    ({"x": [1, 2, 3, 30_000]}, {"x": [1, 2, 3, 30_000]}),  # without a known sensor nothing may wrap in uint16
], ids=str)  # fmt: skip
def test_values(write, given, read):
    assert_reads(write(**{**GOOD, **given}), read)


@pytest.mark.parametrize("given, read, counted", [
    ([1, 2, 2, 1], [0, 1, 1, 0], "1 (2), 2 (2); those above 1 are"),  # of MATLAB
    ([0, 1, 2, 3], [0, 1, 1, 1], "0 (1), 1 (1), 2 (1), 3 (1); those above 0 are"),
    ([1, -1, 0, 1], [1, 0, 0, 1], "-1 (1), 0 (1), 1 (2); those above 0 are"),
])  # fmt: skip
def test_unusual_polarities(write, given, read, counted):
    path = write(**{**GOOD, "p": given})
    assert_reads(path, {"p": read}, size=1)
    with open_recording(path) as recording:
        (note,) = recording.notes()
    assert note.endswith(f": polarities of the first 4 events: {counted} taken as brighter (contrast needs none)")


@pytest.mark.filterwarnings("error::ResourceWarning", "error::pytest.PytestUnraisableExceptionWarning")
def test_nothing_stays_open(write):
    """Neither an unfinished iteration nor an error keeps the file open, nor is a closed file read."""
    path = write(**{**GOOD, "t": [10, 20, 5, 35]})
    with open_recording(path) as recording:
        chunks = recording.chunks(size=1)
        next(chunks)
        with pytest.raises(RecordingError):
            list(recording.chunks())
    del chunks
    gc.collect()
    if (folder := Path("/proc/self/fd")).is_dir():
        opened = [os.readlink(link) for link in folder.iterdir() if link.is_symlink()]
        assert str(path) not in opened


@pytest.mark.parametrize("changed, message", [
    (dict(t=[10, 20, 19, 35]), "event 2 is 19 µs, after 20 µs"),
    (dict(t=[-10, -20, 19, 35]), "event 1 is -20 µs, after -10 µs"),
    (dict(x=[0, -5, 3, 7]), "x of event 1 is -5; 0 to 239"),
    (dict(y=[0, 9, 3, -1]), "y of event 3 is -1; 0 to 179"),
    (dict(x=[0, 5, 240, 7]), "x of event 2 is 240; 0 to 239 is allowed on a sensor of 240×180"),
    (dict(x=[0, 5, 30_000, 7]), "x of event 2 is 30000; 0 to 239"),
    (dict(y=[180, 9, 3, 7]), "y of event 0 is 180; 0 to 179 is allowed on a sensor of 240×180"),
    (dict(p=[0, 1, 16, 0]), "polarity of event 2 is 16; 0 and 1, or -1 and 1"),
    (dict(p=[0, 1, 1, -2]), "polarity of event 3 is -2; 0 and 1, or -1 and 1"),
])  # fmt: skip
@pytest.mark.parametrize("size", [1, 100])
def test_unusable_events(write, changed, message, size):
    assert message in refusal(write(**{**GOOD, **changed}), "read", sensor=(240, 180), size=size)


def test_index_of_the_event_counts_from_the_file(write, rng):
    events = make_events(rng)
    t = events.t.copy()
    t[700] = 0
    path = write(t, events.x, events.y, events.p)
    for start, size in ((0, 64), (650, 50), (699, 1)):
        assert f"event 700 is 0 µs, after {t[699]} µs" in refusal(path, "read", start=start, size=size)
    assert_reads(path, events[701:], start=701)


@pytest.mark.parametrize("start, allowed", [(4, "0 to 3"), (1000, "0 to 3"), (-1, "0 ")])
def test_start_outside(write, start, allowed):
    assert re.search(f"first event {start}; {allowed}", refusal(write(**GOOD), "read", start=start))


def test_no_events(write):
    assert re.search("no events|empty", refusal(write([], [], [], [])))  # a text file of no lines is empty


def any_bytes(path):
    path.write_bytes(bytes(range(256)) * 10)


SUFFIXES = ("h5", "hdf5", "npy", "npz", "zip", "txt", "aedat4", "aedat", "raw", "dat", "es")
NO_RECORDINGS = [
    ("nothing.h5", lambda path: None, "no such file"),
    ("folder", Path.mkdir, "a directory"),
    ("pipe.txt", os.mkfifo, "not a regular file"),
    *((name, Path.touch, "the file is empty") for name in ("a.h5", "a.txt", "a.npy", "a.npz", "a.zip", "a")),
    *((name, any_bytes, r"format not known; .*HDF5 \(\.h5.*text \(\.txt") for name in ("a.blob", "a.rosbag", "a")),
    *((f"a.{suffix}", any_bytes, "does not begin like it") for suffix in SUFFIXES),
]


@pytest.mark.parametrize("name, make, message", NO_RECORDINGS, ids=[f"{row[2][:9]} {row[0]}" for row in NO_RECORDINGS])
def test_what_is_no_recording(tmp_path, name, make, message):
    make(tmp_path / name)
    assert re.search(message, refusal(tmp_path / name))


def test_unreadable(write, monkeypatch):
    path = write(**GOOD)
    if hasattr(os, "geteuid") and os.geteuid():
        path.chmod(0)
    else:  # the superuser may read everything
        refuse = Mock(side_effect=PermissionError(13, "Permission denied", str(path)))
        monkeypatch.setattr(type(path), "open", refuse)
    assert "cannot be read: Permission denied" in refusal(path)


def test_content_goes_before_extension(write):
    path = write(**GOOD)
    assert_reads(path.rename(path.with_suffix(".dat")), GOOD)


def test_options_not_allowed(write):
    path = write(**GOOD)
    for sensor in ((0, 10), (10,), (10, 1 << 17), "10x10", (10.5, 3), 7):
        assert "sensor" in refusal(path, sensor=sensor)
    assert "'min' is not known; one of s, ms, us, ns" in refusal(path, time_unit="min")
    assert "1 or more" in refusal(path, "read", size=0)


def test_registry(tmp_path, monkeypatch):
    """A further format is recognised by its content, before text; and by default is not there."""
    monkeypatch.setattr(recording_module, "_FORMATS", list(formats()))
    events = Events([1, 2], [3, 4], [5, 6], [0, 1])
    path = tmp_path / "a.txt"
    path.write_text("EVENTS! 1 2 3 4\n")
    assert "line 1" in refusal(path)
    mine = Format(
        "mine", (".mine",), lambda head, path: head.startswith(b"EVENTS!"),
        lambda path, time_unit, sensor: MemoryRecording(events, *(sensor or (8, 8)), name=str(path)),
    )  # fmt: skip
    recording_module.register_format(mine)
    assert assert_reads(path, events, sensor=(5, 7)).width == 5


def test_memory_recording(rng):
    events = make_events(rng)
    recording = MemoryRecording(events, 240, 180, name="mine")
    assert (recording.path, recording.name, recording.format) == (None, "mine", "memory")
    assert (recording.width, recording.height, recording.num_events) == (240, 180, 1000)
    assert (recording.time_unit, recording.time_unit_source) == ("us", "file")
    assert_same(read_all(recording, start=10, size=33), events[10:])
    with pytest.raises(RecordingError, match="mine: first event 1000; 0 to 999"):
        recording.chunks(start=1000)
    with pytest.raises(RecordingError, match="x of event"):
        list(MemoryRecording(events, 100, 180).chunks())
    with pytest.raises(RecordingError, match="no events"):
        MemoryRecording(Events.empty(), 240, 180)
    # Times in memory are µs by definition: the rule that looks at rates does not apply.
    t = np.arange(2000) * 1_000_000
    assert read_all(MemoryRecording(Events(t, t * 0, t * 0, t * 0), 2, 2)).t[-1] == t[-1]


SENSORS = {
    **{windows.file: (240, 180) for windows in WINDOWS},
    "davis240b_evbench_seq0002.h5": (190, 180),
    "prophesee_spinner_640x480.h5": (640, 480),
}


@pytest.mark.parametrize("name", SENSORS)
def test_real_recordings(data_dir, name):
    """What their attributes say; the rule finds the unit without them."""
    with open_recording(data_dir / name) as recording:
        assert recording.time_unit_source == "file" and recording.time_unit == "us"
        assert (recording.width, recording.height) == SENSORS[name]
        assert guess_unit(next(recording.chunks()).t) == "us"


def test_whatever_lies_in_the_folder(data_dir):
    """Is read to its end, or refused in one line; which files there are is their owner's choice."""
    read = 0
    for path in sorted(path for path in data_dir.rglob("*") if path.is_file()):
        try:
            with open_recording(path) as recording:
                count = sum(len(chunk) for chunk in recording.chunks())
        except RecordingError as error:
            assert str(error).startswith(str(path)) and "\n" not in str(error)
        else:
            assert count == (recording.num_events or count) > 0
            read += 1
    assert read


TWINS = {
    # file: same events in HDF5, sensor, largest difference of times in µs
    "davis240c_slider_depth_0.0s_events.txt": ("../davis240c_slider_depth_0.0s.h5", None, 0),
    "davis240c_translboxes_imu.aedat": ("../davis240c_translboxes_imu.h5", (240, 180), 0),
    "davis346_traffic.aedat4": ("davis346_traffic_decoded.h5", (346, 260), 0),
    "prophesee_spinner_640x480_evt2.raw": ("../prophesee_spinner_640x480.h5", (640, 480), 0),
    "prophesee_driving_1280x720_evt3.raw": ("prophesee_driving_1280x720_decoded.h5", (1280, 720), 20),
}


@pytest.mark.parametrize("name", TWINS)
def test_original_formats_equal_their_twins(data_dir, tmp_path, name):
    """Opened by a name that says nothing: the content decides."""
    if name.endswith(".aedat4"):
        pytest.importorskip("faery")
    twin, sensor, largest = TWINS[name]
    folder = data_dir / "original_formats"
    (tmp_path / "recording").symlink_to(folder / name)
    with open_recording(tmp_path / "recording") as original, open_recording(folder / twin) as h5:
        assert (original.width, original.height) == (sensor or (None, None))
        assert sensor in (None, (h5.width, h5.height))
        if name.endswith(".txt"):
            assert (original.time_unit, original.time_unit_source, original.num_events) == ("s", "assumed", None)
        found, expected = read_all(original), read_all(h5)
    for column in "xyp":
        np.testing.assert_array_equal(getattr(found, column), getattr(expected, column), err_msg=column)
    assert np.abs(found.t - expected.t).max() <= largest
