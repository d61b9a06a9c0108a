"""Recordings that can only be read from their begin, in pieces of any size: text, and the cameras' own formats."""

import abc
import contextlib

import numpy as np

from ..errors import RecordingError
from .recording import Recording
from .units import to_us

#: Decoded at a time.
RECORDS = 1 << 16


class Truncated(Exception):
    """A file ends too early; the message says what there is of its last part."""


class StreamedRecording(Recording):
    """A recording whose columns come in pieces; how many events there are is only known at the end.

    A file that ends too early, or is damaged somewhere, still gives all events before that place: the error comes after
    them. An iteration that starts at a later event reads all that comes before it.
    """

    #: Whether reading all of it takes little time, beside all that is done with its events.
    fast = True
    #: Events ahead of the first word of EVT's time that were met.
    _early = 0

    def __init__(self, path, format, *, sensor, time_unit, name=None):
        super().__init__(
            path=path, name=name or str(path), format=format, sensor=sensor, num_events=None,
            time_unit=time_unit or "us", time_unit_source="given" if time_unit else "file",
        )  # fmt: skip

    def extent(self):
        """As of any recording; where the file is damaged, up to there."""
        if not self.fast:
            return None
        count, last = 0, 0
        with contextlib.closing(self._pieces()) as pieces, contextlib.suppress(RecordingError):
            for t, *_ in pieces:
                count, last = count + len(t), int(t[-1])
        return count, last

    def notes(self):
        early = [f"{self.name}: {self._early:,} events ahead of the first time word have no time: they are left out"]
        return [*super().notes(), *early * bool(self._early)]

    def _stored(self):
        """Yields ``(t, x, y, p)``, t int64 in the recording's unit, others as stored. Raises :exc:`Truncated`."""
        raise NotImplementedError

    def _pieces(self):
        """Yields ``(t, x, y, p)`` of one or more events: t int64 in µs, others as stored."""
        count = 0
        try:
            for t, *others in self._stored():
                if len(t):
                    yield to_us(t, self.time_unit, self.name, count), *others
                    count += len(t)
        except Truncated as error:
            raise RecordingError(f"{self.name}: truncated: {error}; the {count} events before were read") from None

    def _columns(self, start, size):
        kept, count, total, broken = [], 0, 0, None
        with contextlib.closing(self._pieces()) as pieces:
            try:
                for columns in pieces:
                    length = len(columns[0])
                    skip = min(max(start - total, 0), length)
                    total, count = total + length, count + length - skip
                    if skip < length:
                        kept.append([column[skip:] for column in columns])
                    if count < size:
                        continue
                    joined = _join(kept)
                    # As many chunks as there are, then keep the rest: each event is copied once.
                    for at in range(0, count - size + 1, size):
                        yield [column[at : at + size] for column in joined]
                    rest = count % size
                    kept = [[column[count - rest :] for column in joined]] if rest else []
                    count = rest
            except RecordingError as error:
                broken = error
        if broken is None and total <= start:
            raise self._start_error(start, total)
        if count:
            yield _join(kept)
        if broken is not None:
            raise broken

    def _require_events(self):
        """Raises :exc:`RecordingError` if there are none, or if not even the first can be read."""
        with contextlib.closing(self._pieces()) as pieces:
            if next(pieces, None) is None:
                raise RecordingError(f"{self.name}: no events")


class RecordsRecording(StreamedRecording):
    """A recording of records of one size behind a header of ``begin`` bytes, with times of few bits, which wrap."""

    record_bytes: int
    time_bits: int

    def __init__(self, path, format, *, begin=0, sensor, time_unit):
        self._begin = begin
        super().__init__(path, format, sensor=sensor, time_unit=time_unit)
        self._require_events()

    @abc.abstractmethod
    def _decode(self, content):
        """``(t, x, y, p)`` of whole records, int64; t as it stands there."""

    def _stored(self):
        wraps, last = 0, 0
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while content := file.read(RECORDS * self.record_bytes):
                rest = len(content) % self.record_bytes
                t, *others = self._decode(content[: len(content) - rest])
                if len(t):
                    # Half the range back is a wrap; less is a step back, which the checks report.
                    back = np.diff(t, prepend=last) < -(1 << self.time_bits - 1)
                    last = int(t[-1])
                    yield t + (wraps + np.cumsum(back) << self.time_bits), *others
                    wraps += int(back.sum())
                if rest:
                    raise Truncated(f"{rest} of {self.record_bytes} bytes of the last record are there")


def _join(parts):
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]
