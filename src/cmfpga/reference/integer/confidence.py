"""Model of :mod:`cmfpga.rtl.confidence`: the evaluations beside v, and the verdict."""

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


def probes(config, v):
    """The raw velocities that are evaluated behind a batch's last iteration, whose result is ``v``; not of rounds."""
    fmt, distance = config.formats.v, 3 << (config.v_frac - 2)
    if config.motion_model.basis:
        return probes_towards_zero(v, distance)
    return probe_velocities(v, distance, fmt.min, fmt.max)


def confidence(config, sums, last, probed, settings, n):
    """What the hardware finds behind a batch's last iteration: (fields of the result, flags).

    Parameters
    ----------
    config : Config
    sums : tuple of int
        Of the last iteration; of a round the means, floored.
    last, probed : sequences of IntegerIteration
        The evaluations of the last iteration; those beside v. A round's are the same four.
    settings : BatchSettings
    n : int
        Events of each.
    """
    squares = sum(int((one.images.i**2).sum()) for one in last) // len(last)
    found = not_judged(config) | {"sum_squares": squares}
    if not settings.judge:  # a round has its curvature all the same
        found |= {"curvature": tuple(curvature(*(one.g for one in probed)))} if len(last) > 1 else {}
        return found, Flag(0)
    limit, gradients = settings.confidence_limit, [one.g for one in probed]
    if config.motion_model.basis:
        shape = (least_fall(last[0].v_next, last[0].g, gradients),)
        trusted = is_sharp(config, n, limit, *shape, squares)
    else:
        shape = curvature(*gradients)
        trusted = is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, sums, squares))
    found |= {"curvature": tuple(shape), "confidence_limit": limit}
    return found, Flag(0) if trusted else Flag.DOUBTFUL
