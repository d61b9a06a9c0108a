"""How many clock cycles a batch takes, from the latencies of the core's parts."""

from ..protocol.settings import by_signs


class CycleFormula:
    """What :class:`~cmfpga.rtl.core.Core` knows of time without being simulated."""

    @property
    def batch_latency(self):
        """Cycles of a batch that depend on neither N, n nor T."""
        move = self.roi_updater.latency if self.config.buffers == 1 else 1
        ahead = self.drain + self.iteration_control.hand_over + self.reciprocal.latency
        return ahead + min(self._feed, self._evaluate) + move

    @property
    def shortest_batch(self):
        """Events of the batches that take the longest of all short ones: those with fewer take as long.

        With two buffers, a batch is handed over when the ROI of the next one is known.
        """
        return 0 if self.config.buffers == 1 else self.roi_updater.settle + 2 - self.drain

    def cycles(self, *, events, roi_events, iterations, judge=None):
        """Clock cycles of a batch: N + Σ n_k + T·(sweep + L) + constant.

        n_k events of the batch's n are used in iteration k. ``iterations`` says how many there are, each of which
        uses all n; or it is the plan, a ``ScheduleEntry`` for each. If v's confidence is measured (setting ``judge``,
        by default the configuration's), there are four more, or one for each parameter of another motion than
        translation, which use all n, and :attr:`judge_latency`. From the cycle in which the first event is offered to
        the one in which the result is; events offered in every cycle, no other batch under way, batch not degenerate,
        at least :attr:`shortest_batch` events.
        """
        iterated = self.iterated_cycles(roi_events, iterations, judge)
        return max(events, self.shortest_batch) + iterated + self.batch_latency

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text."""
        if by_signs(self.config):
            return f"N + {self.iterated_formula(self.batch_latency)}"
        each = " + ".join(str(cycles) for cycles in (self.sweep_cycles, self.iteration_latency) if cycles)
        return f"N + T·(n + {each}) + {self.batch_latency}"
