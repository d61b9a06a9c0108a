"""Model of :mod:`cmfpga.rtl.ingest.undistorter`, and the table that it reads. NumPy alone, so that tools see the same.

Positions are raw integers with ``formats.event_frac`` fraction bits, 0 of them where the hardware does not undistort.
"""

import functools
from dataclasses import dataclass

import numpy as np

from .camera import Camera


def node_table(config, lens):
    """How far each node moves what lies on it: raw ``formats.node_x``, ``formats.node_y``; int64 [2, rows, columns].

    Parameters
    ----------
    config : Config
        Sizes and formats.
    lens : tuple
        The nine numbers of a :class:`Camera`; (): nothing moves.

    Raises
    ------
    ConfigError
        The distortion has no inverse on the sensor.
    """
    size, formats = (config.sensor_width, config.sensor_height), config.formats
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
    return np.stack(
        [
            np.clip(np.floor(axis * (1 << fmt.f) + 0.5), fmt.min, fmt.max).astype(np.int64)
            for axis, fmt in zip(moved, (node_x, node_y), strict=True)
        ]
    )


def node_writes(config, lens):
    """What has to be written to undistort for a camera: [(column, row, x, y)], the nodes in order."""
    table = node_table(config, lens)
    _, rows, columns = table.shape
    return [(c, r, int(table[0, r, c]), int(table[1, r, c])) for r in range(rows) for c in range(columns)]


def undistort(config, lens, x, y):
    """Undistorted positions of events, rounded to ``event_frac`` bits: two int64 [n], raw.

    Interpolated exactly between the four nodes around an event's pixel.

    Parameters
    ----------
    config : Config
    lens : tuple
        As of :func:`node_table`.
    x, y : integer arrays [n]
        Columns and rows of the sensor.
    """
    x, y = (np.asarray(axis).astype(np.int64) for axis in (x, y))
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
    """Events as the ROI filter sees them: ``x`` and ``y`` in the undistorted image, px, float64 [n]."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray

    def __len__(self):
        return len(self.t)


def seen(config, events):
    """The :class:`Seen` of ``events``; the same object without a camera."""
    if not config.lens:
        return events
    x, y = (axis * 2.0**-config.formats.event_frac for axis in undistort(config, config.lens, events.x, events.y))
    return Seen(events.t, x, y, events.p)


def nearest(config, x, y):
    """Whole pixels of positions, int64 [n] each, and which lie on the sensor."""
    x, y = (np.floor(np.asarray(axis) + 0.5).astype(np.int64) for axis in (x, y))
    return x, y, (x >= 0) & (x < config.sensor_width) & (y >= 0) & (y < config.sensor_height)
