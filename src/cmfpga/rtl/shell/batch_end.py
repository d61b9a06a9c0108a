"""Batch end: marks the last event of each batch."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block
from .. import payloads as core
from . import payloads
from .decoder import lowest_one


class BatchEnd(Block):
    """Ends batches with TLAST, on command, by their duration, or by their number of events.

    Each event waits here until it is known whether it is its batch's last: until the next one comes (which may be later
    than the batch's duration allows), or TLAST, or the command; not at all if it completes the number. So whatever
    ends a batch, there is an event to mark. An event outside t_first − duration … t_first + duration ends the batch
    before it: a jump of the clock costs one batch, and not all that follow.

    The number itself is counted by the core; here it is only known when it is complete.

    A vector of events is spread here, one a cycle. What is known to lie outside the ROI leaves at once, while the core
    is ``far`` from a batch's begin and end.

    One event per cycle; latency :attr:`latency` cycle, if the next event is there.

    Members
    -------
    i : ``In``, stream of :func:`payloads.sensor_token`
    o : ``Out``, stream of :func:`cmfpga.rtl.payloads.event`
    settings : ``In``, :func:`payloads.end_settings`
        Taken over with ``opened``.
    go : ``In(1)``
        A batch may begin.
    opened, taken : ``In(1)``
        The core begins a batch with the event that is offered; it has taken the last one of a batch.
    end_batch : ``In(1)``
        End the batch with the events that have come, when ``idle``.
    idle : ``In(1)``
        No event is on its way to ``i``.
    far : ``In(1)``
        As of :class:`~cmfpga.rtl.ingest.ingest_control.IngestControl`. Only where vectors are split.
    taking_in, holding : ``Out(1)``
        Between ``opened`` and ``taken``; an event waits.
    empty_end : ``Out(1)``
        One cycle: the end of a batch that has no event.
    """

    latency = 1

    def __init__(self, config):
        super().__init__(
            config,
            i=In(stream.Signature(payloads.sensor_token(config))),
            o=Out(stream.Signature(core.event(config, skips=config.skips))),
            **({"far": In(1)} if config.skips else {}),
            settings=In(payloads.end_settings(config)),
            **dict.fromkeys(("go", "opened", "taken", "end_batch", "idle"), In(1)),
            **dict.fromkeys(("taking_in", "holding", "empty_end"), Out(1)),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        current = Signal(payloads.end_settings(config))
        held = Signal(payloads.sensor_token(config))
        commanded = Signal()  # the held event was made the last one
        # It is the last that a batch has room for: the core ends that batch, and nothing that comes while it waits.
        full, behind = Signal(init=config.slice_events == 1), Signal()  # its end came behind it
        number = Signal(bits_for(config.slice_events), init=1)  # of the held event in its batch
        t_first, later, apart = (Signal(config.time_bits, name=name) for name in ("t_first", "later", "apart"))
        within = Signal(len(current.duration) + 2)  # negative: not within the duration
        by_time, by_number, followed, leaves = Signal(), Signal(), Signal(), Signal()
        arrives, ends, ended = Signal(), Signal(), Signal()
        column, events, leaves_whole, goes_on = held.x, 1, leaves, ended | followed | by_number
        if config.evt3:
            column, events, leaves_whole, more = self._spread(m, held, leaves)
            goes_on |= more

        def final(condition):
            """Where no event of the same vector follows."""
            return condition & ~more if config.evt3 else condition

        alone = config.slice_events == 1

        def completes(number, wanted):
            return (wanted == number) | (number == config.slice_events)

        # Is the held event the last one?
        m.d.comb += [
            followed.eq(self.i.valid & self.i.payload.event),
            later.eq(self.i.payload.t - t_first),
            # −duration … duration − 1 is still the batch's: the complement of a negative number is one less. Not by
            # ``>=``, so that the duration alone goes straight into the carry chain.
            apart.eq(later ^ later[-1].replicate(len(later))),
            within.eq(Cat(Const(0, 1), current.duration) - Cat(Const(1, 1), apart[: len(current.duration)])),
            by_time.eq(final((current.duration != 0) & followed & (within[-1] | apart[len(current.duration) :].any()))),
        ]
        m.d.comb += [
            self.o.payload.t.eq(held.t),
            self.o.payload.x.eq(column),
            self.o.payload.y.eq(held.y),
            ended.eq(final((held.end & current.by_tlast) | commanded)),
            # Of a vector, what is its last is not known where its end comes.
            self.o.payload.last.eq((ended & ~(behind & full if config.evt3 else behind)) | (by_time & ~full)),
            # Not behind the comparison of times, which ends a batch only where an event follows.
            self.o.valid.eq(self.holding & ((self.taking_in & goes_on) | (~self.taking_in & self.go))),
            self.holding.eq(held.event),
            leaves.eq(self.o.valid & self.o.ready),
        ]
        # An end right behind an event that completed the number is that batch's.
        completed = Signal()
        with m.If(leaves):
            m.d.sync += [
                held.event.eq(0),
                commanded.eq(0),
                number.eq(number + events),
                by_number.eq(completes(number + events, current.batch_events)),
                completed.eq(final(by_number & ~(ended | by_time) & ~arrives)),
                behind.eq(0),
                full.eq(alone | ((number == config.slice_events - events) & ~(by_number | ended | by_time))),
            ]
            if config.evt3:
                with m.If(~leaves_whole):
                    m.d.sync += [held.event.eq(1), commanded.eq(commanded), behind.eq(behind)]
        with m.Elif(arrives):
            m.d.sync += completed.eq(0)

        # Events take the place of the one that leaves; ends without an event belong to the one that waits.
        m.d.comb += [
            # As leaves is where an event follows, but not behind the comparison of times.
            self.i.ready.eq(~self.i.payload.event | ~self.holding | ((self.taking_in | self.go) & final(self.o.ready))),
            arrives.eq(self.i.valid & self.i.ready),
            ends.eq(arrives & ~self.i.payload.event & self.i.payload.end),
        ]
        with m.If(arrives & self.i.payload.event):
            m.d.sync += held.eq(self.i.payload)
        with m.Elif(ends):
            with m.If(self.holding & ~held.end & ~commanded & ~leaves_whole):
                m.d.sync += [held.end.eq(1), behind.eq(1 if config.evt3 else full)]
            with m.Elif(~completed & ~(leaves_whole & by_number & ~ended)):
                m.d.comb += self.empty_end.eq(self.settings.by_tlast)

        # The command waits for what is on its way.
        waiting = Signal()
        with m.If(self.end_batch):
            m.d.sync += waiting.eq(1)
        with m.Elif(waiting & self.idle & ~self.i.valid):
            m.d.sync += waiting.eq(0)
            with m.If(self.holding & ~leaves_whole):
                m.d.sync += commanded.eq(1)
            with m.Else():
                m.d.comb += self.empty_end.eq(1)

        # Batches.
        with m.If(self.opened):
            m.d.sync += [
                self.taking_in.eq(1),
                number.eq(1),
                by_number.eq(completes(1, self.settings.batch_events)),
                full.eq(alone),
                current.eq(self.settings),
                t_first.eq(held.t),
            ]
        with m.Elif(self.taken):
            m.d.sync += self.taking_in.eq(0)
        return m

    def _spread(self, m, held, leaves):
        """Column and number of the events that leave ``held`` next; whether they are all of it; whether more follow."""
        rest, index, several = lowest_one(m, held.vector)
        skip, more, whole = Signal(), Signal(), Signal()
        m.d.comb += [more.eq(several & ~skip), whole.eq(leaves & ~more)]
        with m.If(leaves):
            m.d.sync += held.vector.eq(rest)
        if not self.config.skips:
            return held.x + index, 1, whole, more
        # What was compared with another ROI is a batch's first. An event of it leaves alone, for the core is not far.
        m.d.comb += [skip.eq(held.outside & several & self.far), self.o.payload.skip.eq(Mux(skip, held.events, 0))]
        with m.If(leaves):
            m.d.sync += held.outside.eq(0)
        return held.x + index, Mux(skip, held.events, 1), whole, more
