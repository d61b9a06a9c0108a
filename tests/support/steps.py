"""What the programs in C do, in float64: steps by signs of the contrast's gradient."""

import numpy as np

from cmfpga.config.schedule import used
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.trace import Trace
from cmfpga.reference.float_core import FloatCore
from cmfpga.reference.floating import evaluate, float64
from cmfpga.reference.flow import by_signs


def ascend(x, y, dt, *, v_start, schedule, **size):
    """All v, float64 [T + 1, 2]; ``size`` is as for :func:`evaluate`."""
    v = [float64(v_start)]
    for k, entry in enumerate(schedule):
        now = evaluate(*(axis[used(entry, k, len(dt))] for axis in (x, y, dt)), v[-1], level=entry.level, **size)
        v.append(v[-1] + by_signs(now.g, entry.log2_step))
    return np.array([one.tolist() for one in v])


class StepCore(FloatCore):
    """A core that goes by such steps; its border is that of the programs."""

    def ascend(self, batch, settings, plan, roi, middle=None):
        size = {"width": self.config.roi_width, "height": self.config.roi_height}
        v = ascend(*self.place(batch), v_start=self.v, schedule=plan, **size)
        sums = np.zeros((len(plan), 5))
        return Trace(v=v, sum_i=sums[:, 0], sum_d=sums[:, 1:3], s=sums[:, 3:]), Flag(0), {}
