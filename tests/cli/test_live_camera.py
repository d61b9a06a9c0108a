"""Live cameras, by a driver that is not one: what comes is tracked, or counted; what is wrong is said in one line."""

import dataclasses
import inspect
import json
import sys
import time
import types
from unittest.mock import Mock

import numpy as np
import psutil
import pytest

import cmfpga
from cmfpga.cli import track
from cmfpga.errors import RecordingError
from cmfpga.events import LiveSource, usb
from cmfpga.events.evt import EvtDecoder
from support.designs import PAPER
from support.fake_camera import Busy, Driver, Name, listed
from support.recordings import evt3


@pytest.fixture
def plug(monkeypatch):
    """``plug(packets, camera, …)``: the :class:`Driver` that is found from now on; packets, or a callable.

    Nobody waits for a camera that is gone, unless it comes ``again``.
    """

    def plug(packets, *cameras, **options):
        sent = packets if callable(packets) else [*packets].__iter__
        monkeypatch.setattr(usb, "_AWAIT_S", 10.0 if "again" in options else 0.0)
        driver = Driver(sent, *cameras, **options)
        monkeypatch.setitem(sys.modules, "neuromorphic_drivers", driver)
        return driver

    return plug


def packets(data, *sizes):
    """Words in packets of these numbers of bytes, and the rest, which may end within a word."""
    for size in sizes:
        yield data[:size], 3, 0
        data = data[size:]
    yield data, 1, 2


def silent():
    """Packets of a camera that sees nothing."""
    while True:
        time.sleep(0.01)
        yield None, 0, 0


def test_until_it_is_unplugged(plug, follow, expected, dot_events, tmp_path):
    """The result is that of the file; then the summary, and one line."""
    driver = plug([*packets(evt3(dot_events), 1, 1200), (None, 0, 0)])
    done = follow("camera:")
    assert done.status == 2 and driver.closed and driver.opened == [("00050001", True)]
    assert done.err.splitlines() == [
        "note: camera:00050001: Prophesee EVK4, USB 3.0 SuperSpeed (5.0 Gb/s)",
        "error: camera:00050001: broke off after 600 events: Usb(Rusb(NoDevice))",
    ]
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected
    told = "600 events came, 0 were dropped; 3 packets waited in the driver at most, 2 were dropped there"
    assert told in done.out.splitlines() and "60 events were not tracked any more" in done.out


def test_it_is_unplugged_and_comes_again(plug, follow, dot_events, tmp_path):
    """Its times begin anew, in the middle of a word; the track's go on, later by as long as it was gone."""
    data = evt3(dot_events)
    plug([*packets(data, 1200), (b"\x08", 0, 5)], again=[*packets(data, 600)].__iter__)
    begin = time.monotonic()
    with LiveSource("camera:") as source:
        chunks, came = source.chunks(), []
        while sum(map(len, came)) < 1200:
            came.append(next(chunks))
        took = time.monotonic() - begin
    t, x = (np.concatenate([getattr(one, name) for one in came]) for name in ("t", "x"))
    assert source.counts() | {"received": 1200, "reconnected": 1, "driver_dropped": 7} == source.counts()
    assert x[600:].tolist() == x[:600].tolist() == dot_events.x.tolist()
    assert np.diff(t[:600]).tolist() == np.diff(t[600:]).tolist() == np.diff(dot_events.t).tolist()
    assert 0.4e6 <= t[600] - t[599] <= took * 1e6


def test_the_summary(plug, follow, dot_events):
    """It tells that the camera came again; and as JSON."""
    driver = plug(packets(evt3(dot_events), 1200), again=[*packets(evt3(dot_events))].__iter__)
    done = follow("camera:", "--batches", 8)
    assert done.status == 0 and "were dropped there; it was gone once" in done.out and len(driver.opened) == 2
    plug(packets(evt3(dot_events), 1200))
    *_, last = map(json.loads, follow("camera:00050001", "--json").out.splitlines())
    assert (last["summary"]["driver_backlog"], last["summary"]["driver_dropped"]) == (3, 2)


def test_events_of_another_make(plug, follow, expected, dot_events, tmp_path):
    """Whose driver gives columns, a time at a time; some of them behind an empty packet."""
    names = {"t": "<u8", "x": "<u2", "y": "<u2", "on": "?"}
    columns = np.empty(len(dot_events), [*names.items()])
    for name, values in zip(names, (dot_events.t, dot_events.x, dot_events.y, dot_events.p), strict=True):
        columns[name] = values
    sent = [(types.SimpleNamespace(polarity_events=part), 0, 0) for part in (columns[:200], None, columns[200:])]
    driver = plug(sent, listed("DVX1", Name.DVXPLORER))
    assert "broke off after 600 events" in follow("camera:").err and driver.opened == [("DVX1", False)]
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected


def test_one_is_chosen_by_its_serial_number(plug):
    driver = plug(silent, listed(None, error="Access denied"), listed("A1"), listed("B2"))
    for address, serial in (("camera:", "A1"), ("camera:B2", "B2")):
        with LiveSource(address) as source:
            assert (source.name, source.width, source.height) == (f"camera:{serial}", 32, 24)
        assert driver.opened[-1] == (serial, True)
    there = r"there are: Prophesee EVK4 \(Access denied\), Prophesee EVK4 \(A1\), "
    with pytest.raises(RecordingError, match=f"^camera:C3: not connected; {there}"):
        LiveSource("camera:C3")


def test_what_is_not_there(plug, follow, monkeypatch):
    driver = plug([])
    driver.list_devices = list
    assert follow("camera:").error == "no camera is connected"
    denied = "Access denied (insufficient permissions)"
    driver.list_devices = lambda: [listed(None, error=denied)]
    told = f"camera: Prophesee EVK4: {denied}; on Linux neuromorphic-drivers-install-udev-rules gives access"
    assert follow("camera:").error == told
    assert follow("camera:", "--format", "evt3").error.endswith("--format is not allowed")
    driver.list_devices = Mock(side_effect=RuntimeError("Other error"))
    assert follow("camera:").error == "a camera: USB cannot be used here: Other error"
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", None)
    assert follow("camera:").error == "a camera: neuromorphic_drivers is not installed; pip install 'cmfpga[cameras]'"


def test_a_package_that_was_built_for_another_system(follow, tmp_path, monkeypatch):
    (tmp_path / "neuromorphic_drivers.py").write_text("raise ImportError('wrong architecture')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "neuromorphic_drivers", raising=False)
    assert follow("camera:").error == "a camera: neuromorphic_drivers cannot be loaded here: wrong architecture"


def test_from_python(plug, dot_events):
    """``track``, and a ``Tracker`` that is fed with what comes: until it is unplugged, or enough came."""
    options = {"roi": (8, 9), "batch_events": 90, "engine": "model", **PAPER}
    plug(packets(evt3(dot_events), 1200))
    tracking = cmfpga.track("camera:", batches=6, **options)
    plug(packets(evt3(dot_events), 1200))
    with LiveSource("camera:") as source, cmfpga.Tracker(sensor=(32, 24), **options) as tracker:
        with pytest.raises(RecordingError, match="NoDevice"):
            for events in source.chunks():
                tracker.push(events)
    assert tracking.vx.tolist() == tracker.tracking.vx.tolist() and len(tracking) == 6


def test_the_real_driver_has_the_same_interface():
    real = pytest.importorskip("neuromorphic_drivers", exc_type=ImportError)
    device = pytest.importorskip("neuromorphic_drivers.device").Device
    status = pytest.importorskip("neuromorphic_drivers.status")
    assert {one.value for one in Name} <= {one.value for one in real.Name}
    assert set(vars(listed())) <= {field.name for field in dataclasses.fields(real.ListedDevice)}
    assert {"iterator_timeout", "raw", "serial"} <= inspect.signature(real.open).parameters.keys()
    for kind in (status.RawRingStatus, status.RingStatus):
        assert {"backlog", "dropped_packets"} <= kind.__annotations__.keys()
    assert hasattr(device, "close") and real.prophesee_evk4.Properties().width == 1280
    assert "polarity_events" in real.DvxplorerPacket.__annotations__


def test_a_skipped_piece_means_the_same_to_the_next(rng):
    """Words of all types, some of them cut, skipped and decoded by turns; times rise."""
    share = [0.1] * 3 + [0.3] + [0.1] * 2 + [0.05] * 2 + [0.1]
    words = rng.choice([0x0, 0x2, 0x3, 0x4, 0x5, 0x6, 0x7, 0x8, 0xA], 20_000, p=share)
    words = words << 12 | rng.integers(0, 4096, len(words))
    high = words >> 12 == 8
    words[high] = 0x8000 | np.sort(rng.integers(0, 4096, high.sum()))
    low = words >> 12 == 6
    words[low] = 0x6000 | (np.arange(len(words)) - np.maximum.accumulate(np.where(high, np.arange(len(words)), 0)))[low]
    data = words.astype("<u2").tobytes()
    cuts = np.sort(rng.integers(0, len(data), 40))
    whole, skipping = EvtDecoder("3.0"), EvtDecoder("3.0")
    for k, piece in enumerate(data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)):
        expected = whole(piece)
        if k % 3 == 1:
            assert skipping.skip(piece) == len(expected[0])
        else:
            for one, other in zip(skipping(piece), expected, strict=True):
                np.testing.assert_array_equal(one, other)


def test_twenty_million_events_a_second(plug, command, small, rng, tmp_path):
    """On two cores: each event is tracked, outside, or dropped, by the driver or before the track; all are counted."""
    busy = Busy(rng)
    plug(busy, size=(1280, 720))
    options = ["--engine", "model", "--roi", "600,300", "--batch-events", 20_000, "--no-picture", "--out", tmp_path]
    done = command(track, "camera:", *options, *small, "--set", "max_batch_events=20000", "--json")
    *lines, last = map(json.loads, done.out.splitlines())
    counts, tracked = last["summary"], sum(line["events"] for line in lines)
    assert "broke off" in done.err and busy.sent > 55_000_000
    assert counts["received"] + busy.dropped == busy.sent
    assert tracked + counts["not_tracked"] + counts["out_of_sensor"] + counts["lost"] == counts["received"]
    assert min(tracked, counts["out_of_sensor"], counts["lost"]) > 0
    assert bool(busy.dropped) == bool(counts["driver_dropped"])


def test_memory_stays_flat(plug, rng):
    """Where the track is slow."""
    plug(Busy(rng, seconds=2.5), size=(1280, 720))
    used, memory = [], psutil.Process()
    with LiveSource("camera:") as source, pytest.raises(RecordingError, match="NoDevice"):
        for _ in source.chunks():
            time.sleep(0.05)
            used.append(memory.memory_info().rss)
    assert source.lost > 30_000_000 and max(used) - used[len(used) // 3] < 100 << 20
