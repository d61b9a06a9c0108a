"""How sure a batch's v is: from raw sums to a confidence, a covariance, and the hardware's verdict.

A round evaluates the image on either side of v, along x and along y. The sharper the contrast's peak, the more the
gradient falls from one side to the other. The batch's last round counts; its distance is :data:`PROBE` px. What all
numbers mean, and what they do not see: docs/rounds.md.

A motion beyond translation is evaluated once more for each of its parameters, :data:`PROBE` px nearer to 0. What counts
is the parameter along which the gradient falls the least, which is compared with Σ I².
"""

from math import hypot, sqrt
from typing import NamedTuple

from .flags import Flag

#: Distance from v at which a batch's last evaluations are, px per half batch.
PROBE = 0.75

#: Of so many ROI events, stored or not, the covariance is the inverse of the information. Events of one edge tell the
#: same, so that it falls with the root of their number: then ellipses hold about what they say (docs/rounds.md).
CALIBRATED_AT = 700

#: Of less motion, px per half batch, so little is left in the image that the contrast's own peak lies too far out.
SHORT_PX = 1.5

#: ``((below so many px per half batch, found too large by up to this share of the truth), …)``.
OVERESTIMATED = ((1.0, 0.25), (SHORT_PX, 0.05))

#: A translation that is found too large by so much at most, px, may be trusted; by more, where it is as uncertain.
COVERED = 0.095

#: The limit of the comparison is so many times the smallest confidence.
LIMIT_SCALE = 3


class Curvature(NamedTuple):
    """How much the gradient G falls from one side of v to the other, raw.

    ``xx``, ``yy`` and ``cross``/2 are minus the Hessian of the contrast along x, along y, and mixed.
    """

    xx: int
    yy: int
    cross: int


def beside(v, distance):
    """Four velocities, in order: below and above ``v`` along x, then along y; no format limits them."""
    x, y = v
    return (x - distance, y), (x + distance, y), (x, y - distance), (x, y + distance)


def curvature(below_x, above_x, below_y, above_y):
    """:class:`Curvature` of the gradients (G_x, G_y) at the four velocities :func:`beside` v."""
    return Curvature(
        xx=below_x[0] - above_x[0],
        yy=below_y[1] - above_y[1],
        cross=below_x[1] - above_x[1] + below_y[0] - above_y[0],
    )


def probes_towards_zero(v, distance):
    """The velocities that are probed of a motion beyond translation, in order: each parameter nearer to 0."""
    return tuple((*v[:k], one + (distance if one < 0 else -distance), *v[k + 1 :]) for k, one in enumerate(v))


def least_fall(v, last, probed):
    """Least fall of the gradient along a parameter, from ``last`` at ``v`` to those at :func:`probes_towards_zero`."""
    falls = (g[k] - last[k] for k, g in enumerate(probed))
    return min(-fall if one < 0 else fall for one, fall in zip(v, falls, strict=True))


def contrast(pixels, sums, sum_squares):
    """P² times the contrast of an image, raw: P·Σ I² − (ΣI)², of its ``sums`` (ΣI first) and Σ I²."""
    return pixels * sum_squares - sums[0] ** 2


def kept(bits, *values):
    """``values``, all shifted right by as few bits as leave ``bits`` of each in two's complement, floored."""
    drop = max(0, *((value if value >= 0 else ~value).bit_length() + 1 - bits for value in values))
    return tuple(value >> drop for value in values)


def is_trusted(config, n, limit, shape, contrast):
    """The hardware's verdict: whether the confidence is at least ``limit`` / :data:`LIMIT_SCALE`.

    ``n`` are the events of the evaluations, ``limit`` is the setting ``confidence_limit``, raw. Of the curvature
    ``shape`` the ``config.widths.kept_bits`` highest bits are compared; more would change one verdict in thousands.
    """
    xx, yy, cross, contrast = kept(config.widths.kept_bits, *shape, contrast)
    by_n, by_limit = (scale * factor for scale, factor in zip(config.widths.judge_scales, (n, limit), strict=True))
    a, c, b = by_n * xx - by_limit * contrast, by_n * yy - by_limit * contrast, by_n * cross
    return a > 0 and 4 * a * c > b * b  # then c > 0, too


def is_sharp(config, n, limit, least, sum_squares):
    """The hardware's verdict in a motion beyond translation, exactly: as :func:`is_trusted`, by :func:`least_fall`."""
    by_n, by_limit = config.widths.judge_scales
    return by_n * n * least > by_limit * limit * sum_squares


def is_short(v):
    """The flag ``SHORT`` of a ``v`` in px per half batch: Σ|v_p| + max |v_p| < 2·:data:`SHORT_PX`, exactly.

    Of a translation that is |v| below 1.34 to 1.5 px, by its direction: all that has the flag is shorter than 1.5 px.
    Of another motion it is told of what moves at the lever arm, near the image's edge.
    """
    size = [abs(one) for one in v]
    return sum(size) + max(size) < 2 * SHORT_PX


def is_judged(outcome):
    """Whether it was asked how sure a batch's v is."""
    return bool(outcome.confidence_limit) and Flag.DEGENERATE not in outcome.flags


def is_sure(outcome):
    """Whether a batch was judged, and its v is to be trusted."""
    return is_judged(outcome) and Flag.DOUBTFUL not in outcome.flags


def is_trustworthy(config, outcome):
    """Whether a batch :func:`is_sure`, and not ``SHORT`` with a bias beyond :data:`COVERED` and its uncertainty."""
    if not is_sure(outcome) or Flag.SHORT not in outcome.flags:
        return is_sure(outcome)
    found = uncertainty(config, outcome)
    if found is None:
        return False
    (x, y), (xx, yy, xy) = outcome.v, found
    along = xx * x * x + 2 * xy * x * y + yy * y * y
    return (bias(outcome) ** 2 - COVERED**2) * (x * x + y * y) <= along


def bias(outcome):
    """How much too large a ``SHORT`` translation may have been found, px, by :data:`OVERESTIMATED`; 0 of others."""
    size = hypot(*outcome.v)
    share = next((share for limit, share in OVERESTIMATED if size < limit), 0.0) if Flag.SHORT in outcome.flags else 0.0
    return size * share / (1 + share)


def _scale(config, outcome, whole):
    """What makes information, per px², of a fall of the gradient where the contrast is ``whole``, both raw."""
    # The float engine's sums are real numbers.
    raw = 1 if isinstance(outcome.sum_squares, float) else 2.0 ** (config.weight_frac - config.derivative_frac)
    return outcome.roi_events * raw / (PROBE * whole)


def information(config, outcome):
    """Fisher information of v, per px²: (xx, yy, xy); of a batch that was judged."""
    whole = contrast(config.geometry.pixels, outcome.sums, outcome.sum_squares)
    if whole <= 0:  # all pixels alike: no contrast at all
        return 0.0, 0.0, 0.0
    factor = _scale(config, outcome, whole)
    xx, yy, cross = outcome.curvature
    return factor * xx, factor * yy, factor * cross / 2


def _variance(outcome):
    """The variance of v along an axis, as a share of the inverse of the information along it."""
    return sqrt((outcome.roi_events + outcome.thinned + outcome.overflow) / CALIBRATED_AT)


def confidence(config, outcome):
    """κ, per px²: the information along the direction in which v is known worst; 1/√κ px is its standard deviation.

    In a motion beyond translation on the parameter that is known worst, if the others are known. Below 0 where the
    contrast has no peak; None of an outcome that was not judged.
    """
    if not is_judged(outcome):
        return None
    if config.motion_model.basis:
        whole = outcome.sum_squares
        if not isinstance(whole, float):
            whole <<= config.motion_model.frac
        return 2 * _scale(config, outcome, whole) * outcome.curvature[0] if whole else 0.0
    xx, yy, xy = information(config, outcome)
    return (xx + yy) / 2 - hypot((xx - yy) / 2, xy)


def uncertainty(config, outcome):
    """The inverse of the information, px²: (xx, yy, xy); None of a batch that is not sure, or of another motion."""
    if not is_sure(outcome) or config.motion_model.basis:
        return None
    xx, yy, xy = information(config, outcome)
    determinant = xx * yy - xy * xy
    if xx <= 0 or determinant <= 0:
        return None
    return yy / determinant, xx / determinant, -xy / determinant


def covariance(config, outcome):
    """Covariance of v, px² (of v per half batch), :func:`bias` included: (xx, yy, xy); None as of :func:`uncertainty`.

    That in (px/s)² is (2/span)² times as large, where span is the batch's t_N − t_1 in s.
    """
    found = uncertainty(config, outcome)
    if found is None:
        return None
    (x, y), share = outcome.v, _variance(outcome)
    more = (bias(outcome) / (hypot(x, y) or 1)) ** 2
    return tuple(share * one + more * own for one, own in zip(found, (x * x, y * y, x * y), strict=True))


def deviations(config, outcome):
    """Standard deviation of each parameter of v, px per half batch, beyond translation the worst; None if not sure."""
    if not is_sure(outcome):
        return None
    if config.motion_model.basis:
        kappa = confidence(config, outcome)
        return (sqrt(_variance(outcome) / kappa),) * len(outcome.v) if kappa > 0 else None
    found = covariance(config, outcome)
    return found and tuple(map(sqrt, found[:2]))
