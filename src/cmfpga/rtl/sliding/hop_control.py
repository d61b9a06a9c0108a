"""Hop control: takes events in, and says where a hop ends."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out

from ...config.widths import Widths
from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay
from .ring import address_bits, ring_event
from .walker import lengths


def hop_counts(config):
    """Where the events of a hop went, ``events`` in all."""
    marks = [name for name in ("hot", "noise") if name in payloads.marked_event(config).members]
    names = ("events", "fresh", "outside", "thinned", "time_back", *marks)
    return data.StructLayout(dict.fromkeys(names, bits_for(config.max_batch_events)))


class HopControl(Block):
    """Passes the events of the ROI on to the ring, and closes a hop with the ``hop_events``-th of them.

    Or before the first event, wherever on the sensor, that comes ``hop_us`` or more after the last hop closed; or with
    the ``max_batch_events``-th of the sensor. An event whose time steps back is dropped; one that is marked tells the
    time, and is dropped. Of the others in the ROI one in ``thinning`` is passed on.

    The ROI moves where a hop closes, between two events, to the corner that is given then. An event waits only if a hop
    would close before the last one is evaluated, or if the ring has no place. So hops follow from the sequence of
    events, and not from when they come.

    One event per cycle; latency :attr:`latency` cycles. A hop's end costs two cycles, and three where it closes by
    time.

    Members
    -------
    i : ``In``, stream of :func:`payloads.undistorted_event`
    o : ``Out``, flow of :func:`.ring.ring_event`
        Those in the ROI.
    lengths, thinning : ``In``, :func:`.walker.lengths`
        ``thinning`` is constant from the first event on. ``lengths`` may change while no event comes, the last hop is
        evaluated, and ``waits`` is low; the hop under way keeps its own.
    corner : ``In``, :func:`payloads.roi_corner`
        The ROI from the end of the hop on; before the first event, that of the first hop.
    free : ``In(1)``
        The last hop is evaluated, so that one may close. From then on high until ``closed``, low from the cycle after
        that on.
    oldest : ``In``
        Place in the ring of the first event that is still needed.
    closed : ``Out(1)``
        A hop has closed: one cycle, that in which its last event comes out, or later. What follows then stays until
        ``free`` is high again.
    end, now : ``Out``
        Place in the ring after its last event; when it closed, µs.
    step, stale : ``Out``
        How long that was after the one before, lowest bits, and whether more than ``window_us``; from the cycle after
        ``closed`` on, and the one after that.
    counts : ``Out``, :func:`hop_counts`
        From the second cycle after ``closed`` on.
    waits : ``Out(1)``
        An event has been taken that is not judged yet.
    """

    latency = 4

    def __init__(self, config):
        super().__init__(
            config,
            i=In(stream.Signature(payloads.undistorted_event(config))),
            o=Out(payloads.flow(ring_event(config))),
            lengths=In(lengths(config)),
            thinning=In(Widths.thinning_bits, init=1),
            corner=In(payloads.roi_corner(config)),
            free=In(1),
            oldest=In(address_bits(config)),
            closed=Out(1),
            end=Out(address_bits(config)),
            now=Out(config.time_bits),
            step=Out(config.span_bits),
            stale=Out(1),
            counts=Out(hop_counts(config)),
            waits=Out(1),
        )

    def elaborate(self, platform):
        config, lengths, frac = self.config, self.lengths, self.config.formats.event_frac
        sizes = config.roi_width, config.roi_height
        m = Module()
        # Stages 1 to 3 go on together. What is judged in the third is known there: nothing is compared any more.
        moves, goes, begun = Signal(), Signal(), Signal()
        valid_s1, valid_s2, valid_s3 = (Signal(name=f"valid_s{stage}") for stage in (1, 2, 3))
        event_s1, event_s2, event_s3 = (
            Signal(payloads.undistorted_event(config), name=f"event_s{stage}", reset_less=True) for stage in (1, 2, 3)
        )
        roi, latest, left = Signal.like(self.corner), Signal(config.time_bits), Signal.like(lengths.hop_events)
        place = Signal.like(self.end)
        behind, after = Signal.like(place, init=1), Signal.like(place, init=2)  # the next place, and the one after that
        before, target, step = (Signal(config.time_bits, name=name) for name in ("before", "target", "step"))
        closes, stays, due, last, full = (Signal(name=name) for name in ("closes", "stays", "due", "last", "full"))
        keeps, kept = Signal(init=1), Signal()  # one in ``thinning``: of what comes next, and of what comes behind that
        # What waits is judged again, for the next hop: stages 2 and 3 change places, and back. Nothing moves meanwhile.
        again, stops = delay(m, self.closed, 1, name="closed", valid=True), Signal()
        m.d.sync += stops.eq(closes | self.closed)
        m.d.comb += [
            moves.eq(goes | ~(valid_s3 | stops)),
            self.i.ready.eq(moves),
            self.waits.eq(valid_s1 | valid_s2 | valid_s3),
        ]
        with m.If(moves):
            m.d.sync += [valid_s1.eq(self.i.valid), event_s1.eq(self.i.payload)]

        # Stage 1: the time that it is.
        now_s2, now_s3 = (Signal(config.time_bits, name=f"now_s{stage}", reset_less=True) for stage in (2, 3))
        back_s2, back_s3 = (Signal(name=f"back_s{stage}", reset_less=True) for stage in (2, 3))
        since = (event_s1.t - latest)[: config.time_bits]
        now = Mux(since[-1], latest, event_s1.t)
        with m.If(valid_s1):  # whether or not it moves: a second time changes nothing
            m.d.sync += latest.eq(now)

        # Stage 2: whether it lies in the ROI, and comes behind the hop.
        inside_s3, due_s3, stands_s3 = (
            Signal(name=f"{name}_s3", reset_less=name != "stands") for name in ("inside", "due", "stands")
        )
        timed, inside, late = Signal(), Signal(), Signal()
        ends, sides = {}, []
        for axis, size in zip("xy", sizes, strict=True):
            at, ends[axis] = event_s2[axis], Signal(range((1 << len(roi[axis])) + size), name=f"end_{axis}")
            sides += [at >= Cat(Const(0, frac), roi[axis]), at < Cat(Const(0, frac), ends[axis])]
        marks = [name for name in ("hot", "noise") if name in hop_counts(config).members]
        marked = Cat(event_s2[name] for name in marks).any() if marks else 0
        m.d.comb += [
            inside.eq(Cat(sides).all() & ~back_s2 & ~marked),
            # Time never steps back here, so the sign tells.
            late.eq(timed & ~back_s2 & ~(now_s2 - target)[config.time_bits - 1]),
        ]
        with m.If(moves | stops):
            m.d.sync += [
                valid_s2.eq(Mux(stops, valid_s3, valid_s1)),
                event_s2.eq(Mux(stops, event_s3.as_value(), event_s1.as_value())),
                now_s2.eq(Mux(stops, now_s3, now)),
                back_s2.eq(Mux(stops, back_s3, since[-1])),
                *(later.eq(value) for later, value in ((valid_s3, valid_s2), (event_s3, event_s2))),
                *(later.eq(value) for later, value in ((now_s3, now_s2), (back_s3, back_s2))),
                inside_s3.eq(inside),
                due_s3.eq(late),
                stands_s3.eq(valid_s2 & ~late),  # there is an event, and the hop does not end before it
            ]

        # Stage 3: whether it stays, and whether it ends a hop.
        taken = Signal.like(self.counts.events, name="taken")
        longest = Signal.like(lengths.window_us)
        step_s1 = delay(m, step, 1, name="step")
        m.d.comb += self.step.eq(step_s1)
        m.d.sync += self.stale.eq(step_s1 > longest)
        with m.If(self.closed):
            m.d.sync += longest.eq(Mux(lengths.window_us == 0, 1 << (config.span_bits - 1), lengths.window_us))
        most = config.max_batch_events
        # Flags: the next one that stays ends the hop; any is the last of so many; a hop may close. One that stays
        # waits, for it has no place, or would close a hop that may not close yet; any waits, for it would.
        ending, greatest, free, waits, all_wait = Signal(), Signal(init=most == 1), Signal(), Signal(), Signal()
        skipped, others = Signal(Widths.thinning_bits), Signal(Widths.thinning_bits)
        marks = {name: event_s3[name] & ~back_s3 for name in marks}
        marked = Cat(marks.values()).any() if marks else 0
        stored = Signal()
        m.d.comb += [
            step.eq(self.now - before),
            stays.eq(inside_s3 & keeps),
            due.eq(due_s3),
            last.eq((stays & ending) | greatest),
            full.eq(stays & waits),
            closes.eq(free & ((valid_s3 & due) | (stands_s3 & last & ~full))),
            goes.eq(stands_s3 & ~stops & ~all_wait & ~full),
            stored.eq(goes & stays),
        ]
        m.d.sync += [
            self.closed.eq(closes),
            self.o.valid.eq(stored),
            *(self.o.payload[name].eq(event_s3[name]) for name in ("x", "y")),
            self.o.payload.t.eq(now_s3),  # of one that stays
            others.eq(Mux(self.thinning == 0, 0, self.thinning - 1)),
            free.eq(self.free & ~closes & ~self.closed),
            # As the oldest was a cycle ago: a place that has become free since is used a cycle later. Where a hop has
            # closed, all stops until that is known here.
            waits.eq(
                Mux(
                    stored,
                    (after == self.oldest) | ((left == 2) & ~self.free),
                    (behind == self.oldest) | (ending & ~self.free),
                )
            ),
            all_wait.eq(Mux(goes, taken == most - 2, greatest) & ~self.free),
        ]
        lost = {"fresh": stays, "outside": ~inside_s3 & ~back_s3 & ~marked}
        lost |= {"thinned": inside_s3 & ~stays, "time_back": back_s3} | marks
        grown = Signal(data.StructLayout({name: taken.shape() for name in lost}), name="grown")  # two cycles later
        counts = Signal.like(grown, name="counts")
        for name, which in lost.items():
            m.d.comb += grown[name].eq(counts[name] + delay(m, goes & which, 2, name=f"grows_{name}", valid=True))
        m.d.sync += counts.eq(Mux(again, 0, grown.as_value()))
        with m.If(self.closed):
            m.d.sync += self.counts.events.eq(taken)
        with m.If(again):
            m.d.sync += [self.counts[name].eq(grown[name]) for name in lost]
        with m.If(goes):
            m.d.sync += [taken.eq(taken + 1), greatest.eq(taken == most - 2)]
        m.d.comb += kept.eq(keeps)
        with m.If(goes & inside_s3):
            m.d.comb += kept.eq(Mux(keeps, others == 0, skipped == 1))
            m.d.sync += skipped.eq(Mux(keeps, others, skipped - 1))
        m.d.sync += keeps.eq(kept)
        with m.If(stored):
            m.d.sync += [place.eq(behind), behind.eq(after), after.eq(after + 1)]
            m.d.sync += [left.eq(left - 1), ending.eq(left == 2)]
        # They follow the events until the hop closes, for less hangs on a register than on its end.
        with m.If(free):
            m.d.sync += [self.end.eq(Mux(stays & ~due, behind, place)), self.now.eq(now_s3)]
        # The first hop begins a cycle after its first event is there, before that is judged.
        waits_first = ~delay(m, begun, 1, name="begun", valid=True)
        with m.If((self.free & ~free & ~self.closed) | waits_first):  # from the next cycle on a hop may close
            m.d.sync += before.eq(self.now)
        with m.If(self.closed | waits_first):  # the next hop begins
            m.d.sync += [
                roi.eq(self.corner),
                *(ends[axis].eq(self.corner[axis] + size) for axis, size in zip("xy", sizes, strict=True)),
                target.eq(self.now + lengths.hop_us),
                timed.eq(lengths.hop_us != 0),
                left.eq(lengths.hop_events),
                ending.eq(lengths.hop_events == 1),
                taken.eq(0),
                greatest.eq(most == 1),
            ]
        with m.If(~begun):
            m.d.sync += [time.eq(self.i.payload.t) for time in (self.now, latest)]
            m.d.sync += begun.eq(self.i.valid)
        return m
