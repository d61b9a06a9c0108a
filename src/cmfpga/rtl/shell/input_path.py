"""Input path: words from ``s_axis`` to events of the sensor."""

from amaranth.hdl import Module, ResetInserter
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from . import payloads
from .decoder import Decoder
from .sensor_gate import SensorGate


class InputPath(wiring.Component):
    """The decoder, the gate behind it, and a register between them.

    One event per cycle; latency :attr:`latency` cycles from a word to its first event.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.sensor_token`
    format, swap : ``In``
        The words' format; exchange the 32-bit halves. May change only while ``empty``.
    restart : ``In(1)``
        Forget the time.
    time_known, empty : ``Out(1)``
    counted : ``Out``
        One cycle each, under the names of the counters.
    """

    latency = Decoder.latency + 1

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
        m.submodules.decoder = decoder = ResetInserter(self.restart)(Decoder(self.config))
        m.submodules.gate = gate = SensorGate(self.config)
        connect(m, flipped(self.i), decoder.i)
        connect(m, gate.o, flipped(self.o))
        with m.If(decoder.o.ready):
            m.d.sync += [gate.i.valid.eq(decoder.o.valid), gate.i.payload.eq(decoder.o.payload)]
        m.d.comb += [
            decoder.o.ready.eq(~gate.i.valid | gate.i.ready),
            decoder.format.eq(self.format),
            decoder.swap.eq(self.swap),
            self.empty.eq(decoder.empty & ~gate.i.valid),
            self.time_known.eq(decoder.time_known),
            self.counted.format_errors.eq(decoder.format_error),
            self.counted.other_words.eq(decoder.other),
            self.counted.time_high_back.eq(decoder.back),
            self.counted.events_in.eq(gate.event),
            self.counted.before_time.eq(gate.before_time),
            self.counted.out_of_sensor.eq(gate.outside),
        ]
        return m
