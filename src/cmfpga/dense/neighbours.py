"""Whether the tiles around a tile bear out its flow in the direction that its own events leave open.

A tile that few edges cross (the aperture problem) has peaks of the contrast along them, too, where events meet by
chance. There a wrong v is off, and hardly across its edges. So each tile around says what v is across *its* edges, and
counts as far as that is the open direction. Figures: ``studies/accuracy/large.py``.
"""

import numpy as np

from ..protocol.confidence import information, is_judged
from .fields import basis, fit_field

#: Tiles farther apart disagree, px per half window: three quarters of what is called wrong (0.6 px), for they are
#: compared at an angle of up to 41° to the open direction.
ALIKE_PX = 0.45

#: Tiles of so many columns and rows around have a vote, those of the second ring half of one. Half a vote, too, has the
#: direction that a tile knows worst, if it is sure of that.
REACH, HALF = 2, 0.5

#: Of votes for it a tile needs as many as of one tile beside it that sees the open direction across its edges, and half
#: of all. A quarter of one must come from what tiles know well, or all may share one aperture problem.
FEWEST, MAJORITY, SEEN = 1.0, 0.5, 0.25

#: Where v is known along the worst direction by such a share of that along the best, edges have many directions.
EVEN = 0.5

#: Where fewer of the sure tiles are borne out, most are wrong, and neighbours agree by chance: none is to be trusted.
ORDERLY = 0.5


def borne_out(window):
    """Which sure tiles those around bear out: bool [n]. All, where nothing was judged, or there is nothing to compare.

    Compared are the tiles' flows, or what the slopes of an affine field leave of them where more agree then: a zoom
    or a turn is no disagreement, and neither are two motions side by side.
    """
    if len(window.tiles) == 1 or not any(map(is_judged, window.tiles.of(window.result))):
        return window.sure
    found = max((window.sure & _supported(window, v) for v in (window.v, window.v - _slopes(window))), key=np.sum)
    long = window.sure & ~window.short
    return found & ((found & long).sum() >= ORDERLY * long.sum())


def _slopes(window):
    """The affine field of the window without its constant part, px per half window: float64 [n, 2]; 0 without one."""
    values = fit_field("affine", window).values
    if np.isnan(values).any():
        return np.zeros_like(window.v)
    return np.einsum("apn,p->na", basis("affine", window.config, window.centres)[:, 2:], values[2:]) * window.half_s


def _supported(window, v):
    """Which tiles have enough of the votes around them, with the flow ``v``, px per half window: bool [n]."""
    shape = len(window.tiles.rows), len(window.tiles.columns)
    xx, yy, xy = window.each(lambda one: information(window.config, one) if is_judged(one) else None, (0.0,) * 3).T
    sharpness, directions = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1))
    worst, best = (directions[:, :, k].reshape(*shape, 2) for k in (0, 1))
    known = (sharpness[:, 1] >= window.config.confidence_limit).reshape(shape) & np.isfinite(v[:, 0]).reshape(shape)
    worst_known = known & window.sure.reshape(shape)
    even = (sharpness[:, 0] >= EVEN * sharpness[:, 1]).reshape(shape)
    v = np.nan_to_num(v).reshape(*shape, 2)
    every, agreeing, well = np.zeros((3, *shape))
    for down in range(-REACH, REACH + 1):
        for right in range(-REACH, REACH + 1):
            ring = max(abs(down), abs(right))
            if not ring or abs(down) >= shape[0] or abs(right) >= shape[1]:
                continue
            own, other = ((_part(down, sign), _part(right, sign)) for sign in (1, -1))
            for direction, asked, share in ((best, known, 1.0), (worst, worst_known, HALF)):
                across = direction[other]
                votes = (across * worst[own]).sum(-1) ** 2 * asked[other] * share * HALF ** (ring - 1)
                alike = np.abs((across * (v[own] - v[other])).sum(-1)) <= ALIKE_PX
                every[own] += votes
                agreeing[own] += votes * alike
                well[own] += votes * alike * (even[other] | (direction is best))
    return ((agreeing >= FEWEST) & (well >= SEEN) & (agreeing >= MAJORITY * every)).ravel()


def _part(shift, sign):
    """The indices of what has something ``shift`` further on (sign 1), or of that (sign −1)."""
    shift *= sign
    return slice(max(0, -shift), -shift if shift > 0 else None)
