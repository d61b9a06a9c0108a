"""What holds for recordings of every format."""

import gc
import os
import re
from pathlib import Path

import numpy as np
import pytest

from cmfpga.accuracy.real import WINDOWS
from cmfpga.errors import RecordingError
from cmfpga.events import Events, Format, MemoryRecording, formats, open_recording
from cmfpga.events import recording as recording_module

GOOD = dict(t=[10, 20, 20, 35], x=[0, 5, 239, 7], y=[0, 9, 179, 8], p=[0, 1, 1, 0])


def good(**changed):
    return {**GOOD, **changed}


def check_error(error, path, *parts):
    """One line that names the file and holds ``parts``."""
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    for part in parts:
        assert part in text


# -------------------------------------------------------------------- what is read


def test_reads_back(write, rng, helpers):
    events = helpers.make_events(rng)
    with open_recording(write(events.t, events.x, events.y, events.p)) as recording:
        helpers.assert_same(helpers.read_all(recording), events)
        assert recording.num_events in (None, len(events))
        assert (recording.width, recording.height) == (None, None)
        assert recording.time_unit_source == "assumed"


@pytest.mark.parametrize("start, size", [(0, 1), (0, 999), (0, 1000), (0, 5000), (1, 7), (333, 100), (999, 10)])
def test_chunks_of_any_start_and_size(write, rng, helpers, start, size):
    events = helpers.make_events(rng)
    with open_recording(write(events.t, events.x, events.y, events.p)) as recording:
        chunks = list(recording.chunks(start=start, size=size))
    assert [len(chunk) for chunk in chunks[:-1]] == [size] * (len(chunks) - 1)
    assert 1 <= len(chunks[-1]) <= size
    helpers.assert_same(Events.concatenate(chunks), events[start:])


def test_iterators_side_by_side(write, rng, helpers):
    events = helpers.make_events(rng)
    with open_recording(write(events.t, events.x, events.y, events.p)) as recording:
        pairs = list(zip(recording.chunks(size=100), recording.chunks(start=500, size=50), strict=True))
    helpers.assert_same(Events.concatenate(a for a, _ in pairs), events)
    helpers.assert_same(Events.concatenate(b for _, b in pairs), events[500:])


@pytest.mark.parametrize("p", [[0, 1, 1, 0], [-1, 1, 1, -1], [False, True, True, False], [0.0, 1.0, 1.0, 0.0]])
def test_polarities(write, helpers, p):
    with open_recording(write(**good(p=p))) as recording:
        assert helpers.read_all(recording).p.tolist() == [0, 1, 1, 0]


def test_negative_times_are_allowed(write, helpers):
    with open_recording(write(**good(t=[-1_500_001, -20, 0, 7]))) as recording:
        assert helpers.read_all(recording).t.tolist() == [-1_500_001, -20, 0, 7]


def test_sensor_given(write):
    with open_recording(write(**GOOD), sensor=(240, np.int64(180))) as recording:
        assert (recording.width, recording.height) == (240, 180)
        assert len(next(recording.chunks())) == 4


def test_closed(write):
    with open_recording(write(**GOOD)) as recording:
        pass
    recording.close()
    with pytest.raises(RecordingError, match="closed"):
        recording.chunks()


@pytest.mark.filterwarnings("error")
def test_nothing_stays_open(write):
    """Neither an unfinished iteration nor an error keeps the file open, nor is a closed file read."""
    path = write(**good(t=[10, 20, 5, 35]))
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


# -------------------------------------------------------------------- events that cannot be used


@pytest.mark.parametrize(
    "changed, parts",
    [
        (dict(t=[10, 20, 19, 35]), ["event 2 is 19 µs, after 20 µs"]),
        (dict(t=[-10, -20, 19, 35]), ["event 1 is -20 µs, after -10 µs"]),
        (dict(x=[0, -5, 3, 7]), ["x of event 1 is -5", "0 to 239"]),
        (dict(y=[0, 9, 3, -1]), ["y of event 3 is -1", "0 to 179"]),
        (dict(x=[0, 5, 240, 7]), ["x of event 2 is 240", "0 to 239", "240×180"]),
        (dict(y=[180, 9, 3, 7]), ["y of event 0 is 180", "0 to 179", "240×180"]),
        (dict(p=[0, 1, 2, 0]), ["polarity of event 2 is 2", "0 and 1, or -1 and 1"]),
        (dict(p=[0, 1, 1, -1]), ["-1 and 0 both"]),
    ],
)
@pytest.mark.parametrize("size", [1, 100])
def test_unusable_events(write, changed, parts, size):
    path = write(**good(**changed))
    with open_recording(path, sensor=(240, 180)) as recording, pytest.raises(RecordingError) as error:
        list(recording.chunks(size=size))
    check_error(error, path, *parts)


def test_coordinates_fit_in_memory(write):
    """Without a known sensor nothing may wrap in uint16."""
    path = write(**good(t=[0, 1, 2, 3], x=[0, 1, 2, 30_000]))
    with open_recording(path) as recording:
        assert next(recording.chunks()).x.max() == 30_000
    with open_recording(path, sensor=(30_000, 180)) as recording, pytest.raises(RecordingError, match="29999"):
        list(recording.chunks())


def test_index_of_the_event_counts_from_the_file(write, rng, helpers):
    events = helpers.make_events(rng)
    t = events.t.copy()
    t[700] = 0
    path = write(t, events.x, events.y, events.p)
    with open_recording(path) as recording:
        for start, size in ((0, 64), (650, 50), (699, 1)):
            with pytest.raises(RecordingError) as error:
                list(recording.chunks(start=start, size=size))
            check_error(error, path, f"event 700 is 0 µs, after {t[699]} µs")
        assert len(helpers.read_all(recording, start=701)) == 299


@pytest.mark.parametrize("start, allowed", [(4, "0 to 3"), (1000, "0 to 3"), (-1, "0 ")])
def test_start_outside(write, start, allowed):
    path = write(**GOOD)
    with open_recording(path) as recording, pytest.raises(RecordingError) as error:
        list(recording.chunks(start=start))
    check_error(error, path, f"first event {start}", allowed)


def test_no_events(write, tmp_path):
    path = write([], [], [], [])
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    check_error(error, path)
    assert "no events" in str(error.value) or "empty" in str(error.value)  # a text file of no lines


# -------------------------------------------------------------------- files that cannot be opened


def test_missing_file(tmp_path):
    path = tmp_path / "nothing.h5"
    with pytest.raises(RecordingError, match="no such file") as error:
        open_recording(path)
    check_error(error, path)


def test_directory(tmp_path):
    with pytest.raises(RecordingError, match="a directory") as error:
        open_recording(tmp_path)
    check_error(error, tmp_path)


@pytest.mark.parametrize("name", ["a.h5", "a.txt", "a.npy", "a.npz", "a.zip", "a"])
def test_empty_file(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"")
    with pytest.raises(RecordingError, match="the file is empty") as error:
        open_recording(path)
    check_error(error, path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_pipe_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe.txt")
    with pytest.raises(RecordingError, match="not a regular file"):
        open_recording(tmp_path / "pipe.txt")


def test_unreadable(write, monkeypatch):
    path = write(**GOOD)
    if hasattr(os, "geteuid") and os.geteuid():
        path.chmod(0)
    else:  # the superuser may read everything

        def refuse(self, *_):
            raise PermissionError(13, "Permission denied", str(self))

        monkeypatch.setattr(type(path), "open", refuse)
    with pytest.raises(RecordingError, match="cannot be read: Permission denied") as error:
        open_recording(path)
    check_error(error, path)


@pytest.mark.parametrize("name", ["a.bin", "a.rosbag", "a"])
def test_unknown_format(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(bytes(range(256)) * 10)
    with pytest.raises(RecordingError, match="format not known") as error:
        open_recording(path)
    check_error(error, path, "HDF5 (.h5", "text (.txt")


@pytest.mark.parametrize("name", ["a.h5", "a.hdf5", "a.npy", "a.npz", "a.zip", "a.txt", "a.aedat4", "a.aedat",
                                  "a.raw", "a.dat", "a.es"])  # fmt: skip
def test_content_does_not_fit_the_extension(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(bytes(range(256)) * 10)
    with pytest.raises(RecordingError, match="does not begin like it") as error:
        open_recording(path)
    check_error(error, path)


def test_content_goes_before_extension(write, helpers):
    path = write(**GOOD)
    renamed = path.rename(path.with_suffix(".dat"))
    with open_recording(renamed) as recording:
        assert len(helpers.read_all(recording)) == 4


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
def test_truncated(write, rng, helpers, share):
    """A file that was cut; text within a line, for a cut between two lines cannot be told."""
    events = helpers.make_events(rng, 3000)
    path = write(events.t, events.x, events.y, events.p)
    content = path.read_bytes()
    content = content[: int(share * len(content))]
    path.write_bytes(content.rsplit(b" ", 1)[0] if path.suffix == ".txt" else content)
    with pytest.raises(RecordingError) as error, open_recording(path) as recording:
        list(recording.chunks())
    check_error(error, path)
    assert re.search(r"truncated|line \d+: [123] fields?", str(error.value))


def test_changed_bytes(write, rng, helpers):
    """Whatever is damaged: the events are read, or refused in one line."""
    events = helpers.make_events(rng, 200)
    path = write(events.t, events.x, events.y, events.p)
    content = path.read_bytes()
    refused = 0
    for k in range(100):
        damaged = np.frombuffer(content, np.uint8).copy()
        reach = min(len(damaged), 1000) if k % 2 else len(damaged)  # headers are where most can go wrong
        damaged[rng.integers(reach, size=3)] = rng.integers(256, size=3)
        path.write_bytes(damaged.tobytes())
        try:
            with open_recording(path, sensor=(240, 180)) as recording:
                assert helpers.read_all(recording, size=50).x.max() < 240
        except RecordingError as error:
            assert "\n" not in str(error) and str(error).startswith(str(path))
            refused += 1
    assert refused > 10


@pytest.mark.parametrize("sensor", [(0, 10), (10,), (10, 1 << 17), "10x10", (10.5, 3), 7])
def test_sensor_not_allowed(write, sensor):
    path = write(**GOOD)
    with pytest.raises(RecordingError) as error:
        open_recording(path, sensor=sensor)
    check_error(error, path, "sensor")


def test_time_unit_not_allowed(write):
    path = write(**GOOD)
    with pytest.raises(RecordingError, match="'min' is not known; one of s, ms, us, ns") as error:
        open_recording(path, time_unit="min")
    check_error(error, path)


def test_chunk_size_not_allowed(write):
    with open_recording(write(**GOOD)) as recording, pytest.raises(RecordingError, match="1 or more"):
        recording.chunks(size=0)


# -------------------------------------------------------------------- registry, memory


def test_registry(tmp_path, monkeypatch, helpers):
    """A further format is recognised by its content, before text; and by default is not there."""
    monkeypatch.setattr(recording_module, "_FORMATS", list(formats()))
    events = Events([1, 2], [3, 4], [5, 6], [0, 1])
    path = tmp_path / "a.txt"
    path.write_text("EVENTS! 1 2 3 4\n")
    with pytest.raises(RecordingError, match="line 1"):
        open_recording(path)
    recording_module.register_format(
        Format(
            "mine",
            (".mine",),
            lambda head, path: head.startswith(b"EVENTS!"),
            lambda path, time_unit, sensor: MemoryRecording(events, *(sensor or (8, 8)), name=str(path)),
        )
    )
    with open_recording(path, sensor=(5, 7)) as recording:
        helpers.assert_same(helpers.read_all(recording), events)
        assert recording.width == 5


def test_memory_recording(rng, helpers):
    events = helpers.make_events(rng)
    recording = MemoryRecording(events, 240, 180, name="mine")
    assert (recording.path, recording.name, recording.format) == (None, "mine", "memory")
    assert (recording.width, recording.height, recording.num_events) == (240, 180, 1000)
    assert (recording.time_unit, recording.time_unit_source) == ("us", "file")
    helpers.assert_same(helpers.read_all(recording, start=10, size=33), events[10:])
    with pytest.raises(RecordingError, match="mine: first event 1000; 0 to 999"):
        recording.chunks(start=1000)
    with pytest.raises(RecordingError, match="x of event"):
        list(MemoryRecording(events, 100, 180).chunks())
    with pytest.raises(RecordingError, match="no events"):
        MemoryRecording(Events.empty(), 240, 180)


def test_memory_recording_keeps_microseconds(helpers):
    """Times in memory are µs by definition: the rule that looks at rates does not apply."""
    t = np.arange(2000) * 1_000_000
    recording = MemoryRecording(Events(t, t * 0, t * 0, t * 0), 2, 2)
    assert helpers.read_all(recording).t[-1] == t[-1]


# -------------------------------------------------------------------- real recordings


SENSORS = {
    **{windows.file: (240, 180) for windows in WINDOWS},
    "davis240b_evbench_seq0002.h5": (190, 180),
    "prophesee_spinner_640x480.h5": (640, 480),
}


@pytest.mark.parametrize("name", SENSORS)
def test_real_recordings(data_dir, name):
    with open_recording(data_dir / name) as recording:
        assert recording.time_unit_source == "file" and recording.time_unit == "us"
        assert (recording.width, recording.height) == SENSORS[name]


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


def test_text_equals_hdf5(data_dir, helpers):
    with (
        open_recording(data_dir / "davis240c_slider_depth_0.0s.h5") as h5,
        open_recording(data_dir / "original_formats" / "davis240c_slider_depth_0.0s_events.txt") as text,
    ):
        assert (text.time_unit, text.time_unit_source, text.num_events) == ("s", "assumed", None)
        helpers.assert_same(helpers.read_all(text), helpers.read_all(h5))


TWINS = {
    # file: same events in HDF5, sensor, largest difference of times in µs
    "davis240c_slider_depth_0.0s_events.txt": ("../davis240c_slider_depth_0.0s.h5", None, 0),
    "davis240c_translboxes_imu.aedat": ("../davis240c_translboxes_imu.h5", (240, 180), 0),
    "davis346_traffic.aedat4": ("davis346_traffic_decoded.h5", (346, 260), 0),
    "prophesee_spinner_640x480_evt2.raw": ("../prophesee_spinner_640x480.h5", (640, 480), 0),
    "prophesee_driving_1280x720_evt3.raw": ("prophesee_driving_1280x720_decoded.h5", (1280, 720), 20),
}


@pytest.mark.parametrize("name", TWINS)
def test_original_formats_equal_their_twins(data_dir, helpers, tmp_path, name):
    """Opened by a name that says nothing: the content decides."""
    if not name.endswith((".txt", ".aedat")):
        pytest.importorskip("faery")
    twin, sensor, largest = TWINS[name]
    (tmp_path / "recording").symlink_to(data_dir / "original_formats" / name)
    with (
        open_recording(tmp_path / "recording") as original,
        open_recording(data_dir / "original_formats" / twin) as h5,
    ):
        assert (original.width, original.height) == (sensor or (None, None))
        assert sensor in (None, (h5.width, h5.height))
        found, expected = helpers.read_all(original), helpers.read_all(h5)
    for column in "xyp":
        np.testing.assert_array_equal(getattr(found, column), getattr(expected, column), err_msg=column)
    assert np.abs(found.t - expected.t).max() <= largest
