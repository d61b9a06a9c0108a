"""The probes beside the last iteration's v in float64: what :mod:`cmfpga.rtl.confidence` is measured against."""

from ..protocol.confidence import LIMIT_SCALE, PROBE, confidence, probe_velocities
from .floating import evaluate


def probe(x, y, dt, v, found, settings, *, level=0, **size):
    """Fields of the result that tell how sure ``found`` is, by their names in :mod:`cmfpga.protocol.results`.

    Parameters
    ----------
    x, y, dt : float64 [n]
        As for :func:`~.floating.evaluate`; ``size`` is ``width``, ``height`` and ``border``.
    v, found : pair of float
        Velocity of the last iteration, and the batch's, px per half batch.
    settings : BatchSettings
    level : int
        Of the last iteration: pixels are 2^level px wide.
    """
    velocities = (v, *(probe_velocities(v, found, PROBE) if settings.judge else ()))
    last, *probes = (evaluate(x, y, dt, one, level=level, **size) for one in velocities)
    sums = [tuple(map(float, (at.sum_i, at.sum_dx, at.sum_dy, at.s_x, at.s_y))) for at in probes] or [(0.0,) * 5] * 2
    return {
        "sum_squares": float(last.image.square().sum()),
        "probe_x": sums[0],
        "probe_y": sums[1],
        "confidence_limit": settings.confidence_limit if settings.judge else 0,
    }


def is_doubtful(config, result):
    """Whether the confidence of a :class:`~cmfpga.protocol.results.BatchResult` is below its limit, exactly."""
    kappa = confidence(config, result)
    return kappa is not None and LIMIT_SCALE * kappa < result.confidence_limit
