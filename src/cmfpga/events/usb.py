"""Cameras at this computer, by ``neuromorphic-drivers``: ``pip install 'cmfpga[cameras]'`` brings it.

Prophesee's sensors give raw words of EVT 3.0, which our own decoder reads. iniVation's give events, for their words are
of other formats. The driver fills a ring of packets by itself; where that is full it drops packets, and counts them.
"""

from ..errors import RecordingError, needs
from .arrays import Events
from .evt import EvtDecoder

_POLL_S = 0.2  # how long one reading waits


class Camera:
    """An open camera.

    Parameters
    ----------
    address : str
        ``camera:``, the first one that can be opened, or ``camera:SERIAL``.

    Attributes
    ----------
    name, note, format : str
        Its address with the serial number; and for people.
    sensor : (int, int)
        Width and height, px.
    decoder : callable
        Of what :meth:`read` gives, as :class:`EvtDecoder`.
    backlog, dropped : int
        Packets that waited in the driver's ring at most, and that it dropped because the ring was full.

    Raises
    ------
    UserError
        The package, or the camera, is not there, or cannot be opened; one line.
    """

    def __init__(self, address):
        serial = address.removeprefix("camera:")
        with needs("neuromorphic_drivers", "cameras", "a camera"):
            try:
                import neuromorphic_drivers as driver
            except ModuleNotFoundError:
                raise
            except ImportError as error:  # such as of a system for which it was not built
                raise RecordingError(f"a camera: neuromorphic_drivers cannot be loaded here: {error}") from None
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
        words = not model.startswith("iniVation")
        self.format = model if words else f"{model}, events"
        try:
            if chosen.error is not None:
                raise RuntimeError(chosen.error)
            self._device = driver.open(serial=chosen.serial, raw=words, iterator_timeout=_POLL_S)
        except RuntimeError as error:
            raise RecordingError(
                f"{self.name}: {model}: {error}; on Linux neuromorphic-drivers-install-udev-rules gives access"
            ) from None
        properties = self._device.properties()
        self.sensor = properties.width, properties.height
        self.decoder = EvtDecoder("3.0") if words else _Decoded()
        self.backlog = self.dropped = 0

    def read(self):
        """What came next; None where nothing did. Raises :exc:`OSError` where the camera is gone."""
        try:
            status, packet = next(self._device)
        except Exception as error:  # of a foreign program, in a thread whose end the track waits for
            raise OSError(str(error) or type(error).__name__) from None
        if status.ring is not None:
            self.backlog = max(self.backlog, status.ring.backlog)
            self.dropped = status.ring.dropped_packets
        if isinstance(self.decoder, EvtDecoder) or packet is None:
            return packet
        events = packet.polarity_events
        return None if events is None else Events(events["t"], events["x"], events["y"], events["on"])

    def close(self):
        """Stop it. May be called more than once."""
        self._device.close()


class _Decoded:
    """Takes events for words."""

    rest, early = b"", 0

    def __call__(self, events):
        return events.t, events.x, events.y, events.p

    def skip(self, events):
        return len(events)
