"""NumPy recordings: ``.npz`` archives and ``.npy`` arrays.

- ``.npy``: a structured array with fields named as in ``columns.NAMES``, or N×4 with columns t, x, y, p. The file is
  mapped into memory, so only what is read is loaded. Or three files, ``…t.npy``, ``…xy.npy`` and ``…p.npy``, as EVIMO2
  has them, or four: each of them stands for all, and so does the folder that holds no others of the kind.
- ``.npz``: arrays named as in ``columns.NAMES``; or one array, named ``events`` or the only one, as for ``.npy``.
  Members are streamed, compressed or not: memory is bounded, but an iteration that starts at a later event
  decompresses all that comes before it.
"""

import contextlib
import lzma
import math
import tokenize
import zipfile
import zlib

import numpy as np

from ..errors import RecordingError
from .columns import Columns, ColumnsRecording, match_names, readable, require_names
from .recording import Format

# The header of an array is Python's notation, so a damaged one may fail as a program does.
_NPY_ERRORS = (OSError, EOFError, ValueError, SyntaxError, TypeError, OverflowError, MemoryError, tokenize.TokenError)
# RuntimeError, with NotImplementedError below it: encryption, compressions and versions that zipfile does not know.
#: What reading a damaged archive raises.
NPZ_ERRORS = (*_NPY_ERRORS, LookupError, RuntimeError, zipfile.BadZipFile, zlib.error, lzma.LZMAError)
_SKIP_BYTES = 1 << 20
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def open_npy(path, *, time_unit=None, sensor=None, columns=None):
    """The :class:`Recording` of a ``.npy`` file, or of some that hold a column each."""
    files, source = _files_of_columns(path), {}
    for part, file in (files or {"": path}).items():
        with readable(f"{file}: not a readable .npy file of numbers", _NPY_ERRORS):
            array = np.load(file, mmap_mode="r", allow_pickle=False)
        if len(part) == 2 and (array.ndim != 2 or array.shape[1] != 2):
            raise RecordingError(f"{file}: array of {'×'.join(map(str, array.shape))}; N×2 of x and y is needed")
        source |= {name: array[:, k] if len(part) == 2 else array for k, name in enumerate(part)}
    found = Columns(source or array, str(path), columns)
    return ColumnsRecording(lambda: found, path=path, format="NumPy array", sensor=sensor, time_unit=time_unit)


def _files_of_columns(path):
    """``{"t": file, "xy": file, "p": file}`` of which ``path`` is one, or the folder; empty if there are no such."""
    folder, begins = path.parent, [path.stem[: path.stem.rfind("_") + 1]]
    if path.is_dir():
        folder, begins = path, [file.stem[:-1] for file in path.glob("*t.npy")]
    found = [
        {part: folder / f"{begin}{part}.npy" for part in parts}
        for begin in begins for parts in (("t", "xy", "p"), ("t", "x", "y", "p"))
    ]  # fmt: skip
    found = [files for files in found if all(file.is_file() for file in files.values())]
    return found[0] if len(found) == 1 and (path.is_dir() or path in found[0].values()) else {}


class NpzRecording(ColumnsRecording):
    """Events of a ``.npz`` archive, streamed from its members."""

    def __init__(self, path, *, time_unit=None, sensor=None, columns=None):
        self._order = columns
        with readable(f"{path}: not a readable .npz archive", NPZ_ERRORS), contextlib.ExitStack() as opened:
            self._file = opened.enter_context(zipfile.ZipFile(path))
            super().__init__(
                self._open, path=path, format="NumPy archive", sensor=sensor, time_unit=time_unit,
                read_errors=NPZ_ERRORS,
            )  # fmt: skip
            opened.pop_all()

    def _open(self):
        path = self._file.filename
        files = {name.removesuffix(".npy"): name for name in self._file.namelist() if name.endswith(".npy")}
        if not match_names(files) and ("events" in files or len(files) == 1):
            source = Member(self._file, files.get("events") or next(iter(files.values())))
            members = [source]
        else:
            names = require_names(files, path)
            source = {column: Member(self._file, files[name]) for column, name in names.items()}
            members = source.values()

        def close():  # the archive's file is only released when all its streams are
            for member in members:
                member.close()

        return Columns(source, path, self._order, close)


class Member:
    """An array in an archive, sliced along its first axis with few bytes in memory; ascending slices are fast.

    One stream for an array in C order; one per column for Fortran order, which is what saving ``array.T`` gives.
    """

    def __init__(self, archive, name):
        self._archive = archive
        self._name = name
        with archive.open(name) as stream:
            version = np.lib.format.read_magic(stream)
            if version not in _HEADERS:
                raise ValueError(f"{name} has version {version} of the .npy format; 1.0 or 2.0 is needed")
            self.shape, fortran, self.dtype = _HEADERS[version](stream)
            self._data = stream.tell()
        if self.dtype.hasobject:
            raise ValueError(f"{name} holds Python objects")
        if math.prod(self.shape) * max(self.dtype.itemsize, 1) > archive.getinfo(name).file_size:
            raise EOFError(f"{name} ends early")
        columns = fortran and len(self.shape) == 2
        self._streams = [None] * (self.shape[1] if columns else 1)
        self._row_bytes = self.dtype.itemsize * (1 if columns else math.prod(self.shape[1:]))

    def __getitem__(self, index):
        start, stop, _ = index.indices(self.shape[0])
        if len(self._streams) == 1:
            return self._read(0, start, stop).reshape(-1, *self.shape[1:])
        return np.stack([self._read(k, start, stop) for k in range(len(self._streams))], axis=1)

    def all(self):
        """The whole array."""
        self.shape, shape = self.shape or (1,), self.shape
        return self[:].reshape(shape)

    def close(self):
        for stream in self._streams:
            if stream is not None:
                stream.close()

    def _read(self, k, start, stop):
        begin = self._data + (k * self.shape[0] + start) * self._row_bytes
        stream = self._streams[k]
        if stream is None or stream.tell() > begin:
            if stream is not None:
                stream.close()
            stream = self._streams[k] = self._archive.open(self._name)
        while stream.tell() < begin and stream.read(min(_SKIP_BYTES, begin - stream.tell())):
            pass  # not seek(), which may hold all that it skips
        size = (stop - start) * self._row_bytes
        content = stream.read(size)
        if len(content) < size:
            raise EOFError(f"{self._name} ends early")
        return np.frombuffer(content, self.dtype)


def _is_npy(head, path):
    return head.startswith(b"\x93NUMPY") or (path.is_dir() and bool(_files_of_columns(path)))


def _is_npz(head, path):
    if not head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith(".npy") for name in archive.namelist())
    except NPZ_ERRORS:
        return path.suffix.lower() == ".npz"


FORMATS = (
    Format("NumPy array", (".npy",), _is_npy, open_npy, ("columns",)),
    Format("NumPy archive", (".npz",), _is_npz, NpzRecording, ("columns",)),
)
