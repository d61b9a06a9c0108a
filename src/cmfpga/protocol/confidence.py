"""How sure a batch's v is: from raw sums to a confidence, a covariance, and the hardware's verdict.

After the last iteration, which evaluated the image at v_p, it is evaluated twice more: :data:`PROBE` px beside v_p,
along x and along y, towards v = 0. The sharper the contrast's peak, the more the gradient changes. What all numbers
mean, and what they do not see: docs/confidence.md.

Imports neither Amaranth nor NumPy.
"""

from math import hypot
from typing import NamedTuple

from .flags import Flag

#: Distance of the probes from the velocity of the last iteration, px per half batch.
PROBE = 0.75

#: Standard deviation of v that no peak is too sharp for, px per half batch: what the formats and the grid leave.
FLOOR = 0.05

#: The limit of the comparison is so many times the smallest confidence.
LIMIT_SCALE = 3


class Curvature(NamedTuple):
    """How fast the gradient falls within a probe's distance, raw.

    ``xx``, ``yy`` and ``cross``/2 are minus the Hessian of the contrast along x, along y, and mixed; ``contrast`` is
    the contrast itself: P·Σ I² − (ΣI)².
    """

    xx: int
    yy: int
    cross: int
    contrast: int


def probe_velocities(v, found, distance):
    """The two velocities that are probed: beside ``v``, that of the last iteration, towards zero from ``found``."""
    x, y = (-distance if axis > 0 else distance for axis in found)
    return (v[0] + x, v[1]), (v[0], v[1] + y)


def curvature(pixels, found, sums, sum_squares, probe_x, probe_y):
    """:class:`Curvature` of a batch.

    Parameters
    ----------
    pixels : int
        P, of the ROI.
    found : pair of numbers
        The batch's v; only the signs count.
    sums, probe_x, probe_y : tuple of five numbers
        ΣI, ΣDx, ΣDy, Σ I·Dx, Σ I·Dy of the last iteration and of the probes.
    sum_squares : number
        Σ I² of the last iteration.
    """
    (gx, gy), at_x, at_y = (
        (pixels * s[3] - s[0] * s[1], pixels * s[4] - s[0] * s[2]) for s in (sums, probe_x, probe_y)
    )
    sign_x, sign_y = (-1 if axis > 0 else 1 for axis in found)
    return Curvature(
        xx=sign_x * (gx - at_x[0]),
        yy=sign_y * (gy - at_y[1]),
        cross=sign_x * (gy - at_x[1]) + sign_y * (gx - at_y[0]),
        contrast=pixels * sum_squares - sums[0] ** 2,
    )


def is_trusted(config, n, limit, shape):
    """The hardware's verdict: whether the confidence is at least ``limit`` / :data:`LIMIT_SCALE`.

    Of the curvature the ``config.widths.kept_bits`` highest bits are compared; more would change one verdict in
    thousands.

    Parameters
    ----------
    config : Config
    n : int
        Events of the evaluations.
    limit : int
        Setting ``confidence_limit``, raw.
    shape : Curvature
    """
    drop = max(0, *((value if value >= 0 else ~value).bit_length() + 1 - config.widths.kept_bits for value in shape))
    xx, yy, cross, contrast = (value >> drop for value in shape)
    by_n, by_limit = (scale * factor for scale, factor in zip(config.widths.judge_scales, (n, limit), strict=True))
    a, c, b = by_n * xx - by_limit * contrast, by_n * yy - by_limit * contrast, by_n * cross
    return a > 0 and 4 * a * c > b * b  # then c > 0, too


def is_judged(outcome):
    """Whether a batch was probed."""
    return bool(outcome.confidence_limit) and Flag.DEGENERATE not in outcome.flags


def is_sure(outcome):
    """Whether a batch was judged, and its v is to be trusted."""
    return is_judged(outcome) and Flag.DOUBTFUL not in outcome.flags


def _information(config, outcome):
    """Fisher information of v, per px²: (xx, yy, xy)."""
    shape = curvature(
        config.geometry.pixels, outcome.v, outcome.sums, outcome.sum_squares, outcome.probe_x, outcome.probe_y
    )
    if shape.contrast <= 0:  # all pixels alike: no contrast at all
        return 0.0, 0.0, 0.0
    # The float engine's sums are real numbers.
    raw = 1 if isinstance(outcome.sum_squares, float) else 2.0 ** (config.weight_frac - config.derivative_frac)
    factor = 2 * outcome.roi_events * raw / (PROBE * shape.contrast)
    return factor * shape.xx, factor * shape.yy, factor * shape.cross / 2


def confidence(config, outcome):
    """κ, per px²: the information along the direction in which v is known worst; 1/√κ px is its standard deviation.

    Parameters
    ----------
    config : Config
    outcome : RegionOutcome or BatchResult

    Returns
    -------
    float or None
        Below 0 where the contrast has no peak; None of a batch that was not probed.
    """
    if not is_judged(outcome):
        return None
    xx, yy, xy = _information(config, outcome)
    return (xx + yy) / 2 - hypot((xx - yy) / 2, xy)


def covariance(config, outcome):
    """Covariance of v, px² (of v per half batch): (xx, yy, xy); None of a batch that is not trusted.

    That in (px/s)² is (2/span)² times as large, where span is the batch's t_N − t_1 in s.
    """
    if not is_sure(outcome):
        return None
    xx, yy, xy = _information(config, outcome)
    determinant = xx * yy - xy * xy
    if xx <= 0 or determinant <= 0:
        return None
    return yy / determinant + FLOOR**2, xx / determinant + FLOOR**2, -xy / determinant
