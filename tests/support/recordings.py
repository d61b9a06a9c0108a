"""Events, files of them in every format written without the code under test, and how a file is refused."""

import gzip
import re
import zipfile

import h5py
import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import Events, open_recording


def make_events(rng, count=1000, width=240, height=180, step=20):
    """Random events; many time stamps are equal, as in recordings."""
    t = 5_000 + np.cumsum(rng.integers(0, step, count) * rng.integers(0, 2, count))
    return Events(t, rng.integers(width, size=count), rng.integers(height, size=count), rng.integers(2, size=count))


def columns(events):
    return [getattr(events, name) for name in "txyp"]


def read_all(recording, **options):
    return Events.concatenate(recording.chunks(**options))


def assert_same(a, b):
    for name in "txyp":
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def assert_reads(path, events, *, size=1 << 16, start=0, **options):
    """The file holds these events (or these columns); returns the recording, closed."""
    with open_recording(path, **options) as recording:
        found = read_all(recording, size=size, start=start)
    if isinstance(events, dict):
        assert {name: getattr(found, name).tolist() for name in events} == events
    else:
        assert_same(found, events)
    return recording


def refusal(path, when="open", *, size=1 << 16, start=0, **options):
    """The line with which a file is refused, without its path; ``when`` it is opened, read, or at either time."""
    opened = False
    with pytest.raises(RecordingError) as error, open_recording(path, **options) as recording:
        opened = True
        list(recording.chunks(size=size, start=start))
    assert when == "either" or opened == (when == "read")
    text = str(error.value)
    assert text.startswith(str(path)) and "\n" not in text
    return text.removeprefix(str(path))


def assert_cut_off(path, events, message, least, size=64):
    """The file gives the first of ``events``, at least so many, then a line; {} in ``message`` is their number."""
    got = [Events.empty()]
    with pytest.raises(RecordingError) as error, open_recording(path) as recording:
        got.extend(recording.chunks(size=size))
    got = Events.concatenate(got)
    assert least <= len(got) < len(events)
    assert_same(got, events[: len(got)])
    assert re.fullmatch(re.escape(f"{path}: ") + message.format(len(got)), str(error.value))


def damaged(path, rng, count, headers):
    """The file with three bytes changed, ``count`` times; every second time among its first ``headers`` bytes."""
    content = np.frombuffer(path.read_bytes(), np.uint8)
    for k in range(count):
        changed = content.copy()
        changed[rng.integers(min(len(content), headers) if k % 2 else len(content), size=3)] = rng.integers(256, size=3)
        yield changed.tobytes()


def cut(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)


def text_lines(t, x, y, p):
    """Times in µs as exact decimals in seconds, with nine decimals as in the DAVIS 240C data set."""
    times = (f"{'-' * (a < 0)}{abs(a) // 10**6}.{abs(a) % 10**6:06d}000" for a in map(int, t))
    return "".join(f"{a} {b} {c} {int(d)}\n" for a, b, c, d in zip(times, x, y, p, strict=True))


def structured(t, x, y, p):
    array = np.zeros(len(t), [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "i1")])
    for name, values in zip("txyp", (t, x, y, p), strict=True):
        array[name] = values
    return array


def _write_zip(path, *columns):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("images.txt", "0.0 images/frame_00000000.png\n")
        archive.writestr("slider/events.txt", text_lines(*columns))


def _write_h5(path, *columns):
    with h5py.File(path, "w") as file:
        for name, values in zip("txyp", columns, strict=True):
            file[f"events/{name}"] = values


#: ``writer(path, t, x, y, p)`` by suffix.
WRITERS = {
    "h5": _write_h5,
    "txt": lambda path, *columns: path.write_text(text_lines(*columns)),
    "txt.gz": lambda path, *columns: path.write_bytes(gzip.compress(text_lines(*columns).encode())),
    "zip": _write_zip,
    "npy": lambda path, *columns: np.save(path, structured(*columns)),
    "npz": lambda path, *columns: np.savez_compressed(path, **dict(zip("txyp", columns, strict=True))),
}


def write_by_faery(path, events, sensor=(240, 180), **options):
    """``options``: of faery's ``to_file``; skips without the package."""
    faery = pytest.importorskip("faery")
    table = np.zeros(len(events), faery.EVENTS_DTYPE)
    for name, column in zip(("t", "x", "y", "on"), "txyp", strict=True):
        table[name] = getattr(events, column)
    faery.events_stream_from_array(table, sensor).to_file(path, **options)


#: AEDAT 2.0 of a DAVIS 240C.
AEDAT2_HEADER = (
    b"#!AER-DAT2.0\r\n# This is a raw AE data file - do not edit\r\n"
    b"# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n"
)


def aedat2_words(events, width=240, height=180):
    """Address and time of each event: the row from the bottom, the column from the right; [n, 2] of 32 bits each."""
    x, y, p = (getattr(events, name).astype(np.int64) for name in "xyp")
    return np.stack([(height - 1 - y) << 22 | (width - 1 - x) << 12 | p << 11, events.t % (1 << 32)], axis=1)


def write_aedat2(path, words, header=AEDAT2_HEADER):
    path.write_bytes(header + np.asarray(words).astype(">u4").tobytes())
    return path


def packed(form, *columns):
    """Little-endian words of the columns, event after event."""
    return np.stack(columns, axis=1).astype(form).tobytes()


def integers(events):
    return (column.astype(np.int64) for column in columns(events))


def evt2(events):
    """EVT 2.0: 4 bits of type, then the 28 upper bits of the time, or its 6 lower bits, x and y (11 bits each)."""
    t, x, y, p = integers(events)
    return packed("<u4", 0x8 << 28 | t >> 6, p << 28 | (t & 63) << 22 | x << 11 | y)


def evt21(events, legacy=False):
    """EVT 2.1: as EVT 2.0 in the upper 32 bits, a bit for each of 32 columns in the lower; or the halves exchanged."""
    words, last = [], None
    for t, x, y, p in zip(*map(np.ndarray.tolist, integers(events)), strict=True):
        key = (t, x // 32, y, p)
        if key == last and x % 32 > words[-1][1].bit_length() - 1:
            words[-1][1] |= 1 << x % 32
            continue
        if last is None or t >> 6 != last[0] >> 6:
            words.append([0x8 << 28 | t >> 6, 0])
        words.append([p << 28 | (t & 63) << 22 | (x // 32 * 32) << 11 | y, 1 << x % 32])
        last = key
    halves = np.array(words, np.int64).reshape(-1, 2)
    return (halves if legacy else halves[:, ::-1]).astype("<u4").tobytes()


def evt3(events, vectors=False):
    """EVT 3.0: words of 16 bits, of which 4 are the type: time high (8) and low (6), y (0), single x (2).

    With ``vectors`` events of one time and row, of rising columns, go into a base (3) and vectors of 12 (4) or 8 (5)
    columns.
    """
    if not vectors:
        t, x, y, p = integers(events)
        return packed("<u2", 8 << 12 | t >> 12 & 0xFFF, 6 << 12 | t & 0xFFF, y, 2 << 12 | p << 11 | x)
    columns, words, k = [*zip(*map(np.ndarray.tolist, integers(events)), strict=True)], [], 0
    while k < len(columns):
        t, x, y, p = columns[k]
        words += [8 << 12 | t >> 12 & 0xFFF, 6 << 12 | t & 0xFFF, y, 3 << 12 | p << 11 | x]
        for size in (12, 8):  # one after the other: the base goes on
            bits, first, x = 0, x, x + size
            while k < len(columns) and columns[k][0::2] == (t, y) and columns[k][3] == p:
                bit = columns[k][1] - first
                if not bits.bit_length() <= bit < size:
                    break
                bits, k = bits | 1 << bit, k + 1
            words.append((4 if size == 12 else 5) << 12 | bits)
    return np.array(words, "<u2").tobytes()
