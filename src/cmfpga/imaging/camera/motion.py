"""What the parameters of a motion mean: how far they move an event, and how fast that is in physical units.

Conventions. The image has x to the right and y down; a camera's frame is OpenCV's: x to the right, y down, z forward.
An event at x, y moves by u per half batch, so that x' = x − dt·u is where it was seen in the batch's middle.

- ``similarity``: u = v + (zoom·p − roll·q, zoom·q + roll·p)/L at (p, q) px from the ROI's centre. A positive zoom
  grows, what is seen comes nearer; a positive roll turns from x to y, clockwise on the screen.
- ``rotation``: the camera's own angular velocity ω, a right-handed one, in the camera's frame. A still scene moves the
  other way round: v = (−f·ωy, f·ωx)·T at the principal point, roll = −L·ωz·T.

L = 2^lever px is the lever arm of :class:`~cmfpga.config.motion.MotionModel`, T half a batch, f = √(fx·fy). NumPy
alone.
"""

import math

import numpy as np

#: What :func:`rates` tells, by the value of ``Config.motion``.
RATES = {
    "translation": (),
    "similarity": ("zoom_per_s", "roll_rad_per_s", "time_to_contact_s"),
    "rotation": ("wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"),
}


def rates(config, v, span):
    """A motion in physical units: ``{name: value}`` of :data:`RATES`; None where there is none.

    Parameters
    ----------
    config : Config
        For a rotation with a camera.
    v : sequence of float
        Parameters, in the order of ``config.motion_model.names``; px per half batch.
    span : int
        t_N − t_1 of the batch, µs; 0: nothing was measured.

    Returns
    -------
    dict
        ``zoom_per_s``: 1/s; ``time_to_contact_s``: its inverse, s, None without a zoom, negative of what goes away;
        ``roll_rad_per_s`` and ``wx_rad_per_s``, …: rad/s.
    """
    names = RATES[config.motion]
    if not span or not names:
        return dict.fromkeys(names)
    motion, half = config.motion_model, span / 2e6
    lever = half * (1 << motion.lever)
    v = dict(zip(motion.names, v, strict=True))
    if config.motion == "similarity":
        found = v["zoom"] / lever, v["roll"] / lever, lever / v["zoom"] if v["zoom"] else None
        return dict(zip(names, found, strict=True))
    focus = half * math.sqrt(config.lens[0] * config.lens[1])
    return dict(zip(names, (v["y"] / focus, -v["x"] / focus, -v["roll"] / lever), strict=True))


def parameters(config, found, span):
    """The other way round: v, px per half batch, of what :func:`rates` gives.

    Parameters
    ----------
    config : Config
    found : sequence of float
        (ωx, ωy, ωz) in rad/s; or, of a similarity, (vx, vy) in px/s, zoom in 1/s, roll in rad/s.
    span : int
        µs.
    """
    half = span / 2e6
    lever = half * (1 << config.motion_model.lever)
    if config.motion == "rotation":
        focus = half * math.sqrt(config.lens[0] * config.lens[1])
        return -found[1] * focus, found[0] * focus, -found[2] * lever
    return tuple(one * scale for one, scale in zip(found, (half, half, lever, lever), strict=True))


def flow(config, v, x, y, roi):
    """How far events move along x and y per half batch, px: two float64 [n]; of a translation ``v`` itself.

    Parameters
    ----------
    config : Config
    v : sequence of float
        As of :func:`rates`.
    x, y : arrays [n]
        Columns and rows in the ROI, px.
    roi : pair of int
        Its left column and top row, px.
    """
    motion = config.motion_model
    if not motion.basis:
        return v
    bent, lever = "xx" in motion.basis, 1 << motion.lever
    if bent:
        middle = [at - corner for at, corner in zip(config.lens[2:4], roi, strict=True)]
    else:
        middle = [(size - 1) / 2 for size in (config.roi_width, config.roi_height)]
    p, q = (np.asarray(axis, np.float64) - at for axis, at in zip((x, y), middle, strict=True))
    basis = {"p": p / lever, "q": q / lever}
    if bent:
        square = config.lens[0] * config.lens[1]
        basis |= {"xx": p * p / square, "xy": p * q / square, "yy": q * q / square}
    v = dict(zip(motion.names, v, strict=True))
    return tuple(
        v[axis] + sum(sign * v[name] * basis[member] for name, member, sign in terms)
        for axis, terms in motion.terms.items()
    )


def extent(config, v, roi):
    """How far the image moves, px per half batch: at the ROI's centre, or at its edge, in the middle of each side.

    The larger of the two, which of a translation are the same.
    """
    if not config.motion_model.basis:
        return math.hypot(*v)
    right, bottom = config.roi_width - 1, config.roi_height - 1
    x = np.array([right / 2, 0, right, right / 2, right / 2])
    y = np.array([bottom / 2, bottom / 2, bottom / 2, 0, bottom])
    moved = np.hypot(*flow(config, v, x, y, roi))
    return float(max(moved[0], moved[1:].mean()))
