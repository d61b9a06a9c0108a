"""The ascents in float64: the article's by a constant η, and the robust one by signs.

See :mod:`.floating` for what ``x``, ``y``, ``dt`` and ``v`` are.
"""

from dataclasses import dataclass

import torch

from ..config.schedule import ScheduleEntry, used
from .floating import evaluate, float64


@dataclass(frozen=True)
class Ascent:
    """Trace of an ascent of T iterations.

    Parameters
    ----------
    v : float64 [T + 1, 2]
        The start, then v after each iteration; ``v[-1]`` is the result.
    contrast : float64 [T]
        C at ``v[k]``; the contrast of the result itself is not part of an iteration.
    gradient : float64 [T, 2]
        ∇C at ``v[k]``.
    sum_i : float64 [T]
        ΣI at ``v[k]``.
    sum_d, s, g : float64 [T, 2]
        ΣD, S and G at ``v[k]``, along x and y.
    """

    v: torch.Tensor
    contrast: torch.Tensor
    gradient: torch.Tensor
    sum_i: torch.Tensor
    sum_d: torch.Tensor
    s: torch.Tensor
    g: torch.Tensor


def _follow(x, y, dt, v_start, plan, step, **size):
    """An :class:`Ascent`: v ← v + step(k, iteration k), for each ``ScheduleEntry`` of a plan."""
    with torch.no_grad():  # a trace, not a graph
        x, y, dt = float64(x), float64(y), float64(dt)
        v = torch.empty(len(plan) + 1, 2, dtype=torch.float64, device=dt.device)
        v[0] = float64(v_start)
        scalars = torch.empty(len(plan), 10, dtype=torch.float64, device=dt.device)
        for k, entry in enumerate(plan):
            events = (axis[used(entry, k, len(dt))] for axis in (x, y, dt))
            now = evaluate(*events, v[k], level=entry.level, **size)
            sums = (now.sum_i, now.sum_dx, now.sum_dy, now.s_x, now.s_y, now.g_x, now.g_y)
            scalars[k] = torch.stack((now.contrast, *now.gradient, *sums))
            v[k + 1] = v[k] + step(k, now)
    contrasts, gradients, sum_i, sum_d, s, g = scalars.split((1, 2, 1, 2, 2, 2), dim=1)
    return Ascent(v, contrasts[:, 0], gradients, sum_i[:, 0], sum_d, s, g)


def ascend(x, y, dt, *, v_start, eta, iterations, **size):
    """Gradient ascent with constant step: v ← v + η·∇C, ``iterations`` times (Eq. v_update). An :class:`Ascent`.

    ``size`` is ``width``, ``height`` and ``border``, as for :func:`evaluate`. v does not saturate here, as it does in
    the hardware.
    """
    plan = [ScheduleEntry(0, None)] * iterations
    return _follow(x, y, dt, v_start, plan, lambda _, now: eta * now.gradient, **size)


def by_signs(slopes, log2_step):
    """±2^log2_step for each slope that is not zero, half of it where one is less than half of the steepest: [p]."""
    return 2.0**log2_step * slopes.sign() * torch.where(2 * slopes.abs() < slopes.abs().max(), 0.5, 1.0)


def ascend_by_signs(x, y, dt, *, v_start, schedule, **size):
    """Ascent by signs, coarse to fine: v ← v + :func:`by_signs` of G. An :class:`Ascent`.

    Parameters
    ----------
    schedule : sequence of cmfpga.config.ScheduleEntry
        One per iteration: pixels are 2^level px wide, the step is 2^log2_step px per half batch, of the events those
        count that :func:`cmfpga.config.schedule.used` says. Where G is zero, v stays along that axis.
    size
        ``width``, ``height`` and ``border``, as for :func:`evaluate`.

    v does not saturate here, as it does in the hardware.
    """

    def step(k, now):
        return by_signs(torch.stack((now.g_x, now.g_y)), schedule[k].log2_step)

    return _follow(x, y, dt, v_start, schedule, step, **size)
