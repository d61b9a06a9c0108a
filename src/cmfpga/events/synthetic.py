"""Synthetic recordings with known motion.

The model is that of an ideal event camera without delay. The object is a set of edge points that move together; each
has a *gradient*, the change of log brightness over a pixel, in contrast thresholds, pointing to the brighter side.
While the object moves by d, the brightness under an edge point changes by −gradient·d, and an event is emitted each
time that this crosses a whole threshold, at the pixel (rounded) and the µs (floored) in which the point is then.
So a point emits ``|gradient · d|`` events on average: many if the edge is moved across, few if along itself; and its
polarity is the sign of ``−gradient · d``. Each point starts at a random level. The background is empty; noise is added.

Pixel (x, y) covers x − ½ … x + ½, as everywhere in this project.
"""

import itertools
import math
import operator
from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from .arrays import Events
from .columns import MemoryRecording
from .motion import Motion, Turning

TEXTURES = ("lines", "dense")
MAX_EVENTS = 50_000_000

# Lines: one for this many square pixels of the object, bars of this thickness.
_PIXELS_PER_LINE = 100
_BAR_PX = 2.0
# Dense: standard deviation of the blur of the random pattern.
_BLUR_PX = 1.5


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What :func:`generate` shows.

    Parameters
    ----------
    seed : int
        The same scene with the same seed gives the same events.
    width, height : int
        Size of the sensor, px.
    texture : {"lines", "dense"}
        ``lines``: thin bright bars at random positions and angles, most pixels of the object empty. ``dense``: a
        smooth random pattern with a gradient at every pixel.
    size : (int, int)
        Width and height of the object, px.
    position : (float, float), optional
        Centre of the object at the start, px; the centre of the sensor by default.
    velocity : (float, float), or sequence of (int, float, float), optional
        (vx, vy) in px/s; or, piece by piece, (duration in µs, vx, vy), the last piece lasting to the end.
        By default (100, 0); with a rotation (0, 0).
    duration_us, t_start_us : int
        Length of the recording, and time of its start, µs.
    contrast : float
        Events of an edge point per pixel that the edge is moved across: the gradient of ``lines``, and the mean
        magnitude of the gradient of ``dense``.
    noise : float
        Background noise, uniform over pixels and time, as a fraction of all events but those of hot pixels; 0 to 0.95.
        (Of an object that emits nothing, nothing.)
    hot_pixels, hot_rate : int, float
        Pixels that emit by themselves, and the rate of each of them, events/s.
    camera : cmfpga.imaging.camera.Camera, optional
        What distorts the image: position, size and velocity are in the undistorted one, events where it sees them.
    bars : int, optional
        Number of bars of the texture ``lines``; one for every 100 px² of the object by default.
    zoom, roll : float
        The object grows about its centre by so much per s, and turns by so many rad/s, clockwise on the screen.
    rotation : (float, float, float), optional
        Angular velocity of the camera itself, rad/s, about x (to the right), y (down), z (forward), from the start on;
        what is seen is far away and stands still at the start. Needs ``camera``.
    """

    seed: int = 0
    width: int = 240
    height: int = 180
    texture: str = "lines"
    size: tuple[int, int] = (40, 40)
    position: tuple[float, float] | None = None
    velocity: tuple | None = None
    duration_us: int = 500_000
    t_start_us: int = 0
    contrast: float = 1.0
    noise: float = 0.0
    hot_pixels: int = 0
    hot_rate: float = 1000.0
    camera: object = None
    bars: int | None = None
    zoom: float = 0.0
    roll: float = 0.0
    rotation: tuple | None = None

    def __post_init__(self):
        for name, low, high, *kind in (
            ("seed", 0, None, "whole"), ("width", 1, 1 << 16, "whole"), ("height", 1, 1 << 16, "whole"),
            ("duration_us", 1, None, "whole"), ("t_start_us", None, None, "whole"),
            ("hot_pixels", 0, self.width * self.height, "whole"), ("bars", 1, None, "whole"),
            ("contrast", 0, None), ("noise", 0, 0.95), ("hot_rate", 0, None), ("zoom", -100, 100), ("roll", -100, 100),
        ):  # fmt: skip
            if (value := getattr(self, name)) is not None or name != "bars":
                _check(name, value, low, high, whole=bool(kind))
        if self.texture not in TEXTURES:
            raise ConfigError(f"texture = {self.texture!r}: one of {', '.join(TEXTURES)} is needed")
        _check_many("size", self.size, 2, 1, 1 << 16, whole=True)
        if self.rotation is not None:
            _check_many("rotation", self.rotation, 3, -100, 100)
            if self.camera is None:
                raise ConfigError("rotation: a camera is needed")
        if self.position is not None:
            _check_many("position", self.position, 2)
        for duration, _, _ in self._pieces():
            _check("velocity: duration", duration, 1, None, whole=True)

    def _pieces(self):
        """Velocity as a list of (duration in µs, vx, vy)."""
        usual = (100.0, 0.0) if self.rotation is None else (0.0, 0.0)
        velocity = usual if self.velocity is None else self.velocity
        constant = len(velocity) == 2 and not np.ndim(velocity[0])
        pieces = [(self.duration_us, *velocity)] if constant else list(velocity)
        if not pieces:
            raise ConfigError("velocity: no pieces; (vx, vy) or a sequence of (duration_us, vx, vy) is needed")
        for piece in pieces:
            _check_many("velocity", piece, 3)
        return pieces

    @property
    def motion(self):
        """The object's true :class:`Motion`; its position is that of the centre."""
        durations, *_ = pieces = list(zip(*self._pieces(), strict=True))
        times = self.t_start_us + np.concatenate([[0], np.cumsum(durations[:-1])]).astype(np.int64)
        start = ((self.width - 1) / 2, (self.height - 1) / 2) if self.position is None else self.position
        return Motion(times, list(zip(*pieces[1:], strict=True)), start)


@dataclass(frozen=True, eq=False)
class Synthetic:
    """A synthetic recording and its truth.

    ``motion`` has the position of the object's centre (px) and velocity (px/s) over time (µs); ``from_object``, a bool
    array, which events the object emitted: the others are noise and hot pixels.
    """

    scene: Scene
    events: Events
    motion: Motion
    from_object: np.ndarray

    def roi_start(self, width, height):
        """(x, y) of an ROI of this size (px) with the object in its middle at the start, inside the sensor.

        Raises :exc:`ConfigError` for an ROI that is larger than the sensor.
        """
        sensor = (self.scene.width, self.scene.height)
        if not (0 < width <= sensor[0] and 0 < height <= sensor[1]):
            raise ConfigError(f"ROI of {width}×{height} px: 1×1 to {sensor[0]}×{sensor[1]} is allowed (sensor)")
        centre = self.motion.position(self.scene.t_start_us)
        corner = [math.floor(c - (size - 1) / 2 + 0.5) for c, size in zip(centre, (width, height), strict=True)]
        return tuple(min(max(c, 0), s - size) for c, s, size in zip(corner, sensor, (width, height), strict=True))

    def recording(self, name=None):
        """The events as a :class:`MemoryRecording`. Raises :exc:`RecordingError` if there are none."""
        name = name or f"synthetic scene ({self.scene.texture}, seed {self.scene.seed})"
        return MemoryRecording(self.events, self.scene.width, self.scene.height, name)


def generate(scene=None, /, **fields):
    """The :class:`Synthetic` recording of a :class:`Scene`, or of ``Scene(**fields)``.

    Raises :exc:`ConfigError` where a field is not allowed, or the scene has more than ``MAX_EVENTS`` events.
    """
    if scene is None:
        scene = Scene(**fields)
    elif fields:
        raise ConfigError(f"{', '.join(fields)} given beside a scene: either a scene or its fields are needed")
    rng = np.random.default_rng(scene.seed)
    points, gradients = _lines(scene, rng) if scene.texture == "lines" else _dense(scene, rng)
    motion = scene.motion
    t, x, y, p = _emit(scene, points, gradients * scene.contrast, motion, rng)

    noise = rng.poisson(len(t) * scene.noise / (1 - scene.noise))
    places = (rng.integers(side, size=noise) for side in (scene.width, scene.height))
    background = (_times(scene, noise, rng), *places)
    pixels = rng.choice(scene.width * scene.height, scene.hot_pixels, replace=False)
    expected = scene.hot_rate * scene.duration_us * 1e-6
    _check_count(len(t) + noise + scene.hot_pixels * expected)
    where = np.repeat(pixels, rng.poisson(expected, scene.hot_pixels))
    hot = (_times(scene, len(where), rng), where % scene.width, where // scene.width)

    others = noise + len(where)
    t, x, y = (np.concatenate(parts) for parts in zip((t, x, y), background, hot, strict=True))
    p = np.concatenate([p, rng.integers(2, size=others)])
    from_object = np.arange(len(t)) < len(t) - others
    order = np.argsort(t, kind="stable")
    return Synthetic(scene, Events(t[order], x[order], y[order], p[order]), motion, from_object[order])


def _times(scene, count, rng):
    return scene.t_start_us + rng.integers(scene.duration_us, size=count)


def _lines(scene, rng):
    """Edge points (px, relative to the object's centre) and gradients, N×2, of random bars: two edges each."""
    width, height = scene.size
    count = scene.bars or max(1, round(width * height / _PIXELS_PER_LINE))
    half = np.array([width, height]) / 2
    ends = rng.uniform(-half, half, (2, count, 2))
    points, gradients = [], []
    for a, b in zip(*ends, strict=True):
        length = max(math.dist(a, b), 1.0)
        # One point per pixel of length, so that a moved edge gives `contrast` events per pixel it sweeps.
        along = (np.arange(round(length)) + rng.random()) / length
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / length
        middle = a + along[:, None] * (b - a)
        for side in (-1, 1):
            points.append(middle + side * _BAR_PX / 2 * normal)
            gradients.append(np.broadcast_to(-side * normal, middle.shape))
    return np.concatenate(points), np.concatenate(gradients)


def _dense(scene, rng):
    """As :func:`_lines`, of a smooth random pattern: a point per pixel, with the pattern's gradient there."""
    width, height = scene.size
    reach = math.ceil(3 * _BLUR_PX)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / _BLUR_PX) ** 2)
    pattern = rng.standard_normal((height + 2 * reach + 2, width + 2 * reach + 2))
    for axis in (0, 1):
        pattern = np.apply_along_axis(np.convolve, axis, pattern, kernel, mode="valid")
    dx = (pattern[1:-1, 2:] - pattern[1:-1, :-2]).ravel() / 2
    dy = (pattern[2:, 1:-1] - pattern[:-2, 1:-1]).ravel() / 2
    y, x = np.divmod(np.arange(width * height), width)
    # Off the pixel grid, as no object's grid coincides with the sensor's.
    points = np.stack([x - (width - 1) / 2, y - (height - 1) / 2], axis=1) + rng.uniform(-0.5, 0.5, (len(x), 2))
    gradients = np.stack([dx, dy], axis=1)
    return points, gradients / np.hypot(dx, dy).mean()


def _emit(scene, points, gradients, motion, rng):
    """t (µs), x, y (px) and p of the events of the edge points, not sorted, those outside the sensor left out."""
    level = rng.random(len(points))
    end = scene.t_start_us + scene.duration_us
    begins = motion.times[motion.times < end]
    turning, parts = Turning(scene, points, gradients, motion), []
    pieces = [turning.pieces(t0, t1) for t0, t1 in zip(begins, [*begins[1:], end], strict=True)]
    for t0, t1 in (pair for times in pieces for pair in itertools.pairwise(times)):
        place, step, change = turning.step(t0, t1)
        begin_level, level = level, level + change
        up = change > 0
        count = np.abs(np.floor(level) - np.floor(begin_level)).astype(np.int64)
        _check_count(sum(len(part[0]) for part in parts) + count.sum())
        owner = np.repeat(np.arange(len(points)), count)
        nth = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        # Thresholds on the way: upwards from the next whole level, downwards from the last one.
        threshold = np.floor(begin_level)[owner] + np.where(up[owner], nth + 1, -nth)
        share = np.clip((threshold - begin_level[owner]) / change[owner], 0, 1)
        at = place[owner] + share[:, None] * (step if step.ndim == 1 else step[owner])
        if scene.camera:
            at = scene.camera.distorted(*at.T).T
        pixel = np.floor(np.nan_to_num(at, nan=-1.0) + 0.5).astype(np.int64)
        t = np.minimum(np.floor(t0 + share * (t1 - t0)).astype(np.int64), t1 - 1)
        inside = ((pixel >= 0) & (pixel < [scene.width, scene.height])).all(axis=1)
        parts.append((t[inside], pixel[inside, 0], pixel[inside, 1], up[owner][inside].astype(np.uint8)))
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _check_count(count):
    if count > MAX_EVENTS:
        raise ConfigError(f"the scene has {count:.0f} events or more: at most {MAX_EVENTS} are allowed")


def _check(name, value, low=None, high=None, whole=False):
    try:
        number = operator.index(value) if whole else float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} = {value!r}: {'an integer' if whole else 'a number'} is needed") from None
    if not math.isfinite(number) or (low is not None and number < low) or (high is not None and number > high):
        allowed = f"{low} to {high}" if high is not None else f"{low} or more" if low is not None else "a finite number"
        raise ConfigError(f"{name} = {value!r}: {allowed} is needed")


def _check_many(name, values, count, *limits, whole=False):
    if np.ndim(values) != 1 or len(values) != count:
        raise ConfigError(f"{name} = {values!r}: {count} numbers are needed")
    for value in values:
        _check(name, value, *limits, whole=whole)
