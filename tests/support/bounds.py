"""How far the integer model's gradient can be from the float reference's, for one iteration from the same v.

The bound follows from the formats alone: each rounding errs by its worst case, in the worst direction, for every
event by itself. It does not run the integer model, so it can judge it.

Derivation, for ∂C/∂vx (∂C/∂vy is the same with x and y exchanged). Hats mark what the integer model computes.

**1. dt.** R = t_N − t_1 is shifted to R·2^s in [2^(B−1), 2^B), B = span_bits, and
recip = ⌊2^(B−1+r)/(R·2^s)⌋ with r = reciprocal_bits. The floor takes less than 1 off, so

    num·recip·2^−(B−1+r) = dt·(1 − θ·R·2^s·2^−(B−1+r)),  0 ≤ θ < 1,

which is off by less than |dt|·2^(1−r). Rounding to dt_frac bits adds at most half a step:

    |d̂t − dt| ≤ 2^−(dt_frac+1) + |dt|·2^(1−r).                                               (:func:`dt_error`)

**2. Position.** x̂' = ⌊x − d̂t·v⌋ to position_frac bits. The product is a multiple of g = 2^−dt_frac·(lowest set bit of
v), so the floor takes at most 2^−position_frac − g off, and nothing where g ≥ 2^−position_frac:

    −|v|·|d̂t − dt| − max(0, 2^−position_frac − g) ≤ x̂' − x' ≤ |v|·|d̂t − dt|.              (:func:`position_error`)

**3. The gradient's change.** With φ = I − μ, ψ = D − mean(D), δI = Î − I and δD = D̂ − D,

    (P/2)·δ(∂C/∂v) = Σ φ·δD + Σ ψ·δI + Σ (δI − mean δI)·(δD − mean δD)

exactly, because Σφ = Σψ = 0. The first two sums are linear in the events. Event k contributes to them F̂_k − F_k with

    F(x', y', dt) = Σ_corners ψ·w + φ·∂w/∂vx                          (φ = ψ = 0 outside the ROI).

In one cell F is linear in each of x', y', dt, hence extreme at the vertices of the box that 1. and 2. allow. Where
the box reaches over a grid line, ∂w/∂x' jumps; the box is cut there and each cell's part has its own vertices, so an
event that may cross gets the jump and all others the smooth bound. Keeping the four corners of an event together lets
their errors cancel as they do in fact.

**4. Votes.** Rounding changes a weight by at most 2^−(weight_frac+1), and changes F by at most that times Σ|ψ|. The two
magnitudes dt·(1−fy), dt·fy change by at most 2^−(derivative_frac+1) and enter F as differences of φ along x. Where the
exact product has no more bits than the format, nothing is rounded.

**5. Second order.** The last sum is a covariance. With worst-case error images |δI| ≤ εI and |δD| ≤ εD, found per pixel
from the same boxes, it is at most min(Σ εI·εD + Σ εI·Σ εD/P, ‖εI‖·‖εD‖).

**6. Sums.** ΣI, ΣD, S and G are exact. The gradient is G·2^−shift, floored to gradient_frac bits: at most one step
less. It still carries the factor ρ of ``config.widths.gradient_scale``; it is meant divided by the exact ρ here. That
the hardware multiplies by a rounded 1/ρ, folded into η, is a relative error of the step, :func:`gain_error`.

**7. float64.** The reference rounds too; 2^−50 relative at the position, where it may decide about a crossing, and a
generous multiple of its summation error are added.
"""

from fractions import Fraction

import torch

from cmfpga.errors import ConfigError
from cmfpga.fixed import round_half_up
from cmfpga.reference.floating import accumulate, cell_pixels, evaluate, float64, warp


def dt_error(config, dt):
    """Largest |d̂t − dt| for each ``dt`` [n], in half batches (part 1 of the derivation)."""
    return 2.0 ** -(config.dt_frac + 1) + float64(dt).abs() * (2.0 ** (1 - config.reciprocal_bits) + 2.0**-52)


def position_error(config, dt, v):
    """``(below, above)``, float64 [n] each, in pixels: x̂' lies in x' − below … x' + above (part 2).

    ``v`` is the velocity along the axis, a value of ``config.formats.v``.
    """
    raw = _raw_velocity(config, v)
    product_step = 2.0**-config.dt_frac * (raw & -raw) * config.formats.v.step
    floored = max(0.0, 2.0**-config.position_frac - product_step) if raw else 0.0
    above = dt_error(config, dt) * abs(float(v))
    return above + floored, above


def gain_error(config):
    """Relative error of the step's factor η·2^16/ρ as the hardware holds it, η's own rounding included; ≥ 0.

    The hardware's step is the bounded gradient times η times at most 1 ± this, then rounded to ``config.formats.v``.
    Zero for a power-of-two P and an η that its format holds; also for η = 0.
    """
    if not config.eta:
        return 0.0
    _, mantissa = config.widths.gradient_scale
    gain = Fraction(round_half_up(config.formats.eta.raw(config.eta) * mantissa, 8), 1 << config.formats.gain.f)
    return float(abs(gain * _rho(config) / Fraction(config.eta) - 1))


def gradient_bound(config, x, y, dt, v):
    """Upper bounds of |∂Ĉ/∂v − ∂C/∂v| along x and y: float64 [2].

    Parameters
    ----------
    config : Config
        The formats and the ROI's size.
    x, y : integers [n]
        Events relative to the ROI's origin.
    dt : float64 [n]
        Their :func:`~cmfpga.reference.floating.scaled_times`, unrounded.
    v : pair
        The velocity, the same in both models: values of ``config.formats.v``.

    Returns
    -------
    The bounds; infinite along an axis where the integer gradient might leave ``config.formats.gradient`` and saturate.
    """
    x, y, dt, v = float64(x), float64(y), float64(dt), float64(v)
    width, height = config.roi_width, config.roi_height
    at = evaluate(x, y, dt, v, width=width, height=height)
    x_warped, y_warped = warp(x, y, dt, v)
    box_x = _Box(config, x, x_warped, dt, v[0], width)
    box_y = _Box(config, y, y_warped, dt, v[1], height)
    half_sums = torch.stack(
        (
            _axis_bound(config, at.image, at.derivative_x, box_x, box_y, dt),
            _axis_bound(config, at.image.T, at.derivative_y.T, box_y, box_x, dt),
        )
    )
    n, pixels = len(dt), config.geometry.pixels
    # Each of the n + P roundings of a sum, times Σ (|I| + μ)·(Σ|d| + mean) ≤ 8·n·max I.
    summation = 2.0**-51 * (n + pixels + 16) * 8 * n * float(at.image.max())
    rho = float(_rho(config))
    floored = config.formats.gradient.step / rho if config.widths.gradient_shift > 0 else 0.0
    bound = (half_sums + summation) * 2 / pixels + floored
    fits = (at.gradient.abs() + bound) * rho <= config.formats.gradient.real(config.formats.gradient.max)
    return torch.where(fits, bound, torch.inf)


# -------------------------------------------------------------------- parts of the bound


def _raw_velocity(config, v):
    raw = float(v) / config.formats.v.step
    if raw != int(raw) or not config.formats.v.min <= raw <= config.formats.v.max:
        raise ConfigError(f"v = {float(v)!r}: a value of the format {config.formats.v} is needed")
    return int(raw)


def _rho(config):
    """ρ of P² = ρ·2^q, 1 ≤ ρ < 2, exactly."""
    square = config.geometry.pixels**2
    return Fraction(square, 1 << (square.bit_length() - 1))


class _Box:
    """Where the integer model may place each event along one axis: ``at`` the float position, ``low`` … ``high``."""

    def __init__(self, config, x, warped, dt, v, size):
        below, above = position_error(config, dt, v)
        slop = 2.0**-50 * (x.abs() + v.abs()) * (v != 0)  # at v = 0 both are exact
        # Beyond −2 and size nothing votes: clamping there changes no vote and keeps the number of cells small.
        self.at = warped.clamp(-2, size)
        self.low, self.high = (warped - below - slop).clamp(-2, size), (warped + above + slop).clamp(-2, size)
        self.size = size
        self.first, self.last = self.low.floor(), self.high.floor()
        self.cells = int((self.last - self.first).max()) + 1 if len(x) else 0

    def hat(self, column):
        """Weight factor of pixels ``column`` [n] at the float position, and its smallest and largest over the box."""
        at, low, high, nearest = (
            (1 - (column - position).abs()).clamp(min=0)
            for position in (self.at, self.low, self.high, torch.clamp(column, self.low, self.high))
        )
        return at, torch.minimum(low, high), nearest

    def sign(self, column):
        """Derivative factor of pixels ``column`` (−1 left of the event, 1 right, 0 elsewhere), likewise."""
        cell = self.at.floor()
        at = (column - 1 == cell).double() - (column == cell).double()
        left = (self.first <= column) & (column <= self.last)
        right = (self.first <= column - 1) & (column - 1 <= self.last)
        none = self.last - self.first + 1 > left.double() + right.double()
        high = torch.where(right, 1.0, torch.where(none, 0.0, -1.0)).double()
        low = torch.where(left, -1.0, torch.where(none, 0.0, 1.0)).double()
        return at, low, high


def _rounding(config):
    """Largest rounding of a weight and of a derivative's magnitude (part 4)."""
    weight = 2.0 ** -(config.weight_frac + 1) * (config.weight_frac < 2 * config.position_frac)
    derivative = 2.0 ** -(config.derivative_frac + 1) * (config.derivative_frac < config.dt_frac + config.position_frac)
    return weight, derivative


def _axis_bound(config, image, derivative, u, w, dt):
    """Bound of (P/2)·|δ(∂C/∂v)|; ``u`` is the :class:`_Box` along the axis of the derivative, ``w`` along the other."""
    if not len(dt):
        return image.new_zeros(())
    return _first_order(config, image - image.mean(), derivative - derivative.mean(), u, w, dt) + _second_order(
        config, u, w, dt
    )


def _first_order(config, phi, psi, u, w, dt):
    """Parts 3 and 4: worst Σ_k (F̂_k − F_k)."""
    weight_error, derivative_error = _rounding(config)
    phi, psi = (torch.cat((image.flatten(), image.new_zeros(1))) for image in (phi, psi))
    t_error = dt_error(config, dt)

    def corners(i, j):
        """F as a function in the cells (i, j), and its rounding."""
        pixel = cell_pixels(i, j, u.size, w.size)
        (p00, p10, p01, p11), (f00, f10, f01, f11) = p, f = psi[pixel], phi[pixel]

        def value(x, y, t):
            fx, fy = x - i, y - j
            votes = (1 - fy) * ((1 - fx) * p00 + fx * p10) + fy * ((1 - fx) * p01 + fx * p11)
            return votes + t * ((1 - fy) * (f00 - f10) + fy * (f01 - f11))

        rounding = weight_error * p.abs().sum(0) + derivative_error * ((f[0] - f[1]).abs() + (f[2] - f[3]).abs())
        return value, rounding

    exact = corners(u.at.floor(), w.at.floor())[0](u.at, w.at, dt)
    highest, lowest = torch.full_like(dt, -torch.inf), torch.full_like(dt, torch.inf)
    for a in range(u.cells):
        for b in range(w.cells):
            i, j = u.first + a, w.first + b
            value, rounding = corners(i, j)
            reached = (i <= u.last) & (j <= w.last)
            for x in (torch.maximum(u.low, i), torch.minimum(u.high, i + 1)):
                for y in (torch.maximum(w.low, j), torch.minimum(w.high, j + 1)):
                    for t in (dt - t_error, dt + t_error):
                        vertex = value(x, y, t)
                        highest = torch.maximum(highest, torch.where(reached, vertex + rounding, -torch.inf))
                        lowest = torch.minimum(lowest, torch.where(reached, vertex - rounding, torch.inf))
    return torch.maximum((highest - exact).sum(), (exact - lowest).sum())


def _second_order(config, u, w, dt):
    """Part 5: worst covariance of the error images."""
    weight_error, derivative_error = _rounding(config)
    t_error = dt_error(config, dt)
    pixels, weights, derivatives = [], [], []
    for a in range(u.cells + 1):
        hat_u, hat_u_low, hat_u_high = u.hat(u.first + a)
        sign, sign_low, sign_high = u.sign(u.first + a)
        for b in range(w.cells + 1):
            hat_w, hat_w_low, hat_w_high = w.hat(w.first + b)
            # The first corner of the cell (column, row) is the pixel itself.
            pixels.append(cell_pixels(u.first + a, w.first + b, u.size, w.size)[0])
            weight = hat_u * hat_w
            error = torch.maximum(hat_u_high * hat_w_high - weight, weight - hat_u_low * hat_w_low)
            weights.append(error + weight_error * (hat_u_high * hat_w_high > 0))
            exact = dt * sign * hat_w
            error = torch.stack(
                [
                    (t * s * h - exact).abs()
                    for t in (dt - t_error, dt + t_error)
                    for s in (sign_low, sign_high)
                    for h in (hat_w_low, hat_w_high)
                ]
            ).amax(0)
            derivatives.append(error + derivative_error * (hat_w_high > 0))
    pixels = torch.stack(pixels)
    error_i, error_d = (accumulate(pixels, torch.stack(values), u.size, w.size) for values in (weights, derivatives))
    covariance = (error_i * error_d).sum() + error_i.sum() * error_d.mean()
    return torch.minimum(covariance, error_i.norm() * error_d.norm())
