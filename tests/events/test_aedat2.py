"""AEDAT 2.0: files written word by word here."""

import struct

import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import Events, aedat2, open_recording

HEADER = (
    b"#!AER-DAT2.0\r\n# This is a raw AE data file - do not edit\r\n"
    b"# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n"
)
EVENTS = Events([10, 20, 20, 35], [0, 5, 239, 7], [0, 9, 179, 8], [0, 1, 1, 0])


def words(events, width=240, height=180):
    """Address and time of each: the row from the bottom, the column from the right."""
    columns = zip(events.t.tolist(), events.x.tolist(), events.y.tolist(), events.p.tolist(), strict=True)
    return [((height - 1 - y) << 22 | (width - 1 - x) << 12 | p << 11, t % (1 << 32)) for t, x, y, p in columns]


def write(path, records, header=HEADER):
    path.write_bytes(header + b"".join(struct.pack(">II", *record) for record in records))
    return path


def test_reads_back(tmp_path, helpers):
    with open_recording(write(tmp_path / "a", words(EVENTS))) as recording:
        helpers.assert_same(helpers.read_all(recording), EVENTS)
        assert (recording.format, recording.width, recording.height) == ("AEDAT 2.0", 240, 180)
        assert (recording.time_unit, recording.time_unit_source, recording.num_events) == ("us", "file", None)


def test_other_davis(tmp_path, helpers):
    path = write(tmp_path / "a", words(EVENTS, 346, 260), HEADER.replace(b"DAVIS240C", b"Davis346blue"))
    with open_recording(path) as recording:
        helpers.assert_same(helpers.read_all(recording), EVENTS)
        assert (recording.width, recording.height) == (346, 260)


def test_frames_and_triggers_are_skipped(tmp_path, helpers):
    """Also where their times step back, as those of frames do."""
    events = words(EVENTS)
    others = [(1 << 31 | 5 << 12, 3), (1 << 10, 2), (0xFFFFFFFF, 0)]
    records = [others[0], events[0], others[1], events[1], events[2], others[2], events[3], others[0]]
    with open_recording(write(tmp_path / "a", records)) as recording:
        helpers.assert_same(helpers.read_all(recording), EVENTS)


def test_times_that_wrap(tmp_path, helpers, monkeypatch):
    monkeypatch.setattr(aedat2, "_RECORDS", 2)  # the wrap stands between two blocks, and within one
    turn = 1 << 32
    t = [turn - 9, turn - 1, turn, turn + 5, 2 * turn - 1, 2 * turn, 2 * turn]
    events = Events(t, [1] * 7, [2] * 7, [1] * 7)
    for first in (0, 1):
        with open_recording(write(tmp_path / "a", words(events[first:]))) as recording:
            helpers.assert_same(helpers.read_all(recording), events[first:])


def test_a_step_back_is_no_wrap(tmp_path):
    path = write(tmp_path / "a", words(Events([50, 40], [1, 1], [1, 1], [1, 1])))
    with open_recording(path) as recording, pytest.raises(RecordingError, match="event 1 is 40 µs, after 50 µs"):
        list(recording.chunks())


def test_truncated(tmp_path, helpers):
    path = write(tmp_path / "a.aedat", words(EVENTS))
    path.write_bytes(path.read_bytes()[:-3])
    got = []
    with open_recording(path) as recording, pytest.raises(RecordingError) as error:
        for chunk in recording.chunks(size=1):
            got.append(chunk)
    assert str(error.value) == (
        f"{path}: truncated: 5 of 8 bytes of the last record are there; the 3 events before were read"
    )
    helpers.assert_same(Events.concatenate(got), EVENTS[:3])


@pytest.mark.parametrize(
    "header, message",
    [
        (b"#!AER-DAT2.0\r\n", "no line '# AEChip:' in the header; a DAVIS240 or DAVIS346 is needed"),
        (HEADER.replace(b"davis.DAVIS240C", b"DVS128"), "chip 'DVS128'; a DAVIS240 or DAVIS346 is needed"),
        (b"#!AER-DAT3.1\r\n#Format: RAW\r\n", "AEDAT '3.1'; version 2.0 or 4.0 is needed"),
        (b"#!AER-DAT\xff\r\n", "version 2.0 or 4.0 is needed"),
    ],
)
def test_not_read(tmp_path, header, message):
    path = write(tmp_path / "a.aedat", words(EVENTS), header)
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    assert str(error.value).startswith(f"{path}: ") and message in str(error.value)


def test_no_events(tmp_path):
    with pytest.raises(RecordingError, match="no events"):
        open_recording(write(tmp_path / "a", [(1 << 31, 5)]))
