"""What a track or a flow found, as files of other tools; the ending of a name says which.

A track is a bag of ROS, by the package ``rosbags`` and without ROS, or a recording of rerun, which its viewer shows on
a time line. A flow is as published data sets have it: 16-bit PNG of DSEC, ``.npz`` of MVSEC. A pixel has the flow of
the tile whose middle is the nearest, if that tile is trusted and the pixel in it. Windows without events are left out.
"""

import contextlib
import os
import struct
import tempfile
import zipfile
import zlib
from pathlib import Path

import numpy as np

from ..errors import ConfigError, naming, needs
from ..protocol.confidence import covariance

#: Topics: ``geometry_msgs/TwistWithCovarianceStamped``, whose linear x and y are px/s, and ``std_msgs/Bool``.
VELOCITY, TRUSTED = "/cmfpga/velocity_px_per_s", "/cmfpga/trusted"

_TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"


@contextlib.contextmanager
def bag(path, config):
    """What takes the batches: MCAP or ROS 1 in a file, ROS 2 with SQLite in a folder, as ``path`` ends."""
    with needs("rosbags", "formats", f"export {path.name}"):
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore
    kind, folder = path.suffix.lower(), path.parent / "bag"
    if kind == ".bag":
        store, writer = get_typestore(Stores.ROS1_NOETIC), rosbag1.Writer(path)
    else:  # of version 8, which older ROS 2 reads, too
        store = get_typestore(Stores.ROS2_HUMBLE)
        how = {"storage_plugin": rosbag2.StoragePlugin.MCAP} if kind else {}
        writer = rosbag2.Writer(folder if kind else path, version=8, **how)
    with writer:
        yield _Bag(writer, store, config)
    if kind == ".mcap":
        os.replace(folder / "bag.mcap", path)


class _Bag:
    def __init__(self, writer, store, config):
        self._writer, self._types, self._config = writer, store.types, config
        self._ros1 = "seq" in store.types["std_msgs/msg/Header"].__dataclass_fields__
        self._serialize = store.serialize_ros1 if self._ros1 else store.serialize_cdr
        self._velocity, self._trusted = (
            writer.add_connection(topic, kind, typestore=store)
            for topic, kind in ((VELOCITY, _TWIST), (TRUSTED, "std_msgs/msg/Bool"))
        )

    def add(self, batch):
        """Write a batch: whether it is trusted, and its velocity unless it is degenerate; nothing without events."""
        values = batch.values
        if values["t_ref_us"] is None:
            return
        ns = int(2 * values["t_ref_us"]) * 500  # t_ref may be half a µs; times of today as float64 ns are inexact
        if ns >= 2**31 * 10**9:
            raise ConfigError(f"time {values['t_ref_us']:.0f} µs: ROS has times up to 2^31 s; see --time-unit")
        self._write(self._trusted, ns, self._types["std_msgs/msg/Bool"](bool(values["trusted"])))
        if values["vx_px_per_s"] is not None:
            self._write(self._velocity, ns, self._twist(batch, ns))

    def _write(self, connection, ns, message):
        self._writer.write(connection, ns, self._serialize(message, connection.msgtype))

    def _twist(self, batch, ns):
        values, found = batch.values, covariance(self._config, batch.result)
        matrix = np.zeros((6, 6))
        matrix[0, 0] = -1  # not known
        if found:
            xx, yy, xy = np.array(found) * (2 * self._config.pixel / (batch.result.span * 1e-6)) ** 2
            matrix[:2, :2] = [[xx, xy], [xy, yy]]
        types = self._types
        stamp = types["builtin_interfaces/msg/Time"](*divmod(ns, 10**9))
        header = types["std_msgs/msg/Header"](*[0] * self._ros1, stamp, self._config.image or "sensor")
        vectors = (
            types["geometry_msgs/msg/Vector3"](*(float(values.get(name) or 0) for name in names))
            for names in (("vx_px_per_s", "vy_px_per_s", ""), ("wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"))
        )
        twist = types["geometry_msgs/msg/Twist"](*vectors)
        return types[_TWIST](header, types["geometry_msgs/msg/TwistWithCovariance"](twist, matrix.ravel()))


#: The arrow of a velocity is the way in so many seconds.
ARROW_S = 0.1

_OFF, _ON, _ROI, _SURE, _DOUBTFUL = (92, 140, 240), (255, 255, 255), (220, 60, 60), (60, 200, 120), (240, 150, 40)

#: Columns of the track that are drawn over time.
SERIES = ("vx_px_per_s", "vy_px_per_s", "confidence")


@contextlib.contextmanager
def rerun(path, config):
    """What takes the batches, and writes them to ``path`` as they come."""
    with needs("rerun", "rerun", f"export {path.name}"):
        import rerun as rr
    stream = rr.RecordingStream("cmfpga")
    path.touch()  # what cannot be written is told by the system
    stream.save(path)
    try:
        yield _Viewer(rr, stream, config)
    finally:
        stream.disconnect()  # which writes what is left


class _Viewer:
    def __init__(self, rr, stream, config):
        self._rr, self._stream, self._pixel = rr, stream, config.pixel
        self._size = np.array(config.roi_px, np.float64)

    def add(self, batch):
        """Write a batch, at the middle of its time range; nothing without events."""
        values, rr, log = batch.values, self._rr, self._stream.log
        if values["t_ref_us"] is None:
            return
        ns = int(2 * values["t_ref_us"]) * 500
        self._stream.set_time("recording", duration=np.timedelta64(ns, "ns"))
        corner = np.array([values["roi_x"], values["roi_y"]], np.float64)
        colours = np.array([_OFF, _ON], np.uint8)[np.asarray(batch.events.p, np.int64)]
        places = (np.stack([batch.seen.x, batch.seen.y], axis=1) + 0.5) * self._pixel - 0.5
        log("sensor/events", rr.Points2D(places, colors=colours))
        log("sensor/roi", rr.Boxes2D(mins=[corner - 0.5], sizes=[self._size], colors=[_ROI]))
        v = [values["vx_px_per_s"], values["vy_px_per_s"]]
        there = [] if None in v else [np.array(v) * ARROW_S]
        middle = [corner + (self._size - 1) / 2] * len(there)
        colour = [_SURE if values["trusted"] else _DOUBTFUL] * len(there)
        log("sensor/velocity", rr.Arrows2D(vectors=there, origins=middle, colors=colour))
        for name in SERIES:
            if values[name] is not None:
                log(f"track/{name}", rr.Scalars(values[name]))


#: Of a track: ``opened(path, config)`` gives what takes its batches. A name without an ending is a folder.
TRACK = {".mcap": bag, ".bag": bag, ".rrd": rerun, "": bag}


def checked_path(path, endings):
    """``path`` as a :class:`Path`; :exc:`ConfigError` unless it can be written and its ending is one of ``endings``."""
    path = Path(path)
    if path.suffix.lower() not in endings or not path.name:
        named = ", ".join(filter(None, endings))
        raise ConfigError(f"export {path}: a name that ends in {named}, or a folder's without an ending, is needed")
    if not path.parent.is_dir():
        raise ConfigError(f"export {path}: {path.parent}: no such folder")
    if path.is_dir() or (path.exists() and not path.suffix):
        raise ConfigError(f"export {path}: exists already; another name is needed")
    return path


@contextlib.contextmanager
def placed(path):
    """A path in a folder beside ``path``; what is there takes its place at the end, or nothing does after an error."""
    try:
        folder = tempfile.TemporaryDirectory(dir=path.parent, prefix=".export-")
    except OSError as error:
        raise ConfigError(f"export {path}: cannot be written: {error.strerror}") from None
    with folder, naming(path):
        made = Path(folder.name) / path.name
        yield made
        os.replace(made, path)


@contextlib.contextmanager
def exported(path, config):
    """What takes the batches of a track, ``add(batch)``, and writes them to ``path``.

    It ends as one of :data:`TRACK`: MCAP, a bag of ROS 1, a recording of rerun, or the folder of a bag of ROS 2. A file
    is replaced, a folder must not be there yet. :exc:`ConfigError`: it cannot be written, or a package is missing.
    """
    path = checked_path(path, TRACK)
    with placed(path) as made, TRACK[path.suffix.lower()](made, config) as writer:
        yield writer


def export_flow(flow, path):
    """Write a :class:`~cmfpga.api.flow.Flow`: ``.npz`` of MVSEC, or a folder of DSEC, as ``path`` ends.

    A file is replaced, a folder must not be there yet. :exc:`ConfigError`: it cannot be written.
    """
    path = checked_path(path, ENDINGS)
    with placed(path) as made:
        ENDINGS[path.suffix.lower()](made, _Pixels(flow))


class _Pixels:
    """Flow of each pixel, window by window, on a sensor of ``shape`` (rows, columns).

    ``times`` are those of the first and last event of each window, µs, int64 [W, 2].
    """

    def __init__(self, flow):
        arrays, config = flow.arrays, flow.config
        self.shape = config.sensor_height, config.sensor_width
        kept = arrays["window_events"] > 0
        self.times, self._v, self._trusted = (arrays[name][kept] for name in ("t", "v", "trusted"))
        self._tile, self._covered = flow.tiles.of_pixels(config.sensor_width, config.sensor_height)

    def moved(self, k, duration_us):
        """Motion in a time at the flow of window ``k``, px, float64 [rows, columns, 2]; 0 where it is not trusted.

        And where it is: bool [rows, columns].
        """
        there = self._covered & (self._trusted[k] != 0)[self._tile]
        moved = self._v[k] * (duration_us * 1e-6)
        return np.where(there[..., None], moved[self._tile], 0.0), there


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
