"""How many clock cycles a batch takes, from the latencies of the core's parts."""

from ..config.schedule import ScheduleEntry, used_events
from ..protocol.settings import by_signs


class CycleFormula:
    """What :class:`~cmfpga.rtl.core.Core` knows of time without being simulated."""

    @property
    def latencies(self):
        """Clock cycles from input to output of each block that the events or the sums go through, by name."""
        return {name: block.latency for name, block in self.blocks.items() if hasattr(block, "latency")}

    @property
    def batch_latency(self):
        """Cycles of a batch that depend on neither N, n nor T."""
        move = self.roi_updater.latency if self.config.buffers == 1 else 1
        ahead = self.drain + self.iteration_control.hand_over + self.reciprocal.latency
        return ahead + min(self._feed, self._evaluate) + move

    @property
    def sweep_cycles(self):
        """Cycles of an iteration between its last vote and the image being complete: P/4 with the sweep."""
        return self.image.sweep_cycles

    @property
    def shortest_batch(self):
        """Events of the batches that take the longest of all short ones: those with fewer take as long.

        With two buffers, a batch is handed over when the ROI of the next one is known.
        """
        return 0 if self.config.buffers == 1 else self.roi_updater.settle + 2 - self.drain

    @property
    def judge_latency(self):
        """Cycles that a batch takes more if v's confidence is measured, beside those of four iterations."""
        return self.probe.latency + self.judge.latency - self.ascent.latency

    def cycles(self, *, events, roi_events, iterations, judge=None, most=False):
        """Clock cycles of a batch: N + Σ ⌈n_k/K⌉ + T·(sweep + L) + constant, with K lanes.

        Where the image is not ``exact_cycles`` these are the fewest, if no vote has to wait, or the ``most``; what lies
        between depends on the images (:func:`cmfpga.reference.integer.lanes.waits`).
        n_k events of the batch's n are used in iteration k. ``iterations`` says how many there are, each of which
        uses all n; or it is the plan, a ``ScheduleEntry`` for each. If v's confidence is measured (setting ``judge``,
        by default the configuration's), there are four more, which use all n, and :attr:`judge_latency`. From the cycle
        in which the first event is offered to the one in which the result is; events offered in every cycle, no other
        batch under way, batch not degenerate, at least :attr:`shortest_batch` events.
        """
        judged = self.config.confidence and (self.config.judge if judge is None else judge)
        every = ScheduleEntry(0, None)
        plan = (every,) * iterations if isinstance(iterations, int) else tuple(iterations)
        plan, more = ((*plan, *[every] * 4), self.judge_latency) if judged else (plan, 0)
        groups = [-(-n // self.config.lanes) for n in used_events(plan, roi_events)]
        votes = sum(map(self.image.most_cycles, groups) if most else groups)
        iterated = votes + len(plan) * (self.sweep_cycles + self.iteration_latency)
        return max(events, self.shortest_batch) + iterated + self.batch_latency + more

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text; "≥" where the image is not ``exact_cycles``."""
        least = "" if self.image.exact_cycles else "≥ "
        each = " + ".join(str(cycles) for cycles in (self.sweep_cycles, self.iteration_latency) if cycles)
        n, n_k = (f"⌈{n}/{self.config.lanes}⌉" if self.config.lanes > 1 else n for n in ("n", "n_k"))
        if not by_signs(self.config):
            return f"{least}N + T·({n} + {each}) + {self.batch_latency}"
        each = f"({each})" if self.sweep_cycles else each
        if self.judge is None:
            return f"{least}N + Σ {n_k} + T·{each} + {self.batch_latency}"
        return f"{least}N + Σ {n_k} + 4·{n} + (T + 4)·{each} + {self.batch_latency + self.judge_latency}"
