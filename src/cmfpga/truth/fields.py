"""True flow of every pixel, window by window, as data sets have it.

- A folder of DSEC: ``forward/*.png`` (16-bit RGB: 128·x + 2^15, 128·y + 2^15 in px, and 0 where it is unknown), in
  the order of the lines of ``forward_timestamps.txt`` (begin and end, µs); or the folder ``forward`` itself.
- ``.npz`` of MVSEC: ``timestamps`` (s), ``x_flow_dist`` and ``y_flow_dist`` [N, rows, columns], px until the next time.
- HDF5: one of :data:`DATASETS`, [N, 2, rows, columns], px; its times, µs if they are whole, else s, stand beside it:
  [N, 2], begin and end; or [N], until the next. Or [2, rows, columns], over all of ``/events/t``.

But for PNG, NaN and a flow of exactly 0, 0 are not known.
"""

import struct
import zipfile
import zlib

import h5py
import numpy as np

from ..errors import RecordingError
from ..events.columns import readable
from ..events.numpy_files import NPZ_ERRORS, Member

#: ``{data set of a flow: that of its times}``; those of MVSEC come first.
DATASETS = {
    "davis/left/flow_dist": "davis/left/flow_dist_ts",
    "flow": "flow_ts",
    "flow/flow": "flow/timestamps",
    "ground_truth/flow": "ground_truth/flow_ts",
}
_HDF5_ERRORS = (OSError, LookupError, RuntimeError, TypeError, ValueError, AttributeError)
_PNG_ERRORS = (OSError, ValueError, IndexError, struct.error, zlib.error)
_COVERED = 0.9  # of a window's time


class FlowField:
    """A flow over time; each of its windows, which begin and end at ``times`` [N, 2], µs, ascending, has one.

    ``frame(k)`` is the motion in window k, px, float64 [rows, columns, 2]; NaN where it is not known. ``first`` and
    ``last`` are the range of time that is covered, µs.
    """

    def __init__(self, times, shape, frame):
        self.times, self.shape, self._frame = np.asarray(times, np.float64).reshape(-1, 2), tuple(shape), frame
        if not len(self.times) or not np.isfinite(self.times).all() or (self.times[:, 1] <= self.times[:, 0]).any():
            raise ValueError("times that ascend are needed")
        if (np.diff(self.times[:, 0]) <= 0).any():
            raise ValueError("windows in the order of time are needed")
        self.first, self.last = float(self.times[0, 0]), float(self.times[-1, 1])
        self._kept = {}

    def mean(self, t0, t1):
        """Mean flow from ``t0`` to ``t1``, µs, of what overlaps: px/s, float64 [rows, columns, 2].

        NaN where it is not known, and everywhere if a tenth of the time or more has no flow.
        """
        overlap = np.clip(np.minimum(self.times[:, 1], t1) - np.maximum(self.times[:, 0], t0), 0, None)
        if overlap.sum() < _COVERED * (t1 - t0):
            return np.full((*self.shape, 2), np.nan)
        used = np.flatnonzero(overlap)
        kept, lengths = self._kept, np.diff(self.times) * 1e-6
        self._kept = {k: kept[k] if k in kept else self._frame(k) / lengths[k] for k in used.tolist()}
        return sum(overlap[k] * flow for k, flow in self._kept.items()) / overlap.sum()


def is_field(path):
    """Whether a path is one of these files, by its form; an HDF5 file by what is in it."""
    if path.is_dir() or path.suffix.lower() == ".npz":
        return True
    if not (path.is_file() and h5py.is_hdf5(path)):
        return False
    with readable(f"{path}: not a readable HDF5 file", _HDF5_ERRORS), h5py.File(path, "r") as file:
        return any(isinstance(file.get(name), h5py.Dataset) for name in DATASETS)


def read_field(path):
    """The :class:`FlowField` of a file, or folder. Raises :exc:`RecordingError`, one line."""
    if path.is_dir():
        return _read_dsec(path)
    return _read_npz(path) if path.suffix.lower() == ".npz" else _read_hdf5(path)


def _ends(times):
    """Begin and end of windows that last until the next time; the last one is as long as the one before."""
    times = np.asarray(times, np.float64)
    if times.ndim == 2:
        return times
    return np.stack([times, np.append(times[1:], 2 * times[-1] - times[-2])], axis=1)


def _known(flow):
    """Float64 with NaN instead of 0, 0."""
    flow = np.array(flow, np.float64)
    flow[(flow == 0).all(axis=2)] = np.nan
    return flow


def _read_npz(path):
    needed = "timestamps, x_flow_dist and y_flow_dist [N, rows, columns] are needed"
    names = ("timestamps", "x_flow_dist", "y_flow_dist")
    with readable(f"{path}: no flow as MVSEC has it: {needed}", NPZ_ERRORS):
        archive = zipfile.ZipFile(path)  # stays open, for flow is read as it is needed
        times, *axes = (Member(archive, f"{name}.npy") for name in names)
        if len(times.shape) != 1 or times.shape[0] < 2 or any(one.shape[:1] != times.shape for one in axes):
            raise ValueError("lengths differ")
        if len(axes[0].shape) != 3 or axes[0].shape != axes[1].shape:
            raise ValueError("not of pixels")

        def frame(k):
            with readable(f"{path}: flow {k} cannot be read", NPZ_ERRORS):
                return _known(np.stack([one[k : k + 1][0] for one in axes], axis=-1))

        return FlowField(_ends(times[:] * 1e6), axes[0].shape[1:], frame)


def _read_hdf5(path):
    with readable(f"{path}: no readable flow", _HDF5_ERRORS):
        file = h5py.File(path, "r")
        name = next(name for name in DATASETS if isinstance(file.get(name), h5py.Dataset))
        flow, when = file[name], file.get(DATASETS[name])
        if flow.dtype.kind not in "fiu" or flow.ndim not in (3, 4) or flow.shape[flow.ndim - 3] != 2:
            raise ValueError(f"/{name}: N×2×rows×columns is needed")
        if flow.ndim == 4 and when is None:
            raise ValueError(f"/{name}: its times, /{DATASETS[name]}, are needed")
        times = when[()] if when is not None else np.array([[file["events/t"][0], file["events/t"][-1]]])
        count = len(flow) if flow.ndim == 4 else 1
        if times.shape not in ((count,), (count, 2)) or times.shape == (1,):
            raise ValueError(f"/{DATASETS[name]}: a time, or begin and end, is needed for each of {count} flows")
        whole = times.dtype.kind in "iu" or not (times % 1).any()

        def frame(k):
            with readable(f"{path}: flow {k} cannot be read", _HDF5_ERRORS):
                return _known(np.moveaxis(flow[k] if flow.ndim == 4 else flow[()], 0, 2))

        return FlowField(_ends(times) * (1 if whole else 1e6), flow.shape[-2:], frame)


def _read_dsec(path):
    folder = path / "forward" if (path / "forward").is_dir() else path
    text = folder.with_name(f"{folder.name}_timestamps.txt")
    images = sorted(folder.glob("*.png"))
    if not images:
        raise RecordingError(f"{path}: cannot be read: a folder without forward/*.png, the flow as DSEC has it")
    needed = f"{text}: begin and end, µs, of each of {len(images)} images are needed"
    try:
        lines = text.read_text(encoding="utf-8").splitlines()
        times = [[*map(int, line.split(","))] for line in lines if line.strip() and not line.startswith("#")]
    except (OSError, ValueError) as error:
        raise RecordingError(f"{needed}: {getattr(error, 'strerror', None) or error}") from None
    if len(times) != len(images) or {*map(len, times)} != {2}:
        raise RecordingError(f"{needed}, not {len(times)} lines")

    def frame(k):
        with readable(f"{images[k]}: no flow as DSEC has it, RGB of 16 bits", _PNG_ERRORS):
            raw = read_png(images[k]).astype(np.float64)
        flow = (raw[..., :2] - 2**15) / 128
        flow[raw[..., 2] == 0] = np.nan
        return flow

    with readable(f"{text}: no times of windows", ValueError):
        return FlowField(times, frame(0).shape[:2], frame)


def read_png(path):
    """An RGB image with 16 bits each: uint16 [rows, columns, 3]. No library that we have reads all 16."""
    data, at, packed, head = path.read_bytes(), 8, [], None
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body, at = data[at + 8 : at + 8 + size], at + 12 + size
        head = struct.unpack(">IIBBBBB", body) if kind == b"IHDR" else head
        packed += [body] * (kind == b"IDAT")
    if data[:8] != b"\x89PNG\r\n\x1a\n" or head is None or head[2:] != (16, 2, 0, 0, 0):
        raise ValueError("not RGB with 16 bits, without interlace")
    columns, rows = head[:2]
    lines = np.frombuffer(zlib.decompress(b"".join(packed)), np.uint8).reshape(rows, 1 + 6 * columns)
    before, image = np.zeros((columns, 6), np.uint8), np.empty((rows, columns, 6), np.uint8)
    for k, (kind, line) in enumerate(zip(lines[:, 0].tolist(), lines[:, 1:].reshape(rows, columns, 6), strict=True)):
        image[k] = before = _unfiltered(kind, line, before)
    return image.reshape(rows, columns, 3, 2).view(">u2")[..., 0].astype(np.uint16)


def _unfiltered(kind, line, above):
    """A line of PNG, uint8 [columns, 6]; each pixel's prediction was taken off."""
    if kind == 1:
        return np.cumsum(line, axis=0, dtype=np.uint8)
    if kind in (0, 2):
        return line + above if kind else line
    found, last, corner = [], [0] * 6, [0] * 6
    for pixel, up in zip(line.tolist(), above.tolist(), strict=True):
        if kind == 3:
            guess = [(a + b) // 2 for a, b in zip(last, up, strict=True)]
        elif kind == 4:
            guess = [_paeth(*three) for three in zip(last, up, corner, strict=True)]
        else:
            raise ValueError(f"filter {kind}")
        last, corner = [(one + add) % 256 for one, add in zip(pixel, guess, strict=True)], up
        found.append(last)
    return np.array(found, np.uint8)


def _paeth(left, up, corner):
    guess = left + up - corner
    return min((left, up, corner), key=lambda one: abs(one - guess))
