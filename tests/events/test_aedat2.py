"""AEDAT 2.0: files written word by word here."""

import re

import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import Events, open_recording, streamed
from support.recordings import AEDAT2_HEADER, aedat2_words, assert_reads, assert_same, refusal, write_aedat2

EVENTS = Events([10, 20, 20, 35], [0, 5, 239, 7], [0, 9, 179, 8], [0, 1, 1, 0])
WORDS = aedat2_words(EVENTS)


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
    events = Events([10, 20, 20, 35], [0, 5, 127, 7], [0, 9, 127, 8], [0, 1, 1, 0])
    x, y, p = (getattr(events, name).astype(np.int64) for name in "xyp")
    words = np.stack([(127 - y) << 8 | (127 - x) << 1 | 1 - p, events.t], axis=1)
    path = write_aedat2(tmp_path / "a", [*words[:2], (1 << 15 | 3, 20), *words[2:]], b"#!AER-DAT2.0\r\n" + chip)
    recording = assert_reads(path, events)
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
    got = []
    with open_recording(path) as recording, pytest.raises(RecordingError) as error:
        got.extend(recording.chunks(size=1))
    assert str(error.value) == (
        f"{path}: truncated: 5 of 8 bytes of the last record are there; the 3 events before were read"
    )
    assert_same(Events.concatenate(got), EVENTS[:3])


@pytest.mark.parametrize("header, message", [
    (b"#!AER-DAT2.0\r\n", "no line '# AEChip:' in the header; a DAVIS240, DAVIS346 or DVS128 is needed, or --sensor"),
    (AEDAT2_HEADER.replace(b"davis.DAVIS240C", b"cDVSTest"), "chip 'cDVSTest'; a DAVIS240, DAVIS346 or DVS128"),
    (b"#!AER-DAT3.0\r\n#Format: RAW\r\n", "AEDAT '3.0'; version 2.0, 3.1 or 4.0 is needed"),
    (b"#!AER-DAT\xff\r\n", "version 2.0, 3.1 or 4.0 is needed"),
])  # fmt: skip
def test_not_read(tmp_path, header, message):
    assert re.search(f"^: .*{re.escape(message)}", refusal(write_aedat2(tmp_path / "a.aedat", WORDS, header)))


def test_no_events(tmp_path):
    assert "no events" in refusal(write_aedat2(tmp_path / "a", np.array([(1 << 31, 5)])))
