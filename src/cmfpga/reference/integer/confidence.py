"""Model of :mod:`cmfpga.rtl.confidence`: the probes behind the last iteration, and the verdict."""

from ...protocol.confidence import (
    contrast,
    curvature,
    is_sharp,
    is_trusted,
    least_fall,
    probe_velocities,
    probes_towards_zero,
)
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
    v, squares = last.v_next, found["sum_squares"]
    fmt, limit, distance = config.formats.v, settings.confidence_limit, 3 << (config.v_frac - 2)
    if config.motion_model.basis:
        shape = (least_fall(v, last.g, [evaluate(one).g for one in probes_towards_zero(v, distance)]),)
        trusted = is_sharp(config, n, limit, *shape, squares)
    else:
        shape = curvature(*(evaluate(one).g for one in probe_velocities(v, distance, fmt.min, fmt.max)))
        trusted = is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, last.sums, squares))
    found |= {"curvature": tuple(shape), "confidence_limit": limit}
    return found, Flag(0) if trusted else Flag.DOUBTFUL
