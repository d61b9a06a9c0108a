"""AEDAT 4, Prophesee RAW and DAT, Event Stream: files written byte by byte here, or by faery, and damaged ones."""

import re
import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import Events, open_recording

faery = pytest.importorskip("faery")

SENSOR = (240, 180)
EVENTS = Events([70_000, 70_003, 70_003, 70_080, 4_300_001], [0, 239, 7, 100, 3], [0, 179, 8, 90, 2], [0, 1, 1, 0, 1])


def evt2(events):
    """EVT 2.0: 4 bits of type, then the 28 upper bits of the time, or its 6 lower bits, x and y (11 bits each)."""
    words = []
    for t, x, y, p in zip(events.t, events.x, events.y, events.p, strict=True):
        words += [0x8 << 28 | int(t) >> 6, int(p) << 28 | (int(t) & 63) << 22 | int(x) << 11 | int(y)]
    return struct.pack(f"<{len(words)}I", *words)


def evt3(events):
    """EVT 3.0: words of 16 bits, of which 4 are the type: time high (8) and low (6), y (0), single x (2)."""
    words = []
    for t, x, y, p in zip(events.t, events.x, events.y, events.p, strict=True):
        words += [8 << 12 | int(t) >> 12 & 0xFFF, 6 << 12 | int(t) & 0xFFF, int(y), 2 << 12 | int(p) << 11 | int(x)]
    return struct.pack(f"<{len(words)}H", *words)


def dat(events):
    """DAT 2: 32 bits of time; 14 bits each of x and y, and the polarity."""
    words = []
    for t, x, y, p in zip(events.t, events.x, events.y, events.p, strict=True):
        words += [int(t), int(p) << 28 | int(y) << 14 | int(x)]
    return b"\x0c\x08" + struct.pack(f"<{len(words)}I", *words)


def by_faery(kind, **options):
    def write(path, events):
        table = np.zeros(len(events), faery.EVENTS_DTYPE)
        for name, column in (("t", events.t), ("x", events.x), ("y", events.y), ("on", events.p)):
            table[name] = column
        faery.events_stream_from_array(table, SENSOR).to_file(path, zero_t0=False, file_type=kind, **options)

    return write


def by_hand(header, encode):
    return lambda path, events: path.write_bytes(header + encode(events))


WRITERS = {
    "aedat4": by_faery("aedat"),
    "aedat4 zstd": by_faery("aedat", compression=("zstd", 3)),
    "es": by_faery("es"),
    "dat1": by_faery("dat", version="dat1"),
    "dat2": by_faery("dat", version="dat2"),
    "evt2": by_faery("evt", version="evt2"),
    "evt3": by_faery("evt", version="evt3"),
    "evt2 by hand": by_hand(b"% evt 2.0\n% geometry 240x180\n", evt2),
    "evt3 by hand": by_hand(b"% camera x\n% format EVT3;height=180;width=240\n% end\n", evt3),
    "dat by hand": by_hand(b"% Data file containing CD events.\n% Version 2\n% Height 180\n% Width 240\n", dat),
}


@pytest.fixture(params=WRITERS)
def write(request, tmp_path):
    """``write(events)``: the path of a file of these events; the test runs once per format."""

    def write(events):
        path = tmp_path / "recording"  # no extension: the content decides
        WRITERS[request.param](path, events)
        return path

    return write


def test_reads_back(write, helpers):
    path = write(EVENTS)
    with open_recording(path) as recording:
        helpers.assert_same(helpers.read_all(recording), EVENTS)
        assert (recording.width, recording.height) == SENSOR
        assert (recording.time_unit, recording.time_unit_source, recording.num_events) == ("us", "file", None)
    with open_recording(path, sensor=(200, 180)) as recording:
        with pytest.raises(RecordingError, match="x of event 1 is 239; 0 to 199 is allowed"):
            list(recording.chunks())
    with open_recording(path, time_unit="ns") as recording:
        assert recording.time_unit_source == "given"
        assert helpers.read_all(recording).t.tolist() == [70, 70, 70, 70, 4300]


@pytest.mark.parametrize("start, size", [(0, 1), (0, 70_000), (1, 7_001), (40_000, 1000), (59_999, 10)])
def test_chunks_of_any_start_and_size(write, rng, helpers, start, size):
    events = helpers.make_events(rng, 60_000)  # more than faery decodes at a time
    with open_recording(write(events)) as recording:
        chunks = list(recording.chunks(start=start, size=size) if size > 1 else recording.chunks(start, 999))
        helpers.assert_same(Events.concatenate(chunks), events[start:])
        assert len({len(chunk) for chunk in chunks[:-1]}) <= 1
        a, b = recording.chunks(size=20_000), recording.chunks(start=30_000, size=5_000)
        for k in range(2):
            helpers.assert_same(next(a), events[k * 20_000 :][:20_000])
            helpers.assert_same(next(b), events[30_000 + k * 5_000 :][:5_000])
        with pytest.raises(RecordingError, match="first event 60000; 0 to 59999"):
            list(recording.chunks(start=60_000))


def test_no_events(write, tmp_path):
    path = write(EVENTS[:0])
    with pytest.raises(RecordingError, match="no events") as error:
        open_recording(path)
    assert str(error.value).startswith(str(path))


# -------------------------------------------------------------------- sensors


@pytest.mark.parametrize(
    "header, sensor",
    [
        ("% plugin_name hal_plugin_gen3_fx3\n% evt 2.0\n", (640, 480)),
        ("% evt 2.0\n% plugin_name hal_plugin_gen41_evk3\n", (1280, 720)),
        ("% evt 2.0\n% plugin_name hal_plugin_imx636\n% geometry 320x240\n", (320, 240)),
        ("% evt 2.0\n% plugin_name mine\n", None),
        ("% format EVT2;width=300;height=200\n", (300, 200)),
    ],
)
def test_sensor_of_raw(tmp_path, helpers, header, sensor):
    by_hand(header.encode(), evt2)(tmp_path / "a", EVENTS)
    with open_recording(tmp_path / "a") as recording:
        assert (recording.width, recording.height) == (sensor or (None, None))
        helpers.assert_same(helpers.read_all(recording), EVENTS)


def test_dat_without_a_sensor(tmp_path, helpers):
    by_hand(b"% Data file containing CD events.\n% Version 2\n", dat)(tmp_path / "a", EVENTS)
    with open_recording(tmp_path / "a") as recording:
        assert recording.width is None
        helpers.assert_same(helpers.read_all(recording), EVENTS)


@pytest.mark.parametrize(
    "header, message",
    [
        (b"% Date 2020\n", "names no version of EVT"),
        (b"% evt 4.0\n", "version '4.0'"),
        (b"% format HISTO3D;height=320\n", "version 'HISTO3D;height=320'"),
    ],
)
def test_versions_that_are_not_read(tmp_path, header, message):
    (tmp_path / "a.raw").write_bytes(header + evt2(EVENTS))
    with pytest.raises(RecordingError, match=re.escape(message)) as error:
        open_recording(tmp_path / "a.raw")
    assert "EVT 2.0, 2.1 or 3.0 is needed" in str(error.value)


# -------------------------------------------------------------------- damage


@pytest.mark.parametrize("name, word", [("evt2", 4), ("evt3", 2), ("dat2", 8)])
def test_truncated_within_a_word(tmp_path, rng, helpers, name, word):
    """All whole events come first, then one line."""
    events = helpers.make_events(rng, 3000)
    path = tmp_path / "a"
    WRITERS[name](path, events)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - word * 100 - 1])
    got = []
    with open_recording(path) as recording, pytest.raises(RecordingError) as error:
        for chunk in recording.chunks(size=64):
            got.append(chunk)
    got = Events.concatenate(got)
    assert 2700 < len(got) < 3000
    helpers.assert_same(got, events[: len(got)])
    text = str(error.value)
    assert text == f"{path}: truncated: {word - 1} of {word} bytes of the last word are there; the {len(got)} events " \
        "before were read"  # fmt: skip


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("compression", [("lz4", 1), ("zstd", 3)])
def test_truncated_aedat4(tmp_path, rng, helpers, share, compression):
    events = helpers.make_events(rng, 60_000)
    path = tmp_path / "a.aedat4"
    by_faery("aedat", compression=compression)(path, events)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    got = [Events.empty()]
    with pytest.raises(RecordingError, match="truncated") as error, open_recording(path) as recording:
        got.extend(recording.chunks(size=1000))
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)
    got = Events.concatenate(got)
    assert len(got) >= (share - 0.2) * len(events)
    helpers.assert_same(got, events[: len(got)])


def test_aedat4_that_was_never_closed(tmp_path, helpers, rng):
    """A recorder that died leaves no table at the end; what there is can be read."""
    events = helpers.make_events(rng, 20_000)
    path = tmp_path / "a.aedat4"
    by_faery("aedat")(path, events)
    content = bytearray(path.read_bytes())
    table = open_table(content)
    at = content.index(struct.pack("<q", table))
    content[at : at + 8] = struct.pack("<q", -1)
    path.write_bytes(content[:table])
    with open_recording(path) as recording:
        helpers.assert_same(helpers.read_all(recording), events)


def open_table(content):
    """Where the packets end: walks over them."""
    at = 18 + struct.unpack_from("<I", content, 14)[0]
    while at < len(content):
        stream, size = struct.unpack_from("<ii", content, at)
        if stream != 0:
            break
        at += 8 + size
    return at


def test_a_description_that_is_no_text(tmp_path):
    """faery would end the process: it is not given such a file."""
    path = tmp_path / "a.aedat4"
    by_faery("aedat")(path, EVENTS)
    content = path.read_bytes()
    path.write_bytes(content.replace(b"outInfo", b"out\xff\xfefo", 1))
    with pytest.raises(RecordingError, match="not a readable AEDAT 4 file") as error:
        open_recording(path)
    assert "\n" not in str(error.value)


PROGRAM = """
import sys
from cmfpga.errors import RecordingError
from cmfpga.events import open_recording
for path in sys.argv[1:]:
    try:
        with open_recording(path) as recording:
            for chunk in recording.chunks():
                assert chunk.x.max() < (recording.width or 1 << 14)
        print("read")
    except RecordingError as error:
        assert "\\n" not in str(error) and str(error).startswith(path), error
        print("refused")
"""


def test_changed_bytes(write, rng, helpers, tmp_path):
    """Whatever is damaged: the events are read, or refused in one line; in a process that faery could end."""
    path = write(helpers.make_events(rng, 500))
    content = path.read_bytes()
    paths = []
    for k in range(60):
        damaged = np.frombuffer(content, np.uint8).copy()
        reach = min(len(damaged), 300) if k % 2 else len(damaged)
        damaged[rng.integers(reach, size=3)] = rng.integers(256, size=3)
        paths.append(tmp_path / f"{k}")
        paths[-1].write_bytes(damaged.tobytes())
    program = [sys.executable, "-c", PROGRAM, *map(str, paths)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 60 and lines.count("refused") > 5


# -------------------------------------------------------------------- without faery


def test_without_faery(write, monkeypatch):
    path = write(EVENTS)
    monkeypatch.setitem(sys.modules, "faery", None)
    with pytest.raises(RecordingError, match=r"needs the package faery: pip install 'cmfpga\[formats\]'$") as error:
        open_recording(path)
    assert str(error.value).startswith(f"{path}: reading ")


def test_a_text_file_without_faery(tmp_path, monkeypatch, helpers):
    """What needs it not does not load it."""
    monkeypatch.setitem(sys.modules, "faery", None)
    path = tmp_path / "a.csv"
    path.write_text("x,y,p,t\n1,2,1,30\n")
    with open_recording(path) as recording:
        assert helpers.read_all(recording).t.tolist() == [30]


def test_the_content_goes_before_the_extension(tmp_path, helpers):
    by_faery("es")(tmp_path / "a.es", EVENTS)
    shutil.copy(tmp_path / "a.es", tmp_path / "a.raw")
    with open_recording(tmp_path / "a.raw") as recording:
        assert recording.format == "Event Stream"
        helpers.assert_same(helpers.read_all(recording), EVENTS)
