"""Regions: events in, the motion of many regions of each batch out."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import memory, stream
from amaranth.lib.wiring import In, Out, connect, flipped

from .. import Block
from .. import payloads as common
from ..arithmetic import delay, select
from ..ingest import connect_front, make_front, write_ports
from ..ingest.ingest_control import IngestControl
from ..ingest.reciprocal import Reciprocal
from ..ingest.roi_filter import RoiFilter
from ..iterating import Iterating, boxes_of
from . import payloads
from .collector import Collector
from .distributor import Distributor
from .slices import Slices
from .store import Store
from .unit import Unit


def _numbered(name, blocks):
    """``{name: block}`` of one, ``{name_k: block}`` of several."""
    return {f"{name}_{k}" if len(blocks) > 1 else name: block for k, block in enumerate(blocks)}


class Regions(Block):
    """Contrast Maximization of many regions of each batch::

        i ─► ingest control ─► filter ─► store ─► distributor ─┬─► unit 0 ─────┬─► collector ─► o
                  │ batch        │ t_1, t_N          ▲  ▲       ├─► unit 1 ─────┤      │
                  ▼              └──► reciprocal     │  │       └─► unit U − 1 ─┘      │
              distributor                    table of regions,  states ◄──────────────┘

    The filter passes what lies on the sensor; in front of it may stand what :mod:`cmfpga.rtl.ingest` has. A row
    of the table says which events a region has, and how its motion is looked for
    (:class:`cmfpga.protocol.regions.Region`). Results come in the order in which units finish; each has its region's
    number. A result does not depend on that order, nor on how fast events come or results go.

    One event per cycle at ingest, while the batch before is measured. Where the units are more than one store can feed
    (:data:`cmfpga.config.regions.READER_UNITS`), there are several, all with the same events, and each with a
    distributor that goes through a part of the rows.

    Members
    -------
    i : ``In``, stream of :func:`~cmfpga.rtl.payloads.event`
    o : ``Out``, stream of :func:`payloads.region_result`
        One per region of a batch.
    settings : ``In``, :func:`~cmfpga.rtl.payloads.settings`
        As those of :class:`~cmfpga.rtl.core.Core`; ``rows`` is how many rows the table has. Those of one ROI
        (``roi_load``, ``roi_x``, ``roi_y``, ``thinning``, ``thin_target``, ``batch_roi_events``, ``start_last``,
        ``cold``, ``warm``) mean nothing.
    row_write : ``In``, flow of :func:`payloads.row_write`
        Fills the table of regions; only while no batch is under way. A row that was not in use in the batch before has
        to be written again, ``fresh``.
    schedule_write, mask_write, node_write, opened, take
        As those of :class:`~cmfpga.rtl.core.Core`.
    takes_over : ``Out(1)``
        One cycle: the results that come from now on are those of the batch that was taken last. Two batches may be
        under way, the last regions of one and the first of the next.
    traces : ``Out``, array of flows of :func:`payloads.region_trace`
        Every iteration of each unit, for verification.
    """

    def __init__(self, config):
        self.front = make_front(config)
        self.roi_filter = RoiFilter(config, config.geometry.size)
        readers = range(config.store.readers)
        self.stores, self.distributors = [Store(config) for _ in readers], [Distributor(config, k) for k in readers]
        self.drain = sum(block.latency for block in (*self.front.values(), self.roi_filter, self.stores[0])) + 1
        self.ingest_control = IngestControl(config, drain=self.drain)
        self.slices = Slices(config) if config.slices > 1 else None
        self.reciprocal = Reciprocal(span_bits=config.span_bits, reciprocal_bits=config.reciprocal_bits)
        self.collector = Collector(config)
        self.units = [Unit(config) for _ in range(config.units)]
        members = {
            "i": In(stream.Signature(common.event(config))),
            "o": Out(stream.Signature(payloads.region_result(config))),
            "settings": In(common.settings(config)),
            "opened": Out(1),
            "take": Out(1),
            "takes_over": Out(1),
            "traces": Out(common.flow(payloads.region_trace(config))).array(config.units),
            "schedule_write": In(common.flow(common.schedule_write(config))),
            "row_write": In(common.flow(payloads.row_write(config))),
        }
        super().__init__(config, **members, **write_ports(self.front))

    @property
    def boxes(self):
        """What stands directly in it, by name, in the order of data flow."""
        units = {f"unit_{number}": unit for number, unit in enumerate(self.units)}
        stores, distributors = _numbered("store", self.stores), _numbered("distributor", self.distributors)
        names = ("slices", "ingest_control", self.front, "roi_filter", stores, "reciprocal", distributors, units)
        return boxes_of(self, *names, "collector")

    @property
    def blocks(self):
        """The same, but one store and one distributor, and in place of the units what one of them is made of."""
        several = (*self.stores[1:], *self.distributors[1:], *self.units)
        return {name: block for name, block in self.boxes.items() if block not in several} | self.units[0].blocks

    latencies = Iterating.latencies

    def cycles(self, *, roi_events, iterations, judge=None, **_):
        """Those of a region in a unit: :meth:`Unit.cycles`."""
        return self.units[0].cycles(roi_events=roi_events, iterations=iterations, judge=judge)

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text."""
        unit = self.units[0]
        return f"{unit.iterated_formula(unit.region_latency)} for a region in a unit"

    def elaborate(self, platform):
        m = Module()
        for name, block in self.boxes.items():
            m.submodules[name] = block
        self._ingest(m)
        self._look_up(m)
        self._measure(m)
        return m

    def _ingest(self, m):
        """Filter, undistort, store, measure the time range."""
        control, handover = self.ingest_control, self.ingest_control.handover
        slices = self.slices
        connect(m, flipped(self.i), slices.i if slices else control.i)
        connect_front(
            m, self, control.o, self.roi_filter.i, settings=self.settings, start=handover.opened, clear=control.clear
        )
        connect(m, self.roi_filter.measured, control.measured)
        m.d.comb += [
            control.settings.eq(self.settings),
            self.roi_filter.start.eq(handover.opened),
            handover.free.eq(Cat(distributor.free for distributor in self.distributors).all()),
            handover.settled.eq(1),
            self.opened.eq(handover.opened),
            self.take.eq(handover.take),
        ]
        for store in self.stores:
            m.d.comb += [
                store.i.payload.eq(self.roi_filter.o.payload),
                store.i.valid.eq(self.roi_filter.o.valid),
                store.open.eq(handover.opened),
                store.take.eq(handover.take),
                store.reset.eq(control.clear),
            ]
        if slices:
            connect(m, slices.o, control.i)
            m.d.comb += [
                slices.slice_events.eq(self.settings.batch_events),
                slices.opened.eq(handover.opened),
                control.settings.batch_events.eq(0),  # what ends slices ends windows
            ]
        # What is cleared after a reset is not ready at once.
        parts = {name: block.cleared for name, block in self.boxes.items() if block in (*self.stores, *self.units)}
        if "background_filter" in self.front:
            parts["background_filter"] = self.front["background_filter"].cleared
        all_of_them = 1
        for name, cleared in parts.items():
            once = Signal(name=f"{name}_cleared")
            m.d.sync += once.eq((once | cleared) & ~control.clear)
            all_of_them &= once
        m.d.comb += control.cleared.eq(all_of_them)

    def _look_up(self, m):
        """The table of regions, and what is kept of each: read by distributor and collector."""
        config, write, kept = self.config, self.row_write, self.collector.write
        m.submodules.rows = rows = memory.Memory(shape=payloads.row(config), depth=max(2, config.regions), init=[])
        m.submodules.states = states = memory.Memory(
            shape=payloads.state(config), depth=max(2, config.regions), init=[]
        )
        row_port, state_port = rows.write_port(), states.write_port()
        fresh = Signal(payloads.state(config))
        frac = config.v_frac + config.roi_gain_frac
        m.d.comb += [
            row_port.en.eq(write.valid),
            row_port.addr.eq(write.payload.number),
            row_port.data.eq(write.payload.row),
            fresh.turn.eq(self.distributors[0].turn),
            *(fresh.position[axis].eq(write.payload.row.place[axis] << frac) for axis in ("x", "y")),
        ]
        for axis, most in (("x", config.roi_width), ("y", config.roi_height)):
            with m.If(write.payload.row.end[axis] > most):
                m.d.comb += row_port.data.end[axis].eq(most)
        # A register, for the wires to the memory.
        m.d.sync += [
            state_port.en.eq((write.valid & write.payload.fresh) | kept.valid),
            state_port.addr.eq(Mux(kept.valid, kept.payload.number, write.payload.number)),
            state_port.data.eq(Mux(kept.valid, kept.payload.state.as_value(), fresh.as_value())),
        ]
        for name, block in (_numbered("distributor", self.distributors) | {"collector": self.collector}).items():
            row, state = rows.read_port(), states.read_port()
            m.d.comb += [row.addr.eq(block.number), state.addr.eq(block.number)]
            m.d.comb += [
                block.row.eq(delay(m, row.data, 1, name=f"{name}_row")),
                block.state.eq(delay(m, state.data, 1, name=f"{name}_state")),
            ]

    def _measure(self, m):
        """Region by region to the units, and out."""
        distributors, collector = self.distributors, self.collector
        first, several, handover = distributors[0], len(distributors) > 1, self.ingest_control.handover
        batch = handover.batch
        connect(m, collector.o, flipped(self.o))
        m.d.comb += [
            self.reciprocal.start.eq(first.divide),
            self.reciprocal.span.eq(batch.span),
            collector.begins.eq(first.divide),
            collector.batch.eq(batch),
            collector.turn.eq(first.turn),
            self.takes_over.eq(collector.takes_over),
        ]
        # A unit says a cycle after it was begun that it cannot be loaded, and a distributor sees that one cycle later.
        turn = Signal(range(2 * len(distributors)))
        if several:
            m.d.sync += turn.eq(Mux(turn == 2 * len(distributors) - 1, 0, turn + 1))
        for number, (distributor, store) in enumerate(zip(distributors, self.stores, strict=True)):
            connect(m, store.o, distributor.events)
            connect(m, distributor.read, store.read)
            m.d.comb += [
                distributor.take.eq(handover.take),
                distributor.settings.eq(batch.settings),
                distributor.divided.eq(self.reciprocal.done),
                distributor.busy.eq(store.busy),
                distributor.cleared.eq(store.cleared),
                distributor.begun.eq(collector.begun),
                distributor.ready.eq(Cat(unit.ready for unit in self.units)),
                distributor.idle.eq(Cat(unit.idle for unit in self.units)),
                distributor.may.eq(turn == 2 * number),
                store.clear.eq(distributor.clear),
            ]
        for number, unit in enumerate(self.units):
            # Which distributor began it.
            loads = Signal(range(max(2, len(distributors))), name=f"loads_{number}")
            for which, distributor in enumerate(distributors):
                with m.If(distributor.begin[number]):
                    m.d.sync += loads.eq(which)
            connect(m, unit.o, collector.units[number])
            connect(m, flipped(self.schedule_write), unit.schedule_write)
            connect(m, unit.trace, flipped(self.traces[number]))
            m.d.comb += [
                unit.begin.eq(Cat(distributor.begin[number] for distributor in distributors).any()),
                unit.commit.eq(Cat(distributor.commit[number] for distributor in distributors).any()),
                unit.i.valid.eq(select(loads, [distributor.o.valid for distributor in distributors])),
                unit.i.payload.eq(select(loads, [distributor.o.payload.as_value() for distributor in distributors])),
                unit.job.eq(select(loads, [distributor.job.as_value() for distributor in distributors])),
                unit.times.span.eq(batch.span),
                unit.times.shift.eq(self.reciprocal.shift),
                unit.times.mantissa.eq(self.reciprocal.mantissa),
                unit.clear.eq(self.ingest_control.clear),
            ]
