"""Model of :mod:`cmfpga.rtl.confidence`: the probes behind the last iteration, and the verdict."""

from ...protocol.confidence import curvature, is_trusted, probe_velocities
from ...protocol.flags import Flag
from ...protocol.results import not_judged


def confidence(config, evaluate, last, settings, n):
    """What the hardware finds behind a batch's last iteration: (fields of the result, flags).

    Parameters
    ----------
    config : Config
    evaluate : callable
        ``evaluate(v)``: :class:`~.core.IntegerIteration` of the batch's ``n`` events at a raw velocity, at the level of
        the last iteration.
    last : IntegerIteration
    settings : BatchSettings
    """
    found = not_judged(config) | {"sum_squares": int((last.images.i**2).sum())}
    if not settings.judge:
        return found, Flag(0)
    velocities = probe_velocities(last.v, last.v_next, 3 << (config.v_frac - 2))
    at_x, at_y = (evaluate(v).sums for v in velocities)
    found |= {"probe_x": at_x, "probe_y": at_y, "confidence_limit": settings.confidence_limit}
    shape = curvature(config.geometry.pixels, last.v_next, last.sums, found["sum_squares"], at_x, at_y)
    return found, Flag(0) if is_trusted(config, n, settings.confidence_limit, shape) else Flag.DOUBTFUL
