"""Schedule: the table that says what each iteration does; and the ascents that follow it."""

from functools import reduce
from operator import or_

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import memory
from amaranth.lib.wiring import In, Out, connect, flipped

from ...protocol.settings import PLANS, schedule_highest
from .. import Block, payloads
from ..arithmetic import delay, select
from .ascent import Ascent

_PART = "first", "count"  # of a table


class Schedule(Block):
    """Walks through a part of a table that is written at run time.

    The first entry is at ``level`` and ``shift`` a cycle after ``start``, the next one a cycle after ``advance``.
    ``stride`` is ahead: that of the entry that comes next, because its replay begins before v is known. An entry out
    of range is limited, and flagged.

    Members
    -------
    write : ``In``, flow of :func:`payloads.schedule_write`
        Only while no batch is under way.
    new_batch, start, advance : ``In(1)``
        Forget ``limited``, and go to the entry ``first``; take that entry, at least four cycles later; take the next
        one. One cycle each.
    hold : ``In(1)``
        With ``advance``: the entry was the batch's last, and stays. Only where v's confidence is measured.
    first : ``In``
        In the second cycle after ``new_batch``.
    level, shift, distance, limit : ``Out``
        The entry's parts (:func:`~cmfpga.protocol.settings.schedule_highest`): of those the ones that it has.
    stride : ``Out``
        One event in 2^stride, two cycles after ``start`` or ``advance``; not of rounds.
    limited : ``Out(1)``
        An entry used since ``new_batch`` was out of range.
    """

    def __init__(self, config):
        entry = payloads.schedule_entry(config)
        super().__init__(
            config,
            write=In(payloads.flow(payloads.schedule_write(config))),
            **dict.fromkeys(("new_batch", "start", "advance", *(("hold",) if config.confidence else ())), In(1)),
            first=In(range(config.schedule_entries)),
            **{name: Out(part.shape) for name, part in entry},
            limited=Out(1),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        layout = payloads.schedule_entry(config)
        m.submodules.table = table = memory.Memory(shape=layout, depth=config.schedule_entries, init=[])
        write, read = table.write_port(), table.read_port(domain="comb")
        pointer = Signal(range(config.schedule_entries))
        m.d.comb += [
            write.addr.eq(self.write.payload.address),
            write.data.eq(self.write.payload.entry),
            write.en.eq(self.write.valid),
            read.addr.eq(pointer),
        ]
        out_of_range = Signal()
        entry, highest = read.data, schedule_highest(config)
        # What fills its bits cannot be beyond: linters see a constant comparison.
        beyond = {name: entry[name] > high for name, high in highest.items() if high < (1 << len(entry[name])) - 1}
        limited = {
            name: Mux(beyond[name], high, entry[name]) if name in beyond else entry[name]
            for name, high in highest.items()
        }
        if "stride" in limited:
            m.d.sync += self.stride.eq(limited.pop("stride"))
        with m.If(self.new_batch):
            m.d.sync += self.limited.eq(0)
        with m.If(delay(m, self.new_batch, 2, name="new_batch", valid=True)):
            m.d.sync += pointer.eq(self.first)
        following = self.advance & ~self.hold if config.confidence else self.advance
        with m.If(self.start | following):
            m.d.sync += [
                pointer.eq(Mux(pointer == config.schedule_entries - 1, 0, pointer + 1)),
                *(getattr(self, name).eq(value) for name, value in limited.items()),
            ]
            m.d.sync += out_of_range.eq(reduce(or_, beyond.values()) if beyond else 0)
        # Only an entry that was used counts, not the one behind the last.
        with m.If(self.advance & out_of_range):
            m.d.sync += self.limited.eq(1)
        return m


class ScheduledAscent(Ascent):
    """An ascent by a schedule, which has a part for batches that begin with the last v, and one for all others.

    See :class:`~.ascent.Ascent` for parameters and the other members.

    Members
    -------
    schedule_write : ``In``, flow of :func:`payloads.schedule_write`
        Fills the table. Only while no batch is under way.
    """

    def __init__(self, config, *, target_bits, members):
        self.schedule = Schedule(config)
        write = {"schedule_write": In(payloads.flow(payloads.schedule_write(config)))}
        super().__init__(config, target_bits=target_bits, members=write | members)

    @property
    def blocks(self):
        return {"schedule": self.schedule, "ascent": self}

    def scheduled(self):
        """A module with velocity and schedule in it, which goes on with each move."""
        run, settings, schedule = self.run, self.run.settings, self.schedule
        if self.config.slides:
            m = self._with_table(run.plan != PLANS.index("cold"))
            m.d.comb += self.velocity.hold.eq(run.plan == PLANS.index("after"))
            if self.config.confidence:
                m.d.comb += schedule.hold.eq(run.final)
            self._walk(m, {name: select(run.plan, [settings[plan][name] for plan in PLANS]) for name in _PART})
            return m
        # Warm only while an object is followed: a new ROI, or a batch that found nothing, begins cold.
        tracking = Signal()
        warm = Signal()
        m = self._with_table(warm)
        with m.If(run.done):
            m.d.sync += tracking.eq(~run.degenerate)
        m.d.sync += warm.eq(self._unless_in_doubt(m, settings.start_last & tracking & ~settings.roi_load))
        self._walk(m, {name: Mux(warm, settings.warm[name], settings.cold[name]) for name in _PART})
        return m

    def _with_table(self, warm):
        """:meth:`begin`, and the schedule in it."""
        m = self.begin(warm)
        m.submodules.schedule = self.schedule
        connect(m, flipped(self.schedule_write), self.schedule.write)
        return m

    def _walk(self, m, plan):
        """The schedule goes through a part of the table."""
        run, schedule = self.run, self.schedule
        m.d.comb += [
            run.planned.eq(plan["count"]),
            schedule.new_batch.eq(run.take),
            schedule.start.eq(run.start),
            schedule.first.eq(plan["first"]),
            schedule.advance.eq(self.velocity.move),
            self.level.eq(schedule.level),
            self.limited.eq(schedule.limited),
        ]

    def _unless_in_doubt(self, m, warm):
        """``warm``, but not after a doubtful batch, if the settings say so."""
        run = self.run
        if not self.config.confidence:
            return warm
        m.d.comb += self.schedule.hold.eq(run.final)
        doubtful, restart = Signal(), Signal()
        m.d.comb += restart.eq(warm & doubtful & run.settings.cold_after_doubtful)
        with m.If(run.done):
            m.d.sync += doubtful.eq(run.doubtful)
        with m.If(run.take):
            m.d.sync += self.restarted.eq(0)
        with m.Elif(run.start):
            m.d.sync += self.restarted.eq(restart)
        return warm & ~restart
