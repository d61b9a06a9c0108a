"""Models of what stands between the AXI4-Stream input and the core: decoders, gate and ends of batches, as in
:mod:`cmfpga.rtl.shell`."""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..protocol.word_format import (
    EVENT_TYPES,
    HIGH_BITS,
    LAST_COLUMN,
    LOW_BITS,
    OTHER_TYPES,
    OTHER_TYPES_3,
    TIME_BITS,
    TIME_HIGH,
    VECTORS,
    Evt3,
)

WHOLE = 0xFF


class Beat(NamedTuple):
    """A transfer on AXI4-Stream."""

    data: int  # 64 bits
    keep: int = WHOLE  # one bit for each byte
    last: bool = False


class Token(NamedTuple):
    """An event, the end of a packet, or both."""

    t: int
    x: int
    y: int
    known: bool  # there was a time word before
    event: bool
    end: bool


def to_beats(words, *, last=True):
    """Whole words as beats; TLAST with the last one, if ``last``."""
    words = [int(word) for word in words]
    return [Beat(word, WHOLE, last and k == len(words) - 1) for k, word in enumerate(words)]


class _Time:
    """High bits of EVT 2.x time stamps."""

    def __init__(self, counts):
        self.high, self.known, self.counts = 0, False, counts

    def load(self, high):
        half = 1 << (HIGH_BITS - 1)
        if self.known and (high - self.high) % (2 * half) >= half:
            self.counts["time_high_back"] += 1
        self.high, self.known = high, True

    def stamp(self, low):
        return self.high << LOW_BITS | low


def _count_type(kind, counts):
    counts["other_words" if kind in OTHER_TYPES else "format_errors"] += 1


def _evt21(beats, counts):
    time = _Time(counts)
    for beat in beats:
        vector, fields = beat.data & 0xFFFFFFFF, beat.data >> 32
        kind = fields >> 28
        found = []
        if beat.keep != WHOLE:
            counts["format_errors"] += beat.keep != 0
        elif kind in EVENT_TYPES:
            found = [k for k in range(32) if vector >> k & 1]
        elif kind == TIME_HIGH:
            time.load(fields & ((1 << HIGH_BITS) - 1))
        else:
            _count_type(kind, counts)
        t, x, y = time.stamp(fields >> 22 & 0x3F), fields >> 11 & 0x7FF, fields & 0x7FF
        for k in found:
            yield Token(t, x + k, y, time.known, True, beat.last and k == found[-1])
        if beat.last and not found:
            yield Token(0, 0, 0, False, False, True)


def _evt20(beats, counts):
    time = _Time(counts)
    for beat in beats:
        upper = beat.keep >> 4 != 0
        for half in range(1 + upper):
            word, keep = beat.data >> 32 * half & 0xFFFFFFFF, beat.keep >> 4 * half & 0xF
            kind, end = word >> 28, beat.last and half == upper
            event = False
            if keep != 0xF:
                counts["format_errors"] += keep != 0
            elif kind in EVENT_TYPES:
                event = True
                t = time.stamp(word >> 22 & 0x3F)
                yield Token(t, word >> 11 & 0x7FF, word & 0x7FF, time.known, True, end)
            elif kind == TIME_HIGH:
                time.load(word & ((1 << HIGH_BITS) - 1))
            else:
                _count_type(kind, counts)
            if end and not event:
                yield Token(0, 0, 0, False, False, True)


def _packed(beats, counts):
    for beat in beats:
        if beat.keep == WHOLE:
            word = beat.data
            yield Token(word >> 32, word & 0xFFFF, word >> 16 & 0x7FFF, True, True, beat.last)
            continue
        counts["format_errors"] += beat.keep != 0
        if beat.last:
            yield Token(0, 0, 0, False, False, True)


def _evt30(beats, counts):
    """As :class:`cmfpga.events.evt.EvtDecoder` does it, whose times never step back."""
    known, low, high, wraps, now, y, base = False, 0, 0, 0, 0, 0, 0
    mask, half = (1 << TIME_BITS) - 1, 1 << (TIME_BITS - 1)
    for beat in beats:
        final = max((k for k in range(4) if beat.keep >> 2 * k & 3), default=0)
        for k in range(final + 1):
            word, keep, found = beat.data >> 16 * k & 0xFFFF, beat.keep >> 2 * k & 3, []
            kind, value = word >> TIME_BITS, word & mask
            if keep != 3:
                counts["format_errors"] += keep != 0
            elif kind == TIME_HIGH:
                wraps += known and value < high - half
                counts["time_high_back"] += known and high - half <= value < high
                low, high, known = low if value == high else 0, value, True
            elif kind == Evt3.TIME_LOW:
                low = value if known else 0
            elif kind == Evt3.Y:
                y = value & 0x7FF
            elif kind in (Evt3.X, Evt3.BASE):
                base, found = value & 0x7FF, [value & 0x7FF] * (kind == Evt3.X)
            elif kind in VECTORS:
                found = [base + bit for bit in range(VECTORS[kind]) if value >> bit & 1]
                base = min(base + VECTORS[kind], LAST_COLUMN)
            else:
                counts["other_words" if kind in OTHER_TYPES_3 else "format_errors"] += 1
            now = max(now, (wraps << TIME_BITS | high) << TIME_BITS | low)
            end = beat.last and k == final
            for x in found:
                yield Token(now, x, y, known, True, end and x == found[-1])
            if end and not found:
                yield Token(0, 0, 0, False, False, True)


DECODERS = {"EVT21": _evt21, "EVT20": _evt20, "PACKED": _packed, "EVT30": _evt30}


def swap_beat(beat):
    """A beat with its 32-bit halves exchanged."""
    return Beat((beat.data & 0xFFFFFFFF) << 32 | beat.data >> 32, (beat.keep & 0xF) << 4 | beat.keep >> 4, beat.last)


def decode(config, beats, form, *, swap=False):
    """Tokens of a stream, and what was counted: ``(list of Token, Counter)``.

    Parameters
    ----------
    config : Config
        ``time_bits``: what is left of time stamps.
    beats : iterable of Beat
    form : str
        Key of :data:`cmfpga.protocol.registers.FORMATS`.
    swap : bool
        The halves of each word come exchanged.
    """
    counts = Counter(format_errors=0, other_words=0, time_high_back=0)
    beats = map(swap_beat, beats) if swap else beats
    mask = (1 << config.time_bits) - 1
    return [token._replace(t=token.t & mask) for token in DECODERS[form](beats, counts)], counts


def sensor_gate(config, tokens):
    """The tokens whose event lies on the sensor, and the ends of the others: ``(list of Token, Counter)``."""
    counts = Counter(events_in=0, before_time=0, out_of_sensor=0)
    passed = []
    for token in tokens:
        inside = token.x < config.sensor_width and token.y < config.sensor_height
        event = token.event and token.known and inside
        if token.event:
            counts["events_in"] += 1
            counts["before_time"] += not token.known
            counts["out_of_sensor"] += token.known and not inside
        if event or token.end:
            passed.append(token._replace(event=event))
    return passed, counts


@dataclass(frozen=True, kw_only=True)
class BatchEnds:
    """Where batches end; see the registers ``BATCH_EVENTS``, ``BATCH_DURATION`` and ``BATCH_TLAST``."""

    events: int = 0
    duration: int = 0
    by_tlast: bool = True


def split_batches(config, tokens, ends):
    """Tokens to batches.

    Parameters
    ----------
    config : Config
    tokens : iterable of Token
        As :func:`sensor_gate` passes them.
    ends : BatchEnds

    Returns
    -------
    batches : list of (t, x, y, cut)
        int64 arrays; ``cut`` where the batch, or slice, became as long as one may be.
    rest : list of (t, x, y)
        Events behind the last end.
    empty_ends : int
        Ends of packets without an event in the batch.
    """
    wrap, half = 1 << config.time_bits, 1 << (config.time_bits - 1)
    batches, batch, empty = [], [], 0
    completed = False  # the last token completed the number: an end that follows at once is that batch's

    def close(cut=False):
        columns = np.array(batch, np.int64).reshape(-1, 3).T
        batches.append((*columns, cut))
        batch.clear()

    for token in tokens:
        if token.event:
            if batch and ends.duration:
                since = (token.t - batch[0][0] + half) % wrap - half
                if not -ends.duration <= since < ends.duration:
                    close()
            batch.append((token.t, token.x, token.y))
            marked = token.end and ends.by_tlast
            completed = not marked and len(batch) in (ends.events, config.slice_events)
            if marked or completed:
                close(cut=not marked and len(batch) != ends.events)
        elif token.end and ends.by_tlast:
            if batch:
                close()
            else:
                empty += not completed
            completed = False
    return batches, batch, empty
