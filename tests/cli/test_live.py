"""Streams: a recording that is sent gives the track of its file; senders that stall, break off, or are too fast."""

import contextlib
import json
import os
import re
import socket
import struct
import threading
import time

import numpy as np
import pytest

import cmfpga
from cmfpga import info, track
from cmfpga.errors import RecordingError
from cmfpga.events import LiveSource
from support.designs import FAST, PAPER
from support.recordings import evt2, evt3, make_events

HEADS = {"evt2": b"% evt 2.0\n% geometry 32x24\n", "evt3": b"% camera x\n% format EVT3;height=24;width=32\n% end\n"}
ENCODE = {"evt2": evt2, "evt3": evt3}
MODEL = ["--engine", "model", "--roi", "8,9", "--batch-events", 90]


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


@pytest.fixture
def follow(command, small, tmp_path):
    def follow(recording, *arguments, out="live"):
        return command(track, recording, *MODEL, *small, "--no-picture", "--out", tmp_path / out, *arguments)

    return follow


@pytest.fixture(scope="module")
def expected(command, dot, small, tmp_path_factory):
    """``track.csv`` of the dot's file."""
    folder = tmp_path_factory.mktemp("expected")
    assert command(track, dot, *MODEL, *small, "--no-picture", "--out", folder).status == 0
    return (folder / "track.csv").read_bytes()


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


def test_a_header_that_comes_by_itself(send, follow, expected, dot_events, tmp_path):
    """Its end is the end of what came, and the events take their time."""
    head = HEADS["evt2"] + b"% end\n"
    done = follow(send(head, 0.3, evt2(dot_events)))
    assert (done.status, done.err) == (0, "")
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected


def test_a_file_of_the_same_bytes_gives_the_same(send, follow, dot_events, expected, tmp_path):
    pytest.importorskip("faery")
    (tmp_path / "a.raw").write_bytes(HEADS["evt3"] + evt3(dot_events))
    assert follow(tmp_path / "a.raw", out="file").status == 0
    assert (tmp_path / "file" / "track.csv").read_bytes() == expected


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
    small = [word for name, value in FAST.items() if name != "preset" for word in ("--set", f"{name}={value}")]
    options = ["--roi", "dot=8,9", "--roi", "1,1", "--engine", "model", "--batch-events", 90, *small, "--no-picture"]
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
    assert (tmp_path / "live" / "track.csv").read_bytes() == expected and len(done.out.splitlines()) == 6


def test_the_end_of_a_stream_by_ctrl_c(send, follow, dot_events, monkeypatch):
    def interrupted(self, batch):
        if batch.index == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("cmfpga.track.Lines.add", interrupted)
    done = follow(send(HEADS["evt3"] + evt3(dot_events), 2))
    assert done.status == 0 and done.err == "note: interrupted; this is the end of the stream\n"
    assert done.out.startswith("3 batches tracked (model engine), ")


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
    tracking = cmfpga.track(
        send(evt2(dot_events)), form="evt2", sensor=(32, 24), roi=(8, 9), batch_events=90, engine="model", **PAPER
    )
    assert tracking.vx.tolist() == cmfpga.track(dot, roi=(8, 9), batch_events=90, engine="model", **PAPER).vx.tolist()
    with pytest.raises(RecordingError, match="its events cannot be read again"):
        tracking.trace(0)


def test_a_stream_is_closed_while_nothing_comes(send):
    with LiveSource(send(HEADS["evt3"], 3), sensor=(32, 24)) as source:
        began = time.monotonic()
    assert time.monotonic() - began < 2 and not list(source.chunks())


@pytest.mark.parametrize("pieces, options, message", [
    ([b""], [], "it ended before anything came"),
    ([b"hello, world, this is"], [], r"begins with b'hello, world, th'; a header of EVT 2.0 or EVT 3.0 is needed, or"),
    ([b"% evt 2.1\n% end\n"], [], "begins with '2.1'; a header of EVT 2.0"),
    ([HEADS["evt3"]], [], "too few events for one batch after event 0 \\(0 left\\)"),
    ([HEADS["evt3"], struct.pack("<3H", 0x8000, 0x0003, 0x2040)], [], "x of event 0 is 64; 0 to 31 is allowed on a"),
])  # fmt: skip
def test_what_comes_is_no_stream_of_events(send, follow, pieces, options, message):
    assert re.search(message, follow(send(*pieces), *options).error)


@pytest.mark.parametrize("address, message", [
    ("tcp://127.0.0.1:1", "tcp://127.0.0.1:1: Connection refused"),
    ("tcp://127.0.0.1:99999", "a port from 1 to 65535 is needed"),
    ("tcp://nowhere", "tcp://HOST:PORT is needed"),
    ("tcp://does-not-exist.invalid:5", "tcp://does-not-exist.invalid:5: "),
])  # fmt: skip
def test_addresses(follow, address, message):
    assert message in follow(address).error


def test_what_is_for_streams_only(follow, command, dot, send):
    assert follow(dot, "--drop").error.endswith("a file; --drop is for streams: -, tcp://HOST:PORT, a named pipe")
    assert follow("tcp://127.0.0.1:1", "--columns", "x,y,t,p").error.endswith(
        "a stream; columns can be told of files only"
    )
    assert "--format is for streams" in follow(dot, "--format", "evt2").error
    assert command(track, "--drop").error == "--drop: a RECORDING is needed; the synthetic scene has its own"
    assert command(info, "tcp://127.0.0.1:1").error == "tcp:/127.0.0.1:1: no such file"
    done = command(track, send(HEADS["evt3"]), "--roi", "auto", "--set", "roi_width=8", "--set", "roi_height=8")
    assert "--roi auto: its events come only once; --roi X,Y is needed" in done.error
