"""Walker: where the next window begins."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from ...config.dither import DITHER_BITS, FACTORS
from ...fixed import bits_for
from .. import Block
from ..arithmetic import delay
from .ring import Ring, address_bits


def lengths(config):
    """Layout of what a window may hold, as of :class:`~cmfpga.protocol.settings.BatchSettings`."""
    count, time = bits_for(config.buffer_events), config.span_bits
    return data.StructLayout({"window_events": count, "window_us": time, "hop_events": count, "hop_us": time})


class Walker(Block):
    """Moves the begin b of the window on when a hop has closed, as far as the next hop's events ask for it.

    Dropped are more than ``window_events`` − ``hop_events``, and events that were older than ``window_us`` − ``hop_us``
    when the hop closed; after a pause of more than ``window_us`` all. It keeps the dither's phase at b, so that an
    event keeps its own for as long as it stays; a window that shares no event with the last one begins it anew.

    An event per cycle. What is too many is dropped without a look at the ring, from the third cycle after ``closed``
    on. From ``go`` on its read port is the walker's; of d events that are still to be dropped then, ``done`` is d +
    :attr:`latency` cycles after it.

    Members
    -------
    closed : ``In(1)``
        The hop has closed, at ``end``. Once between ``done`` and ``go``.
    go : ``In(1)``
        ``now`` and ``stale`` say when it has closed, and whether after a pause; at least two cycles later. The event
        before ``end`` can be read.
    lengths : ``In``, :func:`lengths`
        Taken over with ``closed``.
    look, t : ``Out``, ``In``
        A place, and the time of the event there, :attr:`Ring.latency <.ring.Ring.latency>` − 1 cycles later.
    done : ``Out(1)``
        One cycle. What follows is valid from then on until the next ``go``.
    begin, t_first, empty : ``Out``
        b; the time of its event, where there is one; there is none yet.
    phase_x, phase_y : ``Out``
        Its dither: (k + ½)·α.
    """

    latency = Ring.latency + 4

    def __init__(self, config):
        place = address_bits(config)
        super().__init__(
            config,
            closed=In(1),
            go=In(1),
            end=In(place),
            now=In(config.span_bits),
            stale=In(1),
            lengths=In(lengths(config)),
            look=Out(place),
            t=In(config.span_bits),
            done=Out(1),
            begin=Out(place),
            t_first=Out(config.span_bits),
            empty=Out(1, init=1),
            **{f"phase_{axis}": Out(DITHER_BITS, init=f // 2) for axis, f in zip("xy", FACTORS, strict=True)},
        )

    def elaborate(self, platform):
        config, lengths = self.config, self.lengths
        m = Module()
        phases = self.phase_x, self.phase_y
        # Those of the next window, which are not told before it is complete.
        ahead = Signal.like(self.begin)
        its_phases = [Signal.like(phase, name=f"ahead_{axis}") for axis, phase in zip("xy", phases, strict=True)]
        held = Signal.like(self.begin)  # its events
        most = Signal.like(self.begin)  # how many of them may stay
        now, oldest, stale = Signal.like(self.now), Signal(config.span_bits), Signal()
        # A place is looked at in each cycle; what is there comes back in the same order.
        walking = Signal()
        counts = Signal()  # drops what is too many
        arrived = Signal(Ring.latency + 3)
        # Flags of ``held``, which stand beside it: there are some, and more than may stay.
        some = Signal()
        over = Signal()
        drops = Signal()
        more = Signal(len(most) + 1)  # than may stay by one
        t_s1 = delay(m, self.t, 1, name="t_from_ring")  # RAMs are slow, and far away
        age_s2 = delay(m, (now - t_s1)[: config.span_bits], 1, name="age")
        old_s3, t_s3 = delay(m, age_s2 > oldest, 1, name="old"), delay(m, t_s1, 2, name="t")
        looked = walking & arrived[-2]
        m.d.comb += drops.eq(Mux(walking, looked & some & (stale | over | old_s3), counts & over & ~self.go))
        m.d.sync += [some.eq(held != 0), over.eq(held > most), more.eq(most + 1)]
        with m.If(self.closed):
            longest = Mux(lengths.window_us == 0, 1 << (config.span_bits - 1), lengths.window_us)
            m.d.sync += [held.eq(self.end - ahead), most.eq(lengths.window_events - lengths.hop_events)]
            m.d.sync += oldest.eq(longest - lengths.hop_us)
        m.d.sync += counts.eq((counts | delay(m, self.closed, 1, name="closed", valid=True)) & ~self.go)
        m.d.sync += [self.done.eq(0), arrived.eq((arrived << 1) | walking), self.look.eq(self.look + 1)]
        with m.If(self.go):
            m.d.sync += [walking.eq(1), self.look.eq(ahead), now.eq(self.now), stale.eq(self.stale), arrived.eq(0)]
        with m.If(drops):
            m.d.sync += [ahead.eq(ahead + 1), held.eq(held - 1), some.eq(held != 1), over.eq(held > more)]
            m.d.sync += [phase.eq(phase + factor) for phase, factor in zip(its_phases, FACTORS, strict=True)]
        with m.If(looked & ~drops):
            m.d.sync += [walking.eq(0), self.done.eq(1), self.t_first.eq(t_s3), self.empty.eq(~some)]
            m.d.sync += [self.begin.eq(ahead), *(new.eq(its) for new, its in zip(phases, its_phases, strict=True))]
            with m.If(~some):
                for phase, factor in zip((*phases, *its_phases), 2 * FACTORS, strict=True):
                    m.d.sync += phase.eq(factor // 2)
        return m
