"""Ring: keeps the newest events of the ROI, and replays a window of them while others are written."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay
from ..image.sliced_memory import memory_of


def ring_event(config):
    """An event as the ring keeps it: its place on the sensor, and the lowest bits of its time.

    Two times in the ring differ by less than 2^span_bits µs. Two places may lie as far from each other as the sensor
    has pixels: a fast object's image lies far from where its first events were.
    """
    geometry, frac = config.geometry, config.formats.event_frac
    return payloads.layout(t=config.span_bits, x=geometry.x_bits + frac, y=geometry.y_bits + frac)


def address_bits(config):
    """Width of an event's place in the ring, which holds ``buffer_events`` or a few more."""
    return bits_for(config.buffer_events)


class Ring(Block):
    """Stores events one after the other, the newest in place of the oldest, and replays those from ``first`` on.

    A replay follows the writes: it goes on with each event that comes, until it is told with which one the window ends.
    It stays one event behind, because only then it knows which one is the last. Who writes takes care that no event of
    a window that is being replayed is overwritten.

    One event per cycle in and out, as long as there is ``room`` for what comes out. An event can be read
    :attr:`write_latency` cycles after it came. The first one appears :attr:`latency` cycles after ``replay``; the last
    one :attr:`write_latency` + :attr:`latency` cycles after it came, at most, if no replay is late and ``closed`` comes
    a cycle later. Where evaluations of an event take turns, an event comes out in the first cycle of each turn.

    Parameters
    ----------
    config : Config
        ``buffer_events`` is less than the depth, a power of two.

    Members
    -------
    i : ``In``, flow of :func:`ring_event`
    o : ``Out``, flow of :func:`ring_event`, and ``last``
    written : ``Out``
        Place behind the newest event that can be read.
    replay : ``In(1)``
        Begin a replay at ``first``, right from two cycles before on. Not while one is under way, nor in the two cycles
        after it.
    closed, end : ``In(1)``, ``In``
        The window under way ends before the place ``end``, from now on until the next ``replay``; earlier than any
        event behind it can be read. ``end`` is right from a cycle before on.
    room : ``In(1)``
        Where it is low, the replay pauses.
    look : ``In``
        A place. Its event is ``o.payload``, :attr:`latency` − 1 cycles later, while no replay is under way.
    idle : ``Out(1)``
        No replay is under way, but for what is still to come out.
    """

    latency, write_latency = 3, 2

    def __init__(self, config):
        place, event = address_bits(config), ring_event(config)
        super().__init__(
            config,
            i=In(payloads.flow(event)),
            o=Out(payloads.flow(payloads.layout(**event.members, last=1))),
            written=Out(place),
            replay=In(1),
            first=In(place),
            closed=In(1),
            end=In(place),
            room=In(1, init=1),
            look=In(place),
            idle=Out(1, init=1),
        )

    def elaborate(self, platform):
        m = Module()
        event, depth = ring_event(self.config), 1 << address_bits(self.config)
        m.submodules.events = events = memory_of(event, depth, {})
        write, read = events.write_port(), events.read_port()

        # Written a cycle after it came.
        m.d.sync += [write.en.eq(self.i.valid), write.data.eq(self.i.payload)]
        m.d.sync += write.addr.eq(write.addr + write.en)
        m.d.comb += self.written.eq(write.addr)
        stored = Signal.like(self.written)  # the same, and a cycle earlier
        m.d.sync += stored.eq(stored + self.i.valid)

        # Stage 1: place. What decides stands in registers, for much hangs on it: whether the event there can be read,
        # the one behind it too, and whether it is the last.
        names = ("reading_s1", "closed", "some", "more", "ends", "last_s1", "goes")
        reading_s1, closed, some, more, ends, last_s1, goes = (Signal(name=name) for name in names)
        # ``held``: events that can be read, from that place on.
        address_s1, next_s1, held = (Signal.like(self.first, name=name) for name in ("address_s1", "next_s1", "held"))
        turn = 0
        if self.config.geometry.turn_bits:
            turn = Signal(self.config.geometry.turn_bits)
            m.d.sync += turn.eq(Mux(self.replay, 0, turn + 1))
        m.d.comb += [
            last_s1.eq(closed & ends),
            goes.eq(reading_s1 & self.room & (turn == 0) & some & (last_s1 | more)),
            self.idle.eq(~reading_s1),
        ]
        last = delay(m, (self.end - 1)[: len(self.end)], 1, name="last_place")
        empty, comes = delay(m, address_s1 == self.end, 1, name="empty"), write.en
        over = closed & empty
        one, two, three = held != 0, held >= 2, (held >= 4) | (held == 3)  # or more: bits tell, without an adder
        m.d.sync += [
            closed.eq(self.closed),
            ends.eq(Mux(goes, next_s1 == last, address_s1 == last)),
            some.eq((comes | Mux(goes, two, one)) & ~over),  # of an empty window none, though the next hop's are there
            more.eq(Mux(goes, three | (two & comes), two | (one & comes))),
        ]
        with m.If(~reading_s1):  # where the next replay begins
            m.d.sync += [address_s1.eq(self.first), next_s1.eq(self.first + 1)]
            m.d.sync += [held.eq(stored - address_s1), reading_s1.eq(self.replay)]
        with m.Else():
            m.d.sync += held.eq(Mux(goes, Mux(comes, held, held - 1), held + comes))  # only a choice hangs on ``goes``
            with m.If(goes):
                m.d.sync += [address_s1.eq(next_s1), next_s1.eq(next_s1 + 1)]
            with m.If((goes & last_s1) | over):  # or a window without events
                m.d.sync += reading_s1.eq(0)

        # Stage 2: the memory's own register. Stage 3: its output register.
        m.d.comb += read.addr.eq(Mux(reading_s1, address_s1, self.look))
        read_s3 = Signal(event, reset_less=True)  # a reset would keep it out of block RAMs
        m.d.sync += read_s3.eq(read.data)
        m.d.comb += [self.o.payload[name].eq(read_s3[name]) for name in event.members]
        m.d.sync += [
            self.o.payload.last.eq(delay(m, last_s1, 1, name="last")),
            self.o.valid.eq(delay(m, goes, 1, name="goes", valid=True)),
        ]
        return m
