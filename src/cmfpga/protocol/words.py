"""The 64-bit words on the wires of the AXI top: events to words, result packets to values.

Three kinds of event words, little-endian in memory, chosen by the register ``INPUT.FORMAT``:

``EVT21`` (Prophesee EVT 2.1)
    64-bit vectors: type [63:60] (0: darker, 1: brighter), time [59:54], column [53:43], row [42:32], and 32 bits
    [31:0]: bit k is an event at column + k. A word of type 8 gives the time's 28 high bits [59:32] for all that follow.
``EVT20`` (Prophesee EVT 2.0)
    Two 32-bit words in each 64-bit word, the lower one first: type [31:28], time [27:22], column [21:11], row [10:0],
    or with type 8 the time's high bits [27:0].
``PACKED`` (our own)
    One event: time [63:32], polarity [31], row [30:16], column [15:0]. In C a struct of ``uint16_t x, y; uint32_t t``.

Layouts of the first two as in Prophesee's documentation (https://docs.prophesee.ai, "EVT 2.0 Format", "EVT 2.1
Format").
Time stamps are in µs and wrap: after 34 bits in EVT 2.x, after 32 bits in packed words.
"""

from pathlib import Path

import numpy as np

from ..errors import RecordingError
from .registers import FORMATS
from .word_format import COLUMN_BITS, HIGH_BITS, LOW_BITS, TIME_HIGH


def encode(events, form, *, swap=False):
    """Words of ``events`` in the order in which they stand.

    Parameters
    ----------
    events : Events
        Or anything with integer arrays ``t``, ``x``, ``y`` and ``p``.
    form : str
        A key of :data:`cmfpga.protocol.registers.FORMATS`.
    swap : bool
        Exchange the 32-bit halves of each word, as an IMX636 does.

    Returns
    -------
    uint64 array
        What a DMA sends, always whole 64-bit words.

    Raises
    ------
    ValueError
        A coordinate does not fit the format.
    """
    try:
        encoder = {"EVT21": encode_evt21, "EVT20": encode_evt20, "PACKED": encode_packed}[form]
    except KeyError:
        raise ValueError(f"format {form!r}: one of {', '.join(FORMATS)} is needed") from None
    words = encoder(events.t, events.x, events.y, events.p)
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


def read_raw(path):
    """The words of a Prophesee ``.raw`` file.

    Returns
    -------
    form : str
        Key of :data:`cmfpga.protocol.registers.FORMATS`.
    words : uint64 array
        A missing half at the end is filled with an unused word (type F).

    Raises
    ------
    RecordingError
        The file is not readable, or its format is not one that the hardware decodes.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None
    header, start = [], 0
    while content[start : start + 1] == b"%":
        end = content.find(b"\n", start)
        if end < 0:
            raise RecordingError(f"{path}: a header line without an end")
        header.append(content[start + 1 : end].decode("latin-1").strip())
        start = end + 1
        if header[-1] == "end":
            break
    found = " ".join(header).lower().replace("evt2.1", "evt 2.1")
    form = "EVT21" if "evt 2.1" in found else "EVT20" if "evt 2.0" in found else None
    if form is None:
        raise RecordingError(
            f"{path}: the header names neither evt 2.0 nor evt 2.1, which are what the AXI top decodes"
        )
    body = content[start:]
    width = 8 if form == "EVT21" else 4
    body = body[: len(body) // width * width]
    if len(body) % 8:
        body += b"\xff\xff\xff\xff"
    return form, np.frombuffer(body, "<u8").astype(np.uint64)


# ---------------------------------------------------------------- results


def split_packets(registers, words):
    """Result packets, one after the other, as uint32 array [packets, words]: word k is the k-th result register."""
    words = np.ascontiguousarray(words, "<u8").reshape(-1, registers["RESULT_SIZE"].reset)
    return words.view("<u4").astype(np.uint32)


def result_values(registers, words):
    """Values of one result.

    Parameters
    ----------
    registers : RegisterMap
        Of the same configuration.
    words : sequence of int
        The 32-bit words of a packet, or the result registers read one after the other.

    Returns
    -------
    dict of str to int
        Under the names of the core's results (``v_x``, ``roi_next_y``, ``sums_sx`` …), ``flags`` as
        :class:`cmfpga.protocol.flags.Flag` has them; beside them ``batch``, ``t_ref``, ``wire`` and ``config_range``.
    """
    group = registers.group("Result")
    places = {register.name: (register.offset - group[0].offset) // 4 for register in group}
    count = max(places.values()) + 1
    if len(words) not in (count, 2 * registers["RESULT_SIZE"].reset):
        raise ValueError(f"{len(words)} words of a result: {count} are needed")
    word = {name: words[place] for name, place in places.items()}
    values = {}
    for link, parts in registers.linked("Result").items():
        values[link] = sum(f.unpack(word[register.name]) << f.link_lsb for register, f in parts)
    return values


def setting_words(registers, settings):
    """``{register name: word}`` of the settings registers.

    Parameters
    ----------
    registers : RegisterMap
    settings : dict of str to int
        By the links of the settings' fields; those without a register in this map are left out.

    Raises
    ------
    ValueError
        A value does not fit its field.
    """
    words = {}
    for link, ((register, f),) in registers.linked("Settings").items():
        if link in settings:
            words[register.name] = words.get(register.name, 0) | f.pack(int(settings[link]))
    return words
