"""ROS bags: ``.bag`` of ROS 1, ``.mcap``, ``.db3`` and folders of ROS 2. The package ``rosbags`` reads the containers.

A topic of events has one of two types of message, which some packages name otherwise: ``event_camera_msgs/EventPacket``
holds words of EVT as the camera sent them, so times are the camera's; ``dvs_msgs/EventArray`` holds x, y, a time of ROS
and the polarity. Their fields are read here, with NumPy: as objects, they would take minutes.

Types: https://github.com/ros-event-camera/event_camera_msgs, https://github.com/uzh-rpg/rpg_dvs_ros.
"""

import functools
import importlib
import struct

import numpy as np

from ..errors import RecordingError
from .cameras import import_optional
from .columns import why
from .evt import EvtDecoder
from .raw import FORMS
from .recording import Format, check_sensor
from .streamed import StreamedRecording
from .units import to_us

_PACKETS = ("event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray")
_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_EVENT = [("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")]
# In ROS 2, s begins at a multiple of 4 bytes: of all events but the first, 2 bytes behind y.
_ALIGNED = np.dtype({"names": [name for name, _ in _EVENT], "formats": [form for _, form in _EVENT],
                     "offsets": [0, 2, 6, 10, 14], "itemsize": 16})  # fmt: skip


class RosbagRecording(StreamedRecording):
    """Events of one topic of a bag; ``dataset`` names it, where there are several."""

    def __init__(self, path, *, time_unit=None, sensor=None, dataset=None, ros):
        self._ros = ros
        import_optional("rosbags", path, "a ROS bag")
        self._reader = importlib.import_module(f"rosbags.rosbag{self._ros}").Reader
        self._topic = dataset and "/" + dataset.strip("/")
        super().__init__(path, f"ROS {self._ros} bag", sensor=sensor, time_unit=time_unit)
        size = next(self._messages(), (0, 0))[:2]
        if sensor is None and all(size):
            self.width, self.height = check_sensor(size, path)
        self._require_events()

    def _messages(self):
        """Yields ``(width, height, encoding, content)`` of each message; the encoding is None of an EventArray."""
        try:
            with self._reader(self.path) as bag:
                for connection, _, data in bag.messages(self._connections(bag)):
                    message = _Fields(data, self._ros == 2)
                    message.take("II" if self._ros == 2 else "III")  # sequence number (ROS 1), s, ns
                    message.take_bytes()  # name of the frame
                    height, width = message.take("II")
                    if connection.msgtype in _ARRAYS:
                        yield width, height, None, message.take_events()
                        continue
                    message.take("QQ")  # sequence number, time base
                    encoding = message.take_bytes().rstrip(b"\0").decode()
                    message.take("B")  # order of bytes
                    yield width, height, encoding, message.take_bytes()
        except (GeneratorExit, RecordingError):
            raise
        except Exception as error:
            raise RecordingError(f"{self.name}: the bag cannot be read to its end {why(error)}") from None

    def _connections(self, bag):
        """Those of the topic that is asked for, or of the only one."""
        found = [c for c in bag.connections if c.msgtype in _PACKETS + _ARRAYS and c.msgcount]
        topics = sorted({c.topic for c in found})
        if self._topic in topics or (self._topic is None and len(topics) == 1):
            return [c for c in found if c.topic == (self._topic or topics[0])]
        others = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections})) or "nothing"
        told = f"events in {' and '.join(topics)}; --dataset TOPIC (dataset=) says which it is"
        raise RecordingError(f"{self.name}: {told if topics else f'no topic of events; it holds {others}'}")

    def _pieces(self):
        decoder, count = None, 0
        for _, _, encoding, content in self._messages():
            if encoding is None:
                ns = content["s"].astype(np.int64) * 10**9 + content["ns"]
                t, others = to_us(ns, "ns", self.name, count), [content[name] for name in "xyp"]
            else:
                if encoding not in FORMS:
                    raise RecordingError(f"{self.name}: packets of {encoding[:40]!r}; {', '.join(FORMS)} is needed")
                decoder = decoder or EvtDecoder(FORMS[encoding])
                t, *others = decoder(content)
                self._early = decoder.early
            if len(t):
                yield t, *others
                count += len(t)


class _Fields:
    """The values of a message, one after the other; in ROS 2, each stands at a multiple of its size."""

    def __init__(self, data, aligned):
        self._data, self._aligned, self._at = data[4:] if aligned else data, aligned, 0

    def take(self, forms):
        values = []
        for form in forms:
            size = struct.calcsize(form)
            self._at += -self._at % size if self._aligned else 0
            values += struct.unpack_from(f"<{form}", self._data, self._at)
            self._at += size
        return values

    def take_bytes(self):
        (size,) = self.take("I")
        self._at += size
        if self._at > len(self._data):
            raise ValueError("a message ends early")
        return bytes(self._data[self._at - size : self._at])

    def take_events(self):
        (count,) = self.take("I")
        if not self._aligned or not count:
            return np.frombuffer(self._data, _EVENT, count, self._at)
        events = np.frombuffer(bytes(self._data) + b"\0", _ALIGNED, count, self._at - 2).copy()
        events["x"][0], events["y"][0] = self.take("HH")
        return events


def _matches(head, path):
    folder = path.is_dir() and (path / "metadata.yaml").is_file()
    return folder or head.startswith((b"\x89MCAP0\r\n", b"SQLite format 3\0"))


FORMATS = (
    Format(
        "ROS 1 bag", (".bag",), lambda head, path: head.startswith(b"#ROSBAG V"),
        functools.partial(RosbagRecording, ros=1), ("dataset",),
    ),
    Format("ROS 2 bag", (".mcap", ".db3"), _matches, functools.partial(RosbagRecording, ros=2), ("dataset",)),
)  # fmt: skip
