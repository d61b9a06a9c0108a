"""AEDAT 2.0: files written word by word here."""

import re

import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import Events, aedat2, open_recording
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


def test_frames_and_triggers_are_skipped(tmp_path):
    """Also where their times step back, as those of frames do."""
    others = [(1 << 31 | 5 << 12, 3), (1 << 10, 2), (0xFFFFFFFF, 0)]
    records = [others[0], WORDS[0], others[1], WORDS[1], WORDS[2], others[2], WORDS[3], others[0]]
    assert_reads(write_aedat2(tmp_path / "a", records), EVENTS)


def test_times_that_wrap(tmp_path, monkeypatch):
    monkeypatch.setattr(aedat2, "_RECORDS", 2)  # the wrap stands between two blocks, and within one
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
    (b"#!AER-DAT2.0\r\n", "no line '# AEChip:' in the header; a DAVIS240 or DAVIS346 is needed"),
    (AEDAT2_HEADER.replace(b"davis.DAVIS240C", b"DVS128"), "chip 'DVS128'; a DAVIS240 or DAVIS346 is needed"),
    (b"#!AER-DAT3.1\r\n#Format: RAW\r\n", "AEDAT '3.1'; version 2.0 or 4.0 is needed"),
    (b"#!AER-DAT\xff\r\n", "version 2.0 or 4.0 is needed"),
])  # fmt: skip
def test_not_read(tmp_path, header, message):
    assert re.search(f"^: .*{re.escape(message)}", refusal(write_aedat2(tmp_path / "a.aedat", WORDS, header)))


def test_no_events(tmp_path):
    assert "no events" in refusal(write_aedat2(tmp_path / "a", np.array([(1 << 31, 5)])))
