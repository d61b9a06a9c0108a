"""Slices: windows that overlap, each made of the last slices of events."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out

from .. import Block
from .. import payloads as common
from ..image.sliced_memory import memory_of


class Slices(Block):
    """Each slice goes out behind those that it shares its window with, which are kept here, in a ring.

    What follows sees a batch as any other. The first windows after a reset have fewer slices. A slice ends with
    ``last``, by its number of events, or where it has as many as a window has room for.

    An event per cycle in, and one out; an event that comes goes out in the same cycle. Before a slice's first event is
    taken, the n events of the slices before it go out, in n + 4 cycles.

    Members
    -------
    i, o : ``In``, ``Out``, streams of :func:`~cmfpga.rtl.payloads.event`
        ``last`` ends a slice, and the window.
    slice_events : ``In``
        End a slice after so many events; 0: not by their number. Of the slice whose first event is offered.
    opened : ``In(1)``
        The window begins with what is offered.
    """

    def __init__(self, config):
        super().__init__(
            config,
            i=In(stream.Signature(common.event(config))),
            o=Out(stream.Signature(common.event(config))),
            slice_events=In(common.settings(config)["batch_events"].shape),
            opened=In(1),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        kept = Signal(common.event(config), reset_less=True)
        shape, depth = len(kept.as_value()) - 1, config.slices * config.slice_events
        style = {"ram_style": config.store_style} if config.store_style == "ultra" else {}
        m.submodules.ring = ring = memory_of(shape, depth, style)
        write, read = ring.write_port(), ring.read_port()

        def after(place):
            return Mux(place == depth - 1, 0, place + 1)

        # Where slices begin: this one, those before it, the youngest first. After a reset all are at 0, and so empty.
        begin, at, replayed = (Signal(range(depth), name=name) for name in ("begin", "at", "replayed"))
        before = [Signal(range(depth), name=f"before_{k}") for k in range(1, config.slices)]
        number, wanted, full = Signal(range(config.slice_events + 1)), Signal.like(self.slice_events), Signal()
        found, there, begun = Signal(), Signal(), Signal()
        goes = (self.o.ready & self.o.valid) | ~there  # the word behind the RAM can be replaced
        event, out = self.i.payload, self.o.payload
        m.d.comb += [
            read.addr.eq(replayed),
            read.en.eq(goes | ~found),
            write.addr.eq(at),
            write.data.eq(event.as_value()[:-1]),
        ]
        with m.FSM(name="slices"):
            with m.State("WAIT"):
                m.d.sync += [replayed.eq(before[-1]), begin.eq(at), begun.eq(0), number.eq(1)]
                m.d.sync += [
                    wanted.eq(self.slice_events),
                    full.eq((self.slice_events == 1) | (config.slice_events == 1)),
                ]
                with m.If(self.i.valid):
                    m.next = "REPLAY"
            with m.State("REPLAY"):
                m.d.comb += self.o.valid.eq(there & (self.i.valid | begun))
                m.d.comb += [out.eq(kept), out.last.eq(0)]
                with m.If(self.opened):
                    m.d.sync += begun.eq(1)
                # Two words behind one another: that of the RAM, and one in a register.
                with m.If(goes):
                    m.d.sync += [there.eq(found), kept.as_value().eq(read.data)]
                with m.If(goes | ~found):
                    m.d.sync += found.eq(replayed != begin)
                    with m.If(replayed != begin):
                        m.d.sync += replayed.eq(after(replayed))
                with m.If((replayed == begin) & ~found & ~there):
                    m.next = "PASS"
            with m.State("PASS"):
                m.d.comb += [
                    self.o.valid.eq(self.i.valid),
                    self.i.ready.eq(self.o.ready),
                    out.eq(event),
                    out.last.eq(event.last | full),
                    write.en.eq(self.i.valid & self.o.ready),
                ]
                with m.If(write.en):
                    m.d.sync += [at.eq(after(at)), number.eq(number + 1)]
                    m.d.sync += full.eq((number + 1 == wanted) | (number == config.slice_events - 1))
                    with m.If(out.last):
                        m.d.sync += [new.eq(old) for new, old in zip(before, (begin, *before), strict=False)]
                        m.next = "WAIT"
        return m
