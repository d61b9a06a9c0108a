"""The hardware as an engine: the emitted Verilog in Verilator, or Amaranth's simulator, which needs no compiler."""

import functools

import numpy as np
from amaranth.lib import data
from amaranth.sim import Simulator

from ..imaging.camera import node_writes
from ..protocol.settings import schedule_table, settings_values
from ..protocol.tables import mask_writes
from ..protocol.trace import columns, to_batch_result
from ..rtl.core import Core
from ..rtl.payloads import schedule_entry
from ..verilog.simulation import VerilatedCore
from . import Engine

_PIECE = 4096  # events for whose results there is memory


class VerilatedEngine(Engine):
    """Runs the emitted Verilog in Verilator."""

    name = "rtl"

    def __init__(self, config):
        super().__init__(config)
        self._core = VerilatedCore(config)

    @property
    def core(self):
        """The component, which knows how many cycles a batch takes."""
        return self._core.core

    def _write(self, regions, anew):
        self._core.write(regions, anew)

    def _run(self, events, settings):
        if self.config.slides:
            if settings.roi is not None:
                self._core.reset()
            parts = (events[at : at + _PIECE] for at in range(0, len(events), _PIECE))
            return [result for part in parts for result in self._core.slide(part.t, part.x, part.y, settings)]
        results = self._core.results([(events.t, events.x, events.y)], settings)
        self.cycles = self._core.finished[-1] - self._core.offered[-1]
        return results

    def close(self):
        super().close()
        self._core.close()


class AmaranthEngine(Engine):
    """Runs :class:`cmfpga.rtl.core.Core` itself; the results and cycle counts are those of the emitted Verilog.

    ``why`` says in the note what keeps the Verilog from being compiled.
    """

    name = "rtl"

    def __init__(self, config, why="no C++ compiler found"):
        super().__init__(config)
        self.note = (
            f"{why}: using Amaranth's simulator, about 5,000 clock cycles a second "
            "(Verilator with g++ or clang++ does a thousand times that)"
        )
        self.core = Core(config)
        self._job = None  # (events, settings, writes into tables) of the batch to simulate
        self._mask = self._lens = None  # as they stand
        self._outcome = None

    @functools.cached_property
    def _simulator(self):
        """Made when it is needed: a test bench that never began is a warning when it is collected."""
        simulator = Simulator(self.core)
        simulator.add_clock(1e-6)
        simulator.add_testbench(self._bench)
        return simulator

    def _run(self, events, settings):
        table = schedule_table(self.config, settings)
        mask = mask_writes(self.config, settings.hot_mask, self._mask) if settings.hot_mask else []
        self._mask = settings.hot_mask or self._mask
        nodes = node_writes(self.config, settings.camera) if settings.camera not in ((), self._lens) else []
        self._lens = settings.camera or self._lens
        entries = (dict(zip(schedule_entry(self.config).members, row, strict=True)) for row in table)
        writes = [("schedule_write", row) for row in enumerate(entries)]
        writes += [("mask_write", word) for word in mask] + [("node_write", node) for node in nodes]
        self._job = (events, settings_values(self.config, settings), writes)
        self._outcome = None
        # An upper bound of the batch's time: every event in the ROI, and the sweep after a reset.
        n, iterations = len(events), max(settings.iterations, len(table))
        cycles = (
            2 * self.core.cycles(events=n, roi_events=n, iterations=iterations)
            + 2 * (self.config.geometry.bank_words + self.config.geometry.cell_depth * self.config.background)
            + len(writes)
            + 1000
        )
        for _ in range(2 * cycles + 1000):
            self._simulator.advance()
            if self._outcome:
                return [to_batch_result(self.config, *self._outcome)]
        raise TimeoutError(f"no result after {cycles + 500} clock cycles")

    async def _bench(self, ctx):
        core = self.core
        while True:
            while self._job is None:
                await ctx.tick()
            events, values, writes = self._job
            self._job = None
            for name, row in writes:
                port = getattr(core, name)
                ctx.set(port.valid, 1)
                ctx.set(port.payload, dict(zip(port.payload.shape().members, row, strict=True)))
                await ctx.tick()
                ctx.set(port.valid, 0)
            self._outcome = await self._batch(ctx, events, values)

    async def _batch(self, ctx, events, values):
        core = self.core
        ctx.set(core.settings, nested(core.settings.shape(), values))
        rows = list(zip(events.t.tolist(), events.x.tolist(), events.y.tolist(), strict=True))
        wrap = (1 << core.config.time_bits) - 1
        sent, trace = 0, []
        ctx.set(core.i.valid, 1)
        ctx.set(core.o.ready, 1)
        while True:
            if sent < len(rows):
                t, x, y = rows[sent]
                ctx.set(core.i.payload, {"t": t & wrap, "x": x, "y": y, "last": sent + 1 == len(rows)})
            else:
                ctx.set(core.i.valid, 0)
            _, _, accepted, iterated, item, done, result = await ctx.tick().sample(
                core.i.valid & core.i.ready, core.trace.valid, core.trace.payload, core.o.valid, core.o.payload
            )
            sent += accepted
            if iterated:
                trace.append(flat(item))
            if done:
                names = columns(core.config)
                rows = [[row[name] for name in names] for row in trace]
                return [flat(result)], [np.array(rows, np.int64).reshape(-1, len(names))]


def nested(layout, values, prefix=""):
    """Values by their Verilog port names, in the shape of a layout."""
    return {
        name: nested(shape, values, f"{prefix}{name}_") if isinstance(shape, data.Layout) else values[prefix + name]
        for name, shape in layout.members.items()
    }


def flat(values, prefix=""):
    """The leaves of a value by their Verilog port names."""
    found = {}
    for name in values.shape().members:
        value = values[name]
        found |= flat(value, f"{prefix}{name}_") if isinstance(value, data.Const) else {prefix + name: value}
    return found
