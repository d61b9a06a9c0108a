"""A track as a bag of ROS, by the package ``rosbags`` and without ROS."""

import contextlib
import os

import numpy as np

from ...errors import ConfigError, needs
from ...protocol.confidence import covariance

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

    def _made(self, name, *fields):
        return self._types[name](*fields)

    def add(self, batch):
        """Write a batch: whether it is trusted, and its velocity unless it is degenerate; nothing without events."""
        values = batch.values
        if values["t_ref_us"] is None:
            return
        ns = int(2 * values["t_ref_us"]) * 500  # t_ref may be half a µs; times of today as float64 ns are inexact
        if ns >= 2**31 * 10**9:
            raise ConfigError(f"time {values['t_ref_us']:.0f} µs: ROS has times up to 2^31 s; see --time-unit")
        told = self._made("std_msgs/msg/Bool", bool(values["trusted"]))
        self._write(self._trusted, ns, told)
        if values["vx_px_per_s"] is not None:
            self._write(self._velocity, ns, self._twist(batch, ns))

    def _write(self, connection, ns, message):
        self._writer.write(connection, ns, self._serialize(message, connection.msgtype))

    def _twist(self, batch, ns):
        values, found = batch.values, covariance(self._config, batch.result)
        matrix = np.zeros((6, 6))
        matrix[0, 0] = -1  # not known
        if found:
            xx, yy, xy = np.array(found) * (2 / (batch.result.span * 1e-6)) ** 2
            matrix[:2, :2] = [[xx, xy], [xy, yy]]
        stamp = self._made("builtin_interfaces/msg/Time", *divmod(ns, 10**9))
        header = self._made("std_msgs/msg/Header", *[0] * self._ros1, stamp, self._config.image or "sensor")
        vectors = (
            self._made("geometry_msgs/msg/Vector3", *(float(values.get(name) or 0) for name in names))
            for names in (("vx_px_per_s", "vy_px_per_s", ""), ("wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"))
        )
        twist = self._made("geometry_msgs/msg/Twist", *vectors)
        whole = self._made("geometry_msgs/msg/TwistWithCovariance", twist, matrix.ravel())
        return self._made(_TWIST, header, whole)
