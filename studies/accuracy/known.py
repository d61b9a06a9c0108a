"""Recordings whose motion is known, tracked in the default use: an ROI, and no option about batches.

The truth never comes from the tracker. It is what generated the scene; or one motion for all events of the sensor, by
the global float search (:mod:`cmfpga.reference.global_search`); or a circle; or a gyroscope. Each says how well it is
known.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from cmfpga.errors import RecordingError
from cmfpga.events import Events, generate, open_recording
from cmfpga.imaging.camera import read_calibration
from cmfpga.reference.global_search import affine, rotation, search, translation

from .yardstick import ROI

#: Generated: texture, velocity (px/s), noise, size of the object (px), contrast. It crosses the sensor's middle.
SCENES = (
    ("lines", (150, 60), 0.1, (40, 40), 1.0),
    ("dense", (-80, 120), 0.1, (40, 40), 1.0),
    ("lines", (-400, 0), 0.2, (30, 50), 1.5),
    ("dense", (40, -30), 0.2, (44, 44), 0.5),
)
SENSOR = (240, 180)
WAY = 60.0  # px that an object moves at most
LONGEST_US = 1_500_000
#: Of scenes that are drawn: log10 of the speed in px/s, sizes in px; by kind the largest share of noise, contrast.
DRAWN_SPEED, DRAWN_SIZE = (1.3, 2.8), (16, 161)
DRAWN = {"usual": (0.2, (0.5, 2.0)), "faint": (0.25, (0.4, 1.2))}
#: Where the first batch's ROI lies off an object's place then, px.
OFFSETS = tuple((x, y) for y in range(-20, 21, 10) for x in range(-24, 25, 6))
GRID = (9, 5)  # columns and rows of ROIs over a whole sensor
CALIBRATED = 24  # from this column on the calibration of the turning camera holds, px


@dataclass(frozen=True, eq=False)
class Known:
    """A recording, and how its image moves.

    ``truth(first, last, columns, rows)`` is the mean (vx, vy) in px/s of what is seen there, between two times in µs on
    the recording's clock; columns and rows are those of the ROI's events, px. ``doubt`` (px/s) and ``doubt_px`` (px per
    half batch, however long the batch is) say how well it is known: standard deviation, or half of the range of several
    estimates.
    """

    name: str
    events: Events
    sensor: tuple[int, int]  # width and height, px
    rois: tuple  # where tracks start: left column and top row, px
    truth: Callable
    doubt: float = 0.0
    doubt_px: float = 0.0
    in_sum: bool = True  # counts in the sum of all recordings
    left: int = 0  # nothing is known of the image left of this column, px


def generated():
    """The generated recordings, a list of :class:`Known`."""
    return [_scene(seed, *what) for seed, what in enumerate(SCENES, 1)]


def _scene(seed, texture, velocity, noise, size, contrast):
    duration = min(int(WAY / math.hypot(*velocity) * 1e6), LONGEST_US)
    start = [side / 2 - axis * duration / 2e6 for side, axis in zip(SENSOR, velocity, strict=True)]
    made = generate(
        seed=seed, width=SENSOR[0], height=SENSOR[1], texture=texture, size=size, position=tuple(start),
        velocity=velocity, duration_us=duration, contrast=contrast, noise=noise,
    )  # fmt: skip
    motion = made.motion
    name = f"generated {seed}, {texture}, {math.hypot(*velocity):.0f} px/s"
    return Known(name, made.events, SENSOR, _around(start, SENSOR), lambda a, b, *_: motion.mean_velocity(a, b))


def drawn(count, seed, kind):
    """Yields ``count`` scenes of one object, everything drawn, a :class:`Known` each; the ROI lies on the object."""
    most_noise, contrasts = DRAWN[kind]
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        speed, angle = 10 ** rng.uniform(*DRAWN_SPEED), rng.uniform(0, 2 * math.pi)
        velocity = speed * np.array([math.cos(angle), math.sin(angle)])
        size = tuple(int(side) for side in rng.integers(*DRAWN_SIZE, 2))
        noise, contrast = rng.uniform(0, most_noise), math.exp(rng.uniform(*np.log(contrasts)))
        one = _scene(seed * 10_000 + k, ("lines", "dense")[k % 2], velocity, noise, size, contrast)
        yield replace(one, rois=(one.rois[rng.integers(len(one.rois))],))


def _around(centre, sensor):
    """ROIs around a place, inside the sensor."""
    corners = np.clip(np.add(centre, OFFSETS) - ROI / 2, 0, np.subtract(sensor, ROI))
    return tuple(map(tuple, corners.astype(int).tolist()))


def grid(sensor, left=0):
    """ROIs that reach to the borders, and from column ``left`` on."""
    columns, rows = np.linspace(left, sensor[0] - ROI, GRID[0]), np.linspace(0, sensor[1] - ROI, GRID[1])
    return tuple((int(x), int(y)) for y in rows for x in columns)


def read(path):
    """All events of a file, and the sensor's width and height."""
    with open_recording(path) as recording:
        return Events.concatenate(recording.chunks()), (recording.width, recording.height)


def between(events, first, last):
    """Events from one time to another, in µs, this one not among them."""
    return events[slice(*np.searchsorted(events.t, [first, last]))]


def data(path, *names):
    """Data sets of an HDF5 file beside its events."""
    try:
        with h5py.File(path, "r") as file:
            return [file[name][()] for name in names]
    except (OSError, KeyError) as error:
        raise RecordingError(f"{path}: {', '.join(names)} cannot be read: {str(error).splitlines()[0]}") from None


def _checkerboard(path):
    """A tilted camera: an affine flow, median of three windows. The board is not all that the left edge shows."""
    events, sensor = read(path)
    events = events[: int(np.searchsorted(events.t, events.t[0] + 1_900_000))]
    centre, scale, left, found = (109.0, 90.0), 80.0, 28, []
    for begin in (0, 660_000, 1_320_000):
        part = between(events, *(events.t[0] + begin + at for at in (0, 250_000)))
        part = part[(part.x >= 16) & ~((part.x == 27) & (part.y == 70))]  # a hot pixel
        flow = affine(part.x, part.y, centre, scale)
        found.append(search(flow, part.t, window=(left + 2, 180, 8, 172)).at_middle)
    vx, vy, *slopes = np.median(found, axis=0)
    slopes = np.reshape(slopes, (2, 2))

    def truth(first, last, columns, rows):
        return (vx, vy) + slopes @ ([np.mean(columns) - centre[0], np.mean(rows) - centre[1]]) / scale

    doubt = float(np.ptp(np.array(found)[:, :2], axis=0).max() / 2)  # half of the range, of the axis with more
    return Known("checkerboard", events, sensor, grid(sensor, left), truth, doubt, left=left)


def _turning(path, name, linear):
    """A camera that turns, by a search over all events; the doubt is from the events of even and odd number.

    The principal point lies right of and below the middle, and the lens's polynomial does not hold at the left border:
    an edge takes 80 ms for 9 px there, 112 px/s, where it says 131 px/s.
    """
    events, sensor = read(path)
    camera = read_calibration(path).camera
    found, *halves = (
        search(rotation(camera, part.x, part.y), part.t, linear=linear) for part in (events, events[::2], events[1::2])
    )
    middle = (events.t[0] + events.t[-1]) / 2
    rois = grid(sensor, CALIBRATED)
    centres = np.array(rois, float).T + ROI / 2
    ends = [camera.speeds(half.at_middle, *centres) for half in halves]

    def truth(first, last, columns, rows):
        omega = found.at(((first + last) / 2 - middle) * 1e-6)
        return camera.speeds(omega, columns, rows).mean(axis=1)

    doubt = float(np.abs(ends[0] - ends[1]).max() / 2)
    return Known(name, events, sensor, rois, truth, doubt, left=CALIBRATED)


_shapes = functools.partial(_turning, name="shapes, rotation", linear=True)
_poster = functools.partial(_turning, name="poster, rotation", linear=False)


def _spinner(path):
    """A dot on a disc; its angle, a straight line in time, from the events near the dot's circle.

    The dot and its tail span 30 px of that circle: the truth is the mean of what turns with the disc in the ROI.
    """
    events, sensor = read(path)
    centre, radius, many = np.array([[314.4], [202.5]]), 107.2, 2000
    across, down = np.array([events.x, events.y], float) - centre
    near = np.flatnonzero(np.abs(np.hypot(across, down) - radius) < 6)
    near = near[: len(near) // many * many].reshape(-1, many)
    seen = (across[near] + 1j * down[near]).mean(axis=1)
    angles, times = np.unwrap(np.angle(seen)), events.t[near].mean(axis=1)
    fit = np.polynomial.Polynomial.fit(times, angles, 1)
    residual = radius * np.std(angles - fit(times))  # px, of the dot's place

    start, rate = fit(events.t[0]), fit.deriv()(0) * 1e6  # rad, rad/s
    place = centre[:, 0] + radius * np.array([math.cos(start), math.sin(start)])

    def truth(first, last, columns, rows):
        return rate * (centre[1, 0] - np.mean(rows)), rate * (np.mean(columns) - centre[0, 0])

    rois, doubt = _around(place, sensor), residual * math.sqrt(0.5)  # of both ends, for half of the way
    return Known("spinner", events, sensor, rois, truth, doubt_px=doubt, in_sum=False)


GYROSCOPE_DOUBT = 2.5  # px/s, as far apart as fits to windows of 10,000, 20,000 and 40,000 events are


def _gyroscope(path):
    """A camera that pans, so vy is 0. The file has neither the gyroscope's bias nor a focal length: both are fitted to
    searches over the whole sensor in windows of 20,000 events."""
    events, sensor = read(path)
    times, gyro = data(path, "imu/t", "imu/gyro_raw")
    turned = np.concatenate([[0.0], np.cumsum(np.diff(times) * (gyro[1:, 1] + gyro[:-1, 1]) / 2)]) / 32.8e6  # degrees

    def rate(first, last):
        """Mean rate about the camera's y axis, °/s."""
        return np.diff(np.interp([first, last], times, turned))[0] / max(last - first, 1) * 1e6

    parts = [events[at : at + 20_000] for at in range(0, len(events) - 19_999, 20_000)]
    seen = [search(translation(p.x, p.y), p.t, window=(12, 228, 12, 168)).at_middle[0] for p in parts]
    slope, offset = np.polyfit([rate(*p.t[[0, -1]]) for p in parts], seen, 1)
    return Known(
        "translboxes_imu", events, sensor, grid(sensor), lambda a, b, *_: (offset + slope * rate(a, b), 0.0),
        GYROSCOPE_DOUBT, in_sum=False,
    )  # fmt: skip


#: ``{file: what makes it}``.
_REAL = {
    "davis240b_evbench_seq0002.h5": _checkerboard,
    "davis240c_shapes_rotation_2.1s_gtflow.h5": _shapes,
    "davis240c_poster_rotation_0.6s.h5": _poster,
    "prophesee_spinner_640x480.h5": _spinner,
    "davis240c_translboxes_imu.h5": _gyroscope,
}


@functools.cache
def by_file(folder):
    """The real ones, ``{name of the file: Known}``. Raises :exc:`RecordingError` where a recording is missing."""
    return {name: make(Path(folder) / name) for name, make in _REAL.items()}


def recordings(folder=None):
    """All of them, a list of :class:`Known`: the generated, and the real where there is a ``folder``."""
    return [*generated(), *(by_file(folder).values() if folder else ())]
