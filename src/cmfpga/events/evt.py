"""Words of Prophesee's EVT 2.0 and EVT 3.0 to columns of events, piece by piece as they come.

Formats: https://docs.prophesee.ai/stable/data/encoding_formats. What stands between the events (triggers, counters) is
skipped. Times never decrease: a word of time that steps back, as EVT 3.0 has them, leaves the time where it is.
"""

import numpy as np

# Types of words, in their four highest bits.
_EVT2_ON, _EVT2_TRIGGER = 0x1, 0xA
_Y, _X, _BASE, _VECTOR_12, _VECTOR_8, _LOW, _HIGH = 0x0, 0x2, 0x3, 0x4, 0x5, 0x6, 0x8


class EvtDecoder:
    """Keeps what words mean for those after them.

    Parameters
    ----------
    version : {"2.0", "3.0"}

    Members
    -------
    rest : bytes
        Of a word that has not come as a whole.
    """

    def __init__(self, version):
        self._decode, self._word = (self._evt2, "<u4") if version == "2.0" else (self._evt3, "<u2")
        self.word_bytes = np.dtype(self._word).itemsize
        self.rest = b""
        self._begun, self._high, self._wraps, self._t = False, 0, 0, 0
        self._state = [0, 0, 0]  # of EVT 3.0: low part of the time, word of y, word of the base

    def __call__(self, data):
        """``(t, x, y, p)`` of the next bytes, int64. Events before the first word of time's high part are left out."""
        data = self.rest + data
        whole = len(data) // self.word_bytes * self.word_bytes
        self.rest = data[whole:]
        words = np.frombuffer(data[:whole], self._word).astype(np.int64)
        if not self._begun:
            high = np.flatnonzero(words >> 8 * self.word_bytes - 4 == _HIGH)
            words, self._begun = words[high[0] if len(high) else len(words) :], len(high) > 0
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

    def _evt2(self, words):
        kind = words >> 28
        high = _last(kind == _HIGH, words & 0xFFFFFFF, self._high)
        at = np.flatnonzero(kind <= _EVT2_ON)
        # The low part stands in each event, and in each trigger.
        t = self._times(high, np.where((kind <= _EVT2_ON) | (kind == _EVT2_TRIGGER), words >> 22 & 0x3F, 0), 28, 6)
        return t[at], words[at] >> 11 & 0x7FF, words[at] & 0x7FF, kind[at]

    def _evt3(self, words):
        kind, value = words >> 12, words & 0xFFF
        low, y, base = self._state
        high = _last(kind == _HIGH, value, self._high)
        # A new high part begins at low part 0.
        turns = np.diff(high, prepend=self._high) != 0
        low = _last((kind == _LOW) | turns, np.where(turns, 0, value), low)
        t = self._times(high, low, 12, 12)
        y = _last(kind == _Y, value, y)
        # The base goes on behind each vector; its polarity is bit 11 of the word that set it.
        step = np.select([kind == _VECTOR_12, kind == _VECTOR_8], [12, 8], 0)
        passed = np.cumsum(step)
        sets = (kind == _BASE) | (kind == _X)
        start = _last(sets, passed, 0)
        base = _last(sets, value, base)
        column = (base & 0x7FF) + passed - step - start

        single = np.flatnonzero(kind == _X)
        vectors = np.flatnonzero(step)
        bits = value[vectors, None] >> np.arange(12) & (np.arange(12) < step[vectors, None])
        row, bit = np.nonzero(bits)
        at = np.concatenate([single, vectors[row]])
        x = np.concatenate([value[single] & 0x7FF, column[vectors[row]] + bit])
        p = np.concatenate([value[single] >> 11, base[vectors[row]] >> 11])
        order = np.argsort(at, kind="stable")
        at = at[order]
        if len(words):
            self._state = [int(low[-1]), int(y[-1]), int(base[-1] & 0x800) | int(column[-1] + step[-1]) & 0x7FF]
        return t[at], x[order], y[at] & 0x7FF, p[order]


def _last(there, values, before):
    """For each word the value of the last one for which ``there`` holds, up to it; ``before`` where there is none."""
    at = np.maximum.accumulate(np.where(there, np.arange(len(values)), -1))
    return np.where(at < 0, before, values[at]) if len(values) else values
