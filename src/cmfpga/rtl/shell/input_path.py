"""Input path: words from ``s_axis`` to events of the sensor, by the decoder that is asked for."""

from amaranth.hdl import Cat, Module, Mux, ResetInserter, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out, connect

from ...protocol.registers.declaration import FORMATS
from . import payloads
from .evt20_decoder import Evt20Decoder
from .evt21_decoder import Evt21Decoder
from .packed_decoder import PackedDecoder
from .sensor_gate import SensorGate
from .skid_buffer import SkidBuffer


class InputPath(wiring.Component):
    """Decoders side by side, the gate behind them, and a register before and after it.

    One event per cycle; latency :attr:`latency` cycles from a word to its first event, one more through a decoder that
    has a register.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.sensor_token`
    format, swap : ``In``
        Which decoder; exchange the 32-bit halves. May change only while ``empty``.
    restart : ``In(1)``
        Forget the time.
    time_known, empty : ``Out(1)``
    counted : ``Out``
        One cycle each, under the names of the counters.
    """

    latency = 2

    def __init__(self, config):
        self.config = config
        counted = ("format_errors", "other_words", "time_high_back", "events_in", "before_time", "out_of_sensor")
        super().__init__(
            {
                "i": In(stream.Signature(payloads.beat())),
                "o": Out(stream.Signature(payloads.sensor_token(config))),
                "format": In(2),
                **dict.fromkeys(("swap", "restart"), In(1)),
                **dict.fromkeys(("time_known", "empty"), Out(1)),
                "counted": Out(data.StructLayout(dict.fromkeys(counted, 1))),
            }
        )

    def elaborate(self, platform):
        m = Module()
        decoders = {
            "EVT21": Evt21Decoder(self.config),
            "EVT20": Evt20Decoder(self.config),
            "PACKED": PackedDecoder(self.config),
        }
        m.submodules.before = before = SkidBuffer(payloads.token(self.config))
        m.submodules.gate = gate = SensorGate(self.config)
        m.submodules.after = after = SkidBuffer(payloads.sensor_token(self.config))
        connect(m, before.o, gate.i)
        connect(m, gate.o, after.i)
        m.d.comb += [self.o.valid.eq(after.o.valid), self.o.payload.eq(after.o.payload), after.o.ready.eq(self.o.ready)]

        beat = Signal(payloads.beat())
        taken = self.i.payload
        m.d.comb += [
            beat.eq(taken),
            beat.data.eq(Mux(self.swap, Cat(taken.data[32:], taken.data[:32]), taken.data)),
            beat.keep.eq(Mux(self.swap, Cat(taken.keep[4:], taken.keep[:4]), taken.keep)),
        ]
        m.d.comb += self.empty.eq(before.empty & after.empty & Cat(d.empty for d in decoders.values()).all())
        for k, (name, decoder) in enumerate(decoders.items()):
            m.submodules[name.lower()] = ResetInserter(self.restart)(decoder)
            assert FORMATS[name] == k
            chosen = self.format == k if k < 2 else self.format >= k
            m.d.comb += [decoder.i.payload.eq(beat), decoder.i.valid.eq(self.i.valid & chosen)]
            with m.If(chosen):
                m.d.comb += [
                    self.i.ready.eq(decoder.i.ready),
                    before.i.valid.eq(decoder.o.valid),
                    before.i.payload.eq(decoder.o.payload),
                    decoder.o.ready.eq(before.i.ready),
                    self.time_known.eq(decoder.time_known),
                    self.counted.format_errors.eq(decoder.format_error),
                    self.counted.other_words.eq(decoder.other),
                    self.counted.time_high_back.eq(decoder.back),
                ]
        m.d.comb += [
            self.counted.events_in.eq(gate.event),
            self.counted.before_time.eq(gate.before_time),
            self.counted.out_of_sensor.eq(gate.outside),
        ]
        return m
