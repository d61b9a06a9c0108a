"""What goes into a batch's run beside its events, and what comes out: the same for every engine."""

from dataclasses import dataclass, field

import numpy as np

from ..fixed import saturate
from .flags import Flag


@dataclass(frozen=True, kw_only=True)
class BatchSettings:
    """Run-time inputs of the hardware for one batch, as raw integers of their formats.

    Parameters
    ----------
    roi : pair of int, or None
        Left column and top row of the ROI in px; None leaves it where the last batch's update put it.
    iterations : int
        T.
    eta, roi_gain : int
        Raw ``config.formats.eta`` and ``config.formats.roi_gain``.
    start_last : bool
        Start from the last batch's v; otherwise from ``v_start``.
    v_start : pair of int
        Raw ``config.formats.v``.
    min_roi_events : int
        Fewer ROI events make the batch degenerate.
    thinning, thin_target : int
        Store one ROI event in ``thinning``; or, with a target other than 0, in as many as would have brought the last
        batch's ROI events down to it.
    cold, warm : tuple of ScheduleEntry
        Sign ascent: the iterations of a batch without, and with, a last v; they replace ``iterations`` and ``eta``.
    """

    roi: tuple[int, int] | None
    iterations: int
    eta: int
    roi_gain: int
    start_last: bool
    v_start: tuple[int, int]
    min_roi_events: int
    thinning: int = 1
    thin_target: int = 0
    cold: tuple = ()
    warm: tuple = ()

    @classmethod
    def from_config(cls, config, roi=None):
        """The settings that ``config``'s run-time fields ask for."""
        start = (config.v_start_x, config.v_start_y) if config.start == "given" else (0.0, 0.0)
        return cls(
            roi=roi,
            iterations=config.iterations,
            eta=config.formats.eta.raw(config.eta),
            roi_gain=config.formats.roi_gain.raw(config.roi_gain),
            start_last=config.start == "last",
            v_start=(config.formats.v.raw(start[0]), config.formats.v.raw(start[1])),
            min_roi_events=config.min_roi_events,
            thinning=config.thinning,
            thin_target=config.thin_target,
            cold=config.cold_schedule if config.ascent == "sign" else (),
            warm=config.warm_schedule if config.ascent == "sign" else (),
        )


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Every iteration's velocity and sums.

    Raw int64 from the engines that compute in the hardware's arithmetic, float64 (px/half batch, votes) from
    the float engine. ``v`` has T + 1 rows: the one that each iteration used, and the result.
    """

    v: np.ndarray  # [T + 1, 2]
    sum_i: np.ndarray  # [T]
    sum_d: np.ndarray  # [T, 2]
    s: np.ndarray  # [T, 2]

    @classmethod
    def without_iterations(cls, v):
        """Of a batch that leaves the velocity at ``v``: T = 0."""
        v = np.array([v])
        none = np.zeros((0, 2), v.dtype)
        return cls(v=v, sum_i=none[:, 0], sum_d=none, s=none)

    def __eq__(self, other):
        return isinstance(other, Trace) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in ("v", "sum_i", "sum_d", "s")
        )


@dataclass(frozen=True, kw_only=True)
class BatchResult:
    """What came of one batch, wherever it was computed.

    ``trace`` is None where only the result is told: by an accelerator, whose packets have no iterations.
    ``events = roi_events + outside + overflow + thinned + time_back + time_span``, always: nothing is lost without
    being counted.
    """

    events: int  # N
    roi_events: int  # n, stored in the buffer
    outside: int  # outside the ROI
    overflow: int  # in the ROI, but the buffer was full
    thinned: int  # in the ROI, but left out by the thinning
    time_back: int  # dropped: time stepped back
    time_span: int  # dropped: later than span_bits can hold
    span: int  # t_N − t_1 in µs
    roi: tuple[int, int]  # px; what this batch was cut with
    roi_next: tuple[int, int]  # px; what the next batch will be cut with
    v: tuple[float, float]  # px per half batch
    iterations: int
    flags: Flag
    cycles: int | None = None  # clock cycles, from what has a clock
    trace: Trace | None = field(default=None, repr=False)


def crop_position(config, position):
    """Whole pixels of a raw ROI coordinate (x and y have the same fraction bits)."""
    frac = config.formats.roi_x.f
    return (position + (1 << (frac - 1))) >> frac


def clamp_roi(config, roi):
    """``roi`` limited to the sensor, and whether that changed it."""
    clamped = (int(saturate(roi[0], 0, config.geometry.roi_x_max)), int(saturate(roi[1], 0, config.geometry.roi_y_max)))
    return clamped, clamped != tuple(roi)
