"""The emitted Verilog of hardware with a table of regions in Verilator, driven batch by batch."""

import dataclasses

import numpy as np

from ...protocol.regions import RegionTable
from ...protocol.results import BatchResult, RegionOutcome, decode, fields_of
from ...protocol.settings import settings_values
from ...protocol.trace import Trace, columns
from .core import VerilatedCore


class VerilatedRegions(VerilatedCore):
    """One simulated :class:`~cmfpga.rtl.regions.regions.Regions`; parameters are those of :class:`VerilatedCore`.

    Attributes
    ----------
    table : RegionTable
    offered, finished : list of int
        Of the batches of the last run: the clock cycle in which its first event was offered, and that of its last
        result.
    """

    def __init__(self, config, *, seed=1):
        self.table = RegionTable(config)
        self.offered, self.finished = [], []
        super().__init__(config, seed=seed)

    @property
    def cycles(self):
        """Of the last batch of the last run, from the offer of its first event to its last result; None before."""
        return self.finished[-1] - self.offered[-1] if self.finished else None

    def reset(self, cycles=2):
        super().reset(cycles)
        self.table.forget()

    def write(self, regions, anew=()):
        """Replace the table, as :meth:`cmfpga.reference.regions.RegionSequence.write` does."""
        self.table.replace(regions, anew)

    @property
    def regions(self):
        """Those of the table."""
        return self.table.regions

    def _write_regions(self, settings):
        changed, schedule = self.table.changes(settings)
        if changed:
            self._write("row", changed)
        self.write_schedule(tuple(schedule))

    def write_tables(self, settings):
        self._write_regions(settings)
        self._write_mask_and_nodes(settings)

    def run(self, t, x, y, settings, *, gaps=None, stalls=None, max_cycles=None):
        """One batch of at least one event: a :class:`BatchResult`, as the integer model's.

        Parameters
        ----------
        t, x, y : int64 arrays [N]
        settings : BatchSettings
        gaps, stalls : int arrays, optional
            Idle cycles before each event, [N]; and before each result is taken, [regions].
        max_cycles : int, optional
            Give up after these; by default after more than the batch can take.
        """
        return self.stream([(t, x, y)], settings, gaps=gaps, stalls=stalls, max_cycles=max_cycles)[0]

    def stream(self, batches, settings, *, gaps=None, stalls=None, max_cycles=None):
        """Several batches of the same settings without a pause between them: a list of :class:`BatchResult`."""
        config, count = self.config, len(self.regions)
        if not count:
            raise ValueError("there are no regions: write some first")
        settings = dataclasses.replace(settings, rows=count)
        self.write_tables(settings)
        plans = [max(len(settings.cold if r.cold is None else r.cold), len(settings.warm if r.warm is None else r.warm))
                 for r in self.regions]  # fmt: skip
        stalls = [0] * count * len(batches) if stalls is None else stalls
        turns = 1 << config.geometry.turn_bits
        limit = self._patience(gaps, stalls) + 4 * config.store.bins
        for t, _, _ in batches:
            # With the slices before, as large as they can be.
            window = len(t) + (config.slices - 1) * config.slice_events
            stored = min(window, config.buffer_events)
            limit += 2 * window + sum((plan + 4) * (turns * stored + 100) + 2 * window + 5000 for plan in plans)
        values, trace, _, self.offered = self._drive(
            batches,
            [settings_values(config, settings)] * len(batches),
            gaps,
            stalls,
            sum(plans) * len(batches),
            max_cycles or limit,
        )
        self.finished = [row["valid"] for row in values[count - 1 :: count]]
        # Iterations of one region come one after the other, also those of two batches.
        which = self.trace_names.index("region")
        steps = {number: np.delete(trace[trace[:, which] == number], which, 1) for number in range(count)}
        return [self._batch(values[at : at + count], steps) for at in range(0, len(values), count)]

    def _batch(self, rows, steps):
        config = self.config
        if [row["last"] for row in rows] != [0] * (len(rows) - 1) + [1]:
            raise AssertionError("the last result of a batch is not marked")
        if sorted(row["region"] for row in rows) != list(range(len(rows))):
            raise AssertionError("a region has no result, or two")
        of_batch = {f.name for f in fields_of("batch", config=config)}
        outcomes = {}
        for row in rows:
            found, number = decode(config, row), row["region"]
            own, steps[number] = np.split(steps[number], [self._traced(row["iterations"])])
            v = tuple(row[f"v_{name}"] for name in config.motion_model.names)
            its = Trace.of_ports(config, own, v)
            batch = {name: found.pop(name) for name in of_batch}
            outcomes[number] = RegionOutcome(**found, trace=its)
        assert [name for name in self.trace_names if name != "region"] == columns(config)
        return BatchResult(regions=tuple(outcomes[number] for number in sorted(outcomes)), **batch)
