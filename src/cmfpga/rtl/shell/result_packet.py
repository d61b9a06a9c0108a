"""Result packet: keeps a result, shows it in the registers, and sends it as one packet."""

from amaranth.hdl import Module, Mux, Signal, Value, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ...protocol.flags import Flag
from ...protocol.results import PACKET_BEATS
from .. import payloads as core
from . import payloads


def value_of(result, link):
    """The member of a core's result that a register's link names: ``roi_next_x`` is ``result.roi_next.x``."""
    names = result.shape().members
    if link in names:
        return result[link]
    outer = max((name for name in names if link.startswith(f"{name}_")), key=len)
    return result[outer][link[len(outer) + 1 :]]


class ResultPacket(wiring.Component):
    """Takes a result over in one cycle; then the core goes on, and :data:`PACKET_BEATS` words go out.

    The packet's first word is on ``o`` in the cycle after the result was taken. A result that comes while a packet is
    being sent waits in the core.

    Parameters
    ----------
    config : Config
    registers : RegisterMap

    Members
    -------
    i : ``In``, stream of :func:`cmfpga.rtl.payloads.result`
    o : ``Out``, stream of :func:`payloads.beat`
        TLAST at the end of each packet, TKEEP all ones.
    wire, config_range : ``In(1)``
        Flags that go into the result taken in this cycle.
    stream_results, hold : ``In(1)``
        Send packets; keep the registers as they are.
    forget : ``In(1)``
        Begin again with batch 1 (soft reset). A packet that is being sent is completed.
    words : ``Out``, array of 32-bit words
        The result registers.
    taken, stalled, held_back, sending : ``Out(1)``
        A result was taken; it waits for the packet ahead; it was taken but not shown; a packet is being sent.
    """

    #: Cycles from a result to its packet's first word.
    latency = 1

    def __init__(self, config, registers):
        self.config = config
        self.registers = registers
        self.beats = PACKET_BEATS
        super().__init__(
            {
                "i": In(stream.Signature(core.result(config))),
                "o": Out(stream.Signature(payloads.beat())),
                **dict.fromkeys(("wire", "config_range", "stream_results", "hold", "forget"), In(1)),
                "words": Out(data.ArrayLayout(32, 2 * PACKET_BEATS)),
                **dict.fromkeys(("taken", "stalled", "held_back", "sending"), Out(1)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        number = Signal(32, init=1)
        new = self._new_words(m, number)
        rest = Signal(data.ArrayLayout(payloads.DATA_BITS, self.beats))  # what is still to be sent, next word lowest
        left = Signal(range(self.beats + 1))
        m.d.comb += [
            self.sending.eq(left != 0),
            self.i.ready.eq(~(self.sending & self.stream_results)),
            self.stalled.eq(self.i.valid & ~self.i.ready),
            self.taken.eq(self.i.valid & self.i.ready),
            self.held_back.eq(self.taken & self.hold),
            self.o.valid.eq(self.sending),
            self.o.payload.data.eq(rest[0]),
            self.o.payload.keep.eq(-1),
            self.o.payload.last.eq(left == 1),
        ]
        with m.If(self.o.valid & self.o.ready):
            m.d.sync += [rest.as_value().eq(rest.as_value() >> payloads.DATA_BITS), left.eq(left - 1)]
        with m.If(self.taken):
            m.d.sync += number.eq(number + 1)
            with m.If(self.stream_results):
                m.d.sync += [rest.as_value().eq(new), left.eq(self.beats)]
            with m.If(~self.hold):
                m.d.sync += self.words.eq(new)
        with m.If(self.forget):
            m.d.sync += [number.eq(1), self.words.eq(0)]
        return m

    def _new_words(self, m, number):
        """All words of the result on ``i``, as one value."""
        result = self.i.payload
        group = self.registers.group("Result")
        degenerate = result.flags[Flag.DEGENERATE.bit_length() - 1]
        words = Signal(64 * self.beats, name="new_words")
        own = {
            "batch": number,
            "t_ref": (result.t_first + (result.span >> 1))[:32],
            "wire": self.wire,
            "config_range": self.config_range,
        }
        for register in group:
            k = (register.offset - group[0].offset) // 4
            for f in register.fields:
                value = own.get(f.link)
                if value is None:
                    value = value_of(result, f.link)
                if f.link.startswith("sums_"):  # they mean nothing then
                    value = Mux(degenerate, 0, value)
                wide = Signal(signed(64) if Value.cast(value).shape().signed else 64, name=f"{register.name}_{f.name}")
                m.d.comb += wide.eq(value)
                low = 32 * k + f.lsb
                m.d.comb += words[low : low + f.width].eq(wide[f.link_lsb : f.link_lsb + f.width])
        return words
