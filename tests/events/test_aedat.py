"""AEDAT 2.0 and 3.1, and N-MNIST: files written word by word here."""

import re
import struct

import numpy as np
import pytest

from cmfpga.events import Events, streamed
from support.recordings import (
    AEDAT2_HEADER,
    aedat2_words,
    assert_cut_off,
    assert_reads,
    integers,
    make_events,
    packed,
    refusal,
    write_aedat2,
)

EVENTS = Events([10, 20, 20, 35], [0, 5, 239, 7], [0, 9, 179, 8], [0, 1, 1, 0])
WORDS = aedat2_words(EVENTS)
#: On a sensor of 128×128 px.
SMALL = Events([10, 20, 20, 35], [0, 5, 127, 7], [0, 9, 127, 8], [0, 1, 1, 0])


def test_reads_back(tmp_path):
    recording = assert_reads(write_aedat2(tmp_path / "a", WORDS), EVENTS)
    assert (recording.format, recording.width, recording.height) == ("AEDAT 2.0", 240, 180)
    assert (recording.time_unit, recording.time_unit_source, recording.num_events) == ("us", "file", None)
    header = AEDAT2_HEADER.replace(b"DAVIS240C", b"Davis346blue")
    recording = assert_reads(write_aedat2(tmp_path / "b", aedat2_words(EVENTS, 346, 260), header), EVENTS)
    assert (recording.width, recording.height) == (346, 260)


@pytest.mark.parametrize("header", [
    b"#!AER-DAT2.0\r\n# Timestamps tick is 1 us\r\n# User name: someone\r\n",  # as v2e writes it
    AEDAT2_HEADER.replace(b"DAVIS240C", b"Davis640"),
    b"#!AER-DAT2.0\n",
])  # fmt: skip
def test_a_chip_that_the_caller_says(tmp_path, header):
    """Also where the first record begins like a line of the header."""
    events = Events([10, 20], [300, 5], [259 - (0x23 << 2), 9], [0, 1])
    path = write_aedat2(tmp_path / "a", aedat2_words(events, 346, 260), header)
    assert path.read_bytes().removeprefix(header).startswith(b"#")
    recording = assert_reads(path, events, sensor=(346, 260))
    assert (recording.width, recording.height) == (346, 260)


@pytest.mark.parametrize("chip", [b"# AEChip: ch.unizh.ini.jaer.chip.retina.DVS128\r\n", b""])
def test_a_dvs128(tmp_path, chip):
    """Row and column from the bottom right, 1 for darker; what bit 15 marks is no event."""
    t, x, y, p = integers(SMALL)
    words = np.stack([(127 - y) << 8 | (127 - x) << 1 | 1 - p, t], axis=1)
    path = write_aedat2(tmp_path / "a", [*words[:2], (1 << 15 | 3, 20), *words[2:]], b"#!AER-DAT2.0\r\n" + chip)
    recording = assert_reads(path, SMALL)
    assert (recording.width, recording.height) == (128, 128)


def test_frames_and_triggers_are_skipped(tmp_path):
    """Also where their times step back, as those of frames do."""
    others = [(1 << 31 | 5 << 12, 3), (1 << 10, 2), (0xFFFFFFFF, 0)]
    records = [others[0], WORDS[0], others[1], WORDS[1], WORDS[2], others[2], WORDS[3], others[0]]
    assert_reads(write_aedat2(tmp_path / "a", records), EVENTS)


def test_times_that_wrap(tmp_path, monkeypatch):
    monkeypatch.setattr(streamed, "RECORDS", 2)  # the wrap stands between two blocks, and within one
    turn = 1 << 32
    t = [turn - 9, turn - 1, turn, turn + 5, 2 * turn - 1, 2 * turn, 2 * turn]
    events = Events(t, [1] * 7, [2] * 7, [1] * 7)
    for first in (0, 1):
        assert_reads(write_aedat2(tmp_path / "a", aedat2_words(events[first:])), events[first:])


def test_a_step_back_is_no_wrap(tmp_path):
    path = write_aedat2(tmp_path / "a", aedat2_words(Events([50, 40], [1, 1], [1, 1], [1, 1])))
    assert "event 1 is 40 µs, after 50 µs" in refusal(path, "read")


def test_truncated(tmp_path):
    path = write_aedat2(tmp_path / "a.aedat", WORDS)
    path.write_bytes(path.read_bytes()[:-3])
    message = "truncated: 5 of 8 bytes of the last record are there; the {} events before were read"
    assert_cut_off(path, EVENTS, message, 3, size=1)


@pytest.mark.parametrize("header, message", [
    (b"#!AER-DAT2.0\r\n", "no line '# AEChip:' in the header; a DAVIS240, DAVIS346 or DVS128 is needed, or --sensor"),
    (AEDAT2_HEADER.replace(b"davis.DAVIS240C", b"cDVSTest"), "chip 'cDVSTest'; a DAVIS240, DAVIS346 or DVS128"),
    (b"#!AER-DAT3.0\r\n#Format: RAW\r\n", "AEDAT '3.0'; version 2.0, 3.1 or 4.0 is needed"),
    (b"#!AER-DAT\xff\r\n", "version 2.0, 3.1 or 4.0 is needed"),
])  # fmt: skip
def test_not_read(tmp_path, header, message):
    assert re.search(f"^: .*{re.escape(message)}", refusal(write_aedat2(tmp_path / "a.aedat", WORDS, header)))


# -------------------------------------------------------------------- AEDAT 3.1

HEADER_3 = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DVS128\r\n#!END-HEADER\r\n"


def packet(events, turns=0, kind=1, source=1, valid=1, spare=0):
    """A packet of 28 bytes of header, and data and time of each event; ``spare`` events lie behind those used."""
    t, x, y, p = integers(events)
    words, n = packed("<u4", x << 17 | y << 2 | p << 1 | valid, t), len(events)
    return struct.pack("<HHIIIIII", kind, source, 8, 4, turns, n + spare, n, n) + words + bytes(8 * spare)


def write_3(tmp_path, *packets, header=HEADER_3):
    path = tmp_path / "a.aedat"
    path.write_bytes(header + b"".join(packets))
    return path


def test_packets(tmp_path):
    """What is of another type, of another camera, not valid or not used is no event of it."""
    path = write_3(
        tmp_path, packet(SMALL, kind=0), packet(SMALL[:2], spare=3), packet(SMALL, source=2),
        packet(SMALL, valid=0), packet(SMALL[2:]),
    )  # fmt: skip
    recording = assert_reads(path, SMALL)
    assert (recording.format, recording.width, recording.height) == ("AEDAT 3.1", 128, 128)
    assert (recording.time_unit, recording.time_unit_source) == ("us", "file")


def test_times_beyond_31_bits(tmp_path):
    later = Events(SMALL.t + 2 * (1 << 31), SMALL.x, SMALL.y, SMALL.p)
    assert_reads(write_3(tmp_path, packet(SMALL), packet(SMALL, turns=2)), Events.concatenate([SMALL, later]))


def test_a_sensor_that_is_not_known(tmp_path):
    recording = assert_reads(write_3(tmp_path, packet(SMALL), header=HEADER_3.replace(b"DVS128", b"File")), SMALL)
    assert (recording.width, recording.height) == (None, None)


@pytest.mark.parametrize("cut, count, missing", [(3, 7, 3), (8, 7, 8), (32, 4, 32), (33, 4, 33), (59, 4, 27)])
def test_truncated_packets(tmp_path, cut, count, missing):
    path = write_3(tmp_path, packet(SMALL), packet(Events(SMALL.t + 40, SMALL.x, SMALL.y, SMALL.p)))
    path.write_bytes(path.read_bytes()[:-cut])
    message = f": truncated: {missing} bytes of the last packet are missing; the {count} events before were read"
    assert refusal(path, "read") == message


@pytest.mark.parametrize("header, message", [
    (HEADER_3.replace(b"RAW", b"SerializedTS"), "AEDAT 3.1 of format 'SerializedTS'; RAW is needed"),
    (HEADER_3[:40] + b"\r\n", "AEDAT 3.1 without a line '#!END-HEADER' (truncated or damaged)"),
])  # fmt: skip
def test_packets_not_read(tmp_path, header, message):
    assert refusal(write_3(tmp_path, packet(SMALL), header=header)) == f": {message}"
    assert "no events" in refusal(write_3(tmp_path, packet(SMALL, kind=2)))


# -------------------------------------------------------------------- N-MNIST


def nmnist(events):
    t, x, y, p = integers(events)
    return packed(np.uint8, x, y, p << 7 | t >> 16 & 0x7F, t >> 8 & 0xFF, t & 0xFF)


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
    # Turns without an event cannot be seen.
    assert_reads(path, {"t": [5, (1 << 23) - 1, 1 << 23, (1 << 23) + 3]}, form="nmnist")
