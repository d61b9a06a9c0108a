"""NumPy arrays and archives."""

import io
import zipfile

import numpy as np
import pytest

from cmfpga.events import open_recording
from cmfpga.events.numpy_files import Member
from support.recordings import assert_reads, columns, make_events, refusal, structured


def table(events, dtype=np.int64):
    return np.stack([events.t, events.x, events.y, events.p], axis=1).astype(dtype)


CONTENTS = {
    "table": table,
    "floats": lambda events: table(events, np.float64),
    "transposed": lambda events: table(events).T.copy().T,  # NumPy stores this column by column
}


@pytest.fixture(params=["npy", "npz"])
def save(request, tmp_path):
    """``save(array)``: path of a file of one array."""

    def save(array):
        path = tmp_path / f"a.{request.param}"
        (np.save if request.param == "npy" else np.savez)(path, array)
        return path

    return save


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_tables(save, rng, content):
    events = make_events(rng)
    path = save(content(events))
    recording = assert_reads(path, events, size=300)
    assert recording.num_events == 1000
    assert recording.format == {".npy": "NumPy array", ".npz": "NumPy archive"}[path.suffix]
    assert_reads(path, events[777:], start=777, size=100)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("names", ["t x y p", "ts xs ys ps", "timestamps x y polarity", "events"])
def test_archives_of_columns(tmp_path, rng, save, names):
    """Or of a structured array."""
    events, path = make_events(rng), tmp_path / "a.npz"
    arrays = [structured(*columns(events))] if names == "events" else columns(events)
    save(path, frames=np.zeros(3), **dict(zip(names.split(), arrays, strict=True)))
    assert assert_reads(path, events, size=300).format == "NumPy archive"


@pytest.mark.parametrize("order", ["x,y,p,t", "x,y,t,p", "t,p,x,y", "p,t,x,y"])
def test_order_of_columns_without_names(save, rng, order):
    events, at = make_events(rng), ["txyp".index(name) for name in order.split(",")]
    path = save(table(events)[:, at])
    assert_reads(path, events, size=300)
    note = f"{path}: columns taken as {order}, as their values are; --columns gives another order"
    for told, notes in ((None, [note]), (order, [])):
        with open_recording(path, columns=told) as recording:
            assert recording.notes() == notes


def test_message_names_the_columns(save, rng):
    """Where no order fits."""
    message = refusal(save(table(make_events(rng))[::-1]), "read")
    assert "(columns t, x, y, p; --columns (columns=) gives another order): time stamp of event" in message


def test_minus_one_of_an_unsigned_byte(tmp_path):
    np.savez(tmp_path / "a.npz", t=[1, 2, 3], x=[1, 1, 1], y=[1, 1, 1], p=np.array([1, 255, 1], np.uint8))
    assert_reads(tmp_path / "a.npz", {"p": [1, 0, 1]})
    with open_recording(tmp_path / "a.npz") as recording:
        assert "1 (2), 255 (1); those above 0, but for 255, are taken as brighter" in recording.notes()[0]


@pytest.mark.parametrize("parts", [("t", "xy", "p"), ("t", "x", "y", "p")])
def test_files_of_a_column_each(tmp_path, rng, parts):
    """As EVIMO2 has them: each stands for all, and so does their folder."""
    events = make_events(rng)
    for part in parts:
        array = np.stack([getattr(events, name) for name in part], axis=1)
        np.save(tmp_path / f"dataset_events_{part}.npy", array if part == "xy" else array[:, 0])
    np.save(tmp_path / "depth_t.npy", np.zeros(3))
    for path in (tmp_path, *(tmp_path / f"dataset_events_{part}.npy" for part in parts)):
        assert_reads(path, events, size=300)
    (tmp_path / "dataset_events_p.npy").unlink()
    assert ": a directory; a file is needed" in refusal(tmp_path)
    assert "array of 1000; N×4" in refusal(tmp_path / "dataset_events_t.npy")
    if "xy" in parts:
        np.save(tmp_path / "dataset_events_p.npy", events.p)
        np.save(tmp_path / "dataset_events_xy.npy", events.x)
        assert "dataset_events_xy.npy: array of 1000; N×2 of x and y is needed" in refusal(tmp_path)


@pytest.mark.parametrize("array, message", [
    (np.zeros((5, 3)), "array of 5×3; N×4"), (np.zeros(5), "array of 5; N×4"), (np.zeros((4, 5)), "array of 4×5"),
    (np.zeros((0, 4)), "no events"),
    (np.zeros(3, [("t", int), ("x", int), ("y", int)]), "p missing; p may be named p, ps"),
    (np.zeros(3, [("t", int), ("x", int), ("y", "U3"), ("p", int)]), "y holds <U3; real numbers"),
    (np.zeros((5, 4), complex), "t holds complex128"), (np.array([None] * 4), "numbers"),
])  # fmt: skip
def test_bad_arrays(save, array, message):
    assert message in refusal(save(array))


@pytest.mark.parametrize("members, message", [
    (dict(t=[1, 2], x=[1], y=[1, 2], p=[1, 2]), "t: 2, x: 1, y: 2, p: 2"),
    (dict(t=[1, 2], x=[1, 2], y=[1, 2]), "p missing"),
    (dict(a=[1, 2], b=[1, 2]), "t and x and y and p missing"),
    (dict(t=[], x=[], y=[], p=[]), "no events"),
])  # fmt: skip
def test_bad_archives(tmp_path, members, message):
    np.savez(tmp_path / "a.npz", **members)
    assert message in refusal(tmp_path / "a.npz")


def test_members_can_be_read_backwards_too(tmp_path, rng):
    events = make_events(rng)
    np.savez_compressed(tmp_path / "a.npz", C=table(events), F=CONTENTS["transposed"](events))
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        for name in ("C.npy", "F.npy"):
            member = Member(archive, name)
            for start in (500, 900, 0, 499):
                np.testing.assert_array_equal(member[start : start + 100], table(events)[start : start + 100])
            member.close()


def test_archive_member_shorter_than_its_header(tmp_path, rng):
    events = make_events(rng)
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in "txyp":
            stream = io.BytesIO()
            np.save(stream, getattr(events, name))
            archive.writestr(f"{name}.npy", stream.getvalue()[: -100 if name == "x" else None])
    assert "cannot be read" in refusal(path, "either", size=10)
