"""Models of the steps of :mod:`cmfpga.rtl.ascent`: constant, sign, and Newton's M⁻¹·g of the four gradients of a round.

A round at v evaluates G, raw, at the four velocities :func:`~cmfpga.protocol.confidence.beside` v. Their mean g is the
gradient at v; how much they fall from one side to the other is the curvature M. What the hardware does, in integers:

1. *Five sums* of the four G: x = Σ Gx, y = Σ Gy, and xx = Gx₀ − Gx₁, yy = Gy₂ − Gy₃, cross = Gy₀ − Gy₁ + Gx₂ − Gx₃.
   Of each ``widths.g_zeros`` lowest bits, which are 0, are left out. |x|, |y|, |cross| ≤ 4·g_max and |xx|, |yy| ≤
   2·g_max, so ``widths.round_bits`` hold each.
2. *Normalise*: all five are shifted right alike, floored, by as few bits as leave 17 bits (``kept_bits``) of each in
   two's complement. Now −2^16 ≤ each < 2^16.
3. *Determinant*: trace = xx + yy (18 bits); det = 4·xx·yy − cross² (|det| < 2^35, 36 bits).
4. *Damp* if 2·det < trace²: xx += trace >> 3, yy += trace >> 3, floored (18 bits), and det += (trace² >> 1) +
   (trace² >> 4), both floored. So det is again 4·xx·yy − cross², but for rounding (36 bits: it was < trace²/2).
5. *Numerators*: nx = 2·yy·x − cross·y, ny = 2·xx·y − cross·x (|n| < 2^34, 35 bits).
6. *Divide* along each axis: size = n, or ~n if n is negative. ratio = ⌊size·2^v_frac / det⌋, limited to
   2^(v_frac + 1) − 1: so many bits, after one that says that size ≥ 2·det.
7. *Scale* with h = distance/4: step = (distance·ratio + 2) >> 2, limited to the entry's limit; negative if n was.
   v + step, limited to v's format, is the next v.

If trace ≤ 0, or det ≤ 0 after 4, there is no peak near: the step is the limit along each axis, with the sign of x and
of y as of 2; or 0 where that is 0, or lesser: where twice its size, in the sense of 6, is less than the other's.

Step 7 is M⁻¹·g = h·(2·yy·x − cross·y)/det, since g = (x, y)/4 and M = [[xx, cross/2], [cross/2, yy]]/(2·h). Numerators
and det have the same power of two, so no exponent is kept.
"""

from typing import NamedTuple

from ...fixed import floor_shift, round_half_up, saturate
from ...protocol.confidence import curvature, kept


def gain(config, eta):
    """Raw ``config.formats.gain``: η times the mantissa of 2/P², once per batch."""
    return round_half_up(eta * config.widths.gradient_scale[1], 8)


def updater(config, v, g, *, gain):
    """One step v + η·∂C/∂v (Eq. v_update) along one axis, of the raw ``v`` and G: ``(next raw v, saturated)``.

    ``gain`` is from :func:`gain`. Saturated: the gradient or v was limited to its format.
    """
    fmt = config.formats.gradient
    slope = floor_shift(g, config.widths.gradient_shift)
    limited_slope = saturate(slope, fmt.min, fmt.max)
    target = v + round_half_up(limited_slope * gain, config.widths.step_shift)
    limited = saturate(target, config.formats.v.min, config.formats.v.max)
    return limited, limited_slope != slope or limited != target


def lesser(config, gradient):
    """Which parameters' slopes are less than half of the steepest one's, a bool each.

    Whole parts of S are compared, rounded down, of negative ones less one: −8 counts as 7.
    """
    whole = [g >> config.widths.s_frac for g in gradient]
    sizes = [part if part >= 0 else ~part for part in whole]
    return [2 * size < max(sizes) for size in sizes]


def sign_updater(fmt, v, g, *, log2_step, halved=False):
    """One step v + 2^log2_step · sign(G) of one parameter: (next raw v, whether it was limited to its format).

    ``halved``: half of that step, rounded down.
    """
    step = (1 << (log2_step + fmt.f)) >> halved
    target = v + step * ((g > 0) - (g < 0))
    limited = saturate(target, fmt.min, fmt.max)
    return limited, limited != target


class Solved(NamedTuple):
    """What the steps find, by their names above."""

    sums: tuple  # 1, with the bits that 1 leaves out: x, y, xx, yy, cross
    kept: tuple  # 2
    damped: bool
    det: int  # after 4
    peak: bool  # that and the trace are positive
    ratio: tuple  # 6, of x and y
    step: tuple  # 7


def solve(config, gradients, entry):
    """The step of a :class:`Round`, raw: :class:`Solved`.

    ``gradients`` are (Gx, Gy) at the four of :func:`~cmfpga.protocol.confidence.beside`, int, in its order.
    """
    fmt, widths = config.formats.v, config.widths
    sums = (*(sum(axis) for axis in zip(*gradients, strict=True)), *curvature(*gradients))
    x, y, xx, yy, cross = five = kept(widths.kept_bits, *(one >> widths.g_zeros for one in sums))
    trace, det = xx + yy, 4 * xx * yy - cross * cross
    if damped := 2 * det < trace * trace:
        square, more = trace * trace, trace >> 3
        xx, yy, det = xx + more, yy + more, det + (square >> 1) + (square >> 4)
    limit = int(entry.limit * (1 << fmt.f))
    if not (peak := trace > 0 and det > 0):
        sizes = [one if one >= 0 else ~one for one in (x, y)]
        step = tuple(
            0 if 2 * size < max(sizes) else limit * ((one > 0) - (one < 0))
            for one, size in zip((x, y), sizes, strict=True)
        )
        return Solved(sums, five, damped, det, peak, (0, 0), step)
    over = 2 * yy * x - cross * y, 2 * xx * y - cross * x
    sizes = (n if n >= 0 else ~n for n in over)
    ratio = tuple(min((size << fmt.f) // det, (2 << fmt.f) - 1) for size in sizes)
    step = (min((entry.distance * one + 2) >> 2, limit) for one in ratio)
    step = tuple(-size if n < 0 else size for size, n in zip(step, over, strict=True))
    return Solved(sums, five, damped, det, peak, ratio, step)


def newton(config, v, gradients, entry):
    """``(next v, saturated)``: raw ``v`` moved by :func:`solve`; whether that was limited to the format."""
    fmt = config.formats.v
    target = tuple(axis + step for axis, step in zip(v, solve(config, gradients, entry).step, strict=True))
    limited = tuple(saturate(axis, fmt.min, fmt.max) for axis in target)
    return limited, limited != target
