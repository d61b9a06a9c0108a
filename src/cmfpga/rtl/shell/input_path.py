"""Input path: words from ``s_axis`` to events of the sensor."""

from amaranth.hdl import Module, Mux, ResetInserter
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ...protocol.registers.declaration import FORMATS
from .. import payloads as core
from . import payloads
from .decoder import Decoder
from .evt3_decoder import Evt3Decoder
from .sensor_gate import SensorGate
from .vector_splitter import VectorSplitter


class InputPath(wiring.Component):
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
        As of :class:`~.vector_splitter.VectorSplitter`. Only where vectors are split.
    """

    def __init__(self, config):
        self.config = config
        self.latency = Decoder.latency + 1 + (VectorSplitter.latency if config.skips else 0)
        super().__init__(
            {
                "i": In(stream.Signature(payloads.beat())),
                "o": Out(stream.Signature(payloads.sensor_token(config))),
                "format": In(2),
                **dict.fromkeys(("swap", "restart"), In(1)),
                **dict.fromkeys(("time_known", "empty"), Out(1)),
                "counted": Out(payloads.counted(config)),
                **({"roi": In(core.roi_corner(config)), "opened": In(1)} if config.skips else {}),
            }
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
