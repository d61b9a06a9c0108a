"""The 64-bit words on the wires of the AXI top: events to words, result packets to values.

Four kinds of event words, little-endian in memory, chosen by the register ``INPUT.FORMAT``:

``EVT21`` (Prophesee EVT 2.1)
    64-bit vectors: type [63:60] (0: darker, 1: brighter), time [59:54], column [53:43], row [42:32], and 32 bits
    [31:0]: bit k is an event at column + k. A word of type 8 gives the time's 28 high bits [59:32] for all that follow.
``EVT20`` (Prophesee EVT 2.0)
    Two 32-bit words in each 64-bit word, the lower one first: type [31:28], time [27:22], column [21:11], row [10:0],
    or with type 8 the time's high bits [27:0].
``EVT30`` (Prophesee EVT 3.0; hardware with ``evt3``)
    Four 16-bit words in each 64-bit word, the lowest first, of a type [15:12] and a value [11:0]: time's high part (8)
    and low part (6), row (0), an event's column [10:0] and polarity [11] (2), those of a vector's first column (3), and
    vectors of 12 (4) or 8 (5) columns, each of which begins where the one before ended.
``PACKED`` (our own)
    One event: time [63:32], polarity [31], row [30:16], column [15:0]. In C a struct of ``uint16_t x, y; uint32_t t``.

Layouts of the first three as in Prophesee's documentation (https://docs.prophesee.ai, "EVT 2.0 Format", …).
Time stamps are in µs and wrap: after 34 bits in EVT 2.x, after 32 bits in packed words. Those of EVT 3.0 have 24 bits,
and a decoder counts how often they wrapped since its reset.
"""

import re
from pathlib import Path

import numpy as np

from ..errors import RecordingError
from .registers import FORMATS
from .word_format import COLUMN_BITS, HIGH_BITS, LOW_BITS, TIME_BITS, TIME_HIGH, Evt3


def encode(events, form, *, swap=False):
    """Words of ``events`` in the order in which they stand: uint64 array, what a DMA sends.

    ``events`` have integer arrays ``t``, ``x``, ``y`` and ``p``; ``form`` is a key of
    :data:`cmfpga.protocol.registers.FORMATS`. With ``swap`` the 32-bit halves of each word are exchanged, as an IMX636
    does. Raises :exc:`ValueError` where a coordinate does not fit the format, or EVT 3.0 has no words for the times.
    """
    encoders = {"EVT21": encode_evt21, "EVT20": encode_evt20, "PACKED": encode_packed, "EVT30": encode_evt30}
    if form not in encoders:
        raise ValueError(f"format {form!r}: one of {', '.join(FORMATS)} is needed")
    words = encoders[form](events.t, events.x, events.y, events.p)
    return swap_halves(words) if swap else words


def swap_halves(words):
    """Each 64-bit word with its 32-bit halves exchanged."""
    words = np.asarray(words, np.uint64)
    return (words << np.uint64(32)) | (words >> np.uint64(32))


def encode_packed(t, x, y, p):
    """Packed words (see the module): uint64 array, one an event."""
    t, x, y, p = _columns(t, x, y, p, ("column", 16), ("row", 15))
    return ((t & 0xFFFFFFFF) << 32 | p << 31 | y << 16 | x).view(np.uint64)


def encode_evt20(t, x, y, p):
    """EVT 2.0, two to a 64-bit word: uint64 array. An odd one is followed by its time word once more."""
    t, x, y, p = _columns(t, x, y, p, ("column", COLUMN_BITS), ("row", COLUMN_BITS))
    if not len(t):
        return np.zeros(0, np.uint64)
    high, low = _split_time(t)
    words = _with_time_words(p << 28 | low << 22 | x << 11 | y, high, TIME_HIGH << 28 | high)
    if len(words) % 2:
        words = np.append(words, TIME_HIGH << 28 | high[-1])
    return words.astype("<u4").view("<u8").astype(np.uint64)


def encode_evt21(t, x, y, p):
    """EVT 2.1 vectors: uint64 array.

    Neighbours become one vector where they differ in the column alone, and increase within 32 columns that begin at a
    multiple of 32: so the order stays.
    """
    t, x, y, p = _columns(t, x, y, p, ("column", COLUMN_BITS), ("row", COLUMN_BITS))
    if not len(t):
        return np.zeros(0, np.uint64)
    same = (np.diff(t) == 0) & (np.diff(y) == 0) & (np.diff(p) == 0) & (np.diff(x >> 5) == 0) & (np.diff(x) > 0)
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    vectors = np.bitwise_or.reduceat(np.left_shift(1, x & 31), starts)
    high, low = _split_time(t[starts])
    words = (p << 60 | y << 32)[starts] | (x[starts] & ~31) << 43 | low << 54 | vectors
    return _with_time_words(words.view(np.uint64), high, (np.uint64(TIME_HIGH << 60) | high.astype(np.uint64) << 32))


def encode_evt30(t, x, y, p):
    """EVT 3.0, four to a 64-bit word: uint64 array, for a decoder after a reset.

    Neighbours that differ in the column alone, and increase by less than 12, become vectors where that saves words.
    Time's high parts lead from 0 to times modulo 2^32 in steps that a decoder can tell from those back. The last time
    word once more fills a 64-bit word up.
    """
    t, x, y, p = _columns(t, x, y, p, ("column", COLUMN_BITS), ("row", COLUMN_BITS))
    if not len(t):
        return np.zeros(0, np.uint64)
    if (np.diff(t) < 0).any() or t[-1] - t[0] >= 1 << 32:
        raise ValueError("times that step back, or by 2^32 µs and more: EVT 3.0 has no words for them")
    high, low = np.divmod(t - t[0] + t[0] % (1 << 32), 1 << TIME_BITS)
    new_time, new_row = (np.diff(a, prepend=-1) != 0 for a in (high << TIME_BITS | low, y))
    # Rows of neighbours; in each of them blocks of 12 columns, from its first on.
    begins = new_time | new_row | (np.diff(p, prepend=2) != 0)
    begins[1:] |= (np.diff(x) <= 0) | (np.diff(x) >= 12)
    starts, row = np.flatnonzero(begins), np.cumsum(begins) - 1
    block, bit = np.divmod(x - x[starts][row], 12)
    heads = np.flatnonzero(begins | (np.diff(block, prepend=0) != 0))
    vectors = np.bitwise_or.reduceat(1 << bit, heads)
    saves = (1 + np.bincount(row[heads]) < np.bincount(row))[row]
    step = (1 << TIME_BITS - 1) - 1
    steps = -(-np.diff(high, prepend=0) // step)
    steps[0] = max(steps[0], 1)
    at = np.repeat(np.arange(len(t)), steps)
    # From the last one on, or 0.
    back = np.repeat(np.cumsum(steps), steps) - 1 - np.arange(len(at))
    before = np.append(0, high)[:-1][at] + step * (steps[at] - back)
    highs = np.where(back == 0, high[at], before)
    single, pixel = np.flatnonzero(~saves), p << 11 | x
    starts, heads, vectors = starts[saves[starts]], heads[saves[heads]], vectors[saves[heads]]
    pieces = [
        (at, TIME_HIGH, highs & 0xFFF),
        (np.flatnonzero(new_time), Evt3.TIME_LOW, low[new_time]),
        (np.flatnonzero(new_row), Evt3.Y, y[new_row]),
        (starts, Evt3.BASE, pixel[starts]),
        (single, Evt3.X, pixel[single]),
        (heads, Evt3.VECTOR_12, vectors),
    ]
    order = np.argsort(np.concatenate([k for k, *_ in pieces]), kind="stable")
    words = np.concatenate([kind << 12 | values for _, kind, values in pieces])[order]
    words = np.append(words, np.full(-len(words) % 4, TIME_HIGH << 12 | high[-1] & 0xFFF))
    return words.astype("<u2").view("<u8").astype(np.uint64)


def _columns(t, x, y, p, *limits):
    columns = [np.asarray(a).astype(np.int64) for a in (t, x, y, p)]
    for (name, bits), values in zip(limits, columns[1:3], strict=True):
        if len(values) and not (values.min() >= 0 and values.max() < 1 << bits):
            raise ValueError(f"{name} {values.min()} to {values.max()}: 0 to {(1 << bits) - 1} fit this format")
    columns[3] &= 1
    return columns


def _split_time(t):
    return (t >> LOW_BITS) & ((1 << HIGH_BITS) - 1), t & ((1 << LOW_BITS) - 1)


def _with_time_words(words, high, time_words):
    """``words`` with a time word before the first, and before each whose high bits differ from the last one's."""
    new = np.concatenate([[True], np.diff(high) != 0])
    return np.insert(words, np.flatnonzero(new), time_words[new])


#: Lines that begin with %, up to "% end" if it is there.
_HEADER = re.compile(rb"(?:%(?![^\S\n]*end[^\S\n]*\n)[^\n]*\n)*(?P<end>%[^\S\n]*end[^\S\n]*\n)?")


def read_raw(path):
    """The words of a Prophesee ``.raw`` file: ``(form, words)``, a key of FORMATS, and a uint64 array.

    Words that are missing at the end are filled with unused ones (type F). Raises :exc:`RecordingError` where the file
    is not readable, or its format is not one that the hardware decodes.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None
    header = _HEADER.match(content)
    body = content[header.end() :]
    if not header["end"] and body.startswith(b"%"):
        raise RecordingError(f"{path}: a header line without an end")
    found = header[0].decode("latin-1").lower()
    widths = {"EVT21": (8, r"evt ?2\.?1"), "EVT20": (4, r"evt ?2(\.0)?\b"), "EVT30": (2, "evt ?3")}
    form = next((form for form, (_, said) in widths.items() if re.search(said, found)), None)
    if form is None:
        why = "the header names none of evt 2.0, 2.1 and 3.0, which are what the AXI top decodes"
        raise RecordingError(f"{path}: {why}")
    body = body[: len(body) - len(body) % widths[form][0]]
    body += b"\xff" * (-len(body) % 8)
    return form, np.frombuffer(body, "<u8").astype(np.uint64)


def split_packets(registers, words):
    """Result packets, one after the other, as uint32 array [packets, words]: word k is the k-th result register."""
    words = np.ascontiguousarray(words, "<u8").reshape(-1, registers["RESULT_SIZE"].reset)
    return words.view("<u4").astype(np.uint32)


def result_values(registers, words):
    """Values of one result, ``{name: int}``, of the 32-bit words of a packet, or the result registers in their order.

    Names are those of the core's results (``v_x``, ``roi_next_y``, ``sums_sx`` …), ``flags`` as
    :class:`cmfpga.protocol.flags.Flag` has them; beside them ``batch``, ``t_ref``, ``wire`` and ``config_range``.
    """
    group = registers.group("Result")
    places = {register.name: (register.offset - group[0].offset) // 4 for register in group}
    count = max(places.values()) + 1
    if len(words) not in (count, 2 * registers["RESULT_SIZE"].reset):
        raise ValueError(f"{len(words)} words of a result: {count} are needed")
    word = {name: words[place] for name, place in places.items()}
    return {
        link: sum(f.unpack(word[register.name]) << f.link_lsb for register, f in parts)
        for link, parts in registers.linked("Result").items()
    }


def setting_words(registers, settings):
    """``{register name: word}`` of the settings registers.

    ``settings`` are by the links of their fields; those without a register in this map are left out. Raises
    :exc:`ValueError` where a value does not fit its field.
    """
    words = {}
    for link, ((register, f),) in registers.linked("Settings").items():
        if link in settings:
            words[register.name] = words.get(register.name, 0) | f.pack(int(settings[link]))
    return words
