"""ROS bags, which ``rosbags`` writes here."""

import sys

import numpy as np
import pytest

from cmfpga.events import open_recording
from support.recordings import assert_reads, cut, evt2, evt3, evt21, make_events, refusal

PACKET, ARRAY = "event_camera_msgs/msg/EventPacket", "dvs_msgs/msg/EventArray"
SIZE = "std_msgs/Header header\nuint32 height\nuint32 width\n"
FIELDS = {
    PACKET: SIZE + "uint64 seq\nuint64 time_base\nstring encoding\nbool is_bigendian\nuint8[] events\n",
    "dvs_msgs/msg/Event": "uint16 x\nuint16 y\nbuiltin_interfaces/Time ts\nbool polarity\n",
    ARRAY: SIZE + "dvs_msgs/Event[] events\n",
}
KINDS = {"ros1.bag": 1, "mcap": 2, "db3": 2}
START = 1_700_000_000


@pytest.fixture(params=KINDS)
def write(request, tmp_path):
    """``write((topic, kind, events, encoding, words), …)``: path of a bag of these topics, three messages each."""
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros = KINDS[request.param]
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    for name, fields in FIELDS.items():
        store.register(get_types_from_msg(fields, name))
    types = store.types
    time = types["builtin_interfaces/msg/Time"]

    def message(kind, frame, events, encoding, words):
        stamp, odd = time(sec=START, nanosec=0), {"seq": 3} if ros == 1 else {}
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **odd)
        head = {"header": header, "height": 180, "width": 240}
        if kind == PACKET:
            content = np.frombuffer(words(events), np.uint8)
            return types[PACKET](**head, seq=1, time_base=0, encoding=encoding, is_bigendian=False, events=content)
        each = []
        for t, x, y, p in zip(*(getattr(events, name).tolist() for name in "txyp"), strict=True):
            ts = time(sec=START + t // 10**6, nanosec=t % 10**6 * 1000)
            each.append(types["dvs_msgs/msg/Event"](x=x, y=y, ts=ts, polarity=bool(p)))
        return types[ARRAY](**head, events=each)

    def write(*topics):
        path = tmp_path / request.param
        if ros == 1:
            writer = rosbag1.Writer(path)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if request.param == "mcap" else rosbag2.StoragePlugin.SQLITE3
            writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
        serialize = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        with writer as bag:
            for topic, kind, events, encoding, words in topics:
                connection = bag.add_connection(topic, kind, typestore=store)
                for k, frame in enumerate(("", "cam", "camera")):  # by which the fields behind it move
                    part = events[len(events) * k // 3 : len(events) * (k + 1) // 3]
                    content = serialize(message(kind, frame, part, encoding, words), kind)
                    bag.write(connection, START * 10**9 + k, content)
        return path

    return write


@pytest.mark.parametrize("encoding, words", [("evt2", evt2), ("evt21", evt21), ("evt3", evt3)])
def test_packets(write, rng, encoding, words):
    events = make_events(rng)
    path = write(("/event_camera/events", PACKET, events, encoding, words))
    recording = assert_reads(path, events, size=300)
    assert recording.format == f"ROS {1 if path.suffix == '.bag' else 2} bag"
    assert (recording.width, recording.height, recording.time_unit) == (240, 180, "us")
    if path.is_dir():
        (file,) = set(path.iterdir()) - {path / "metadata.yaml"}
        assert_reads(file, events)


def test_arrays(write, rng):
    events = make_events(rng)
    expected = {"t": (events.t + START * 10**6).tolist()} | {name: getattr(events, name).tolist() for name in "xyp"}
    recording = assert_reads(write(("/dvs/events", ARRAY, events, None, None)), expected, size=300)
    assert (recording.width, recording.height) == (240, 180)
    assert assert_reads(recording.path, expected, sensor=(300, 200)).width == 300


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_events(write, rng, count):
    """Messages of none and of one."""
    events = make_events(rng, count)
    assert_reads(write(("/dvs/events", ARRAY, events, None, None)), {"x": events.x.tolist()})


def test_topics(write, rng):
    events = make_events(rng)
    path = write(("/b", PACKET, events, "evt3", evt3), ("/a", ARRAY, events, None, None))
    assert refusal(path) == ": events in /a and /b; --dataset TOPIC (dataset=) says which it is"
    assert "events in /a and /b" in refusal(path, dataset="/c")
    for topic in ("b", "/b"):
        assert_reads(path, events, dataset=topic)


def test_not_read(write, rng, monkeypatch):
    path = write(("/b", PACKET, make_events(rng), "libcaer", evt3))
    assert refusal(path) == ": packets of 'libcaer'; evt2, evt21, evt21-legacy, evt3 is needed"
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert refusal(path) == ": reading a ROS bag needs the package rosbags: pip install 'cmfpga[formats]'"


def test_damaged(write, rng):
    path = write(("/b", PACKET, make_events(rng), "evt3", evt3))
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    cut(file, 0.5)
    assert ": the bag cannot be read to its end (" in refusal(file, "either")
    with pytest.raises(Exception, match="cannot be read"):
        open_recording(path)
