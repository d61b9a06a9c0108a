"""Streams: a recording that is sent gives the track of its file; senders that stall, break off, or are too fast."""

import contextlib
import json
import os
import re
import signal
import socket
import struct
import threading
import time
from unittest.mock import Mock

import numpy as np
import pytest

import cmfpga
from cmfpga.cli import info, track
from cmfpga.events import Events, LiveSource
from support.designs import FAST, PAPER
from support.recordings import evt2, evt3, evt21, make_events
from support.small_core import options

HEADS = {
    "evt2": b"% evt 2.0\n% geometry 32x24\n",
    "evt21": b"% evt 2.1\n% format EVT21;endianness=legacy;height=24;width=32\n% end\n",
    "evt3": b"% camera x\n% format EVT3;height=24;width=32\n% end\n",
}
ENCODE = {"evt2": evt2, "evt21": lambda events: evt21(events, legacy=True), "evt3": evt3}
SMALL = options(FAST)
#: Of :func:`make_events`, without a header.
LARGE = "--format evt2 --sensor 240,180 --roi 100,60 --engine model --no-picture".split()


@pytest.fixture
def send():
    """``send(piece, …)``: the address of a sender of bytes; a number is a pause in s, None breaks off."""
    over = threading.Event()
    with contextlib.ExitStack() as stack:

        def send(*pieces):
            server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

            def serve():
                connection, _ = server.accept()
                with connection, contextlib.suppress(OSError):
                    for piece in pieces:
                        if piece is None:
                            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                        elif isinstance(piece, bytes):
                            connection.sendall(piece)
                        else:
                            over.wait(piece)

            thread = threading.Thread(target=serve, daemon=True)
            thread.start()
            stack.callback(thread.join, 10)
            stack.callback(over.set)
            return f"tcp://127.0.0.1:{server.getsockname()[1]}"

        yield send


@pytest.mark.parametrize("form", HEADS)
def test_a_sender_that_stalls_and_resumes(send, follow, expected, dot_events, tmp_path, form):
    """Pieces end anywhere, within a word and within the header; a line comes with every batch."""
    data = HEADS[form] + ENCODE[form](dot_events)
    done = follow(send(data[:7], 0.3, data[7:1201], 0.4, data[1201:1202], data[1202:]))
    assert (done.status, done.err) == (0, "")
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected
    lines = done.out.splitlines()
    assert [line.split()[0] for line in lines[:6]] == list("012345") and lines[0].split()[1:3] == ["0.050445", "s"]
    assert lines[6].startswith("6 batches tracked (model engine), ") and lines[6].endswith(" 60 events left over")
    assert "600 events came, 0 were dropped; the sender was held up for 0 s" in lines


def test_a_header_that_comes_by_itself_and_a_file_of_the_same_bytes(send, follow, expected, dot_events, tmp_path):
    """The header's end is the end of what came, and the events take their time."""
    (tmp_path / "a.raw").write_bytes(HEADS["evt3"] + evt3(dot_events))
    for source in (send(HEADS["evt2"] + b"% end\n", 0.3, evt2(dot_events)), tmp_path / "a.raw"):
        done = follow(source)
        assert (done.status, done.err) == (0, "")
        assert (tmp_path / "live" / "track.csv").read_bytes() == expected


def test_standard_input_and_a_pipe(follow, expected, dot_events, tmp_path, monkeypatch):
    data = HEADS["evt2"] + evt2(dot_events)
    (tmp_path / "data").write_bytes(data)
    with open(tmp_path / "data", "rb") as file:
        monkeypatch.setattr("sys.stdin", file)
        assert follow("-", "--sensor", "32,24").status == 0
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(data,))
    writer.start()
    assert follow(tmp_path / "pipe").status == 0
    writer.join()
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected


def test_lines_of_json(send, follow, dot_events):
    """Here without a header, and from the middle of the stream on."""
    done = follow(send(evt3(dot_events)), "--format", "evt3", "--sensor", "32,24", "--start-event", 123, "--json")
    *batches, last = map(json.loads, done.out.splitlines())
    assert [batch["batch"] for batch in batches] == [0, 1, 2, 3, 4] and batches[0]["t_ref_us"] == 50_000 + 1230 + 445
    assert {batch["flags"] for batch in batches} <= {"", "degenerate"} and batches[0]["events"] == 90
    summary = last["summary"]
    assert (summary["batches"], summary["received"], summary["lost"], summary["held_up_s"]) == (5, 600, 0, 0)


def test_several_objects_of_a_stream(send, command, dot, dot_events, tmp_path):
    """As of its file; each line has a name."""
    options = ["--roi", "dot=8,9", "--roi", "1,1", "--engine", "model", "--batch-events", 90, *SMALL, "--no-picture"]
    assert command(track, dot, *options, "--out", tmp_path / "file").status == 0
    done = command(track, send(HEADS["evt3"] + evt3(dot_events)), *options, "--out", tmp_path / "live")
    assert done.status == 0
    assert [line.split()[:2] for line in done.out.splitlines()[:4]] == [[n, k] for k in "01" for n in ("dot:", "1:")]
    done = command(track, send(HEADS["evt2"] + evt2(dot_events)), *options, "--json", "--out", tmp_path / "json")
    *lines, last = map(json.loads, done.out.splitlines())
    assert [(line["name"], line["batch"]) for line in lines] == [(n, k) for k in range(6) for n in ("dot", "1")]
    assert (last["summary"]["received"], last["summary"]["batches"]) == (600, 6)
    for name in ("track-dot.csv", "track-1.csv"):
        assert (tmp_path / "live" / name).read_bytes() == (tmp_path / "file" / name).read_bytes()


@pytest.mark.parametrize("end, message", [
    (b"\x01", r"cut off: 1 of 2 bytes of the last word came; the 600 events before were read"),
    (None, r"broke off after \d+ events: Connection reset by peer"),
])  # fmt: skip
def test_a_sender_that_breaks_off(send, follow, dot_events, expected, tmp_path, end, message):
    """One line and status 2; what was tracked before stands in the CSV."""
    done = follow(send(HEADS["evt3"] + evt3(dot_events), 1 if end is None else 0, end))
    assert done.status == 2 and re.search(f"^tcp://127.*: {message}$", done.error)
    lines = done.out.splitlines()
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected and "60 events were not tracked any more" in lines
    assert lines[6].startswith("6 batches tracked (model engine)") and lines[6].endswith(" 60 events left over")


def test_the_end_of_a_stream_by_ctrl_c(send, follow, dot_events, monkeypatch):
    monkeypatch.setattr("cmfpga.cli.track.Lines.add", Mock(side_effect=[None, None, KeyboardInterrupt]))
    done = follow(send(HEADS["evt3"] + evt3(dot_events), 2))
    assert done.status == 0 and done.err == "note: interrupted; this is the end of the stream\n"
    assert done.out.startswith("3 batches tracked (model engine), ")


@pytest.mark.parametrize("form", HEADS)
def test_wrong_words_among_them(send, follow, expected, dot_events, tmp_path, rng, form):
    """One in a hundred lies outside the sensor, is of a type that nobody knows, or a time: the rest gives what it gave.

    Whatever low part of the time stands in those outside.
    """
    data, size = ENCODE[form](dot_events), {"evt2": 4, "evt21": 8, "evt3": 2}[form]
    words = [data[k : k + size] for k in range(0, len(data), size)]
    count = -(-len(words) // 100)
    for number, k in enumerate(sorted(rng.choice(np.arange(4, len(words) - 9, 9), count, replace=False))[::-1]):
        kind = [0x8, 0x5, 0x2, 0x1, 0xC][number % 5]
        if form == "evt3":
            kind = {0x5: 0xD, 0x1: 0x2}.get(kind, kind)
            wrong = kind << 12 | int(rng.integers(32, 2048)) * (1 + (kind == 0x8))
        else:
            place = int(rng.integers(64)) << 22 | int(rng.integers(32, 2048)) << 11 | int(rng.integers(2048))
            wrong = kind << 28 | (int(rng.integers(1 << 28)) if kind == 0x8 else place)
        words.insert(k, wrong.to_bytes(min(size, 4), "little") + b"\x01\0\0\0" * (size == 8))
    done = follow(send(HEADS[form] + b"".join(words)), "--json")
    assert (done.status, done.err) == (0, "")
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected
    summary = json.loads(done.out.splitlines()[-1])["summary"]
    assert summary["received"] - summary["out_of_sensor"] == 600 and 0 < summary["out_of_sensor"] <= count
    assert summary["not_tracked"] == summary["events_left_over"] == 60 and summary["wrong_times"] == -(-count // 5)


def test_too_many_wrong_words(send, follow, dot_events):
    good, wrong = evt2(dot_events), (0x1 << 28 | 900 << 11).to_bytes(4, "little")
    words = b"".join(good[k : k + 8] + wrong for k in range(0, 4800, 8))
    done = follow(send(HEADS["evt2"] + words))
    assert re.search(r"600 of 1200 events lie outside the sensor of 32×24 px; up to 10% are left out", done.error)


def test_a_slow_sender_is_answered_within_a_second(send, command, tmp_path, rng):
    """10,000 events/s of which few are in the ROI, and no batch option; then it breaks off, and nothing is lost."""
    events = make_events(rng, 9000, step=400)  # 100 µs from one to the next
    done = command(track, send(evt2(events)[:-1], 1), *LARGE, "--json", "--out", tmp_path)
    first, *_, last = map(json.loads, done.out.splitlines())
    assert done.status == 2 and "cut off: 3 of 4 bytes" in done.err
    assert first["t_ref_us"] - events.t[0] < 500_000 and first["events"] > 0
    tracked = sum(json.loads(line)["events"] for line in done.out.splitlines()[:-1])
    assert tracked + last["summary"]["not_tracked"] == last["summary"]["received"] == 8999


def test_one_event_and_the_end(send, command, dot_events, small, tmp_path):
    """Too few, whatever the options."""
    for more in ([], ["--batch-events", 1], ["--batch-events", 90], ["--batch-us", 10], ["--batch-roi-events", 1]):
        address = send(HEADS["evt2"] + evt2(dot_events[:1]))
        done = command(track, address, "--roi", "8,9", "--engine", "model", *small, "--out", tmp_path, *more)
        assert done.error == f"{address}: too few events for one batch after event 0 (1 left)", more


def test_it_is_told_that_nothing_comes(send, follow, dot_events, monkeypatch, tmp_path):
    """Before the header, between events, and of a pipe that nobody writes to; once each time."""
    monkeypatch.setattr("cmfpga.events.live._QUIET_S", 0.4)
    address = send(0.7, HEADS["evt3"], 0.7, evt3(dot_events))
    assert follow(address).err == f"note: {address}: nothing has come for 0.4 s\n" * 2
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Timer(0.7, (tmp_path / "pipe").write_bytes, [HEADS["evt2"] + evt2(dot_events)])
    writer.start()
    done = follow(tmp_path / "pipe")
    assert (done.status, done.err) == (0, f"note: {tmp_path / 'pipe'}: nothing has come for 0.4 s\n")
    writer.join()


def test_sigterm_ends_a_stream(send, follow, dot_events):
    """With a summary, in which each event is tracked or counted."""
    threading.Timer(0.7, os.kill, [os.getpid(), signal.SIGTERM]).start()
    before = signal.getsignal(signal.SIGTERM)
    done = follow(send(HEADS["evt3"] + evt3(dot_events), 5))
    assert (done.status, done.err) == (0, "note: interrupted; this is the end of the stream\n")
    assert signal.getsignal(signal.SIGTERM) == before
    assert "6 batches tracked (model engine)" in done.out and "60 events were not tracked any more" in done.out


def test_sigterm_before_the_first_answer(send, command, tmp_path, rng):
    """What came is tracked as if the stream had ended."""
    events = make_events(rng, 3000, step=40)
    threading.Timer(0.6, os.kill, [os.getpid(), signal.SIGTERM]).start()
    done = command(track, send(evt2(events), 5), *LARGE, "--json", "--out", tmp_path)
    assert done.status == 0 and "note: interrupted; this is the end of the stream" in done.err
    *lines, last = map(json.loads, done.out.splitlines())
    assert sum(line["events"] for line in lines) + last["summary"]["not_tracked"] == 3000 and lines


def test_a_sender_slower_than_its_own_times(send, command, tmp_path, rng, monkeypatch):
    """10,000 events/s of a recording with 500,000, which then waits: the answer does not wait for more of its times."""
    events, answered = make_events(rng, 6000, step=8), []
    monkeypatch.setattr("cmfpga.cli.track.Lines.add", lambda self, batch: answered.append(time.monotonic()))
    pieces = [part for k in range(0, 6000, 100) for part in (evt2(events[k : k + 100]), 0.01)]
    begin = time.monotonic()
    command(track, send(*pieces, 2), *LARGE, "--out", tmp_path)
    assert answered[0] - begin < 2.3 < 2.6 < time.monotonic() - begin


def test_an_empty_roi_does_not_end_the_others(send, command, dot_events, tmp_path):
    options = ["--engine", "model", "--batch-events", 90, *SMALL, "--no-picture", "--out", tmp_path]
    far = Events(dot_events.t, np.minimum(dot_events.x, 15), np.minimum(dot_events.y, 15), dot_events.p)
    done = command(track, send(HEADS["evt3"] + evt3(far)), "--roi", "dot=8,8", "--roi", "empty=24,16", *options)
    assert done.status == 0 and "dot: 6 batches tracked" in done.out and "empty: 6 batches tracked" in done.out
    assert "warning: empty: ROI at 24,16: none of the events is in it, in 6 batches" in done.err


@pytest.mark.parametrize("drop", [False, True])
def test_a_sender_that_is_too_fast(send, rng, drop):
    """It is held up, and nothing is lost; or events are dropped, and counted."""
    events = make_events(rng, 200_000)
    data = evt2(events)
    source = LiveSource(send(data), form="evt2", sensor=(240, 180), drop=drop, buffer_events=5000)
    with source:
        chunks = source.chunks()
        taken = [next(chunks)]
        time.sleep(0.7)
        taken += chunks
    assert source.received == 200_000
    got = np.concatenate([events.t for events in taken])
    if drop:
        assert source.held_s == 0 and source.lost == 200_000 - len(got) > 100_000
    else:
        assert source.lost == 0 and source.held_s > 0.3
        np.testing.assert_array_equal(got, events.t)


def test_from_python(send, dot, dot_events):
    how = {"roi": (8, 9), "batch_events": 90, "engine": "model", **PAPER}
    tracking = cmfpga.track(send(evt2(dot_events)), form="evt2", sensor=(32, 24), **how)
    assert tracking.vx.tolist() == cmfpga.track(dot, **how).vx.tolist()


def test_a_stream_is_closed_while_nothing_comes(send):
    with LiveSource(send(HEADS["evt3"], 3), sensor=(32, 24)) as source:
        began = time.monotonic()
    assert time.monotonic() - began < 2 and not list(source.chunks())


@pytest.mark.parametrize("source, message", [
    ([b""], "it ended before anything came"),
    ([b"hello, world, this is"], r"begins with b'hello, world, th'; a header of EVT 2.0, 2.1 or 3.0, or"),
    ([b"% evt 4.0\n% end\n"], "version '4.0'; '% evt' or '% format' of EVT 2.0, 2.1 or 3.0"),
    ([HEADS["evt3"]], r"too few events for one batch after event 0 \(0 left\)"),
    ([HEADS["evt3"], struct.pack("<3H", 0x8000, 0x0003, 0x2040)],
     "1 of 1 events lie outside the sensor of 32×24 px; up to 10% are"),
    ("tcp://127.0.0.1:1", "tcp://127.0.0.1:1: Connection refused"),
    ("tcp://127.0.0.1:99999", "a port from 1 to 65535 is needed"),
    ("tcp://nowhere", "tcp://HOST:PORT is needed"),
    ("tcp://does-not-exist.invalid:5", "tcp://does-not-exist.invalid:5: "),
])  # fmt: skip
def test_what_is_no_stream_of_events(send, follow, source, message):
    assert re.search(message, follow(source if isinstance(source, str) else send(*source)).error)


def test_what_is_for_streams_only(follow, command, dot, send):
    for told, why in (
        ((dot, "--drop"), "a file; --drop is for streams: -, tcp://HOST:PORT, a named pipe, camera:"),
        (("tcp://127.0.0.1:1", "--columns", "x,y,t,p"), "a stream; columns can be told of files only"),
    ):
        assert follow(*told).error.endswith(why)
    assert command(track, "--drop").error == "--drop: a RECORDING is needed; the synthetic scene has its own"
    assert command(info, "tcp://127.0.0.1:1").error == "tcp:/127.0.0.1:1: no such file"
    done = command(track, send(HEADS["evt3"]), "--roi", "auto", "--set", "roi_width=8", "--set", "roi_height=8")
    assert "--roi auto: its events come only once; --roi X,Y is needed" in done.error
