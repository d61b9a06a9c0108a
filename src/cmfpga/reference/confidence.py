"""How sure the batch's v is, in float64: what :mod:`cmfpga.rtl.confidence` is measured against."""

from ..protocol.confidence import LIMIT_SCALE, PROBE, confidence, curvature, least_fall, probes_towards_zero
from . import flow


def of_round(pixels, done, settings):
    """Fields of the result that tell how sure v is, by their names in :mod:`cmfpga.protocol.results`.

    Parameters
    ----------
    pixels : int
        P.
    done : Ascent
        By rounds, the last of which tells.
    settings : BatchSettings
    """
    squares = pixels * (done.contrast[-1] + (done.sum_i[-1] / pixels) ** 2)
    return _told(float(squares.mean()), tuple(curvature(*done.g[-1].tolist())), settings)


def probe_flow(x, y, dt, v, found, b, settings, *, at_pixels, **size):
    """The same of a motion beyond translation, whose last iteration was at ``v``, and whose result is ``found``.

    ``x``, ``y``, ``dt``, ``b``, ``at_pixels`` and ``size`` are as of :func:`.flow.sums`.
    """
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
