"""Event words: what the encoders write is read by models that know nothing of them, and by real files."""

import h5py
import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.errors import RecordingError
from cmfpga.events.arrays import Events
from cmfpga.events.evt import EvtDecoder
from cmfpga.protocol.registers import FORMATS
from cmfpga.protocol.words import encode, encode_evt20, encode_evt21, read_raw
from cmfpga.reference.wire import decode, to_beats

CONFIG = Config()


def random_events(rng, count):
    t = 5_000_000_000 + np.cumsum(rng.integers(0, 90, count) * (rng.random(count) < 0.2))
    x = np.where(rng.random(count) < 0.7, np.arange(count) % 240, rng.integers(0, 240, count))
    rows = np.arange(count) // 50
    return Events(t, x, rows % 180, rows % 2)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("form", FORMATS)
def test_round_trip(form, swap, rng):
    events = random_events(rng, 3000)
    words = encode(events, form, swap=swap)
    assert words.dtype == np.uint64 and len(encode(Events.empty(), form, swap=swap)) == 0
    tokens, counts = decode(CONFIG, to_beats(words, last=False), form, swap=swap)
    assert not sum(counts.values()) and all(token.known and token.event for token in tokens)
    got = np.array([(token.t, token.x, token.y) for token in tokens])
    assert np.array_equal(got, np.stack([events.t % (1 << 32), events.x, events.y], axis=1))


def test_evt21_packs_neighbours(rng):
    events = random_events(rng, 3000)
    assert len(encode(events, "EVT21")) < 0.8 * len(events)
    full = Events(np.full(64, 7), np.arange(64), np.full(64, 3), np.ones(64))
    words = encode_evt21(full.t, full.x, full.y, full.p)
    assert [hex(word) for word in words.tolist()] == ["0x8000000000000000", "0x11c00003ffffffff", "0x11c10003ffffffff"]


@pytest.mark.parametrize("start", [5, (1 << 24) - 5, 5_000_000_000])
@pytest.mark.parametrize("step", [3, 5000, 60_000_000])
def test_evt30_is_read_as_a_file(start, step, rng):
    """Polarities too; time's high part goes on by more than its range, in steps that no reader takes for one back."""
    events = random_events(rng, 3000 if step < 1 << 24 else 60)
    t = start + np.cumsum(rng.integers(0, step, len(events)) * (rng.random(len(events)) < 0.3))
    words = encode(Events(t, events.x, events.y, events.p), "EVT30")
    found = EvtDecoder("3.0")(words.astype("<u8").tobytes())
    expected = t - start + start % (1 << 32), events.x, events.y, events.p
    assert all(map(np.array_equal, found, expected)) and (step > 3 or 4 * len(words) < 1.1 * len(events))


def test_evt30_by_hand():
    words = encode(Events([70_000] * 6, [5, 6, 7, 9, 30, 2], [3] * 6, [1] * 5 + [0]), "EVT30").view("<u2").tolist()
    time = [0x8000 | 70_000 >> 12, 0x6000 | 70_000 & 0xFFF]
    assert words == [*time, 3, 0x3805, 0x4017, 0x281E, 0x2002, time[0]]
    for t in ([5, 4], [0, 1 << 32]):
        with pytest.raises(ValueError, match="has no words"):
            encode(Events(t, [1, 1], [1, 1], [0, 0]), "EVT30")


def test_by_hand():
    """Bits as in Prophesee's documentation: type, low time bits, column, row; time words in between."""
    t, x, y, p = [0x12345, 0x12345 + 64], [5, 6], [7, 8], [1, 0]
    time, later = 0x12345 >> 6, (0x12345 >> 6) + 1
    low = 0x12345 & 63
    words = encode_evt20(t, x, y, p).view("<u4").tolist()
    assert words == [8 << 28 | time, 1 << 28 | low << 22 | 5 << 11 | 7, 8 << 28 | later, low << 22 | 6 << 11 | 8]
    words = encode_evt21(t, x, y, p).tolist()
    first, second = 1 << 60 | low << 54 | 7 << 32 | 1 << 5, low << 54 | 8 << 32 | 1 << 6
    assert words == [8 << 60 | time << 32, first, 8 << 60 | later << 32, second]
    packed = encode(Events(t, x, y, p), "PACKED").tolist()
    assert packed == [0x12345 << 32 | 1 << 31 | 7 << 16 | 5, (0x12345 + 64) << 32 | 8 << 16 | 6]


def test_an_odd_word_is_filled_up():
    words = encode(Events([1], [2], [3], [1]), "EVT20")
    assert len(words) == 1  # a time word, and the event
    words = encode(Events([1, 1], [2, 4], [3, 3], [1, 1]), "EVT20")
    assert words.view("<u4")[3] >> 28 == 8


@pytest.mark.parametrize(
    "form, x, y", [("EVT21", 2048, 0), ("EVT20", 0, 2048), ("PACKED", 0, 32768), ("EVT30", 2048, 0)]
)
def test_what_does_not_fit(form, x, y):
    with pytest.raises(ValueError, match="fit this format"):
        encode(Events([1], [x], [y], [1]), form)
    with pytest.raises(ValueError, match="'EVT3': one of EVT21, EVT20, PACKED, EVT30"):
        encode(Events.empty(), "EVT3")


def test_a_real_file(data_dir):
    """Prophesee's own EVT 2.0: decoded by the model as the events that others decoded; written again word by word."""
    form, words = read_raw(data_dir / "original_formats" / "prophesee_spinner_640x480_evt2.raw")
    assert form == "EVT20"
    with h5py.File(data_dir / "prophesee_spinner_640x480.h5") as recording:
        events = Events(*(recording[f"events/{name}"][:] for name in "txyp"))
    tokens, counts = decode(CONFIG, to_beats(words), form)
    found = [token for token in tokens if token.event]
    assert len(found) == len(events) and all(token.known for token in found)
    got = np.array([(token.t, token.x, token.y) for token in found])
    assert np.array_equal(got, np.stack([events.t % (1 << 32), events.x, events.y], axis=1))
    assert counts["format_errors"] == counts["time_high_back"] == 0
    ours = encode(events, form).view("<u4")
    theirs = words.view("<u4")
    theirs = theirs[theirs >> 28 != 0xF]
    # Theirs repeats time words that did not change; ours does not.
    is_time = theirs >> 28 == 8
    times = theirs[np.maximum.accumulate(np.where(is_time, np.arange(len(theirs)), 0))]  # before or at each word
    repeated = is_time & np.concatenate([[False], times[:-1] == theirs[1:]])
    assert np.array_equal(ours[: len(theirs) - repeated.sum()], theirs[~repeated])


WORD = (0x8000000100000000).to_bytes(8, "little")


@pytest.mark.parametrize("content, message", [
    (b"% evt 4.0\n% end\n", r"none of evt 2\.0, 2\.1 and 3\.0"), (None, "No such file"),
    (b"% evt 2.0", "without an end"),
])  # fmt: skip
def test_files_of_other_formats(tmp_path, content, message):
    if content:
        (tmp_path / "a.raw").write_bytes(content)
    with pytest.raises(RecordingError, match=message):
        read_raw(tmp_path / "a.raw")


@pytest.mark.parametrize("content, form, words", [
    (b"% evt 2.1\n% end\n" + WORD + b"%%%", "EVT21", [0, 0x80000001]),
    (b"% format EVT2.1;height=720\n" + WORD, "EVT21", [0, 0x80000001]),
    (b"% evt 2.0\n" + WORD[:4], "EVT20", [0, 0xFFFFFFFF]),
])  # fmt: skip
def test_headers(tmp_path, content, form, words):
    (tmp_path / "a.raw").write_bytes(content)
    found, read = read_raw(tmp_path / "a.raw")
    assert (found, read.view("<u4").tolist()) == (form, words)
