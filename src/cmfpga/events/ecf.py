"""ECF, the compression of events in Prophesee's HDF5 files: filter 0x8ECF, which HDF5 itself does not have.

A chunk begins with its number of events and how they are packed, 4 bytes, and its first time, 8 bytes; all is
little-endian. Times follow as runs: a byte of 4 bits for the step since the last time, and 4 bits for how many events
have it (15: a word of 16 bits says how many). Where the first 4 bits are 15, the others of such bytes are a larger
step, lowest first. Then one of

- 24 bits an event, of y, x (11 bits each) and p, four events in three words of 32 bits;
- runs of y (11 bits, and 5 for how many; 31: the next word says), and 12 bits an event of x and p, four events in three
  words of 16 bits;
- runs of y; x as 11 bits, and a bit for each of the 5 pixels to the right of it that has an event too; runs of p.

Format: https://github.com/prophesee-ai/hdf5_ecf.
"""

import numpy as np

#: Of HDF5's filter.
FILTER = 0x8ECF

DTYPE = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")], align=True)

_PACKED_YXP, _PACKED_XP = 2, 1
_MAX_EVENTS = (1 << 16) - 1


class EcfError(Exception):
    """A chunk is damaged."""


def decode(data):
    """The events of a chunk (bytes), as a structured array of :data:`DTYPE`. Raises :exc:`EcfError`."""
    try:
        return _decode(data)
    except (IndexError, OverflowError, ValueError) as error:
        raise EcfError(f"ECF: damaged chunk of {len(data)} bytes: {error}") from None


def _decode(data):
    head = int.from_bytes(data[:4], "little")
    count = head >> 2
    if count > _MAX_EVENTS or len(data) < 12:
        raise ValueError(f"{count} events")
    events = np.zeros(count, DTYPE)
    events["t"], at = _times(data, count)
    if head & _PACKED_YXP:
        a, b, c = _words(data, at, "<u4", count)
        packed = np.stack([a >> 8, a & 0xFF | b >> 16 << 8, b & 0xFFFF | c >> 24 << 16, c & 0xFFFFFF], axis=1)
        packed = packed.ravel()[:count]
        events["y"], events["x"], events["p"] = packed >> 12 & 0x7FF, packed >> 1 & 0x7FF, packed & 1
        return events
    events["y"], at = _runs(data, at, count, size=2, bits=5)
    if head & _PACKED_XP:
        a, b, c = _words(data, at, "<u2", count)
        packed = np.stack([a >> 4, a & 0xF | b >> 8 << 4, b & 0xFF | c >> 12 << 8, c & 0xFFF], axis=1).ravel()[:count]
        events["x"], events["p"] = packed >> 1, packed & 1
        return events
    words = np.frombuffer(data[at : at + (len(data) - at) // 2 * 2], "<u2")
    there = np.concatenate([np.ones((len(words), 1), bool), (words[:, None] >> np.arange(4, -1, -1) & 1) > 0], axis=1)
    ends = np.cumsum(there.sum(axis=1))
    used = np.searchsorted(ends, count) + 1
    columns = ((words[:used, None] >> 5) + np.arange(6))[there[:used]]
    events["x"] = columns[:count]
    events["p"], _ = _runs(data, at + 2 * int(used), count, size=1, bits=7)
    return events


def _times(data, count):
    """``count`` times from byte 4 on, and where the next part begins."""
    t, at, left = int.from_bytes(data[4:12], "little"), 12, count
    times, lengths = [], []
    while left > 0:
        step, run = divmod(data[at], 16)
        at += 1
        if step == 15:
            shift = 4
            while data[at] >> 4 == 15:
                run |= (data[at] & 15) << shift
                at, shift = at + 1, shift + 4
            t += run
            continue
        t += step
        if run == 15:
            run, at = int.from_bytes(data[at : at + 2], "little"), at + 2
        times.append(t)
        lengths.append(run)
        left -= run
    return np.repeat(np.array(times, np.int64), lengths), at


def _runs(data, at, count, *, size, bits):
    """``count`` values in runs of words of ``size`` bytes whose low ``bits`` say how many; and the part's end."""
    values, lengths, most = [], [], (1 << bits) - 1
    while count > 0:
        word, at = int.from_bytes(data[at : at + size], "little"), at + size
        run = word & most
        if run == most:
            run, at = int.from_bytes(data[at : at + 2], "little"), at + 2
        if not run:
            raise ValueError("an empty run")
        values.append(word >> bits)
        lengths.append(run)
        count -= run
    return np.repeat(np.array(values, np.int64), lengths), at


def _words(data, at, dtype, count):
    """Three columns of words that hold four events each."""
    size = -(-count // 4) * 3 * np.dtype(dtype).itemsize
    return np.frombuffer(data[at : at + size], dtype).reshape(-1, 3).T.astype(np.int64)


class EcfDataset:
    """An HDF5 data set of events, as an array that can be sliced: its chunks are read as they are, and decoded here."""

    def __init__(self, dataset):
        self._dataset, self.shape, self.dtype, self._last = dataset, dataset.shape, DTYPE, (None, None)

    def __getitem__(self, index):
        start, stop, _ = index.indices(self.shape[0])
        size = self._dataset.chunks[0]
        parts = [self._chunk(first) for first in range(start // size * size, stop, size)]
        begin = start % size
        return np.concatenate([np.zeros(0, DTYPE), *parts])[begin : begin + stop - start]

    def _chunk(self, first):
        if self._last[0] != first:
            _, data = self._dataset.id.read_direct_chunk((first,))
            events = decode(data)
            if len(events) < min(self._dataset.chunks[0], self.shape[0] - first):
                raise EcfError(f"ECF: the chunk of event {first} holds {len(events)} events")
            self._last = first, events
        return self._last[1]


def is_compressed(dataset):
    """Whether an h5py data set is compressed in this way."""
    filters = dataset.id.get_create_plist()
    return any(filters.get_filter(k)[0] == FILTER for k in range(filters.get_nfilters()))
