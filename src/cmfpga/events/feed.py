"""Events that come while they are tracked: an :class:`~cmfpga.events.arrays.EventSource`."""

from collections import deque

from .arrays import EventChecker, Events
from .recording import check_sensor


class Feed:
    """Takes events piece by piece, and gives them to one track.

    Parameters
    ----------
    sensor : (int, int) or None
        Width and height of the sensor, px, where they are known.
    name : str
        For people.
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
