"""AEDAT 3.1 and N-MNIST: files written word by word here."""

import struct

import numpy as np
import pytest

from cmfpga.events import Events, open_recording
from support.recordings import assert_reads, make_events, refusal

HEADER = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DVS128\r\n#!END-HEADER\r\n"
EVENTS = Events([10, 20, 20, 35], [0, 5, 127, 7], [0, 9, 127, 8], [0, 1, 1, 0])


def packet(events, turns=0, kind=1, source=1, valid=1, spare=0):
    """A packet of 28 bytes of header, and data and time of each event; ``spare`` events lie behind those used."""
    t, x, y, p = (getattr(events, name).astype(np.int64) for name in "txyp")
    words = np.stack([x << 17 | y << 2 | p << 1 | valid, t], axis=1).astype("<u4").tobytes()
    n = len(events)
    return struct.pack("<HHIIIIII", kind, source, 8, 4, turns, n + spare, n, n) + words + bytes(8 * spare)


def write(tmp_path, *packets, header=HEADER):
    path = tmp_path / "a.aedat"
    path.write_bytes(header + b"".join(packets))
    return path


def test_reads_back(tmp_path):
    """What is of another type, of another camera, not valid or not used is no event of it."""
    path = write(
        tmp_path, packet(EVENTS, kind=0), packet(EVENTS[:2], spare=3), packet(EVENTS, source=2),
        packet(EVENTS, valid=0), packet(EVENTS[2:]),
    )  # fmt: skip
    recording = assert_reads(path, EVENTS)
    assert (recording.format, recording.width, recording.height) == ("AEDAT 3.1", 128, 128)
    assert (recording.time_unit, recording.time_unit_source) == ("us", "file")


def test_times_beyond_31_bits(tmp_path):
    later = Events(EVENTS.t + 2 * (1 << 31), EVENTS.x, EVENTS.y, EVENTS.p)
    assert_reads(write(tmp_path, packet(EVENTS), packet(EVENTS, turns=2)), Events.concatenate([EVENTS, later]))


def test_a_sensor_that_is_not_known(tmp_path):
    recording = assert_reads(write(tmp_path, packet(EVENTS), header=HEADER.replace(b"DVS128", b"File")), EVENTS)
    assert (recording.width, recording.height) == (None, None)


@pytest.mark.parametrize("cut, count, missing", [(3, 7, 3), (8, 7, 8), (32, 4, 32), (33, 4, 33), (59, 4, 27)])
def test_truncated(tmp_path, cut, count, missing):
    path = write(tmp_path, packet(EVENTS), packet(Events(EVENTS.t + 40, EVENTS.x, EVENTS.y, EVENTS.p)))
    path.write_bytes(path.read_bytes()[:-cut])
    message = f": truncated: {missing} bytes of the last packet are missing; the {count} events before were read"
    assert refusal(path, "read") == message


@pytest.mark.parametrize("header, message", [
    (HEADER.replace(b"RAW", b"SerializedTS"), "AEDAT 3.1 of format 'SerializedTS'; RAW is needed"),
    (HEADER[:40] + b"\r\n", "AEDAT 3.1 without a line '#!END-HEADER' (truncated or damaged)"),
])  # fmt: skip
def test_not_read(tmp_path, header, message):
    assert refusal(write(tmp_path, packet(EVENTS), header=header)) == f": {message}"
    assert "no events" in refusal(write(tmp_path, packet(EVENTS, kind=2)))


# -------------------------------------------------------------------- N-MNIST


def nmnist(events):
    t, x, y, p = (getattr(events, name).astype(np.int64) for name in "txyp")
    return np.stack([x, y, p << 7 | t >> 16 & 0x7F, t >> 8 & 0xFF, t & 0xFF], axis=1).astype(np.uint8).tobytes()


def test_nmnist(tmp_path, rng):
    events = make_events(rng, width=34, height=34)
    path = tmp_path / "a.bin"
    path.write_bytes(nmnist(events))
    assert assert_reads(path, events).format == "N-MNIST"
    path = path.rename(tmp_path / "a.dump")
    assert "--format" in refusal(path)
    assert_reads(path, events, form="nmnist")
    path.write_bytes(path.read_bytes()[:-2])
    message = ": truncated: 3 of 5 bytes of the last record are there; the 999 events before were read"
    assert refusal(path, "read", form="nmnist") == message


def test_nmnist_times_that_wrap(tmp_path):
    events = Events([5, (1 << 23) - 1, 1 << 23, (1 << 24) + 3], [1] * 4, [2] * 4, [0, 1, 1, 0])
    path = tmp_path / "a.bin"
    path.write_bytes(nmnist(events[:2]))
    assert_reads(path, events[:2])
    path.write_bytes(nmnist(events))
    assert "named like N-MNIST, but does not begin like it: --format nmnist reads it" in refusal(path)
    with open_recording(path, form="nmnist") as recording:
        (found,) = recording.chunks()
    assert found.t.tolist() == [5, (1 << 23) - 1, 1 << 23, (1 << 23) + 3]  # turns without an event cannot be seen
