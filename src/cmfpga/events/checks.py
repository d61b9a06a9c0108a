"""From columns of numbers, as a file or a caller has them, to checked ones."""

import numpy as np

from ..errors import RecordingError

# Columns and rows are uint16 in memory.
_LARGEST_COORDINATE = (1 << 16) - 1
# Polarities: contrast does not use them, so odd ones are taken. What goes beyond is another column. The last is -1 of
# an unsigned byte.
_CODES = (*range(-1, 16), 255)


class EventChecker:
    """Turns the chunks of one recording, in order, into columns of :class:`Events`; refuses what cannot be used.

    Parameters
    ----------
    where : str
        Start of every message: the file, and what the columns are if that needs to be said.
    width, height : int or None
        Size of the sensor, px. Without it coordinates are only held to 0 … 65535.
    first_event : int
        Index in the recording of the first event that will be given.
    highest_off : int
        Polarities up to it mean darker.
    """

    def __init__(self, where, width=None, height=None, first_event=0, highest_off=0):
        self.where = where
        self.width = width
        self.height = height
        self.next_event = first_event
        self._last_t = None
        self._off = highest_off

    def __call__(self, t, x, y, p):
        """``(t, x, y, p)`` of the next chunk, as :class:`Events` keep them.

        Parameters
        ----------
        t : int64 array
            Time stamps, µs. Negative ones are allowed.
        x, y : arrays of integers, or of floats with whole values
            Column and row.
        p : array of bool or numbers
            Polarity: -1 to 15, or 255, which is -1.

        Raises
        ------
        RecordingError
            A time stamp is lower than the one before (also across chunks), a coordinate is no whole number,
            negative or outside the sensor, or a polarity is another number.
        """
        self._check_order(t)
        x, y, p = self.coordinate("x", x, self.width), self.coordinate("y", y, self.height), self.polarity(p)
        self.next_event += len(t)
        self._last_t = int(t[-1]) if len(t) else self._last_t
        return t, x, y, p

    def _fail(self, k, message):
        raise RecordingError(f"{self.where}: {message.format(event=f'event {self.next_event + k}')}")

    def _check_order(self, t):
        if not len(t):
            return
        if self._last_t is not None and t[0] < self._last_t:
            self._fail_order(0, self._last_t, t[0])
        back = t[1:] < t[:-1]
        if back.any():
            k = int(back.argmax())
            self._fail_order(k + 1, t[k], t[k + 1])

    def _fail_order(self, k, before, after):
        self._fail(
            k, f"time stamp of {{event}} is {after} µs, after {before} µs of the event before; it must never decrease"
        )

    def coordinate(self, name, values, size=None):
        """Column ``name``, x or y, as uint16; ``size`` is that of the sensor, px."""
        if not len(values):
            return values.astype(np.uint16)
        if values.dtype.kind == "f":
            odd = ~(values == np.floor(values))  # NaN too
            if odd.any():
                k = int(odd.argmax())
                self._fail(k, f"{name} of {{event}} is {values[k]}; a whole number of pixels is needed")
        largest = _LARGEST_COORDINATE if size is None else size - 1
        if values.min() < 0 or values.max() > largest:  # faster than a mask of each chunk
            k = int(((values < 0) | (values > largest)).argmax())
            sensor = "" if size is None else f" on a sensor of {self.width}×{self.height} px"
            self._fail(k, f"{name} of {{event}} is {values[k]:.0f}; 0 to {largest} is allowed{sensor}")
        return values.astype(np.uint16)

    def polarity(self, values):
        """Polarities as uint8, 0 and 1."""
        if values.dtype.kind == "b":
            return values.astype(np.uint8)
        bad = ~np.isin(values, _CODES)
        if bad.any():
            k = int(bad.argmax())
            self._fail(k, f"polarity of {{event}} is {values[k]}; 0 and 1, or -1 and 1, are usual; 2 to 15 and 255 go")
        return ((values > self._off) & (values < _CODES[-1])).astype(np.uint8)


def highest_off(p):
    """The highest code of polarity that means darker, of the first codes: 1 of MATLAB's 1 and 2; otherwise 0."""
    return int(set(np.unique(p).tolist()) == {1, 2})


def polarity_notes(p):
    """What is said of unusual codes among the first polarities, as they stand in a file."""
    codes, counts = np.unique(p, return_counts=True)
    told = set(codes.tolist())
    if told <= {0, 1} or told <= {-1, 1} or not told <= {*_CODES}:  # the checks report others
        return []
    found = ", ".join(f"{code:g} ({count:,})" for code, count in zip(codes, counts, strict=True))
    beyond = f", but for {_CODES[-1]}," if codes[-1] == _CODES[-1] else ""
    return [
        f"polarities of the first {len(p):,} events: {found}; those above {highest_off(p)}{beyond} are taken as "
        "brighter (contrast needs none)"
    ]
