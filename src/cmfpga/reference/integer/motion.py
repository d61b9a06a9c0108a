"""Model of :mod:`cmfpga.rtl.image.basis`, :mod:`cmfpga.rtl.image.flow` and :mod:`cmfpga.rtl.image.moments`.

A motion whose basis depends on the position, :class:`cmfpga.config.motion.MotionModel`. Along an axis an event moves
by u = v + Σ v_p·b_p. In a similarity S_p = Σ b_p·I·D over the pixels. In a rotation what an event adds to Σ I·D of the
axis, times its own b_p, is what it adds to S_p: for the votes that it meets in its pixels that is not their own basis,
but that of an event at most a few px away.
"""

import numpy as np
import torch

from ...fixed import floor_shift, round_half_up, saturate


def basis(config, x, y, *, roi, camera, middle=None):
    """``{member: int64 [n]}`` of the basis at events, raw; nothing where v is a translation.

    ``x``, ``y`` are int64 tensors [n], columns and rows in the ROI with ``dithered_frac`` fraction bits. The others are
    as of :func:`cmfpga.reference.flow.basis`.
    """
    motion = config.motion_model
    if not motion.basis:
        return {}
    if config.motion == "rotation":
        centre = [at - (corner << motion.place_frac) for at, corner in zip(motion.centre(camera), roi, strict=True)]
    else:
        centre = [2 * at for at in middle or config.geometry.middle]
    drop = config.formats.dithered_frac - motion.place_frac
    p, q = (floor_shift(axis, drop) - middle for axis, middle in zip((x, y), centre, strict=True))
    found = {"p": p, "q": q}
    if "xx" in motion.basis:
        across, down, fmt = p >> motion.place_frac, q >> motion.place_frac, motion.basis["xx"]
        for name, product in (("xx", across * across), ("xy", across * down), ("yy", down * down)):
            bent = round_half_up(product * motion.curve(camera), motion.curve_frac - motion.frac)
            found[name] = saturate(bent, fmt.min, fmt.max)
    return found


def flow(config, v, b):
    """How far events of a :func:`basis` ``b`` move along x and y per unit of dt: raw, ``v_frac`` fraction bits."""
    motion = config.motion_model
    if not motion.basis:
        return v
    v = dict(zip(motion.names, v, strict=True))
    moved = []
    for axis, terms in motion.terms.items():
        more = sum((sign * v[name] * b[member] for name, member, sign in terms), torch.tensor(0))
        moved.append(v[axis] + round_half_up(more, motion.frac))
    return moved


def growths(config, votes):
    """What each event adds to Σ I·Dx and to Σ I·Dy, one event after the other: two int64 [n].

    A vote turns (I, D) of its pixel into (I + w, D + d), and adds I·d + w·(D + d).
    """
    keep = votes.inside.flatten().numpy()
    pixel = (votes.row * config.roi_width + votes.column).flatten().numpy()[keep]
    # A stable sort of 16-bit numbers is a radix sort, ten times as fast as others.
    order = np.argsort(pixel.astype(np.min_scalar_type(config.geometry.pixels - 1)), kind="stable")
    pixel, number = pixel[order], np.arange(len(order))
    first = np.maximum.accumulate(np.where(np.diff(pixel, prepend=-1) != 0, number, 0))
    event = np.flatnonzero(keep)[order] // 4

    def sorted_votes(values):
        values = values.flatten().numpy()[keep][order]
        total = values.cumsum() - values
        return values, total - total[first]  # what the pixel had before

    w, i = sorted_votes(votes.w)
    grown = []
    for values in (votes.dx, votes.dy):
        d, before = sorted_votes(values)
        grown.append(np.zeros(len(votes.w), np.int64))
        np.add.at(grown[-1], event, i * d + w * (before + d))
    return [torch.from_numpy(each) for each in grown]


def moments(config, votes, images, b, level, middle=None):
    """S of each parameter, in the order of the motion's names: list of int; ``middle`` is that of :func:`basis`."""
    motion = config.motion_model
    if motion.of_pixels:
        # What a pixel has added in the end, and the middle of pixels 2^level px wide: (c + ½)·2^level − ½ px.
        grown = {"x": images.i * images.dx, "y": images.i * images.dy}
        unit = 1 << (level + motion.place_frac)
        p, q = (
            torch.arange(size) * unit + unit // 2 - 2 * (at + 1)
            for size, at in zip((config.roi_width, config.roi_height), middle or config.geometry.middle, strict=True)
        )
        b = {"p": p, "q": q[:, None]}
    else:
        grown = dict(zip(("x", "y"), growths(config, votes), strict=True))
    return [
        int(
            (grown[name].sum() << motion.frac if name in grown else 0)
            + sum(sign * (grown[axis] * b[member]).sum() for axis, member, sign in motion.factors(name))
        )
        for name in motion.names
    ]
