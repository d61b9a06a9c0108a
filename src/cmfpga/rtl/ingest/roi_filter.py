"""ROI filter: crops the event stream and measures the batch's time range."""

import functools
import operator

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay


def measured(config):
    """Signature of what the filter says of a batch.

    ``t_first`` and ``span`` are t_1 and t_N − t_1, in µs; ``outside``, ``time_back``, ``time_span`` count the events
    outside the ROI, dropped for a step back, dropped for lying beyond the span; ``hot`` and ``noise`` those that were
    marked, where the hardware does.
    """
    marks = [name for name in ("hot", "noise") if name in payloads.marked_event(config).members]
    counts = dict.fromkeys(("outside", "time_back", "time_span", *marks), Out(bits_for(config.max_batch_events)))
    return wiring.Signature({"t_first": Out(config.time_bits), "span": Out(config.span_bits), **counts})


class RoiFilter(Block):
    """Passes the events that lie in the ROI, relative to its corner and to the batch's first event.

    The first event after ``start`` gives t_1; the last good one t_N. An event whose time steps back, or lies
    ``2**span_bits`` µs or more after t_1, is dropped and counted. Time stamps may wrap.

    One event per cycle; latency :attr:`latency` cycles.

    Parameters
    ----------
    size : (int, int), optional
        Columns and rows, by default the ROI's.
    skips : bool
        Events may come several at once, all of one time and outside the ROI: ``skip`` of them. Nothing marks events.

    Members
    -------
    i : ``In``, flow of :func:`payloads.undistorted_event`, or of :func:`payloads.event` with ``skips``
        All events of the batch; ``last`` is not used here. Those that are marked tell the time, and are dropped.
    o : ``Out``, flow of :func:`payloads.roi_event`
        Events in the ROI.
    start : ``In(1)``
        A new batch begins: clears the counters. No event in this cycle and the four before.
    roi : ``In``, :func:`payloads.roi_corner`
        The ROI's corner; constant during a batch.
    measured : ``Out``, :func:`measured`
        Right a cycle after the last event would leave.
    """

    latency = 4

    def __init__(self, config, size=None, *, skips=False):
        self._event = payloads.event(config, True) if skips else payloads.undistorted_event(config)
        self._skips = skips
        self._size = size or (config.roi_width, config.roi_height)
        super().__init__(
            config,
            i=In(payloads.flow(self._event)),
            o=Out(payloads.flow(payloads.roi_event(config, *self._size))),
            start=In(1),
            roi=In(payloads.roi_corner(config)),
            measured=Out(measured(config)),
        )

    def elaborate(self, platform):
        config, found, frac = self.config, self.measured, self.config.formats.event_frac
        width, height = self._size
        m = Module()

        # Stage 1: register the event; the first one sets t_1.
        valid_s1 = Signal()
        event_s1 = Signal(self._event, reset_less=True)
        first = Signal(init=1)
        m.d.sync += [valid_s1.eq(self.i.valid), event_s1.eq(self.i.payload)]
        with m.If(self.start):
            m.d.sync += first.eq(1)
        with m.Elif(self.i.valid):
            m.d.sync += first.eq(0)
        with m.If(self.i.valid & first):
            m.d.sync += found.t_first.eq(self.i.payload.t)

        # Stage 2: relative to t_1 (modulo the counter's width) and to the ROI.
        valid_s2 = Signal()
        t_s2 = Signal(signed(config.time_bits), reset_less=True)
        x_s2 = Signal(signed(len(event_s1.x) + 1), reset_less=True)
        y_s2 = Signal(signed(len(event_s1.y) + 1), reset_less=True)
        m.d.sync += [
            valid_s2.eq(valid_s1),
            t_s2.eq((event_s1.t - found.t_first)[: config.time_bits].as_signed()),
            x_s2.eq(event_s1.x - Cat(Const(0, frac), self.roi.x)),
            y_s2.eq(event_s1.y - Cat(Const(0, frac), self.roi.y)),
        ]
        marks = {name: delay(m, event_s1[name], 1, name=name) for name in ("hot", "noise") if hasattr(found, name)}

        # Stage 3: compare with the last good time that is known by now, and with the event before, which may be it.
        valid_s3, good_s4 = Signal(), Signal()
        event_s3 = Signal(payloads.roi_event(config, *self._size), reset_less=True)
        negative, late, inside, before_known, before_last = (
            Signal(name=f"{name}_s3", reset_less=True)
            for name in ("negative", "late", "inside", "before_known", "before_last")
        )
        t = t_s2[: config.span_bits]
        m.d.sync += [
            valid_s3.eq(valid_s2),
            event_s3.t.eq(t_s2),
            event_s3.x.eq(x_s2),
            event_s3.y.eq(y_s2),
            negative.eq(t_s2 < 0),
            late.eq(t_s2 >= 1 << config.span_bits),
            inside.eq((x_s2 >= 0) & (x_s2 < width << frac) & (y_s2 >= 0) & (y_s2 < height << frac)),
            before_known.eq(t < found.span),
            before_last.eq(t < event_s3.t),
        ]
        marks = {name: delay(m, mark, 1, name=f"{name}_s3") for name, mark in marks.items()}
        skip = delay(m, event_s1.skip, 2, name="skip") if self._skips else None

        # Stage 4: judge, pass on.
        back, good = Signal(), Signal()
        m.d.comb += [
            back.eq(negative | (~late & Mux(good_s4, before_last, before_known))),
            good.eq(valid_s3 & ~back & ~late),
        ]
        m.d.sync += [good_s4.eq(good), self.o.valid.eq(_unmarked(good & inside, marks)), self.o.payload.eq(event_s3)]
        with m.If(good):
            m.d.sync += found.span.eq(event_s3.t)
        # Stage 5: count.
        lost = {"time_back": back, "time_span": ~back & late, "outside": _unmarked(~back & ~late & ~inside, marks)}
        for name, mark in marks.items():  # not in a comprehension, which would take the signals' names
            lost[name] = ~back & ~late & mark
        for name, judged in lost.items():
            one = Signal(len(skip) if self._skips else 1, name=f"{name}_s4")
            judged = valid_s3 & judged
            m.d.sync += [
                one.eq(Mux(judged, Mux(skip == 0, 1, skip), 0) if self._skips else judged),
                getattr(found, name).eq(getattr(found, name) + one),
            ]
        with m.If(self.start):
            m.d.sync += [found.span.eq(0), *(getattr(found, name).eq(0) for name in lost)]
        return m


def _unmarked(judged, marks):
    return functools.reduce(operator.and_, (~mark for mark in marks.values()), judged)
