"""Events while they come: of a camera; or of its program, by standard input, a named pipe, TCP, in EVT 2.0, 2.1 or 3.0.

A thread reads and decodes what comes, and the track takes it from a buffer. Where the track is slower than the camera,
the buffer fills up: then the thread stops reading, which holds the sender up and loses nothing; or it drops what comes,
where the user wants the present rather than everything. A camera cannot be held up: of it the thread always drops.
Both are counted.
"""

import os
import re
import select
import socket
import stat
import sys
import threading
import time
from collections import deque
from pathlib import Path

from ..errors import RecordingError
from .arrays import EventChecker, Events
from .evt import EvtDecoder, TimeWords
from .raw import FORMS, HEADER_BYTES, evt_version, prophesee_header, raw_sensor
from .recording import check_sensor, open_recording
from .usb import Camera

#: Events that wait for the track, at most about so many.
BUFFER_EVENTS = 1 << 20

#: Of the events, so many may lie outside the sensor; with more its size is wrong, or what comes is no stream of events.
MOST_OUTSIDE = 0.1

_FEWEST = 1000  # events before the end that are judged by that
_QUIET_S = 5  # then, and after each time twice as long, it is told that nothing comes
_READ_BYTES = 1 << 16
_POLL_S = 0.2  # how soon the thread notices that it is closed
_CONNECT_S = 10


def is_live(path):
    """Whether ``path`` names a stream: ``-``, ``tcp://host:port``, ``camera:``, or a named pipe."""
    path = os.fspath(path)
    try:
        return path == "-" or path.startswith(("tcp://", "camera:")) or stat.S_ISFIFO(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


class Feed:
    """Takes events piece by piece, and gives them to one track: an :class:`~.arrays.EventSource`.

    ``sensor`` is (width, height), px, or None where it is not known; ``name`` is for people.
    """

    seekable = False

    def __init__(self, sensor, name):
        self.name = name
        self.width, self.height = (None, None) if sensor is None else check_sensor(sensor, name)
        self._check = EventChecker(name, self.width, self.height)
        self._pieces, self._ended = deque(), False

    def push(self, events):
        """Append :class:`Events`, which follow the last ones in time.

        Raises :exc:`RecordingError` for those that go back in time or lie outside the sensor; none of them is kept.
        """
        self._pieces.append(Events(*self._check(events.t, events.x, events.y, events.p)))

    def end(self):
        """No more will come."""
        self._ended = True

    def chunks(self, start=0, size=None):
        """As of any source: the pieces as they were pushed; None while there are none."""
        while self._pieces or not self._ended:
            if not self._pieces:
                yield None
                continue
            events = self._pieces.popleft()
            yield events[start:]
            start = max(start - len(events), 0)


class LiveSource(Feed):
    """A stream of events, tracked as it comes; a context manager.

    Raises :exc:`RecordingError`, in one line, where it cannot be opened, or does not begin as a stream of EVT 2.0, 2.1
    or 3.0; :exc:`MissingPackage` where a camera's driver is not installed.

    Parameters
    ----------
    path : str
        ``-``, ``tcp://host:port``, the path of a named pipe; or ``camera:``, ``camera:SERIAL``, a :class:`.usb.Camera`.
    sensor : (int, int), optional
        Goes before what the stream's header, or the camera, says.
    form : {"evt2", "evt21", "evt21-legacy", "evt3"}, optional
        Of a stream without a header (``% evt 3.0`` or ``% format EVT3;…``).
    drop : bool
        Drop what comes while the buffer is full, instead of holding the sender up; always of a camera.
    quiet : callable, optional
        ``quiet(seconds)`` is called where nothing has come for so long.

    Attributes
    ----------
    received, lost, outside : int
        Events that came, how many of them were dropped, and how many lie outside the sensor and were left out.
    held_s : float
        Time that reading was held up by a full buffer, s.
    came, answer_by : float or None
        When the first events came; and from when on :meth:`chunks` gives None where nothing waits, None: never. Both by
        ``time.monotonic()``.
    stopped : bool
        Whether :meth:`stop` was called.
    """

    def __init__(self, path, *, sensor=None, form=None, drop=False, quiet=None, buffer_events=BUFFER_EVENTS):
        self.received, self.lost, self.outside, self.held_s = 0, 0, 0, 0.0
        self.came, self.answer_by, self.stopped = None, None, False
        self._drop, self._most, self._quiet = drop, buffer_events, quiet or (lambda seconds: None)
        self._waiting, self._closed, self._error = 0, False, None
        self._changed = threading.Condition()
        name = os.fspath(path)
        self._fd = self._socket = self._camera = self._times = self._thread = None
        try:
            if name.startswith("camera:"):
                self._camera, first = Camera(name), b""
                self.format, self._decoder = self._camera.format, self._camera.decoder
                name, size, self._drop = self._camera.name, self._camera.sensor, True
            else:
                self._open(name)
                fields, first = self._header(name)
                version = evt_version(fields, form, name, first)
                size = sensor or raw_sensor(fields)
                self.format, self._decoder = f"stream of EVT {version}", EvtDecoder(version, size)
                self._times = TimeWords(version)
        except OSError as error:
            self.close()
            raise RecordingError(f"{name}: {error.strerror or error}") from None
        except BaseException:
            self.close()
            raise
        super().__init__(sensor or size, name)
        self._thread = threading.Thread(target=self._run, args=(first,), daemon=True)
        self._thread.start()

    def _open(self, name):
        if name == "-":
            self._fd = os.dup(sys.stdin.fileno())
            if os.isatty(self._fd):
                raise RecordingError("-: standard input is a terminal; a stream of EVT 2.0, 2.1 or 3.0 is needed")
        elif not name.startswith("tcp://"):
            self._fd = os.open(name, os.O_RDONLY | os.O_NONBLOCK)  # a pipe may have no writer yet
        elif address := re.fullmatch(r"tcp://(\[[^\]]+\]|[^:/]+):(\d{1,5})/?", name):
            if not 0 < int(address[2]) < 1 << 16:
                raise RecordingError(f"{name}: a port from 1 to 65535 is needed")
            self._socket = socket.create_connection((address[1].strip("[]"), int(address[2])), timeout=_CONNECT_S)
            self._socket.setblocking(True)
            self._fd = self._socket.fileno()
        else:
            raise RecordingError(f"{name[:80]}: tcp://HOST:PORT is needed")

    def _read(self):
        """What comes next; nothing at the end, or once it is closed."""
        begin, told = time.monotonic(), _QUIET_S
        while not self._closed:
            if self._camera:
                if data := self._camera.read():
                    return data
            elif select.select([self._fd], [], [], _POLL_S)[0]:
                return os.read(self._fd, _READ_BYTES)
            if time.monotonic() - begin >= told:
                self._quiet(told)
                told *= 2
        return b""

    def _header(self, name):
        """``(fields, bytes behind them)``; the fields are empty where there is no header."""
        data = b""
        while more := self._read():
            data += more
            fields, begin = prophesee_header(data)
            rest = data[begin:]
            if "end" in fields or (rest and not rest.startswith(b"%")) or len(data) > HEADER_BYTES:
                break
        if not data:
            raise RecordingError(f"{name}: it ended before anything came")
        return fields, rest

    def _run(self, data):
        """The thread: reads, decodes, and puts what it has into the buffer."""
        try:
            try:
                data = data or self._read()  # where the header came by itself
                while data and not self._closed:
                    for at in range(0, len(data), _READ_BYTES):  # a camera may give megabytes
                        piece = data[at : at + _READ_BYTES]
                        self._take(self._times(piece) if self._times else piece)
                    data = self._read()
            finally:
                if self._times:
                    self._take(self._times(b"", last=True))
            if (rest := len(self._decoder.rest)) and not self._closed:
                came = f"cut off: {rest} of {self._decoder.word_bytes} bytes of the last word came"
                self._error = RecordingError(f"{self.name}: {came}; the {self.received} events before were read")
        except OSError as error:
            why = error.strerror or error
            self._error = RecordingError(f"{self.name}: broke off after {self.received} events: {why}")
        except RecordingError as error:
            self._error = error
        with self._changed:
            self.end()
            self._changed.notify_all()

    def _take(self, data):
        if self._drop and self._waiting >= self._most:
            count = self._decoder.skip(data)
            self.received += count
            self.lost += count
        elif len((columns := self._decoder(data))[0]):
            self._put(Events(*columns))

    def _put(self, events):
        self.received += len(events)
        self.came = self.came or time.monotonic()
        with self._changed:
            if self._waiting >= self._most:
                begin = time.monotonic()
                self._changed.wait_for(lambda: self._waiting < self._most or self._closed)
                self.held_s += time.monotonic() - begin
            self._pieces.append(events)
            self._waiting += len(events)
            self._changed.notify_all()

    def chunks(self, start=0, size=None):
        """As of any source; waits for what comes. Raises :exc:`RecordingError` where the stream broke off."""
        taken = 0
        for events in super().chunks():
            if self.stopped:
                return
            if events is None:
                left = None if self.answer_by is None else max(0, self.answer_by - time.monotonic())
                with self._changed:
                    here = self._changed.wait_for(lambda: self._pieces or self._ended or self.stopped, left)
                if not here:
                    yield None
                continue
            with self._changed:
                self._waiting -= len(events)
                self._changed.notify_all()
            taken += len(events)
            if self.width is not None:  # as the hardware does it
                inside = (events.x < self.width) & (events.y < self.height)
                events = events if inside.all() else events[inside]
                self.outside += len(inside) - len(events)
                self._judge(taken, _FEWEST)
            yield events[start:]
            start = max(start - len(events), 0)
        self._judge(taken, 1)
        if self._error:
            raise self._error

    def _judge(self, taken, fewest):
        """Raise where too many of the events so far, once these are ``fewest``, lie outside the sensor."""
        if taken >= fewest and self.outside > MOST_OUTSIDE * taken:
            where = f"outside the sensor of {self.width}×{self.height} px"
            allowed = f"up to {MOST_OUTSIDE:.0%} are left out and counted"
            raise RecordingError(f"{self.name}: {self.outside} of {taken} events lie {where}; {allowed}")

    def extent(self):
        """How much will come is not known."""

    def notes(self):
        """Which camera it is; none of another stream, of which nothing has come yet."""
        return (self._camera.note,) if self._camera else ()

    def counts(self):
        """Events received, lost and left out, JSON-ready; ``before_time``: ahead of the first word of time.

        ``wrong_times`` are words, as :class:`.evt.TimeWords` leaves them out. A :class:`.usb.Camera` has three counts
        more, of packets and of connections.
        """
        counts = {
            "received": self.received, "lost": self.lost, "out_of_sensor": self.outside,
            "held_up_s": round(self.held_s, 3), "before_time": self._decoder.early,
            "wrong_times": self._times.wrong if self._times else 0,
        }  # fmt: skip
        if camera := self._camera:
            more = {"driver_backlog": camera.backlog, "driver_dropped": camera.dropped}
            counts |= more | {"reconnected": camera.reconnected}
        return counts

    def stop(self):
        """End the stream, whatever was not taken yet; a handler of signals may call it."""
        with self._changed:
            self.stopped = True
            self._changed.notify_all()

    def close(self):
        """Stop reading. May be called more than once."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
        if self._socket is not None:
            self._socket.close()
        elif self._fd is not None:
            os.close(self._fd)
        elif self._camera is not None:
            self._camera.close()
        self._socket = self._fd = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def open_source(path, *, form=None, drop=False, quiet=None, **options):
    """A :class:`LiveSource` where ``path`` names a stream, or the :class:`~cmfpga.events.Recording` of a file.

    ``options`` are those of :func:`~cmfpga.events.open_recording`; of a stream only ``sensor`` counts.
    """
    if not is_live(path):
        if drop:
            streams = "-, tcp://HOST:PORT, a named pipe, camera:"
            raise RecordingError(f"{Path(path)}: a file; --drop is for streams: {streams}")
        return open_recording(path, form=form, **options)
    sensor = options.pop("sensor", None)
    for name, value in options.items():
        if value is not None:
            raise RecordingError(f"{path}: a stream; {name} can be told of files only")
    if form is not None and os.fspath(path).startswith("camera:"):
        raise RecordingError(f"{path}: a camera says its format itself; --format is not allowed")
    if form not in (None, *FORMS):
        raise RecordingError(f"{path}: a stream; --format {', '.join(FORMS)} is allowed, not {form[:40]}")
    return LiveSource(path, sensor=sensor, form=form, drop=drop, quiet=quiet)
