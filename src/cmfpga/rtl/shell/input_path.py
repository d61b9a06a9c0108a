"""Input path: words from ``s_axis`` to events of the sensor; what is behind the decoders: the gate and the splitter."""

from amaranth.hdl import Cat, Module, Mux, ResetInserter, Signal
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out, connect, flipped

from ...protocol.registers.declaration import FORMATS
from .. import Block
from .. import payloads as core
from ..arithmetic import ones
from . import payloads
from .decoder import Decoder
from .evt3_decoder import Evt3Decoder


class SensorGate(Block):
    """Passes the events of the sensor; of others only the end of the packet. One token per cycle, no register.

    Of a vector across the border the end follows a cycle later: it comes behind events that are dropped.

    Members
    -------
    i : ``In``, stream of :func:`payloads.token`
    o : ``Out``, stream of :func:`payloads.gated_token`
    event, before_time, outside : ``Out``, as :func:`payloads.counted` has them
        How many events came; were dropped because no time word came before them; because they lie outside the sensor.
    """

    latency = 0

    def __init__(self, config):
        counted = payloads.counted(config).members
        super().__init__(
            config,
            i=In(stream.Signature(payloads.token(config))),
            o=Out(stream.Signature(payloads.gated_token(config))),
            event=Out(counted["events_in"]),
            before_time=Out(counted["before_time"]),
            outside=Out(counted["out_of_sensor"]),
        )

    def elaborate(self, platform):
        m = Module()
        if self.config.evt3:
            self._vectors(m)
            return m
        token = self.i.payload
        inside = Signal()
        m.d.comb += [
            inside.eq((token.x < self.config.sensor_width) & (token.y < self.config.sensor_height)),
            self.o.payload.t.eq(token.t),
            self.o.payload.x.eq(token.x),
            self.o.payload.y.eq(token.y),
            self.o.payload.event.eq(token.event & token.known & inside),
            self.o.payload.end.eq(token.end),
            self.o.valid.eq(self.i.valid & (self.o.payload.event | token.end)),
            self.i.ready.eq(~self.o.valid | self.o.ready),
            self.event.eq(self.i.valid & self.i.ready & token.event),
            self.before_time.eq(self.event & ~token.known),
            self.outside.eq(self.event & token.known & ~inside),
        ]
        return m

    def _vectors(self, m):
        token, config = self.i.payload, self.config
        # Columns from the vector's first one to the sensor's end.
        room = Signal(range(-(1 << 16), config.sensor_width + 1))
        inside, vector = Signal(len(token.vector)), Signal(len(token.vector))
        apart, passed, takes = Signal(), Signal(), Signal()  # the end comes behind; its events have gone ahead of it
        m.d.comb += [
            room.eq(config.sensor_width - token.x),
            inside.eq(Cat((room > k) & (token.y < config.sensor_height) for k in range(len(inside)))),
            vector.eq(Mux(token.event, token.vector, 0)),
            apart.eq(token.end & token.known & (vector & inside).any() & (vector & ~inside).any() & ~passed),
            self.o.payload.t.eq(token.t),
            self.o.payload.x.eq(token.x),
            self.o.payload.y.eq(token.y),
            self.o.payload.vector.eq(vector & inside & (token.known & ~passed).replicate(len(inside))),
            self.o.payload.event.eq(self.o.payload.vector.any()),
            self.o.payload.end.eq(token.end & ~apart),
            self.o.valid.eq(self.i.valid & (self.o.payload.event | self.o.payload.end)),
            self.i.ready.eq((~self.o.valid | self.o.ready) & ~apart),
            takes.eq(self.i.valid & self.i.ready),
            self.event.eq(Mux(takes, ones(vector), 0)),
            self.before_time.eq(Mux(token.known, 0, self.event)),
            self.outside.eq(Mux(takes & token.known, ones(vector & ~inside), 0)),
        ]
        with m.If(self.i.valid & self.o.ready):
            m.d.sync += passed.eq(apart)


class VectorSplitter(Block):
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
        super().__init__(
            config,
            i=In(stream.Signature(payloads.gated_token(config))),
            o=Out(stream.Signature(payloads.sensor_token(config))),
            roi=In(core.roi_corner(config)),
            opened=In(1),
            empty=Out(1),
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


class InputPath(Block):
    """The decoders, the gate behind them, and a register between; where vectors are split, the splitter behind.

    One event or vector per cycle; latency :attr:`latency` cycles from a word to its first event.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.sensor_token`
    format, swap : ``In``
        The words' format; exchange the 32-bit halves. May change only while ``empty``.
    restart : ``In(1)``
        Forget the time.
    time_known, empty : ``Out(1)``
    counted : ``Out``, :func:`payloads.counted`
        One cycle each, under the names of the counters.
    roi, opened : ``In``
        As of :class:`VectorSplitter`. Only where vectors are split.
    """

    def __init__(self, config):
        self.latency = Decoder.latency + 1 + (VectorSplitter.latency if config.skips else 0)
        super().__init__(
            config,
            i=In(stream.Signature(payloads.beat())),
            o=Out(stream.Signature(payloads.sensor_token(config))),
            format=In(2),
            **dict.fromkeys(("swap", "restart"), In(1)),
            **dict.fromkeys(("time_known", "empty"), Out(1)),
            counted=Out(payloads.counted(config)),
            **({"roi": In(core.roi_corner(config)), "opened": In(1)} if config.skips else {}),
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.decoder = decoder = ResetInserter(self.restart)(Decoder(self.config))
        m.submodules.gate = gate = SensorGate(self.config)
        words, behind = self._both(m, decoder) if self.config.evt3 else decoder, None
        if words is decoder:
            connect(m, flipped(self.i), decoder.i)
        if self.config.skips:
            m.submodules.splitter = behind = VectorSplitter(self.config)
            connect(m, gate.o, behind.i)
            connect(m, behind.o, flipped(self.o))
            m.d.comb += [behind.roi.eq(self.roi), behind.opened.eq(self.opened)]
        else:
            connect(m, gate.o, flipped(self.o))
        with m.If(words.o.ready):
            m.d.sync += [gate.i.valid.eq(words.o.valid), gate.i.payload.eq(words.o.payload)]
        m.d.comb += [
            words.o.ready.eq(~gate.i.valid | gate.i.ready),
            decoder.format.eq(self.format),
            decoder.swap.eq(self.swap),
            self.empty.eq(words.empty & ~gate.i.valid & behind.empty if behind else words.empty & ~gate.i.valid),
            self.time_known.eq(words.time_known),
            self.counted.format_errors.eq(words.format_error),
            self.counted.other_words.eq(words.other),
            self.counted.time_high_back.eq(words.back),
            self.counted.events_in.eq(gate.event),
            self.counted.before_time.eq(gate.before_time),
            self.counted.out_of_sensor.eq(gate.outside),
        ]
        return m

    def _both(self, m, decoder):
        """One decoder of those of all formats: what it says is that of whose words come."""
        m.submodules.evt3_decoder = evt3 = ResetInserter(self.restart)(Evt3Decoder(self.config))
        words = Evt3Decoder(self.config).signature.create(path=("words",))
        chosen = self.format == FORMATS["EVT30"]
        m.d.comb += [evt3.swap.eq(self.swap), self.i.ready.eq(Mux(chosen, evt3.i.ready, decoder.i.ready))]
        for block, mine in ((decoder, ~chosen), (evt3, chosen)):
            m.d.comb += [
                block.i.valid.eq(self.i.valid & mine),
                block.i.payload.eq(self.i.payload),
                block.o.ready.eq(words.o.ready),
            ]
        m.d.comb += [words.o.valid.eq(decoder.o.valid | evt3.o.valid), words.empty.eq(decoder.empty & evt3.empty)]
        for name in ("format_error", "other", "back"):
            m.d.comb += getattr(words, name).eq(getattr(decoder, name) | getattr(evt3, name))
        m.d.comb += [
            words.time_known.eq(Mux(chosen, evt3.time_known, decoder.time_known)),
            words.o.payload.eq(Mux(chosen, evt3.o.payload, decoder.o.payload)),
        ]
        return words
