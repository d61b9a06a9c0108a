"""NumPy arrays and archives."""

import io
import zipfile

import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import open_recording
from cmfpga.events.numpy_files import _Member


def table(events, dtype=np.int64):
    return np.stack([events.t, events.x, events.y, events.p], axis=1).astype(dtype)


def content(events, kind):
    return {
        "table": table(events),
        "floats": table(events, np.float64),
        "transposed": table(events).T.copy().T,  # NumPy stores this column by column
    }[kind]


@pytest.mark.parametrize("kind", ["table", "floats", "transposed"])
@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_tables(tmp_path, rng, helpers, kind, suffix):
    events = helpers.make_events(rng)
    path = tmp_path / f"a.{suffix}"
    (np.save if suffix == "npy" else np.savez)(path, content(events, kind))
    with open_recording(path) as recording:
        assert recording.num_events == 1000
        helpers.assert_same(helpers.read_all(recording, size=300), events)
        helpers.assert_same(helpers.read_all(recording, start=777, size=100), events[777:])


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("names", ["t x y p", "ts xs ys ps", "timestamps x y polarity"])
def test_archives_of_columns(tmp_path, rng, helpers, save, names):
    events = helpers.make_events(rng)
    path = tmp_path / "a.npz"
    save(path, frames=np.zeros(3), **{n: getattr(events, c) for n, c in zip(names.split(), "txyp", strict=True)})
    with open_recording(path) as recording:
        assert recording.format == "NumPy archive"
        helpers.assert_same(helpers.read_all(recording, size=300), events)


def test_archive_of_a_structured_array(tmp_path, rng, helpers):
    events = helpers.make_events(rng)
    path = tmp_path / "a.npz"
    np.savez(path, events=helpers.structured(events.t, events.x, events.y, events.p), other=np.zeros(2))
    with open_recording(path) as recording:
        helpers.assert_same(helpers.read_all(recording, size=300), events)


def test_array_is_mapped(tmp_path, rng, helpers):
    events = helpers.make_events(rng)
    np.save(tmp_path / "a.npy", table(events))
    with open_recording(tmp_path / "a.npy") as recording:
        assert recording.format == "NumPy array"
        helpers.assert_same(helpers.read_all(recording), events)


def test_message_names_the_columns(tmp_path, rng, helpers):
    events = helpers.make_events(rng)
    for path in (tmp_path / "a.npy", tmp_path / "b.npz"):
        (np.save if path.suffix == ".npy" else np.savez)(path, table(events)[:, [1, 2, 0, 3]])
        with open_recording(path) as recording, pytest.raises(RecordingError, match="columns t, x, y, p"):
            list(recording.chunks())


@pytest.mark.parametrize(
    "array, message",
    [
        (np.zeros((5, 3)), "array of 5×3; N×4"),
        (np.zeros(5), "array of 5; N×4"),
        (np.zeros((0, 4)), "no events"),
        (np.zeros((4, 5)), "array of 4×5"),
        (np.zeros(3, [("t", int), ("x", int), ("y", int)]), "p missing; p may be named p, ps"),
        (np.zeros(3, [("t", int), ("x", int), ("y", "U3"), ("p", int)]), "y holds <U3; real numbers"),
        (np.zeros((5, 4), complex), "t holds complex128"),
        (np.array([None] * 4), "numbers"),
    ],
)
@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_bad_arrays(tmp_path, array, message, suffix):
    path = tmp_path / f"a.{suffix}"
    (np.save if suffix == "npy" else np.savez)(path, array)
    with pytest.raises(RecordingError, match=message) as error:
        open_recording(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "members, message",
    [
        (dict(t=[1, 2], x=[1], y=[1, 2], p=[1, 2]), "t: 2, x: 1, y: 2, p: 2"),
        (dict(t=[1, 2], x=[1, 2], y=[1, 2]), "p missing"),
        (dict(a=[1, 2], b=[1, 2]), "t and x and y and p missing"),
        (dict(t=[], x=[], y=[], p=[]), "no events"),
    ],
)
def test_bad_archives(tmp_path, members, message):
    path = tmp_path / "a.npz"
    np.savez(path, **members)
    with pytest.raises(RecordingError, match=message):
        open_recording(path)


def test_members_can_be_read_backwards_too(tmp_path, rng, helpers):
    events = helpers.make_events(rng)
    np.savez_compressed(tmp_path / "a.npz", C=table(events), F=table(events).T.copy().T)
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        for name in ("C.npy", "F.npy"):
            member = _Member(archive, name)
            for start in (500, 900, 0, 499):
                np.testing.assert_array_equal(member[start : start + 100], table(events)[start : start + 100])
            member.close()


def test_archive_member_shorter_than_its_header(tmp_path, rng, helpers):
    events = helpers.make_events(rng)
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in "txyp":
            stream = io.BytesIO()
            np.save(stream, getattr(events, name))
            archive.writestr(f"{name}.npy", stream.getvalue()[: -100 if name == "x" else None])
    with pytest.raises(RecordingError, match="cannot be read") as error, open_recording(path) as recording:
        list(recording.chunks(size=10))
    assert str(error.value).startswith(str(path))


def test_changed_byte_in_an_archive(tmp_path, rng, helpers):
    events = helpers.make_events(rng, 100_000)
    path = tmp_path / "a.npz"
    np.savez_compressed(path, t=events.t, x=events.x, y=events.y, p=events.p)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0xFF
    path.write_bytes(raw)
    with pytest.raises(RecordingError) as error, open_recording(path) as recording:
        list(recording.chunks())
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)
