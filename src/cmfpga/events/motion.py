"""Motion of a synthetic scene's object, which is also a recording's true motion; and how its points turn and grow."""

import math

import numpy as np


class Motion:
    """Position and velocity over time. Before the first and after the last piece the velocity goes on.

    Parameters
    ----------
    times : sequence of int
        Begin of each piece, µs, ascending.
    velocities : sequence of (float, float)
        (vx, vy) of each piece, px/s; right and down are positive.
    start : (float, float)
        Position at ``times[0]``, px.
    """

    def __init__(self, times, velocities, start):
        self.times = np.array(times, np.int64)
        self.velocities = np.array(velocities, np.float64).reshape(len(self.times), 2)
        lengths = np.diff(self.times)[:, None] * 1e-6
        steps = np.concatenate([np.array(start, np.float64).reshape(1, 2), lengths * self.velocities[:-1]])
        self._knots = np.cumsum(steps, axis=0)

    def _piece(self, t):
        return np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, None)

    def velocity(self, t):
        """(vx, vy) at the times ``t`` (µs): px/s, shape ``t.shape + (2,)``."""
        return self.velocities[self._piece(np.asarray(t))]

    def position(self, t):
        """(x, y) at the times ``t`` (µs): px, shape ``t.shape + (2,)``."""
        t = np.asarray(t)
        piece = self._piece(t)
        return self._knots[piece] + ((t - self.times[piece]) * 1e-6)[..., None] * self.velocities[piece]

    def mean_velocity(self, t_first, t_last):
        """Mean (vx, vy) between two times (µs): px/s. The velocity at that time where both are the same."""
        if t_first == t_last:
            return self.velocity(t_first)
        return (self.position(t_last) - self.position(t_first)) / ((t_last - t_first) * 1e-6)

    def per_half_batch(self, t_first, t_last):
        """What an engine should find for a batch whose first and last events are at these times: px per half batch."""
        return (self.position(t_last) - self.position(t_first)) / 2


#: Most that is turned or grown in one step, in which points move along straight lines: 0.01 px at 800 px from the axis.
STEP = 0.01

#: The least depth of a ray that is looked at.
_NEAR = 0.2


def turned(omega, rays):
    """Rays of a still scene in the frame of a camera that has turned by ``omega``, a rotation vector: float64 [3, n].

    Rodrigues' formula by −ω: what stands still goes the other way round.
    """
    angle = math.sqrt(sum(axis * axis for axis in omega))
    if not angle:
        return rays
    axis = -np.asarray(omega, np.float64) / angle
    across = np.cross(axis, rays, axisb=0, axisc=0)
    along = np.outer(axis, axis @ rays)
    return rays * math.cos(angle) + across * math.sin(angle) + along * (1 - math.cos(angle))


class Turning:
    """Where the edge points of a :class:`~cmfpga.events.synthetic.Scene` are, px of the undistorted image.

    ``points``, px from the object's centre, and ``gradients`` are those of :mod:`cmfpga.events.synthetic`, float64
    [n, 2]; ``motion`` is that of the centre.
    """

    def __init__(self, scene, points, gradients, motion):
        self._scene, self._points, self._gradients, self._motion = scene, points, gradients, motion
        self._still = not (scene.zoom or scene.roll or scene.rotation)
        self._omega = np.array(scene.rotation or (0.0, 0.0, 0.0), np.float64)

    def pieces(self, t0, t1):
        """Times between two, µs, such that each piece is nearly straight."""
        if self._still:
            return [t0, t1]
        rate = abs(self._scene.zoom) + abs(self._scene.roll) + math.sqrt(self._omega @ self._omega)
        count = max(1, math.ceil(rate * (t1 - t0) * 1e-6 / STEP))
        return np.unique(np.linspace(t0, t1, count + 1).round().astype(np.int64)).tolist()

    def step(self, t0, t1):
        """``(at, step, change)`` from one time to another, µs: places and how far they go, px; the brightness's.

        float64 [n, 2], [n, 2] or [2], and [n], in contrast thresholds.
        """
        if self._still:
            place, step = self._motion.position(t0), self._motion.position(t1) - self._motion.position(t0)
            return self._points + place, step, -self._gradients @ step
        at = self._places(t0)
        step = self._places(t1) - at
        since = (t0 - self._scene.t_start_us) * 1e-6
        turn = (self._scene.roll - self._omega[2]) * since
        gradients = self._gradients @ _matrix(turn).T * math.exp(-self._scene.zoom * since)
        return at, step, np.nan_to_num(-(gradients * step).sum(axis=1))

    def _places(self, t):
        """Of all points at a time, px; NaN of what the camera does not see."""
        scene = self._scene
        since = (t - scene.t_start_us) * 1e-6
        at = self._points @ _matrix(scene.roll * since).T * math.exp(scene.zoom * since) + self._motion.position(t)
        if scene.rotation:
            focus, centre = np.array([scene.camera.fx, scene.camera.fy]), np.array([scene.camera.cx, scene.camera.cy])
            rays = np.vstack([((at - centre) / focus).T, np.ones(len(at))])
            x, y, z = turned(self._omega * since, rays)
            z = np.where(z > _NEAR, z, np.nan)
            at = np.stack([x / z, y / z], axis=1) * focus + centre
        return at


def _matrix(angle):
    """Turns a column vector (x, y) from x to y."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
