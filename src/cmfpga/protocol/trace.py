"""Every iteration of a batch."""

from dataclasses import dataclass

import numpy as np

from .results import trace_shape
from .shapes import leaves


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Every iteration's velocity and sums.

    Raw int64 from the engines that compute in the hardware's arithmetic, float64 (px/half batch, votes) from
    the float engine. ``v`` has T + 1 rows: the one that each iteration used, and the result.
    """

    v: np.ndarray  # [T + 1, parameters of the motion]
    sum_i: np.ndarray  # [T]
    sum_d: np.ndarray  # [T, 2]
    s: np.ndarray  # [T, parameters]

    def __eq__(self, other):
        return isinstance(other, Trace) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in ("v", "sum_i", "sum_d", "s")
        )

    @classmethod
    def without_iterations(cls, v):
        """Of a batch that leaves the velocity at ``v``: T = 0."""
        v = np.array([v])
        none = v[:0]
        return cls(v=v, sum_i=none[:, 0], sum_d=none[:, :2], s=none)

    @classmethod
    def of_ports(cls, config, rows, v):
        """Of the trace ports' values, int64 [T, :func:`columns`], and the raw v of the result."""
        at = {name: k for k, name in enumerate(columns(config))}
        names = config.motion_model.names
        parts = ("v_", names), ("sums_d", ("x", "y")), ("sums_s", names)
        vs, d, s = (rows[:, [at[prefix + name] for name in those]] for prefix, those in parts)
        return cls(v=np.vstack([vs, [v]]), sum_i=rows[:, at["sums_i"]], sum_d=d, s=s)

    @property
    def last_sums(self):
        """ΣI, ΣDx, ΣDy, and Σ I·D of each parameter, of the last iteration; zeros if there was none."""
        if not len(self.sum_i):
            return (0,) * (3 + self.s.shape[1])
        return (self.sum_i[-1].item(), *self.sum_d[-1].tolist(), *self.s[-1].tolist())


def columns(config):
    """Names of the trace's values: the Verilog ports behind ``trace_``, in order."""
    return [leaf for name, shape in trace_shape(config).items() for leaf in leaves(name, shape)]
