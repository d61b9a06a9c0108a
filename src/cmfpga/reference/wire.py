"""Models of what stands between the AXI4-Stream input and the core: decoders, gate and ends of batches, as in
:mod:`cmfpga.rtl.shell`."""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..protocol import word_format

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
    return [Beat(int(word), last=last and k == len(words) - 1) for k, word in enumerate(words)]


class _Evt2:
    """EVT 2.1, and EVT 2.0, of which a word is the upper half of one of EVT 2.1 with a single event."""

    def __init__(self, bits):
        self.bits, self.high, self.known = bits, 0, False

    def events(self, word, counts):
        """``(t, x, y, known)`` of each event in a word; ``counts`` grow by what it is otherwise."""
        vector, fields = (word & 0xFFFFFFFF, word >> 32) if self.bits == 64 else (1, word)
        kind, high = fields >> 28, fields & ((1 << word_format.HIGH_BITS) - 1)
        if kind in word_format.EVENT_TYPES:
            t, x, y = self.high << word_format.LOW_BITS | fields >> 22 & 0x3F, fields >> 11 & 0x7FF, fields & 0x7FF
            return [(t, x + k, y, self.known) for k in range(32) if vector >> k & 1]
        if kind == word_format.TIME_HIGH:
            half = 1 << (word_format.HIGH_BITS - 1)
            counts["time_high_back"] += self.known and (high - self.high) % (2 * half) >= half
            self.high, self.known = high, True
        else:
            counts["other_words" if kind in word_format.OTHER_TYPES else "format_errors"] += 1
        return []


class _Packed:
    """An event in each word."""

    bits = 64

    def events(self, word, counts):
        return [(word >> 32, word & 0xFFFF, word >> 16 & 0x7FFF, True)]


class _Evt3:
    """As :class:`cmfpga.events.evt.EvtDecoder` does it, whose times never step back."""

    bits = 16

    def __init__(self):
        self.known, self.low, self.high, self.wraps, self.now, self.y, self.base = False, 0, 0, 0, 0, 0, 0

    def events(self, word, counts):
        columns, half = [], 1 << (word_format.TIME_BITS - 1)
        kind, value = word >> word_format.TIME_BITS, word & ((1 << word_format.TIME_BITS) - 1)
        if kind == word_format.TIME_HIGH:
            self.wraps += self.known and value < self.high - half
            counts["time_high_back"] += self.known and self.high - half <= value < self.high
            self.low, self.high, self.known = self.low if value == self.high else 0, value, True
        elif kind == word_format.Evt3.TIME_LOW:
            self.low = value if self.known else 0
        elif kind == word_format.Evt3.Y:
            self.y = value & 0x7FF
        elif kind in (word_format.Evt3.X, word_format.Evt3.BASE):
            self.base, columns = value & 0x7FF, [value & 0x7FF] * (kind == word_format.Evt3.X)
        elif kind in word_format.VECTORS:
            columns = [self.base + bit for bit in range(word_format.VECTORS[kind]) if value >> bit & 1]
            self.base = min(self.base + word_format.VECTORS[kind], word_format.LAST_COLUMN)
        else:
            counts["other_words" if kind in word_format.OTHER_TYPES_3 else "format_errors"] += 1
        self.now = max(self.now, (self.wraps << word_format.TIME_BITS | self.high) << word_format.TIME_BITS | self.low)
        return [(self.now, x, self.y, self.known) for x in columns]


DECODERS = {"EVT21": partial(_Evt2, 64), "EVT20": partial(_Evt2, 32), "PACKED": _Packed, "EVT30": _Evt3}


def _tokens(beats, decoder, counts):
    size = decoder.bits // 8
    whole = (1 << size) - 1
    for beat in beats:
        # Behind a beat's last byte there are no words; a beat without bytes has an end.
        last = max((k for k in range(8 // size) if beat.keep >> size * k & whole), default=0)
        for k in range(last + 1):
            keep, end, found = beat.keep >> size * k & whole, beat.last and k == last, []
            if keep == whole:
                found = decoder.events(beat.data >> decoder.bits * k & ((1 << decoder.bits) - 1), counts)
            else:
                counts["format_errors"] += keep != 0
            for number, event in enumerate(found, 1):
                yield Token(*event, True, end and number == len(found))
            if end and not found:
                yield Token(0, 0, 0, False, False, True)


def swap_beat(beat):
    """A beat with its 32-bit halves exchanged."""
    return Beat((beat.data & 0xFFFFFFFF) << 32 | beat.data >> 32, (beat.keep & 0xF) << 4 | beat.keep >> 4, beat.last)


def decode(config, beats, form, *, swap=False):
    """Tokens of a stream of beats, and what was counted: ``(list of Token, Counter)``.

    ``form`` is a key of :data:`cmfpga.protocol.registers.FORMATS`. With ``swap`` each word's halves come exchanged.
    """
    counts = Counter(format_errors=0, other_words=0, time_high_back=0)
    beats = map(swap_beat, beats) if swap else beats
    mask = (1 << config.time_bits) - 1
    tokens = _tokens(beats, DECODERS[form](), counts)
    return [token._replace(t=token.t & mask) for token in tokens], counts


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
    """Tokens, as :func:`sensor_gate` passes them, to ``(batches, rest, empty_ends)``.

    ``batches`` are (t, x, y, cut), int64 arrays, ``cut`` where the batch, or slice, became as long as one may be.
    ``rest`` are (t, x, y) of the events after the last end. ``empty_ends`` counts ends of packets without an event in
    the batch.
    """
    wrap, half = 1 << config.time_bits, 1 << (config.time_bits - 1)
    batches, batch, empty = [], [], 0
    completed = False  # the last token completed the number: an end that follows at once is that batch's

    def close(cut=False):
        batches.append((*np.array(batch, np.int64).T, cut))
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
