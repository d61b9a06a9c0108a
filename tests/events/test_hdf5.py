"""Layouts and attributes of HDF5 recordings."""

import dataclasses
import functools
import subprocess
import sys

import h5py
import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import open_recording, write_hdf5
from support.recordings import assert_reads, make_events, refusal, structured


@pytest.fixture
def h5(tmp_path):
    """``h5(content, **attrs)``: path of a file with these data sets (by name) and root attributes."""

    def write(content, **attrs):
        path = tmp_path / "a.h5"
        with h5py.File(path, "w") as file:
            for name, values in content.items():
                file[name] = values
            file.attrs.update(attrs)
        return path

    return write


def columns(events, names, prefix="events/"):
    return {prefix + name: getattr(events, column) for name, column in zip(names, "txyp", strict=True)}


def table(events, dtype, names="txyp"):
    return {"events": np.stack([getattr(events, name) for name in names], axis=1).astype(dtype)}


NAMES = [
    ("t x y p", "events/"), ("ts xs ys ps", "events/"), ("timestamp x y polarity", "events/"), ("t x y p", ""),
    ("timestamps x y polarities", ""),
]  # fmt: skip
LAYOUTS = {
    **{prefix + names: functools.partial(columns, names=names.split(), prefix=prefix) for names, prefix in NAMES},
    **{dtype: functools.partial(table, dtype=dtype) for dtype in ("int64", "float64")},
    "compound": lambda events: {"events": structured(events.t, events.x, events.y, events.p)},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts(h5, rng, layout):
    events = make_events(rng)
    recording = assert_reads(h5(LAYOUTS[layout](events)), events, size=300)
    assert recording.num_events == 1000 and (" " in layout or recording.time_unit == "us")


@pytest.mark.parametrize("prefix", ["cam0/", "prophesee/left/"])
def test_the_only_events_are_found_anywhere_or_named(h5, rng, prefix):
    events, other = make_events(rng), make_events(rng)
    assert_reads(h5({**columns(events, "txyp", prefix), "imu/t": [1]}), events)
    path = h5({**columns(events, "txyp", prefix), **columns(other, "txyp")})
    assert_reads(path, other)
    assert_reads(path, events, dataset=prefix)
    assert f"{prefix}p (1000 uint8), {prefix}t (1000 int64), " in refusal(path, dataset="imu")


def test_columns_in_another_order(h5, rng):
    events = make_events(rng)
    assert_reads(h5(table(events, "int64", "xypt")), events, columns="x,y,p,t")
    wide = np.insert(table(events, "int64", "pxyt")["events"], 1, 7, axis=1)
    assert_reads(h5({"deep/inside": wide}), events, columns=["p", "id", "x", "y", "t"], dataset="deep/inside")
    assert "array of 1000×5; N×4 with columns t, x, y, p" in refusal(h5({"events": wide}))
    assert "columns x,y,t,p: they have names" in refusal(h5(columns(events, "txyp")), columns="x,y,t,p")


def test_mvsec(h5, rng):
    events = make_events(rng)
    table = np.stack([events.x, events.y, events.t * 1e-6 + 1.5e9, events.p * 2.0 - 1], axis=1)
    # float64 resolves 0.24 µs at this time, so the nearest µs is the right one
    later = dataclasses.replace(events, t=events.t + 1_500_000_000_000_000)
    recording = assert_reads(h5({"davis/left/events": table}), later)
    assert (recording.width, recording.height, recording.time_unit) == (346, 260, "s")


def test_dsec(h5, rng):
    events = make_events(rng)
    content = columns(events, "txyp")
    content["events/t"] = events.t.astype(np.uint32)
    offset = np.int64(52_000_000_123)
    path = h5({**content, "t_offset": offset, "ms_to_idx": np.arange(5)})
    recording = assert_reads(path, {"t": (events.t + offset).tolist()})
    assert (recording.width, recording.height) == (640, 480)
    later = {"t": ((events.t + 500) // 1000 + 1).tolist()}
    assert assert_reads(h5({**content, "t_offset": np.int64(1000)}), later, time_unit="ns").width is None


@pytest.mark.parametrize("attrs", [
    dict(sensor_width=240, sensor_height=180), dict(width=240.0, height=np.array([180])),
    dict(sensor_resolution=(180, 240)),
])  # fmt: skip
def test_sensor_attributes(h5, rng, attrs):
    path = h5(columns(make_events(rng), "txyp"), **attrs)
    for told, size in (({}, (240, 180)), ({"sensor": (300, 200)}, (300, 200))):
        with open_recording(path, **told) as recording:
            assert (recording.width, recording.height) == size


@pytest.mark.parametrize("attrs", [
    dict(width=0, height=180), dict(width="wide", height=3), dict(sensor_resolution=5),
    dict(width=np.inf, height=1e300), dict(sensor_resolution=np.nan),
])  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_odd_sensor_attributes(h5, rng, attrs):
    path = h5(columns(make_events(rng), "txyp"), **attrs)
    assert "attribute" in refusal(path)
    open_recording(path, sensor=(240, 180)).close()


@pytest.mark.parametrize("holder", ["events/t", "events", "/"])
@pytest.mark.parametrize("text, factor", [("ns", 1e-3), ("microseconds", 1), (b"milliseconds", 1000), ("S", 10**6)])
def test_unit_attribute(h5, rng, holder, text, factor):
    events = make_events(rng)
    path = h5(columns(events, "txyp"))
    with h5py.File(path, "a") as file:
        file[holder].attrs["unit" if holder == "events/t" else "time_unit"] = text
    found = {"t": np.floor(events.t * factor + 0.5).tolist()}
    assert assert_reads(path, found).time_unit_source == "file"
    assert assert_reads(path, events, time_unit="us").time_unit_source == "given"


def test_unknown_unit_attribute(h5, rng):
    path = h5(columns(make_events(rng), "txyp"), time_unit="ticks")
    assert "time_unit of /: time unit 'ticks' is not known" in refusal(path)


def test_an_attribute_of_a_damaged_type(h5, rng):
    """One bit makes a text a sequence of variable length, whose addresses lie anywhere: HDF5 would end the process."""
    path = h5(columns(make_events(rng), "txyp"), time_unit="us")
    text, sequence = b"\x19\x01\x01\0\x10\0\0\0", b"\x19\0\x01\0\x10\0\0\0"
    assert path.read_bytes().count(text) == 1
    path.write_bytes(path.read_bytes().replace(text, sequence))
    script = f"from cmfpga.events import open_recording; open_recording({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr.endswith(f"{path}: attribute time_unit of /: text or numbers are needed\n")


@pytest.mark.parametrize("missing", "txyp")
@pytest.mark.parametrize("prefix", ["events/", ""])
def test_missing_column(h5, rng, missing, prefix):
    content = columns(make_events(rng), "txyp", prefix)
    del content[prefix + missing]
    assert f"{missing} missing; {missing} may be named {missing}, " in refusal(h5(content))


@pytest.mark.parametrize("content, message", [
    ({}, "no events found; it holds no data sets"),
    ({"images": np.zeros((4, 4))}, "no events found; it holds images (4×4 float64); --dataset PATH"),
    ({f"a/{k:02}": [k] for k in range(20)}, "a/06 (1 int64), a/07 (1 int64), 12 more; --dataset PATH"),
    ({f"{side}/{name}": [1] for side in ("left", "right") for name in "txyp"}, "events in /left and /right; it holds "),
    ({"events": np.zeros((5, 3))}, "array of 5×3; N×4"), ({"events": np.zeros((0, 4))}, "no events"),
    ({"events": np.float64(3)}, "a single value"), ({"t/a": [1], "x": [1], "y": [1], "p": [1]}, "/t is a group"),
    ({"t": [1, 2, 3], "x": [1, 2], "y": [1, 2, 3], "p": [1, 1, 1]}, "t: 3, x: 2, y: 3, p: 3"),
    ({"t": [[1, 2]], "x": [[1, 2]], "y": [[1, 2]], "p": [[1, 1]]}, "t: 1×2"),
    ({"t": [1, 2], "x": [1, 2], "y": ["a", "b"], "p": [1, 1]}, "y holds object; real numbers"),
])  # fmt: skip
def test_bad_content(h5, content, message):
    assert message in refusal(h5(content))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("size", [1, 100])
def test_times_not_finite(h5, bad, size):
    path = h5({"events/t": [0.0, 0.1, bad, 0.2], "events/x": [1] * 4, "events/y": [1] * 4, "events/p": [1] * 4})
    assert "event 2" in refusal(path, "read", size=size)


@pytest.mark.parametrize("x, shown", [(2.5, "2.5"), (np.nan, "nan"), (-1.0, "-1"), (1e9, "1000000000")])
def test_odd_float_coordinates(h5, x, shown):
    assert f"x of event 1 is {shown}" in refusal(h5({"events": np.array([[0, 1, 1, 1], [1, x, 1, 1]])}), "read")


@pytest.mark.parametrize("options, message", [
    ({"shape": (10**12,)}, "it declares 1000000000000, and holds less"),
    ({"shape": (10**12,), "chunks": (1000,)}, "it declares 1000000000000, and holds less"),
    ({"shape": (10**9,), "chunks": (1 << 28,)}, "pieces of 2,147,483,648 bytes are needed at a time; too large"),
])  # fmt: skip
def test_events_that_are_declared_but_not_there(tmp_path, options, message):
    """HDF5 would give zeros, without end."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in "txyp":
            file.create_dataset(f"events/{name}", dtype="i8", **options)
    assert message in refusal(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in "txyp":
            file.create_virtual_dataset(f"events/{name}", h5py.VirtualLayout((10**12,), "i8"))
    assert "/events/t refers to other files; a copy of its events is needed" in refusal(tmp_path / "a.h5")


def test_damaged_inside(h5, rng, tmp_path):
    """Compressed bytes that were changed are found when they are read, not when the file is opened."""
    path = tmp_path / "a.h5"
    events = make_events(rng, 100_000)
    with h5py.File(path, "w") as file:
        for name in "txyp":
            file.create_dataset(f"events/{name}", data=getattr(events, name), chunks=(10_000,), compression="gzip")
        offset = file["events/x"].id.get_chunk_info(9).byte_offset
    content = bytearray(path.read_bytes())
    content[offset : offset + 1000] = bytes(1000)
    path.write_bytes(content)
    with open_recording(path) as recording:
        assert len(next(recording.chunks(size=10_000))) == 10_000
    assert "events 90000 to 99999 cannot be read" in refusal(path, "read", size=10_000)


def test_write_and_reopen(tmp_path, rng):
    path = tmp_path / "a.h5"
    events = make_events(rng, 50_000)
    write_hdf5(path, events, 240, 180, recording="demo", speed=(1.5, 2.5))
    recording = assert_reads(path, events)
    assert (recording.width, recording.height, recording.num_events) == (240, 180, 50_000)
    assert (recording.time_unit, recording.time_unit_source) == ("us", "file")
    with h5py.File(path) as file:
        assert file.attrs["recording"] == "demo" and file.attrs["speed"].tolist() == [1.5, 2.5]
        assert (file.attrs["t_first_us"], file.attrs["t_last_us"]) == (events.t[0], events.t[-1])
        assert [file["events"][name].dtype.str for name in "txyp"] == ["<i8", "<u2", "<u2", "|u1"]


def test_write_errors(tmp_path, rng):
    events = make_events(rng)
    for name, given, width, message in (
        ("nowhere/a.h5", events, 240, "cannot be written"), ("a.h5", events[:0], 240, "no events to write"),
        ("a.h5", events, 0, "sensor of 0×180"),
    ):  # fmt: skip
        with pytest.raises(RecordingError, match=message):
            write_hdf5(tmp_path / name, given, width, 180)
    assert not list(tmp_path.iterdir())


def filtered(path, events, number, chunk=b"not by this filter"):
    """A file whose t went through the filter of that number, as far as it says."""
    with h5py.File(path, "w") as file:
        for name in "xyp":
            file[f"events/{name}"] = getattr(events, name)
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk((len(events),))
        made.set_filter(number, h5py.h5z.FLAG_OPTIONAL, (2, 2, 8))
        space = h5py.h5s.create_simple((len(events),))
        t = h5py.h5d.create(file["events"].id, b"t", h5py.h5t.NATIVE_INT64, space, made)
        if chunk is None:
            file["events/t"][:] = events.t  # an optional filter that is missing is passed over
        else:
            t.write_direct_chunk((0,), chunk)


@pytest.mark.parametrize("number, name", [(32001, "Blosc "), (32015, "Zstandard "), (400, "")])
def test_a_filter_that_is_missing(tmp_path, rng, monkeypatch, number, name):
    """It is named, and the package that brings it: nothing is damaged."""
    path, available = tmp_path / "a.h5", h5py.h5z.filter_avail
    filtered(path, make_events(rng), number)
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda asked: asked != number and available(asked))
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    told = f": /events/t needs the HDF5 filter {name}(id {number}), which is missing: "
    assert refusal(path) == f"{told}pip install hdf5plugin"
    monkeypatch.setitem(sys.modules, "hdf5plugin", sys)
    assert refusal(path) == f"{told}hdf5plugin does not bring it; a copy without it is needed"


def test_an_optional_filter_that_was_not_used(tmp_path, rng):
    events = make_events(rng)
    filtered(tmp_path / "a.h5", events, 400, chunk=None)
    assert_reads(tmp_path / "a.h5", events)


PROGRAM = """
import sys
from cmfpga.events import open_recording
with open_recording(sys.argv[1]) as recording:
    print(sum(int(chunk.t.sum()) for chunk in recording.chunks()), recording.width)
"""


@pytest.mark.parametrize("name", ["Blosc", "Zstd", "LZ4", "Bitshuffle"])
def test_filters_of_hdf5plugin(tmp_path, rng, name):
    """As DSEC, VECtor and TUM-VIE are published; read by a process that has not imported it."""
    hdf5plugin = pytest.importorskip("hdf5plugin")
    events = make_events(rng)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for column in "txyp":
            file.create_dataset(f"events/{column}", data=getattr(events, column), **getattr(hdf5plugin, name)())
        file["t_offset"], file["ms_to_idx"] = 0, [0, 5]
    program = [sys.executable, "-c", PROGRAM, tmp_path / "a.h5"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == [str(events.t.sum()), "640"], done.stderr
