"""What a window's events leave open although the contrast has a sharp peak: looked for after it was measured.

Each of :data:`PARTS` stretches of the window's time has an image. Its spectrum, times a phase, is that of the image
moved, so one transform serves all velocities that are asked for. Figures: ``studies/accuracy/ambiguous.py``.
"""

import enum
import functools
from math import hypot

import numpy as np

from ..imaging.iwe import scaled_roi_events
from ..protocol.confidence import confidence, information, is_judged, is_sure
from ..protocol.flags import Flag

PARTS = 12

#: Middles of those, in scaled time.
_TIMES = (np.arange(PARTS) + 0.5) * (2 / PARTS) - 1

#: Fewer time stamps say no velocity; of so many, times in a window are told apart.
FEWEST_STAMPS, STAMPS = 5.5, 64

#: Where fewer pixels make the contrast, a short motion is that of hot pixels.
FEWEST_PIXELS = 8

#: Structure across the main direction of the edges, as a share of that along it: below, there is an aperture problem.
ONE_DIRECTION = 0.05

#: Autocorrelation of the image at another place: the image repeats. Of edges of one direction it is less, and of a
#: flat peak that is not steady.
REPEATS, REPEATS_ALONG, REPEATS_FLAT = 0.85, 0.5, 0.6

#: Correlation of the images of every other event, and of the others: of less, the image is no edge's.
ALIKE = 0.1

#: As a share of that: how alike the images of the thirds of its time at v are, where one v holds in all of it. Of less,
#: what is seen stops, starts, shakes or turns.
LASTS = 0.85

#: All events of the window, of which the buffer holds a part, have the contrast's peak so far from v, px, and half as
#: far as the mean of the peaks of both halves of its time lies; no peak lies farther off than the second.
#: Of a peak that is SURE times as sharp as the flattest that is trusted it has to be FAR_PX; nearer ones are noise's.
ELSEWHERE_PX, FARTHEST_PX, FAR_PX, SURE = 1.2, 2.0, 1.6, 2.0

#: Where each block of the ROI takes a velocity of its own, out of nine this far apart, the contrast grows by so much in
#: units of its curvature: half the square of how far the blocks' velocities are off, px². More: two motions.
TWO_MOTIONS, STEP_PX, BLOCKS = 0.45, 1.0, 8

#: Where it grows by more than BLEND and an event says less than BLENDED about v (as of SHARP), v is a blend of motions,
#: and that of none of them. The peak of one thing that is blurred by noise lies farther from v than STEADY_PX.
BLEND, BLENDED, STEADY_PX = 0.1, 0.08, 0.55

#: Where the blocks' velocities are 1.5 px off v (rms), v is that of none of them; but only where an event says more
#: than CLEAR, and κ is less than so many times the smallest that is trusted. Noise blurs one motion's image below 0.16.
MIXED, CLEAR, MIXED_SURE = 1.5**2 / 2, 0.18, 3.0

#: Halves of the ROI that each have such a share of the contrast have its peak so far apart, px: with two motions, or
#: by itself where the peak is not flat.
LEAST_SHARE, APART_PX, FAR_APART_PX = 0.2, 0.7, 1.0

#: What an event says about v along the direction that is known best, 1/px². Below, noise blurs the image in all; where
#: events were thinned as well, those that are left may have a sharp peak by chance.
SHARP = 0.045

#: Structure of this wavelength and longer is left out, px; places nearer than this are the same edge's, px.
_LONGEST, _NEAR = 25.6, 3
_BLUR = 1.2  # rad/px


class Ambiguity(enum.IntFlag):
    """What is open about a window; 0: nothing."""

    FEW_STAMPS = 1
    STRIPES = 2
    ONE_DIRECTION = 4
    TWO_MOTIONS = 8
    FEW_PIXELS = 16
    ELSEWHERE = 32
    APART = 64
    ALONE = 128
    THINNED = 256
    CHANGES = 512


#: With these a window is not trusted. Two motions alone are only told: many windows of one motion look like that, too,
#: where its texture is dense (docs/is-it-right.md).
UNTRUSTED = ~Ambiguity.TWO_MOTIONS

#: In words.
WORDS = {
    Ambiguity.FEW_STAMPS: "few time stamps",
    Ambiguity.STRIPES: "stripes: may repeat",
    Ambiguity.ONE_DIRECTION: "one direction only",
    Ambiguity.TWO_MOTIONS: "two motions",
    Ambiguity.FEW_PIXELS: "hot pixels",
    Ambiguity.ELSEWHERE: "sharper elsewhere",
    Ambiguity.APART: "parts of the ROI move apart",
    Ambiguity.ALONE: "most windows around it are doubtful",
    Ambiguity.THINNED: "too few events kept",
    Ambiguity.CHANGES: "motion changes",
}


def ambiguity(config, events, result, **which):
    """The :class:`Ambiguity` of a window. A doubtful one is asked for time stamps and directions alone.

    ``events`` are where ROI and v have them; ``which`` is as of :func:`~cmfpga.imaging.iwe.scaled_roi_events`.
    """
    found, size = Ambiguity(0), (config.roi_height, config.roi_width)
    if not is_judged(result) or min(size) < 2 * BLOCKS:
        return found
    x, y, dt = scaled_roi_events(config, events, result.roi, **which)
    times = np.bincount(np.rint((dt + 1) * (STAMPS / 2)).astype(np.int64))
    if len(dt) ** 2 < FEWEST_STAMPS * (times**2).sum():
        return Ambiguity.FEW_STAMPS
    if config.motion != "translation":
        return found
    if Flag.SHORT in result.flags and _bright(x, y, size) < FEWEST_PIXELS:
        return Ambiguity.FEW_PIXELS
    halves = [_spectra(x[k::2], y[k::2], dt[k::2], size) for k in (0, 1)]
    by_time = np.stack([_moved(half, result.v, size) for half in halves])
    moved = by_time.sum(1)
    parts, middle = sum(halves), moved[:, 4].sum(0)
    brief = parts[PARTS // 2 - 2 : PARTS // 2 + 2].sum(0)
    if min(_across(one, size) for one in (middle, parts.sum(0), brief)) < ONE_DIRECTION:
        found |= Ambiguity.ONE_DIRECTION
    if not is_sure(result):
        return found
    images = np.fft.irfft2(moved, [2 * (side // 4) for side in size])
    alike = (images[0, 4] * images[1, 4]).sum() / max((images[:, 4] ** 2).sum() / 2, 1e-12)
    kappa, elsewhere = confidence(config, result), _elsewhere(by_time.sum(0))
    flat, steady = kappa < SURE * config.confidence_limit, elsewhere < STEADY_PX
    most = REPEATS_ALONG if found else REPEATS_FLAT if flat and not steady else REPEATS
    if alike < ALIKE or _repeats(middle, size) > most:
        return found | Ambiguity.STRIPES
    if not found and elsewhere > (ELSEWHERE_PX if flat else FAR_PX):
        found |= Ambiguity.ELSEWHERE
    elif min(size) >= 4 * BLOCKS and _lasting(parts, images[:, 4], result.v, size) < LASTS:
        return found | Ambiguity.CHANGES
    best, grown = best_known(config, result), _by_blocks(images) / max(kappa / result.roi_events, 1e-12)
    if which.get("thinned") and best < SHARP:
        return found | Ambiguity.THINNED
    if found or best < SHARP:
        return found
    two, apart = grown > TWO_MOTIONS, _halves_apart(images)
    most = APART_PX if two else np.inf if flat else FAR_APART_PX
    mixed = best > CLEAR and grown > MIXED and kappa < MIXED_SURE * config.confidence_limit
    if mixed or (steady and (apart > most or (best < BLENDED and grown > BLEND))):
        return found | Ambiguity.TWO_MOTIONS | Ambiguity.APART
    return found | Ambiguity.TWO_MOTIONS if two else found


def _bright(x, y, size):
    """How many pixels make the contrast of the image at rest, if each had as large a share."""
    squares = np.bincount(np.rint(y).astype(np.int64) * size[1] + np.rint(x).astype(np.int64)) ** 2.0
    return squares.sum() ** 2 / (squares**2).sum()


@functools.lru_cache(maxsize=8)
def _kept(size):
    """Which rows and columns of a spectrum are kept, half of all; their frequencies, rad/px; the weights."""
    rows, columns = np.r_[: size[0] // 4, size[0] - size[0] // 4 : size[0]], size[1] // 4 + 1
    down, right = 2 * np.pi * np.fft.fftfreq(size[0])[rows, None], 2 * np.pi * np.fft.rfftfreq(size[1])[:columns]
    radius = np.hypot(down, right)
    return rows, columns, down, right, (radius > 2 * np.pi / _LONGEST) * np.exp(-0.5 * (radius / _BLUR) ** 2)


def _spectra(x, y, dt, size):
    """Spectra of the images of each part of the time: complex [PARTS, rows, columns]."""
    (height, width), (rows, columns, _, _, weights) = size, _kept(size)
    part = np.minimum(((dt + 1) * (PARTS / 2)).astype(np.int64), PARTS - 1)
    x, y = (np.clip(np.rint(at).astype(np.int64), 0, most - 1) for at, most in ((x, width), (y, height)))
    images = np.bincount((part * height + y) * width + x, minlength=PARTS * height * width)
    return np.fft.rfft2(images.reshape(PARTS, height, width))[:, rows, :columns] * weights


def _moved(parts, v, size):
    """Spectra of the images of warped events at v, number 4, and a step beside it on all sides.

    Of both halves of the time: complex [2, 9, rows, columns].
    """
    _, _, down, right, _ = _kept(size)
    steps, halves = np.array([-STEP_PX, 0, STEP_PX]), (slice(PARTS // 2), slice(PARTS // 2, None))
    across, along = (
        np.exp(1j * np.multiply.outer(np.multiply.outer(v[k] + steps, _TIMES), f))
        for k, f in ((0, right), (1, down[:, 0]))
    )
    return np.stack([
        np.concatenate([np.einsum("bkl,gbl->gkl", (parts * one[..., None])[half], across[:, half]) for one in along])
        for half in halves
    ])  # fmt: skip


def _lasting(parts, images, v, size):
    """How alike the images of the thirds of the time at v are, as a share of how alike those of all of it are.

    The first and the last, or the middle one and both. ``images`` are of every other event, and of the others. What the
    ROI's border cuts at some time does not count, unless v is beyond a fifth of the ROI's side.
    """
    _, _, down, right, _ = _kept(size)
    moved = parts * np.exp(1j * np.multiply.outer(_TIMES, v[0] * right + v[1] * down))
    thirds = np.fft.irfft2(moved.reshape(3, PARTS // 3, *moved.shape[1:]).sum(1), images.shape[1:])
    rims = (min(int(abs(one) / 2) + 2, side // 4) for one, side in zip(v[::-1], images.shape[1:], strict=True))
    inner = (..., *(slice(rim, -rim) for rim in rims))
    first, middle, last = thirds[inner]
    near = (_alike(first, middle) + _alike(middle, last)) / 2
    return min(near, _alike(first, last)) / max(_alike(*images[inner]), 1e-12)


def _alike(one, other):
    """The correlation of two images without a mean."""
    return (one * other).sum() / max(np.sqrt((one**2).sum() * (other**2).sum()), 1e-12)


def _elsewhere(by_time):
    """How far from v the contrast's peak lies, and half as far as the mean of the peaks of both halves, px."""
    power = np.abs([by_time.sum(0), *by_time]) ** 2
    power[..., 0] /= 2  # the others stand for two each
    nowhere = np.full(2, FARTHEST_PX / np.sqrt(2))
    whole, first, last = (nowhere if (at := _peak(one)) is None else at for one in power.sum((2, 3)))
    return np.hypot(*whole) + np.hypot(*(first + last) / 2) / 2


def _halves_apart(images):
    """How far apart the contrast's peaks of the left and the right half lie, or of the upper and the lower, px."""
    whole, found = images.sum(0) ** 2, [0.0]
    rows, columns = (side // 2 for side in whole.shape[1:])
    for pair in ((whole[:, :, :columns], whole[:, :, columns:]), (whole[:, :rows], whole[:, rows:])):
        values = [half.sum((1, 2)) for half in pair]
        one, two = map(_peak, values)
        least = min(one[4] for one in values)
        if one is not None and two is not None and least >= LEAST_SHARE * whole[4].sum():
            found.append(np.hypot(*(one - two)))
    return max(found)


def _peak(nine):
    """Where the peak of nine values around v lies beside it, px, by a step of Newton; None where there is none.

    No farther than :data:`FARTHEST_PX`.
    """
    values = nine.reshape(3, 3)
    twice = 2 * values[1, 1]
    xx, yy = values[1, ::2].sum() - twice, values[::2, 1].sum() - twice
    xy = (values[::2, ::2] * [[1, -1], [-1, 1]]).sum() / 4
    if xx >= 0 or xx * yy <= xy * xy:
        return None
    x, y = (values[1, 2] - values[1, 0]) / 2, (values[2, 1] - values[0, 1]) / 2
    step = np.array([xy * y - yy * x, xy * x - xx * y]) / (xx * yy - xy * xy) * STEP_PX
    return step * FARTHEST_PX / max(np.hypot(*step), FARTHEST_PX)


def _across(spectrum, size):
    """The smaller eigenvalue of the structure tensor as a share of the larger one."""
    _, _, down, right, _ = _kept(size)
    power = np.abs(spectrum) ** 2
    power[:, 0] /= 2  # the others stand for two each
    xx, yy, xy = (power * right * right).sum(), (power * down * down).sum(), (power * down * right).sum()
    middle, spread = (xx + yy) / 2, hypot((xx - yy) / 2, xy)
    return (middle - spread) / (middle + spread) if middle else 1.0


def _repeats(spectrum, size):
    """The highest peak of the autocorrelation away from the middle."""
    rows, columns = (2 * (side // 4) for side in size)
    same = np.fft.fftshift(np.fft.irfft2(np.abs(spectrum) ** 2, (rows, columns)))
    inner, place = same[1:-1, 1:-1], np.indices((rows, columns))[:, 1:-1, 1:-1]
    far = 2 * np.hypot(place[0] - rows // 2, place[1] - columns // 2) >= _NEAR
    shifts = [(j, i) for j in range(3) for i in range(3) if (j, i) != (1, 1)]
    peak = np.all([inner >= same[j : rows - 2 + j, i : columns - 2 + i] for j, i in shifts], axis=0)
    return inner[far & peak].max(initial=0) / max(same.max(), 1e-12)


def best_known(config, result):
    """What an event says about v along the direction that is known best, 1/px²; of a window that was judged."""
    xx, yy, xy = information(config, result)
    return ((xx + yy) / 2 + hypot((xx - yy) / 2, xy)) / result.roi_events


def _by_blocks(images):
    """By which share the contrast grows where each block takes the best of the velocities.

    Of products of the two halves' images, [2, 9, rows, columns], in which noise cancels; the least of four tilings, for
    edges between two blocks move from one to the other.
    """
    rows, columns = (side // BLOCKS for side in images.shape[2:])
    both, grown = images[0] * images[1], []
    for shift in ((0, 0), (rows // 2, 0), (0, columns // 2), (rows // 2, columns // 2)):
        tiles = np.roll(both, shift, (1, 2))[:, : rows * BLOCKS, : columns * BLOCKS]
        tiles = tiles.reshape(len(both), BLOCKS, rows, BLOCKS, columns).sum((2, 4))
        grown.append((tiles.max(0) - tiles[4]).sum() / max(tiles[4].sum(), 1e-12))
    return min(grown)
