"""Recordings that can only be read from their begin, in pieces of any size: text, and the cameras' own formats."""

import abc
import contextlib

import numpy as np

from ..errors import RecordingError
from .recording import Recording
from .units import to_us

#: Decoded at a time.
RECORDS = 1 << 16


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
        pieces = self._pieces()
        with contextlib.closing(pieces), contextlib.suppress(RecordingError):
            for t, *_ in pieces:
                count, last = count + len(t), int(t[-1])
        return count, last

    def notes(self):
        early = [f"{self.name}: {self._early:,} events ahead of the first time word have no time: they are left out"]
        return [*super().notes(), *early * bool(self._early)]

    @abc.abstractmethod
    def _pieces(self):
        """Yields ``(t, x, y, p)`` of one or more events: t int64 in µs, others as stored."""

    def _columns(self, start, size):
        kept, count, total = [], 0, 0
        pieces = self._pieces()
        try:
            while True:
                broken = None
                try:
                    columns = next(pieces, None)
                except RecordingError as error:
                    columns, broken = None, error
                if columns is None:
                    break
                length = len(columns[0])
                skip = min(max(start - total, 0), length)
                total += length
                if skip == length:
                    continue
                kept.append([column[skip:] for column in columns])
                count += length - skip
                if count < size:
                    continue
                joined = _join(kept)
                # As many chunks as there are, then keep the rest: each event is copied once.
                for at in range(0, count - size + 1, size):
                    yield [column[at : at + size] for column in joined]
                rest = count % size
                kept = [[column[count - rest :] for column in joined]] if rest else []
                count = rest
        finally:
            pieces.close()
        if broken is None and total <= start:
            raise self._start_error(start, total)
        if count:
            yield _join(kept)
        if broken is not None:
            raise broken

    def _require_events(self):
        """Raises :exc:`RecordingError` if there are none, or if not even the first can be read."""
        pieces = self._pieces()
        try:
            if next(pieces, None) is None:
                raise RecordingError(f"{self.name}: no events")
        finally:
            pieces.close()


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

    def _pieces(self):
        wraps, last, count = 0, 0, 0
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while content := file.read(RECORDS * self.record_bytes):
                rest = len(content) % self.record_bytes
                t, *others = self._decode(content[: len(content) - rest])
                if len(t):
                    # Half the range back is a wrap; less is a step back, which the checks report.
                    back = np.diff(t, prepend=last) < -(1 << self.time_bits - 1)
                    last = int(t[-1])
                    t = t + (wraps + np.cumsum(back) << self.time_bits)
                    wraps += int(back.sum())
                    yield to_us(t, self.time_unit, self.name, count), *others
                    count += len(t)
                if rest:
                    raise RecordingError(
                        f"{self.name}: truncated: {rest} of {self.record_bytes} bytes of the last record are there; "
                        f"the {count} events before were read"
                    )


def _join(parts):
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]
