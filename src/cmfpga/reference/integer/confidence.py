"""Model of :mod:`cmfpga.rtl.confidence`: the probes behind the last iteration, and the verdict."""

from ...protocol.confidence import contrast, curvature, is_trusted, probe_velocities
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
    fmt, limit = config.formats.v, settings.confidence_limit
    velocities = probe_velocities(last.v_next, 3 << (config.v_frac - 2), fmt.min, fmt.max)
    shape = curvature(*(evaluate(v).g for v in velocities))
    trusted = is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, last.sums, found["sum_squares"]))
    found |= {"curvature": tuple(shape), "confidence_limit": limit}
    return found, Flag(0) if trusted else Flag.DOUBTFUL
