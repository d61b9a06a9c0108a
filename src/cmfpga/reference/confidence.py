"""The probes beside the batch's v in float64: what :mod:`cmfpga.rtl.confidence` is measured against."""

from ..protocol.confidence import (
    LIMIT_SCALE,
    PROBE,
    confidence,
    curvature,
    least_fall,
    probe_velocities,
    probes_towards_zero,
)
from . import flow
from .floating import evaluate


def probe(x, y, dt, v, found, settings, *, limits, level=0, **size):
    """Fields of the result that tell how sure ``found`` is, by their names in :mod:`cmfpga.protocol.results`.

    Parameters
    ----------
    x, y, dt : float64 [n]
        As for :func:`~.floating.evaluate`; ``size`` is ``width``, ``height`` and ``border``.
    v, found : pair of float
        Velocity of the last iteration, and the batch's, px per half batch.
    settings : BatchSettings
    limits : (float, float)
        Smallest and largest v.
    level : int
        Of the last iteration: pixels are 2^level px wide.
    """
    last, *probes = (
        evaluate(x, y, dt, one, level=level, **size)
        for one in (v, *(probe_velocities(found, PROBE, *limits) if settings.judge else ()))
    )
    shape = curvature(*((float(at.g_x), float(at.g_y)) for at in probes)) if probes else (0.0,) * 3
    return _told(float(last.image.square().sum()), tuple(shape), settings)


def of_round(pixels, done, settings):
    """The same of the last round of an :class:`~.float_ascent.Ascent`, whose evaluations are the probes."""
    squares = pixels * (done.contrast[-1] + (done.sum_i[-1] / pixels) ** 2)
    return _told(float(squares.mean()), tuple(curvature(*done.g[-1].tolist())), settings)


def probe_flow(x, y, dt, v, found, b, settings, *, at_pixels, **size):
    """The same of a motion beyond translation; ``b``, ``at_pixels`` and ``size`` are as of :func:`.flow.sums`."""
    last, *probed = (
        flow.sums(x, y, dt, one, b, at_pixels=at_pixels, **size)[1].tolist()
        for one in (v, *(probes_towards_zero(tuple(found), PROBE) if settings.judge else ()))
    )
    shape = (least_fall(found, last, probed) if probed else 0.0,)
    return _told(flow.squares(x, y, dt, v, b, **size), shape, settings)


def _told(squares, shape, settings):
    limit = settings.confidence_limit if settings.judge else 0
    return {"sum_squares": squares, "curvature": shape, "confidence_limit": limit}


def is_doubtful(config, result):
    """Whether the confidence of a :class:`~cmfpga.protocol.results.BatchResult` is below its limit, exactly."""
    kappa = confidence(config, result)
    return kappa is not None and LIMIT_SCALE * kappa < result.confidence_limit
