"""Model of :mod:`cmfpga.rtl.confidence`: the evaluations beside v, and the verdict."""

from ...protocol.confidence import contrast, curvature, is_sharp, is_trusted, least_fall
from ...protocol.flags import Flag
from ...protocol.results import not_judged


def confidence(config, sums, last, probed, settings, n):
    """What the hardware finds behind a batch's last iteration: (fields of the result, flags).

    Parameters
    ----------
    config : Config
    sums : tuple of int
        Of the last iteration; of a round the means, floored.
    last, probed : sequences of IntegerIteration
        The evaluations of the last iteration; those beside v, of a motion beyond translation.
    settings : BatchSettings
    n : int
        Events of each.
    """
    squares = sum(int((one.images.i**2).sum()) for one in last) // len(last)
    limit, found = settings.confidence_limit, not_judged(config) | {"sum_squares": squares}
    if not config.motion_model.basis:  # a round has its curvature, whether it is judged or not
        shape = curvature(*(one.g for one in last))
        found["curvature"] = tuple(shape)
        trusted = is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, sums, squares))
    elif settings.judge:
        least = least_fall(last[0].v_next, last[0].g, [one.g for one in probed])
        found["curvature"] = (least,)
        trusted = is_sharp(config, n, limit, least, squares)
    if not settings.judge:
        return found, Flag(0)
    return found | {"confidence_limit": limit}, Flag(0) if trusted else Flag.DOUBTFUL
