"""Words of Prophesee's EVT 2.0, 2.1 and 3.0 to columns of events, piece by piece as they come: of files and streams.

Formats: https://docs.prophesee.ai/stable/data/encoding_formats. What stands between the events (triggers, counters) is
skipped. Times never decrease: a word of time that steps back, as EVT 3.0 has them, leaves the time where it is. Events
ahead of the first word of time's high part have no time: they are left out, and counted.
"""

import numpy as np

from ..protocol.word_format import COLUMN_BITS, EVENT_TYPES, HIGH_BITS, LOW_BITS, TIME_BITS, TIME_HIGH, VECTORS, Evt3

#: Words of time so close, µs, are never left out; how many of the next ones judge others, and how close to the last
#: one these are, µs; words that wait for them.
_NEAR_US, _JUDGES, _GOES_ON_US, _MOST_HELD = 4096, 7, 1_000_000, 1 << 18

#: Bytes of a word of each version; the legacy order of EVT 2.1 has the upper half of a word first.
WORD_BYTES = {"2.0": 4, "2.1": 8, "2.1 legacy": 8, "3.0": 2}


class EvtDecoder:
    """Keeps what words mean for those after them; ``version`` is a key of :data:`WORD_BYTES`.

    ``rest`` has the bytes of a word that has not come as a whole; ``early`` counts events that came ahead of the first
    word of time. The time of an event outside ``sensor``, (width, height) in px, counts for no other, as in the
    hardware.
    """

    def __init__(self, version, sensor=None):
        self.word_bytes, self._sensor = WORD_BYTES[version], sensor or (1 << COLUMN_BITS, 1 << COLUMN_BITS)
        self._decode = {"2.0": self._evt20, "3.0": self._evt3}.get(version, self._evt21)
        self._upper = int(version == "2.1")  # which half of a word of EVT 2.1 holds its type
        self.rest, self.early = b"", 0
        self._begun, self._high, self._wraps, self._t = False, 0, 0, 0
        self._state = [0, 0, 0, 0]  # of EVT 3.0: low part of the time, word of y, word and column of the base

    def _words(self, data):
        """Whole words of what was left and the next bytes."""
        data = self.rest + data
        whole = len(data) // self.word_bytes * self.word_bytes
        self.rest = data[whole:]
        return np.frombuffer(data[:whole], "<u2" if self.word_bytes == 2 else "<u4")

    def skip(self, data):
        """The number of events of the next bytes, which are left out; those after them are as if all had been decoded.

        Of EVT 3.0 it is several times faster than decoding them. Its times must rise.
        """
        if not self._begun or self.word_bytes != 2:
            return len(self(data)[0])
        words = self._words(data)
        kind = words >> 12
        count = int(np.count_nonzero(kind == Evt3.X))
        for vector, columns in VECTORS.items():
            count += int(np.bitwise_count(words[kind == vector] & (1 << columns) - 1).sum())
        # What the next words build on: each new high part, the last low part and row, and all since the last column.
        kept = np.zeros(len(words), bool)
        high = np.flatnonzero(kind == TIME_HIGH)
        kept[high[np.diff(words[high], prepend=0) != 0]] = True
        for last in (Evt3.TIME_LOW, Evt3.Y):
            kept[np.flatnonzero(kind == last)[-1:]] = True
        column = np.flatnonzero((kind == Evt3.BASE) | (kind == Evt3.X))
        kept[column[-1] if len(column) else 0 :] = True
        self._evt3(words[kept, None].astype(np.int64))
        return count

    def __call__(self, data):
        """``(t, x, y, p)`` of the next bytes, int64."""
        words = self._words(data).astype(np.int64).reshape(-1, self.word_bytes // 4 or 1)
        if not self._begun:
            kind = words[:, self._upper % words.shape[1]] >> (12 if self.word_bytes == 2 else 28)
            high = np.flatnonzero(kind == TIME_HIGH)
            begin = high[0] if len(high) else len(words)
            self.early += len(self._decode(words[:begin])[0])
            words, self._begun = words[begin:], len(high) > 0
            self._t = self._state[0] = 0  # what they left of a time
        return self._decode(words)

    def _times(self, high, low, high_bits, low_bits):
        """The time at each word, of its high and low part; a high part that falls by half its range has wrapped."""
        if not len(high):
            return high
        wraps = self._wraps + np.cumsum(np.diff(high, prepend=self._high) < -(1 << high_bits - 1))
        t = np.maximum.accumulate(((wraps << high_bits) + high << low_bits) + low)
        t = np.maximum(t, self._t)
        self._high, self._wraps, self._t = int(high[-1]), int(wraps[-1]), int(t[-1])
        return t

    def _evt2(self, fields):
        """``(t, x, y, p)`` of the words of events, and which these are, of EVT 2.x words without their vectors."""
        kind = fields >> 28
        event = kind <= max(EVENT_TYPES)
        high = _last(kind == TIME_HIGH, fields & (1 << HIGH_BITS) - 1, self._high)
        x, y = fields >> COLUMN_BITS & (1 << COLUMN_BITS) - 1, fields & (1 << COLUMN_BITS) - 1
        inside = event & (x < self._sensor[0]) & (y < self._sensor[1])
        low = np.where(inside, fields >> 22 & (1 << LOW_BITS) - 1, 0)
        t, at = self._times(high, low, HIGH_BITS, LOW_BITS), np.flatnonzero(event)
        return at, t[at], x[at], y[at], kind[at]

    def _evt20(self, words):
        return self._evt2(words[:, 0])[1:]

    def _evt21(self, words):
        """Each bit of a word's vector is an event, the lowest one at x."""
        at, t, x, y, p = self._evt2(words[:, self._upper])
        word, bit = _bits(words[at, 1 - self._upper], "<u4")
        return t[word], x[word] + bit, y[word], p[word]

    def _evt3(self, words):
        words = words[:, 0]
        kind, value = words >> 12, words & 0xFFF
        low, y, base, column = self._state
        high = _last(kind == TIME_HIGH, value, self._high)
        # A new high part begins at low part 0.
        turns = np.diff(high, prepend=self._high) != 0
        low = _last((kind == Evt3.TIME_LOW) | turns, np.where(turns, 0, value), low)
        t = self._times(high, low, 12, 12)
        y = _last(kind == Evt3.Y, value, y)
        # The base goes on behind each vector; its polarity is bit 11 of the word that set it.
        step = np.select([kind == vector for vector in VECTORS], [*VECTORS.values()], 0)
        passed = np.cumsum(step)
        sets = (kind == Evt3.BASE) | (kind == Evt3.X)
        start = _last(sets, passed, 0)
        base, column = _last(sets, value, base), _last(sets, value & 0x7FF, column) + passed - step - start

        # A single event is a vector of one bit, at its own column.
        at = np.flatnonzero((step > 0) | (kind == Evt3.X))
        word, bit = _bits(np.where(kind[at] == Evt3.X, 1, value[at] & (1 << step[at]) - 1), "<u2")
        if len(words):
            self._state = [int(low[-1]), int(y[-1]), int(base[-1]), int(column[-1] + step[-1])]
        at = at[word]
        return t[at], column[at] + bit, y[at] & 0x7FF, base[at] >> 11


class TimeWords:
    """Leaves out words of time that those around them contradict; a stream's go on as if they had never come.

    A word that is further than :data:`_NEAR_US` from the last one is left out where two of the next :data:`_JUDGES`
    go on from the last one, and are nearer to that than to it. What follows it waits for them. ``wrong`` counts words
    that were left out.
    """

    def __init__(self, version):
        self.wrong, self._bytes, self._rest, self._last = 0, WORD_BYTES[version], b"", None
        self._upper = int(version == "2.1")
        self._bits, low_bits = (TIME_BITS, TIME_BITS) if version == "3.0" else (HIGH_BITS, LOW_BITS)
        self._near, self._goes_on = _NEAR_US >> low_bits, _GOES_ON_US >> low_bits

    def _apart(self, one, other):
        """How far two high parts, which wrap, are from each other; positive where the other is later."""
        half = 1 << self._bits - 1
        return (other - one + half & 2 * half - 1) - half

    def __call__(self, data, last=False):
        """What is left of the bytes so far, without those that wait; with the ``last`` bytes, of all."""
        data = self._rest + data
        whole = len(data) // self._bytes * self._bytes
        words = np.frombuffer(data[:whole], f"<u{min(self._bytes, 4)}").reshape(-1, self._bytes // 4 or 1)
        heads, shift = words[:, self._upper % words.shape[1]], 12 if self._bytes == 2 else 28
        at = np.flatnonzero(heads >> shift == TIME_HIGH)
        high = (heads[at] & (1 << shift) - 1).astype(np.int64)
        until, out = self._judge(high, last)
        hold = int(at[until]) if until < len(at) and len(words) - at[until] < _MOST_HELD else len(words)
        rest, self.wrong = data[hold * self._bytes :], self.wrong + len(out)
        self._rest = b"" if last else rest
        return np.delete(words[:hold], at[out], axis=0).tobytes() + rest * last

    def _judge(self, high, ended):
        """Of high parts how many are judged, and the numbers of those that are left out."""
        far = np.flatnonzero(abs(self._apart(high[:-1], high[1:])) > self._near) + 1
        k, out = 0, []
        while k < len(high):
            word, after, last = int(high[k]), high[k + 1 : k + 1 + _JUDGES].tolist(), self._last
            if last is None:  # of the first word, which the second one may be ahead of
                if not (after or ended):
                    break
                last = after[0] if after and self._apart(word, after[0]) < 0 else word
            if abs(self._apart(last, word)) > self._near:
                apart = [(abs(self._apart(last, other)), abs(self._apart(word, other))) for other in after]
                against = [here < min(there, self._goes_on) for here, there in apart]
                if against.count(True) > (not ended):
                    out.append(k)
                    k += 1
                    continue
                if against.count(False) < _JUDGES - 1 and not ended:
                    break
            k = int(next(iter(far[np.searchsorted(far, k, "right") :]), len(high)))
            self._last = int(high[k - 1])
        return k, out


def _bits(vectors, form):
    """``(index of the vector, number of the bit)`` of each bit that is set, in order."""
    vectors = vectors.astype(form)
    found = np.flatnonzero(np.unpackbits(vectors.view(np.uint8), bitorder="little").view(bool))
    return np.divmod(found, 8 * vectors.itemsize)


def _last(there, values, before):
    """For each word the value of the last one for which ``there`` holds, up to it; ``before`` where there is none."""
    return np.concatenate([[before], values[there]])[np.cumsum(there)]
