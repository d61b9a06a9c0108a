"""Files that are damaged, and those that are not but cannot be read."""

import re
import struct
import zipfile

import h5py
import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import open_recording
from support.recordings import columns, cut, damaged, flip, make_events, read_all, refusal


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
def test_truncated(write, rng, share):
    """A file that was cut; text within a line, for a cut between two lines cannot be told."""
    path = write(*columns(make_events(rng, 3000)))
    cut(path, share)
    if path.suffix == ".txt":
        path.write_bytes(path.read_bytes().rsplit(b" ", 1)[0])
    assert re.search(r"truncated|line \d+: [123] fields?", refusal(path, "either"))


@pytest.mark.parametrize("write", ["npz", "zip", "txt.gz"], indirect=True)
def test_one_changed_byte_of_what_is_compressed(write, rng):
    path = write(*columns(make_events(rng, 100_000)))
    flip(path)
    assert re.search("truncated or damaged|line", refusal(path, "either"))


def test_changed_bytes(write, rng):
    """Whatever is damaged: the events are read, or refused in one line."""
    path = write(*columns(make_events(rng, 200)))
    refused = 0
    for content in damaged(path, rng, 100, headers=1000):  # headers are where most can go wrong
        path.write_bytes(content)
        try:
            with open_recording(path, sensor=(240, 180)) as recording:
                assert read_all(recording, size=50).x.max() < 240
        except RecordingError as error:
            assert "\n" not in str(error) and str(error).startswith(str(path))
            refused += 1
    assert refused > 10


def _encrypted(path, flags=1, method=None):
    """A zip archive of an .npy file whose headers say that it is encrypted, or compressed by another method."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("events.npy" if path.suffix == ".npz" else "events.txt", b"0.1 1 1 1\n" * 50)
    content = bytearray(path.read_bytes())
    for sign, at in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        at += content.index(sign)
        content[at : at + 4] = struct.pack("<2H", flags, 8 if method is None else method)
    path.write_bytes(content)


def _of_type(path, kind=None):
    """HDF5 with times of this type; of none: in another file."""
    with h5py.File(path, "w") as file:
        for name in "xyp":
            file[f"events/{name}"] = [1, 1]
        if kind:
            h5py.h5d.create(file["events"].id, b"t", kind, h5py.h5s.create_simple((2,)))
        else:
            file.create_dataset("events/t", (2,), dtype="i8", external=[(str(path) + ".bin", 0, 16)])


def _of_version(path):
    with h5py.File(path, "w") as file:
        file["events/t"] = [1, 2]
    content = bytearray(path.read_bytes())
    content[8] = 9
    path.write_bytes(content)


WHOLE = {
    "a.npz": (_encrypted, r"\(encrypted\): .*; a copy without a password is needed"),
    "a.zip": (_encrypted, r"\(encrypted\): .*; a copy without a password is needed"),
    "b.npz": (lambda path: _encrypted(path, 0, 93), r"\(compressed by an unknown method\): .*savez_compressed"),
    "a.npy": (lambda path: np.save(path, np.array([{}])),
              r"\(of an unsupported type\): .*; numbers t, x, y, p are needed"),
    "a.h5": (lambda path: _of_type(path, h5py.h5t.UNIX_D64LE), r"\(of an unsupported type\): .*; numbers t, x, y, p"),
    "b.h5": (_of_type, r"\(incomplete\): .*; it refers to another file, which is needed beside it"),
    "c.h5": (_of_version, r"\(of an unknown version\): .*; a newer release"),
}  # fmt: skip


@pytest.mark.parametrize("name", WHOLE)
def test_what_is_not_damaged_is_not_called_so(tmp_path, name):
    """A password, a compression, a type, a version, a file that is elsewhere: each with its cure."""
    make, message = WHOLE[name]
    make(tmp_path / name)
    told = refusal(tmp_path / name, "either")
    assert re.search(message, told) and "damaged" not in told
