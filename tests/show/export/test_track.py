"""A track's files for other tools, read back by their own readers: the arrays of the track, bit for bit."""

import re
import sys

import numpy as np
import pytest

import cmfpga
from cmfpga.cli import track
from cmfpga.errors import ConfigError, MissingPackage
from cmfpga.events import Events, MemoryRecording, generate
from cmfpga.show.export import TRUSTED, VELOCITY, exported
from support.designs import FAST
from support.flowing import CAMERA
from support.small_core import options, sets


def following(events, **size):
    recording = MemoryRecording(events, 32, 24)
    return cmfpga.track(recording, roi=(8, 9), engine="model", **FAST, **(size or {"batch_events": 90}))


@pytest.fixture(scope="module")
def tracking():
    """Batches that are trusted, and some that are not: in the last ones there is nothing but noise."""
    scene = generate(seed=2, position=(132.0, 62.0), velocity=(90.0, 20.0), duration_us=150_000, noise=0.1)
    rng, t = np.random.default_rng(5), np.arange(6000) * 20 + 150_000
    noise = Events(t, rng.integers(0, 240, 6000), rng.integers(0, 180, 6000), np.zeros(6000, int))
    recording = MemoryRecording(Events.concatenate([scene.events, noise]), 240, 180)
    found = cmfpga.track(recording, roi=(100, 30), engine="model", batch_events=3000)
    assert 0 < found.trusted.sum() < len(found)
    return found


def messages(path):
    """``{topic: ([ns], [message])}`` of a bag, by the reader of ``rosbags``."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, ns, data in reader.messages():
            times, every = found.setdefault(connection.topic, ([], []))
            times.append(ns)
            every.append(reader.deserialize(data, connection.msgtype))
    return found


@pytest.mark.parametrize("name", ["track.mcap", "track.bag", "track"])
def test_a_bag_has_the_arrays_of_the_track(tracking, tmp_path, name):
    tracking.export(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    found = messages(tmp_path / name)
    assert {*found} == {VELOCITY, TRUSTED}
    stamps = np.rint(tracking.t_ref_us * 2).astype(np.int64) * 500
    times, told = found[TRUSTED]
    assert times == stamps.tolist() and [one.data for one in told] == tracking.trusted.tolist()
    there = np.isfinite(tracking.vx_px_per_s)
    times, told = found[VELOCITY]
    assert times == stamps[there].tolist()
    assert [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in told] == times
    assert {one.header.frame_id for one in told} == {"sensor"}
    linear = [[getattr(one.twist.twist.linear, axis) for axis in "xyz"] for one in told]
    v = np.stack([tracking.vx_px_per_s, tracking.vy_px_per_s, np.zeros(len(tracking))], axis=1)
    assert linear == v[there].tolist()
    matrices = np.array([one.twist.covariance for one in told]).reshape(-1, 6, 6)
    assert np.isfinite(matrices).all()
    sure = np.isfinite(tracking.covariance_px_per_s[there, 0, 0])
    assert 0 < sure.sum() < len(sure)
    assert (matrices[sure, :2, :2] == tracking.covariance_px_per_s[there][sure]).all()
    assert (matrices[~sure, 0, 0] == -1).all() and (matrices[~sure] != 0).sum() == (~sure).sum()


def test_batches_without_velocity_or_events(dot_events, tmp_path):
    """A degenerate batch has no velocity; a window without events has no time, and no message."""
    gap = Events(dot_events.t + 20_000, dot_events.x, dot_events.y, dot_events.p)
    found = following(Events.concatenate([dot_events, gap]), batch_us=5000)
    empty, degenerate = np.isnan(found.t_ref_us), np.isnan(found.vx_px_per_s)
    assert empty.any() and (degenerate & ~empty).any()
    found.export(tmp_path / "track.mcap")
    times = {topic: times for topic, (times, _) in messages(tmp_path / "track.mcap").items()}
    assert len(times[TRUSTED]) == (~empty).sum() and len(times[VELOCITY]) == (~degenerate).sum()


def test_a_rotation_is_angular(turning, tmp_path):
    how = {"preset": "rotation", "camera": CAMERA.text, "engine": "model"}
    found = cmfpga.track(turning.recording(), **how, batch_events=9000, batches=1)
    found.export(tmp_path / "track.mcap")
    (one,) = messages(tmp_path / "track.mcap")[VELOCITY][1]
    angular = [getattr(one.twist.twist.angular, axis) for axis in "xyz"]
    assert angular == [found.wx_rad_per_s[0], found.wy_rad_per_s[0], found.wz_rad_per_s[0]] and any(angular)
    assert one.twist.covariance[0] == -1 and one.header.frame_id == found.config.image


def test_times_that_ros_has_not(dot_events, tmp_path):
    late = Events(dot_events.t + 2**31 * 10**6, dot_events.x, dot_events.y, dot_events.p)
    with pytest.raises(ConfigError, match=r"time \d+ µs: ROS has times up to 2\^31 s; see --time-unit"):
        following(late).export(tmp_path / "track.mcap")
    assert not [*tmp_path.iterdir()]


def test_the_command_writes_the_same(command, dot, tmp_path):
    how = ["--roi", "8,9", "--engine", "model", "--no-picture", "--batch-events", 90, *options(FAST)]
    export = ["--export", tmp_path / "a.mcap", "--export", tmp_path / "a.bag"]
    done = command(track, dot, *how, "--out", tmp_path / "out", *export)
    assert done.status == 0 and f"wrote {tmp_path / 'a.mcap'}\nwrote {tmp_path / 'a.bag'}\n" in done.out
    (tmp_path / "python").mkdir()
    cmfpga.track(dot, roi=(8, 9), batch_events=90, engine="model", **FAST).export(tmp_path / "python" / "a.mcap")
    written = {path: messages(tmp_path / path) for path in ("a.mcap", "a.bag", "python/a.mcap")}
    times = [[found[topic][0] for topic in (VELOCITY, TRUSTED)] for found in written.values()]
    assert times[0] == times[1] == times[2] and len(times[0][0])


def test_several_objects_have_a_file_each(command, dot, tmp_path):
    how = "--roi a=8,9 --roi b=9,9 --engine model --no-picture --batch-events 90 --batches 2".split()
    small = sets({"roi_width": 8, "roi_height": 8, "max_batch_events": 100})
    done = command(track, dot, *how, *small, "--out", tmp_path / "out", "--export", tmp_path / "x.mcap")
    assert done.status == 0, done.err
    assert {path.name for path in tmp_path.iterdir()} == {"out", "x-a.mcap", "x-b.mcap"}
    assert len(messages(tmp_path / "x-b.mcap")[TRUSTED][0]) == 2


def test_a_file_is_replaced_and_stays_after_an_error(tracking, tmp_path):
    path = tmp_path / "track.mcap"
    path.write_text("old")
    with pytest.raises(RuntimeError), exported(path, tracking.config):
        raise RuntimeError
    assert path.read_text() == "old" and len([*tmp_path.iterdir()]) == 1
    tracking.export(path)
    assert messages(path)


@pytest.mark.parametrize("name, message", [
    ("x.csv", "a name that ends in .mcap, .bag, .rrd, or a folder's without an ending, is needed"),
    ("none/x.mcap", "none: no such folder"),
    ("there", "exists already; another name is needed"),
    ("there.mcap", "exists already; another name is needed"),
])  # fmt: skip
def test_names_that_cannot_be_written(command, dot, tracking, tmp_path, name, message):
    for folder in ("there", "there.mcap"):
        (tmp_path / folder).mkdir()
    path = tmp_path / name
    done = command(track, dot, "--roi", "8,9", "--engine", "model", "--out", tmp_path / "out", "--export", path)
    assert re.fullmatch(f"argument --export: export {re.escape(str(path))}: .*{re.escape(message)}.*", done.error)
    with pytest.raises(ConfigError, match=re.escape(message)):
        tracking.export(path)
    assert not (tmp_path / "out").exists()


def test_a_missing_package(tracking, tmp_path, monkeypatch):
    for package, name, extra in (("rosbags", "x.mcap", "formats"), ("rerun", "x.rrd", "rerun")):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(MissingPackage, match=rf"export {name}: {package} is not installed; .*cmfpga\[{extra}\]"):
            tracking.export(tmp_path / name)
    assert not [*tmp_path.iterdir()]


def test_rerun_has_the_arrays_of_the_track(tracking, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    from rerun.chunk import RrdReader

    tracking.export(tmp_path / "track.rrd")
    found = {}
    for chunk in RrdReader(tmp_path / "track.rrd").stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            column = batch.column(name)
            column = column.cast("int64") if name == "recording" else column  # Python's own durations end at µs
            found.setdefault((chunk.entity_path, name), []).extend(column.to_pylist())
    stamps = np.rint(tracking.t_ref_us * 2).astype(np.int64) * 500
    for name in ("vx_px_per_s", "vy_px_per_s", "confidence"):
        values = getattr(tracking, name)
        there = np.isfinite(values)
        assert [value for (value,) in found[f"/track/{name}", "Scalars:scalars"]] == values[there].tolist()
        assert found[f"/track/{name}", "recording"] == stamps[there].tolist()
    assert [len(points) for points in found["/sensor/events", "Points2D:positions"]] == tracking.events.tolist()
    corners = np.stack([tracking.roi_x, tracking.roi_y], axis=1)
    centres = np.array(found["/sensor/roi", "Boxes2D:centers"])[:, 0]
    assert (centres == corners + 31.5).all()
    arrows = [arrow for arrow in found["/sensor/velocity", "Arrows2D:vectors"] if arrow]
    there = np.isfinite(tracking.vx_px_per_s)
    v = np.stack([tracking.vx_px_per_s, tracking.vy_px_per_s], axis=1)[there]
    assert (np.array(arrows)[:, 0] == (v * 0.1).astype(np.float32)).all()
