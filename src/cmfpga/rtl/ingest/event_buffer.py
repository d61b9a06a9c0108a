"""Event buffer: stores a batch's ROI events and replays them in every iteration."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import payloads


def stored(config):
    """Signature of what the buffer says of a batch: events stored and events dropped since ``clear``."""
    return wiring.Signature(
        {"count": Out(bits_for(config.buffer_events)), "overflow": Out(bits_for(config.max_batch_events))}
    )


class EventBuffer(wiring.Component):
    """Stores events until it is full, then replays all of them, one per cycle, whenever asked.

    The surplus of a full buffer is dropped and counted. With two buffers, one is filled while the other is replayed.
    One event per cycle in and out, as long as there is ``room`` for what comes out; the first event appears
    :attr:`latency` cycles after ``replay``, and each one :attr:`latency` − 1 after the cycle in which there was room.

    Parameters
    ----------
    config : Config
        ``buffer_events`` is the depth of each of ``buffers``.

    Members
    -------
    i : ``In``, flow of :func:`payloads.roi_event`
        Events to store.
    o : ``Out``, flow of :func:`payloads.replayed_event`
        The stored events in order; ``last`` marks the last one.
    clear : ``In(1)``
        Begin to fill: the other buffer, if there are two. No event in this cycle.
    take : ``In(1)``
        What has been filled is what will be replayed. No replay is under way.
    replay : ``In(1)``
        Begin a replay. Not while one is under way; at least one event must be stored.
    room : ``In(1)``
        Where it is low, the replay pauses: here alone, because nothing behind can be stalled.
    stored : ``Out``, :func:`stored`
    """

    latency = 3

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(payloads.flow(payloads.roi_event(config))),
                "o": Out(payloads.flow(payloads.replayed_event(config))),
                "clear": In(1),
                "take": In(1),
                "replay": In(1),
                "room": In(1, init=1),
                "stored": Out(stored(config)),
            }
        )

    def elaborate(self, platform):
        depth = self.config.buffer_events
        count, overflow = self.stored.count, self.stored.overflow
        m = Module()
        two = self.config.buffers == 2
        offset = 1 << bits_for(depth - 1)  # the second buffer begins at a power of two
        m.submodules.events = events = memory.Memory(
            shape=payloads.roi_event(self.config), depth=offset + depth if two else depth, init=[]
        )
        write, read = events.write_port(), events.read_port()

        filling, replaying = Signal(), Signal()  # which of two buffers
        replayed = Signal.like(count)  # events of the one that is replayed
        if two:
            with m.If(self.clear):
                m.d.sync += filling.eq(~filling)
        with m.If(self.take):
            m.d.sync += [replaying.eq(filling), replayed.eq(count)]

        full = Signal()
        m.d.comb += [
            full.eq(count == depth),
            write.addr.eq(count | Mux(filling, offset, 0)),
            write.data.eq(self.i.payload),
            write.en.eq(self.i.valid & ~full),
        ]
        with m.If(self.clear):
            m.d.sync += [count.eq(0), overflow.eq(0)]
        with m.Elif(self.i.valid):
            with m.If(full):
                m.d.sync += overflow.eq(overflow + 1)
            with m.Else():
                m.d.sync += count.eq(count + 1)

        # Stage 1: address.
        reading_s1 = Signal()
        address_s1 = Signal(range(max(2, depth)))
        last_s1 = Signal()
        m.d.comb += [last_s1.eq(address_s1 + 1 == replayed), read.addr.eq(address_s1 | Mux(replaying, offset, 0))]
        with m.If(self.replay):
            m.d.sync += [reading_s1.eq(1), address_s1.eq(0)]
        with m.Elif(reading_s1 & self.room):
            m.d.sync += [reading_s1.eq(~last_s1), address_s1.eq(address_s1 + 1)]

        # Stage 2: the memory's own register. Stage 3: its output register.
        reading_s2 = Signal()
        last_s2 = Signal(reset_less=True)
        m.d.sync += [
            reading_s2.eq(reading_s1 & self.room),
            last_s2.eq(last_s1),
            self.o.valid.eq(reading_s2),
            self.o.payload.eq(read.data),
            self.o.payload.last.eq(last_s2),
        ]
        return m
