"""Every iteration of a batch."""

from dataclasses import dataclass

import numpy as np

from .results import BatchResult, trace_shape
from .shapes import leaves


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Every iteration's velocity and sums.

    Raw int64 from the engines that compute in the hardware's arithmetic, float64 (px/half batch, votes) from
    the float engine. ``v`` has T + 1 rows: the one that each iteration used, and the result. Where an iteration is a
    round of several evaluations beside v, the sums have an axis more behind T: an entry for each.
    """

    v: np.ndarray  # [T + 1, parameters of the motion]
    sum_i: np.ndarray  # [T]
    sum_d: np.ndarray  # [T, 2]
    s: np.ndarray  # [T, parameters]

    def __eq__(self, other):
        return isinstance(other, Trace) and all(
            np.array_equal(one, vars(other)[name]) for name, one in vars(self).items()
        )

    @classmethod
    def of_table(cls, v, table):
        """Of ``v``, and the sums of each evaluation, in their order: ΣI, ΣDx, ΣDy, and Σ I·D of each parameter."""
        count = len(v) - 1
        if len(table) > count:
            table = table.reshape(count, -1, table.shape[1])
        return cls(v=v, sum_i=table[..., 0], sum_d=table[..., 1:3], s=table[..., 3:])

    @classmethod
    def without_iterations(cls, config, v):
        """Of a batch that leaves the velocity at ``v``: T = 0."""
        v, each = np.array([v]), config.ascent_rule.evaluations
        return cls.of_table(v, np.zeros((0, *((each,) if each > 1 else ()), 3 + v.shape[1]), v.dtype))

    @classmethod
    def of_ports(cls, config, rows, v):
        """Of the trace ports' values, int64 [evaluations, :func:`columns`], and the raw v of the result."""
        if not len(rows):
            return cls.without_iterations(config, v)
        at = {name: k for k, name in enumerate(columns(config))}
        names = config.motion_model.names
        vs = rows[:: config.ascent_rule.evaluations, [at[f"v_{name}"] for name in names]]
        sums = ("i", "dx", "dy", *(f"s{name}" for name in names))
        return cls.of_table(np.vstack([vs, [v]]), rows[:, [at[f"sums_{name}"] for name in sums]])

    @property
    def last_sums(self):
        """ΣI, ΣDx, ΣDy, and Σ I·D of each parameter, of the last iteration; zeros if there was none.

        Of a round the means of its evaluations, raw ones floored.
        """
        if not len(self.sum_i):
            return (0,) * (3 + self.s.shape[-1])
        last = np.concatenate([self.sum_i[-1, ..., None], self.sum_d[-1], self.s[-1]], -1)
        if last.ndim > 1:
            last = last.sum(0) // len(last) if last.dtype.kind == "i" else last.mean(0)
        return tuple(last.tolist())


def columns(config):
    """Names of the trace's values: the Verilog ports behind ``trace_``, in order."""
    return [leaf for name, shape in trace_shape(config).items() for leaf in leaves(name, shape)]


def to_batch_result(config, rows, traces):
    """A :class:`BatchResult` of raw values: result ports by name, and the trace ports' [T, 7], of each region."""
    ends = (tuple(row[f"v_{name}"] for name in config.motion_model.names) for row in rows)
    paths = [Trace.of_ports(config, trace, v) for trace, v in zip(traces, ends, strict=True)]
    return BatchResult.decoded(config, rows, paths)
