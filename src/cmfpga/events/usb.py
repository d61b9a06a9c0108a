"""Cameras at this computer, by ``neuromorphic-drivers``: ``pip install 'cmfpga[cameras]'`` brings it.

Prophesee's sensors give raw words of EVT 3.0, which our own decoder reads. iniVation's give events, for their words are
of other formats. The driver fills a ring of packets by itself; where that is full it drops packets, and counts them.
"""

import time

from ..errors import RecordingError, needs
from .arrays import Events
from .evt import EvtDecoder

_POLL_S = 0.2  # how long one reading waits
_AWAIT_S = 10.0  # a camera that is gone is awaited for so long


class Camera:
    """An open camera, of ``address`` ``camera:SERIAL``, or ``camera:``, the first one that can be opened.

    ``name`` is its address with the serial number; ``note`` and ``format`` are for people; ``sensor`` is (width,
    height), px. ``decoder`` takes what :meth:`read` gives, as :class:`EvtDecoder` does; times go on where the camera
    was gone, which ``reconnected`` counts. ``backlog`` and ``dropped`` are packets: those that waited in the driver's
    ring at most, and those that it dropped because the ring was full.

    Raises :exc:`UserError`, in one line, where the package, or the camera, is not there, or cannot be opened.
    """

    def __init__(self, address):
        self._serial = address.removeprefix("camera:")
        with needs("neuromorphic_drivers", "cameras", "a camera"):
            try:
                import neuromorphic_drivers as driver
            except ModuleNotFoundError:
                raise
            except ImportError as error:  # such as of a system for which it was not built
                raise RecordingError(f"a camera: neuromorphic_drivers cannot be loaded here: {error}") from None
        self._driver, self._gone = driver, None
        self.backlog = self.dropped = self.reconnected = 0
        self._open()
        self.decoder = _Joined(lambda: EvtDecoder("3.0") if self._words else _Decoded())

    def _open(self):
        driver, serial = self._driver, self._serial
        try:
            listed = driver.list_devices()
        except RuntimeError as error:
            raise RecordingError(f"a camera: USB cannot be used here: {error}") from None
        fit = [one for one in listed if serial in ("", one.serial)]
        if not fit:
            there = ", ".join(f"{one.name.value} ({one.serial or one.error})" for one in listed)
            what = f"camera:{serial[:40]}: not" if serial else "no camera is"
            raise RecordingError(f"{what} connected" + f"; there are: {there}" * bool(there))
        chosen = next((one for one in fit if one.error is None), fit[0])
        self.name = f"camera:{chosen.serial or serial}".rstrip(":")
        model = chosen.name.value
        self.note = f"{self.name}: {model}, {chosen.connection.value}"
        self._words = words = not model.startswith("iniVation")
        self.format = model if words else f"{model}, events"
        try:
            if chosen.error is not None:
                raise RuntimeError(chosen.error)
            self._device = driver.open(serial=chosen.serial, raw=words, iterator_timeout=_POLL_S)
        except RuntimeError as error:
            cure = "on Linux neuromorphic-drivers-install-udev-rules gives access"
            raise RecordingError(f"{self.name}: {model}: {error}; {cure}") from None
        properties = self._device.properties()
        self.sensor, self._serial = (properties.width, properties.height), chosen.serial or serial
        self._lost = 0  # packets, of this connection

    def read(self):
        """What came next; None where nothing did. Raises :exc:`OSError` where the camera has been gone for too long."""
        if self._gone and not self._again():
            return None
        try:
            status, packet = next(self._device)
        except Exception as error:  # of a foreign program, in a thread whose end the track waits for
            self._gone = time.monotonic(), str(error) or type(error).__name__
            self._device.close()
            return None
        if status.ring is not None:
            self.backlog = max(self.backlog, status.ring.backlog)
            self.dropped += status.ring.dropped_packets - self._lost
            self._lost = status.ring.dropped_packets
        if self._words or packet is None:
            return packet
        events = packet.polarity_events
        return None if events is None else Events(events["t"], events["x"], events["y"], events["on"])

    def _again(self):
        """Whether it is there again, and open."""
        begin, why = self._gone
        if time.monotonic() - begin >= _AWAIT_S:
            raise OSError(why)
        time.sleep(_POLL_S)
        try:
            self._open()
        except RecordingError:
            return False
        self._gone = None
        self.reconnected += 1
        self.decoder.renew(int((time.monotonic() - begin) * 1e6))
        return True

    def close(self):
        """Stop it. May be called more than once."""
        if not self._gone:
            self._device.close()


class _Joined:
    """A decoder of each connection, one after the other; its times go on where those of the last one ended."""

    def __init__(self, make):
        self._make, self._decoder, self._early = make, make(), 0
        self._offset, self._last, self._begin = 0, None, None

    def renew(self, gone):
        """The next connection begins, so many µs later."""
        self._early += self._decoder.early
        self._decoder = self._make()
        self._begin = None if self._last is None else self._last + gone

    def __call__(self, data):
        t, x, y, p = self._decoder(data)
        if len(t):
            if self._begin is not None:
                self._offset, self._begin = self._begin - int(t[0]), None
            t = t + self._offset if self._offset else t
            self._last = int(t[-1])
        return t, x, y, p

    @property
    def early(self):
        return self._early + self._decoder.early

    def __getattr__(self, name):
        return getattr(self._decoder, name)  # skip, rest, word_bytes


class _Decoded:
    """Takes events for words."""

    rest, early = b"", 0

    def __call__(self, events):
        return events.t, events.x, events.y, events.p

    def skip(self, events):
        return len(events)
