"""A batch's result as it comes over the wire."""

from dataclasses import dataclass, fields

from ..protocol.batch import BatchResult, Flag
from ..protocol.words import result_values

SUMS = ("i", "dx", "dy", "sx", "sy")


@dataclass(frozen=True, kw_only=True)
class WireResult(BatchResult):
    """What a result packet carries: a :class:`.BatchResult` without a trace, and more of the hardware's own.

    Parameters
    ----------
    batch : int
        Its number since the last reset, from 1; 0 for a batch without events, which never reaches the hardware.
    t_first, t_ref : int or None
        Time stamps in µs, modulo 2^32: of the first event; the reference time, rounded down.
    sums : tuple of int
        ΣI, ΣDx, ΣDy, Σ I·Dx, Σ I·Dy of the last iteration, raw; 0 in a degenerate batch.
    wire : bool
        Words or events were dropped at the input since the result before.
    config_range : bool
        A setting was out of range, and limited.
    """

    batch: int
    t_first: int | None
    t_ref: int | None
    sums: tuple[int, int, int, int, int]
    wire: bool = False
    config_range: bool = False


def from_words(config, registers, words):
    """The :class:`WireResult` of a packet's 32-bit words, or of the result registers."""
    value = result_values(registers, [int(word) for word in words])
    counts = ("events", "roi_events", "outside", "overflow", "thinned", "time_back", "time_span", "span")
    return WireResult(
        **{name: value[name] for name in (*counts, "iterations", "cycles", "batch", "t_first", "t_ref")},
        roi=(value["roi_x"], value["roi_y"]),
        roi_next=(value["roi_next_x"], value["roi_next_y"]),
        v=(config.formats.v.real(value["v_x"]), config.formats.v.real(value["v_y"])),
        flags=Flag(value["flags"]),
        sums=tuple(value[f"sums_{name}"] for name in SUMS),
        wire=bool(value["wire"]),
        config_range=bool(value["config_range"]),
    )


def differences(result, expected):
    """Where a :class:`WireResult` differs from the integer model's :class:`~cmfpga.protocol.batch.BatchResult`.

    Returns
    -------
    list of str
        One line each; empty if all is equal. The model has no clock, so cycles are not compared.
    """
    pairs = {
        f.name: (getattr(result, f.name), getattr(expected, f.name))
        for f in fields(BatchResult)
        if f.name not in ("cycles", "trace")
    }
    trace = expected.trace
    rows = [(int(i), *map(int, d), *map(int, s)) for i, d, s in zip(trace.sum_i, trace.sum_d, trace.s, strict=True)]
    pairs["sums"] = (result.sums, rows[-1] if rows else (0,) * len(SUMS))
    return [f"{name} is {got}, {wanted} is expected" for name, (got, wanted) in pairs.items() if got != wanted]
