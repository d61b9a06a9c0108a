"""What the parameters of a motion mean, in pixels and in physical units; and where the hardware takes an event to be.

Conventions. The image has x to the right and y down; a camera's frame is OpenCV's: x to the right, y down, z forward.
An event at x, y moves by u per half batch, so that x' = x − dt·u is where it was seen in the batch's middle.

- ``similarity``: u = v + (zoom·p − roll·q, zoom·q + roll·p)/L at (p, q) px from the ROI's centre. A positive zoom
  grows, what is seen comes nearer; a positive roll turns from x to y, clockwise on the screen.
- ``rotation``: the camera's own angular velocity ω, a right-handed one, in the camera's frame. A still scene moves the
  other way round: v = (−f·ωy, f·ωx)·T at the principal point, roll = −L·ωz·T.

L = 2^lever px is the lever arm of :class:`~cmfpga.config.motion.MotionModel`, T half a batch, f = √(fx·fy).

:func:`undistort` is the model of :mod:`cmfpga.rtl.ingest.undistorter`. Positions are raw integers with
``formats.event_frac`` fraction bits, 0 of them where the hardware does not undistort. NumPy alone.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np

from .camera import Camera

#: What :func:`rates` tells, by the value of ``Config.motion``.
RATES = {
    "translation": (),
    "similarity": ("zoom_per_s", "roll_rad_per_s", "time_to_contact_s"),
    "rotation": ("wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"),
}


def rates(config, v, span):
    """A motion in physical units: ``{name: value}`` of :data:`RATES`; None where there is none.

    ``v`` are the parameters, in the order of ``config.motion_model.names``, px per half batch; ``span`` is t_N − t_1 of
    the batch, µs, 0 where nothing was measured. A rotation needs a camera in ``config``.

    ``zoom_per_s``: 1/s; ``time_to_contact_s``: its inverse, s, None without a zoom, negative of what goes away;
    ``roll_rad_per_s`` and ``wx_rad_per_s``, …: rad/s.
    """
    names, motion, half = RATES[config.motion], config.motion_model, span / 2e6
    if not span or not names:
        return dict.fromkeys(names)
    lever = half * (1 << motion.lever)
    v = dict(zip(motion.names, v, strict=True))
    if config.motion == "similarity":
        found = v["zoom"] / lever, v["roll"] / lever, lever / v["zoom"] if v["zoom"] else None
        return dict(zip(names, found, strict=True))
    focus = half * math.sqrt(config.lens[0] * config.lens[1])
    return dict(zip(names, (v["y"] / focus, -v["x"] / focus, -v["roll"] / lever), strict=True))


def parameters(config, found, span):
    """The other way round: v, px per half batch, of what :func:`rates` gives for a batch of ``span`` µs.

    ``found`` is (ωx, ωy, ωz) in rad/s; or, of a similarity, vx, vy in px/s, zoom in 1/s, roll in rad/s.
    """
    half = span / 2e6
    lever = half * (1 << config.motion_model.lever)
    if config.motion == "rotation":
        focus = half * math.sqrt(config.lens[0] * config.lens[1])
        return -found[1] * focus, found[0] * focus, -found[2] * lever
    return tuple(one * scale for one, scale in zip(found, (half, half, lever, lever), strict=True))


def flow(config, v, x, y, roi):
    """How far events move along x and y per half batch, px: two float64 [n]; of a translation ``v`` itself.

    ``v`` is as of :func:`rates`; ``x``, ``y`` are arrays [n] of columns and rows in the ROI, whose left column and top
    row are ``roi``, all in px.
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


def node_table(config, lens):
    """How far each node moves what lies on it: raw ``formats.node_x``, ``formats.node_y``; int64 [2, rows, columns].

    ``lens`` has the nine numbers of a :class:`Camera`, or (), where nothing moves. Raises :exc:`ConfigError` where the
    distortion has no inverse on the sensor.
    """
    size, formats = config.geometry.size, config.formats
    return _table(size, config.undistortion_cell, formats.node_x, formats.node_y, lens)


@functools.lru_cache(maxsize=8)
def _table(size, cell, node_x, node_y, lens):
    nodes = [np.arange(((side - 1) >> cell) + 2) << cell for side in size]
    shape = len(nodes[1]), len(nodes[0])
    if not lens:
        return np.zeros((2, *shape), np.int64)
    # The last nodes may lie beyond the sensor, where the camera has nothing to say: the line through its last pixel.
    column, row = np.meshgrid(*(np.minimum(at, side - 1) for at, side in zip(nodes, size, strict=True)))
    at = np.stack([column.ravel(), row.ravel()])
    moved = (Camera(*lens).undistorted(*at) - at).reshape(2, *shape)
    for axis, side in ((1, size[1]), (2, size[0])):
        near, last = np.moveaxis(moved, axis, 0)[-2:]
        last += (last - near) * ((1 << cell) / max(1, (side - 1) % (1 << cell)) - 1)
    # Between nodes a chord lies on one side of a curve: by 1/12 of the second difference on average, along each axis.
    bend = np.zeros_like(moved)
    for axis in (1, 2):
        if moved.shape[axis] > 2:
            rest = [(1, 1) if k == axis else (0, 0) for k in range(3)]
            bend += np.pad(np.diff(moved, 2, axis=axis), rest, mode="edge")
    moved -= bend / 12
    axes = zip(moved, (node_x, node_y), strict=True)
    rounded = [np.clip(np.floor(axis * (1 << fmt.f) + 0.5), fmt.min, fmt.max) for axis, fmt in axes]
    return np.stack(rounded).astype(np.int64)


def node_writes(config, lens):
    """What has to be written to undistort for a camera: [(column, row, x, y)], the nodes in order."""
    table = node_table(config, lens)
    _, rows, columns = table.shape
    return [(c, r, int(table[0, r, c]), int(table[1, r, c])) for r in range(rows) for c in range(columns)]


def undistort(config, lens, x, y):
    """Binned and undistorted positions of events, rounded to ``event_frac`` bits: two int64 [n], raw.

    ``x``, ``y`` are integer arrays [n] of the sensor's columns and rows, ``lens`` is as of :func:`node_table`. Binned
    first (:mod:`cmfpga.rtl.ingest.binning`), so that the table is as small as the image; then interpolated exactly
    between the four nodes around an event's pixel.
    """
    x, y = (np.asarray(axis).astype(np.int64) >> config.binning for axis in (x, y))
    frac = config.formats.event_frac
    if not (lens and frac):
        return x << frac, y << frac
    table, cell = node_table(config, lens), config.undistortion_cell
    side = 1 << cell
    column, row, right, down = x >> cell, y >> cell, x & (side - 1), y & (side - 1)

    def between(rows):
        return (table[:, rows, column] << cell) + (table[:, rows, column + 1] - table[:, rows, column]) * right

    top = between(row)
    moved = (top << cell) + (between(row + 1) - top) * down
    drop = 2 * cell + config.formats.node_x.f - frac
    return tuple((axis << frac) + ((by + (1 << (drop - 1))) >> drop) for axis, by in zip((x, y), moved, strict=True))


@dataclass(frozen=True, eq=False)
class Seen:
    """Events as the ROI filter sees them: ``x`` and ``y`` px of the binned and undistorted image, float64 [n]."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray

    def __len__(self):
        return len(self.t)


def seen(config, events):
    """The :class:`Seen` of ``events``; the same object without binning or a camera."""
    if not (config.lens or config.binning):
        return events
    x, y = (axis * 2.0**-config.formats.event_frac for axis in undistort(config, config.lens, events.x, events.y))
    return Seen(events.t, x, y, events.p)


def nearest(config, x, y):
    """Whole pixels of positions, int64 [n] each, and which lie on the sensor's image."""
    x, y = (np.floor(np.asarray(axis) + 0.5).astype(np.int64) for axis in (x, y))
    return x, y, (x >= 0) & (x < config.geometry.width) & (y >= 0) & (y < config.geometry.height)
