"""Vector splitter: parts of a vector that lie left of the ROI, inside, and right of it."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from .. import payloads as core
from ..arithmetic import ones
from . import payloads


class VectorSplitter(wiring.Component):
    """Up to three tokens of each, in order of columns, so that those outside the ROI can be dropped at once.

    The ROI is that of the batch which is taken in. A token that another ROI was compared with is ``outside`` no more:
    ``opened`` says that a batch begins.

    A vector that does not cross the ROI's border takes one cycle; latency :attr:`latency` cycle.

    Members
    -------
    i : ``In``, stream of :func:`payloads.gated_token`
    o : ``Out``, stream of :func:`payloads.sensor_token`
    roi : ``In``, :func:`cmfpga.rtl.payloads.roi_corner`
    opened : ``In(1)``
    empty : ``Out(1)``
        No token is held.
    """

    latency = 1

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(stream.Signature(payloads.gated_token(config))),
                "o": Out(stream.Signature(payloads.sensor_token(config))),
                "roi": In(core.roi_corner(config)),
                "opened": In(1),
                "empty": Out(1),
            }
        )

    def elaborate(self, platform):
        config, token, roi = self.config, self.i.payload, self.roi
        m = Module()
        held, out = Signal(payloads.gated_token(config)), self.o.payload
        valid, known = Signal(), Signal()  # whether the parts are those of the ROI
        parts = [Signal(payloads.VECTOR_BITS, name=name) for name in ("left", "inside", "right")]
        # Columns from the vector's first one to the ROI's first, and to the first behind it.
        begin = roi.x - token.x
        end = begin + config.roi_width
        row = (token.y >= roi.y) & (token.y < roi.y + config.roi_height)
        left = Cat(~row | (k < begin) for k in range(payloads.VECTOR_BITS))
        right = Cat(row & (k >= end) for k in range(payloads.VECTOR_BITS))
        some = [part.any() for part in parts]
        last = ~((some[0] & (some[1] | some[2])) | (some[1] & some[2]))
        m.d.comb += [
            self.o.valid.eq(valid),
            self.i.ready.eq(~valid | (self.o.ready & last)),
            self.empty.eq(~valid),
            out.t.eq(held.t),
            out.x.eq(held.x),
            out.y.eq(held.y),
            out.event.eq(held.event),
            out.end.eq(held.end & last),
            out.vector.eq(Mux(some[0], parts[0], Mux(some[1], parts[1], parts[2]))),
            out.outside.eq(known & (some[0] | ~some[1]) & held.event),
            out.events.eq(ones(out.vector)),
        ]
        with m.If(self.o.ready):
            m.d.sync += [parts[0].eq(0), valid.eq(valid & ~last)]
            with m.If(~some[0]):
                m.d.sync += parts[1].eq(0)
        with m.If(self.i.valid & self.i.ready):
            m.d.sync += [valid.eq(1), held.eq(token), known.eq(1)]
            m.d.sync += [
                part.eq(token.vector & mask) for part, mask in zip(parts, (left, ~left & ~right, right), strict=True)
            ]
        with m.If(self.opened):
            m.d.sync += known.eq(0)
        return m
