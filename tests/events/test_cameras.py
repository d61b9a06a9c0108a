"""AEDAT 4, Prophesee DAT, Event Stream: files written byte by byte here, or by faery, and damaged ones."""

import struct
import subprocess
import sys

import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import Events, open_recording
from support.recordings import (
    assert_cut_off,
    assert_reads,
    assert_same,
    cut,
    damaged,
    integers,
    make_events,
    packed,
    refusal,
    write_by_faery,
)  # fmt: skip

pytest.importorskip("faery")

SENSOR = (240, 180)
EVENTS = Events([70_000, 70_003, 70_003, 70_080, 4_300_001], [0, 239, 7, 100, 3], [0, 179, 8, 90, 2], [0, 1, 1, 0, 1])


def dat(events):
    """DAT 2: 32 bits of time; 14 bits each of x and y, and the polarity."""
    t, x, y, p = integers(events)
    return b"\x0c\x08" + packed("<u4", t, p << 28 | y << 14 | x)


def by_faery(kind, **options):
    return lambda path, events: write_by_faery(path, events, SENSOR, zero_t0=False, file_type=kind, **options)


def by_hand(header, encode):
    return lambda path, events: path.write_bytes(header + encode(events))


WRITERS = {
    "aedat4": by_faery("aedat"), "aedat4 zstd": by_faery("aedat", compression=("zstd", 3)), "es": by_faery("es"),
    **{f"dat{k}": by_faery("dat", version=f"dat{k}") for k in (1, 2)},
    **{f"evt{k}": by_faery("evt", version=f"evt{k}") for k in (2, 3)},
    "dat by hand": by_hand(b"% Data file containing CD events.\n% Version 2\n% Height 180\n% Width 240\n", dat),
}  # fmt: skip


@pytest.fixture(params=WRITERS)
def write(request, tmp_path):
    """``write(events)``: the path of a file of these events; the test runs once per format."""

    def write(events):
        path = tmp_path / "recording"  # no extension: the content decides
        WRITERS[request.param](path, events)
        return path

    return write


def test_reads_back(write):
    path = write(EVENTS)
    recording = assert_reads(path, EVENTS)
    assert (recording.width, recording.height) == SENSOR
    assert (recording.time_unit, recording.time_unit_source, recording.num_events) == ("us", "file", None)
    assert "x of event 1 is 239; 0 to 199 is allowed" in refusal(path, "read", sensor=(200, 180))
    assert assert_reads(path, {"t": [70, 70, 70, 70, 4300]}, time_unit="ns").time_unit_source == "given"
    assert "no events" in refusal(write(EVENTS[:0]))


@pytest.mark.parametrize("start, size", [(0, 1), (0, 70_000), (1, 7_001), (40_000, 1000), (59_999, 10)])
def test_chunks_of_any_start_and_size(write, rng, start, size):
    events = make_events(rng, 60_000)  # more than faery decodes at a time
    with open_recording(write(events)) as recording:
        chunks = list(recording.chunks(start=start, size=size) if size > 1 else recording.chunks(start, 999))
        assert_same(Events.concatenate(chunks), events[start:])
        assert len({len(chunk) for chunk in chunks[:-1]}) <= 1
        a, b = recording.chunks(size=20_000), recording.chunks(start=30_000, size=5_000)
        for k in range(2):
            assert_same(next(a), events[k * 20_000 :][:20_000])
            assert_same(next(b), events[30_000 + k * 5_000 :][:5_000])
        with pytest.raises(RecordingError, match="first event 60000; 0 to 59999"):
            list(recording.chunks(start=60_000))


def test_a_dat_without_a_size(tmp_path):
    by_hand(b"% Data file containing CD events.\n% Version 2\n", dat)(tmp_path / "a", EVENTS)
    assert assert_reads(tmp_path / "a", EVENTS).width is None


def test_truncated_within_a_word(tmp_path, rng):
    events, path = make_events(rng, 3000), tmp_path / "a"
    WRITERS["dat2"](path, events)
    path.write_bytes(path.read_bytes()[:-801])
    message = "truncated: 7 of 8 bytes of the last word are there; the {} events before were read"
    assert_cut_off(path, events, message, 2701)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("compression", [("lz4", 1), ("zstd", 3)])
def test_truncated_aedat4(tmp_path, rng, share, compression):
    events, path = make_events(rng, 60_000), tmp_path / "a.aedat4"
    by_faery("aedat", compression=compression)(path, events)
    cut(path, share)
    assert_cut_off(path, events, ".*truncated.*", (share - 0.2) * len(events), size=1000)


def test_aedat4_that_was_never_closed(tmp_path, rng):
    """A recorder that died leaves no table at the end; what there is can be read."""
    events, path = make_events(rng, 20_000), tmp_path / "a.aedat4"
    by_faery("aedat")(path, events)
    content = path.read_bytes()
    table = open_table(content)
    path.write_bytes(content.replace(struct.pack("<q", table), struct.pack("<q", -1), 1)[:table])
    assert_reads(path, events)


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
    path.write_bytes(path.read_bytes().replace(b"outInfo", b"out\xff\xfefo", 1))
    assert "not a readable AEDAT 4 file" in refusal(path)


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


def test_changed_bytes(rng, tmp_path):
    """Whatever is damaged: the events are read, or refused in one line; in a process that faery could end."""
    events, paths = make_events(rng, 500), []
    for name, write in WRITERS.items():
        write(tmp_path / name, events)
        for k, content in enumerate(damaged(tmp_path / name, rng, 60, headers=300)):
            paths.append(tmp_path / f"{name} {k}")
            paths[-1].write_bytes(content)
    program = [sys.executable, "-c", PROGRAM, *map(str, paths)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(paths)
    assert all(lines[k : k + 60].count("refused") > 5 for k in range(0, len(lines), 60))


def test_without_faery(write, tmp_path, monkeypatch, request):
    """What needs it not does not load it."""
    path = write(EVENTS)
    monkeypatch.setitem(sys.modules, "faery", None)
    if "evt" in request.node.name:
        assert_reads(path, EVENTS)
        return
    told = refusal(path)
    assert told.startswith(": reading ") and told.endswith("needs the package faery: pip install 'cmfpga[formats]'")
    (tmp_path / "a.csv").write_text("x,y,p,t\n1,2,1,30\n")
    assert_reads(tmp_path / "a.csv", {"t": [30]})


def test_the_content_goes_before_the_extension(tmp_path):
    by_faery("es")(tmp_path / "a.es", EVENTS)
    assert assert_reads((tmp_path / "a.es").rename(tmp_path / "a.raw"), EVENTS).format == "Event Stream"
