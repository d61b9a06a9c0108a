"""True motion of a synthetic object: a velocity that is constant piece by piece."""

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
