"""Flow of all windows as published data sets have it: 16-bit PNG of DSEC, ``.npz`` of MVSEC.

A pixel has the flow of the tile whose middle is the nearest, if that tile is trusted and the pixel in it. Windows
without events are left out.
"""

import struct
import zipfile
import zlib

import numpy as np

from . import checked_path, placed


def export_flow(flow, path):
    """Write a :class:`~cmfpga.api.flow_result.Flow`: ``.npz`` of MVSEC, or a folder of DSEC, as ``path`` ends.

    Parameters
    ----------
    flow : Flow
    path : str or Path
        A file is replaced, a folder must not be there yet.

    Raises
    ------
    ConfigError
        The path cannot be written.
    """
    path = checked_path(path, ENDINGS)
    with placed(path) as made:
        ENDINGS[path.suffix.lower()](made, _Pixels(flow))


class _Pixels:
    """Flow of each pixel, window by window.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of the sensor.
    times : int64 array [W, 2]
        First and last event of each window, µs.
    """

    def __init__(self, flow):
        arrays, config = flow.arrays, flow.config
        self.shape = config.sensor_height, config.sensor_width
        kept = arrays["window_events"] > 0
        self.times = arrays["t"][kept]
        self._v, self._trusted = (arrays[name][kept] for name in ("v", "trusted"))
        (width, height), (rows, columns) = arrays["size"], arrays["grid"]
        row, in_row = _nearest(arrays["y"].reshape(rows, columns)[:, 0], height, self.shape[0])
        column, in_column = _nearest(arrays["x"].reshape(rows, columns)[0], width, self.shape[1])
        self._tile = row[:, None] * columns + column
        self._covered = in_row[:, None] & in_column

    def moved(self, k, duration_us):
        """Motion in a time at the flow of window ``k``, px, float64 [rows, columns, 2]; 0 where it is not trusted.

        And where it is: bool [rows, columns].
        """
        there = self._covered & (self._trusted[k] != 0)[self._tile]
        moved = self._v[k] * (duration_us * 1e-6)
        return np.where(there[..., None], moved[self._tile], 0.0), there


def _nearest(starts, length, pixels):
    """Along one axis: the tile whose middle is the nearest to each pixel, and whether the pixel is in it."""
    at = np.arange(pixels)
    index = np.searchsorted((starts[1:] + starts[:-1] + length - 1) / 2, at)
    return index, (at >= starts[index]) & (at < starts[index] + length)


def _dsec(folder, pixels):
    (folder / "forward").mkdir(parents=True)
    for k, (begin, end) in enumerate(pixels.times.tolist()):
        moved, there = pixels.moved(k, end - begin)
        raw = np.rint(moved * 128) + 2**15
        there &= ((raw >= 0) & (raw < 2**16)).all(axis=2)
        image = np.concatenate([np.where(there[..., None], raw, 2**15), there[..., None]], axis=2)
        _write_png(folder / "forward" / f"{k:06}.png", image.astype(">u2"))
    lines = ["# from_timestamp_us, to_timestamp_us", *(f"{begin}, {end}" for begin, end in pixels.times.tolist())]
    (folder / "forward_timestamps.txt").write_text("\n".join(lines) + "\n", encoding="ascii")


def _write_png(path, image):
    """RGB with 16 bits each: [rows, columns, 3] as ``>u2``. No library that we have writes it."""
    rows, columns, _ = image.shape
    lines = np.zeros((rows, 1 + 6 * columns), np.uint8)  # each begins with its filter, none
    lines[:, 1:] = image.reshape(rows, -1).view(np.uint8)
    head = struct.pack(">IIBBBBB", columns, rows, 16, 2, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes())), (b"IEND", b""))
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for kind, data in chunks:
            file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))


def _mvsec(path, pixels):
    """Flow k is the motion from time k to the next one, of the last window to its end. One window is in memory."""
    begins, count = pixels.times[:, 0], len(pixels.times)
    durations = np.append(np.diff(begins), pixels.times[-1:, 1] - begins[-1:])
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:

        def member(name, shape, arrays):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                head = {"descr": "<f8", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, head)
                for array in arrays:
                    file.write(np.ascontiguousarray(array, "<f8").tobytes())

        member("timestamps", (count,), [begins * 1e-6])
        for axis, name in enumerate(("x_flow_dist", "y_flow_dist")):
            found = (pixels.moved(k, duration)[0][..., axis] for k, duration in enumerate(durations.tolist()))
            member(name, (count, *pixels.shape), found)


#: Of a flow: ``write(path, pixels)``. A name without an ending is a folder.
ENDINGS = {".npz": _mvsec, "": _dsec}
