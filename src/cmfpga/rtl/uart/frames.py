"""Frames of the serial link (:mod:`cmfpga.protocol.link`) from bytes, and bytes of frames."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.crc import catalog
from amaranth.lib.wiring import In, Out

from ...protocol.link import END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE


def crc():
    """The checksum of a frame."""
    return catalog.CRC16_IBM_3740(data_width=8).create()


class FrameReader(wiring.Component):
    """Takes escapes and CRC away. A byte leaves when two more have come, since those may be the CRC.

    Members
    -------
    i : ``In``, stream of 8 bits that never waits
    error : ``In(1)``
        One cycle: a byte was lost.
    o : ``Out``, stream of 8 bits that never waits
    end, bad : ``Out(1)``
        One cycle: the bytes since the last of these were a frame; were none, and count for nothing.
    """

    def __init__(self):
        byte = stream.Signature(8, always_ready=True)
        super().__init__({"i": In(byte), "error": In(1), "o": Out(byte), "end": Out(1), "bad": Out(1)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.check = check = crc()
        kept = Signal(data.ArrayLayout(8, 2))
        count = Signal(range(3))
        escaped, wrong = Signal(), Signal()
        byte, good = Signal(8), Signal()
        m.d.comb += [
            byte.eq(self.i.payload),
            check.data.eq(byte),
            self.o.payload.eq(kept[1]),
            good.eq((count == 2) & check.match_detected & ~wrong & ~escaped),
        ]
        with m.If(self.error):
            m.d.sync += wrong.eq(1)
        with m.If(self.i.valid):
            with m.If(self.i.payload == END):
                m.d.comb += [
                    check.start.eq(1),
                    self.end.eq(good),
                    self.bad.eq(~good & ((count != 0) | wrong | escaped)),
                ]
                m.d.sync += [count.eq(0), escaped.eq(0), wrong.eq(0)]
            with m.Elif(~escaped & (self.i.payload == ESCAPE)):
                m.d.sync += escaped.eq(1)
            with m.Else():
                m.d.comb += [check.valid.eq(1), self.o.valid.eq(count == 2)]
                m.d.sync += [escaped.eq(0), kept[0].eq(byte), kept[1].eq(kept[0]), count.eq(count + (count != 2))]
                with m.If(escaped):
                    m.d.comb += byte.eq(Mux(self.i.payload == ESCAPED_END, END, ESCAPE))
                    with m.If((self.i.payload != ESCAPED_END) & (self.i.payload != ESCAPED_ESCAPE)):
                        m.d.sync += wrong.eq(1)
        return m


class FrameWriter(wiring.Component):
    """Puts a CRC behind each frame, escapes, and :data:`~cmfpga.protocol.link.END` before and behind it.

    Members
    -------
    i : ``In``, stream of a byte and of ``last``, which ends its frame
    o : ``Out``, stream of 8 bits
    """

    def __init__(self):
        byte = data.StructLayout({"byte": 8, "last": 1})
        super().__init__({"i": In(stream.Signature(byte)), "o": Out(stream.Signature(8))})

    def elaborate(self, platform):
        m = Module()
        m.submodules.check = check = crc()
        byte, special, escaped = Signal(8), Signal(), Signal()
        offered, sent = Signal(), Signal()  # the byte is there; it has gone, escape and all
        m.d.comb += [
            byte.eq(self.i.payload.byte),
            check.data.eq(byte),
            special.eq((byte == END) | (byte == ESCAPE)),
            self.o.valid.eq(offered),
            self.o.payload.eq(byte),
            sent.eq(offered & self.o.ready & (~special | escaped)),
        ]
        with m.If(special):
            m.d.comb += self.o.payload.eq(Mux(escaped, Mux(byte == END, ESCAPED_END, ESCAPED_ESCAPE), ESCAPE))
            with m.If(offered & self.o.ready):
                m.d.sync += escaped.eq(~escaped)
        with m.FSM():
            with m.State("IDLE"):
                m.d.comb += [self.o.payload.eq(END), self.o.valid.eq(self.i.valid), check.start.eq(1)]
                with m.If(self.i.valid & self.o.ready):
                    m.next = "BYTES"
            with m.State("BYTES"):
                m.d.comb += [offered.eq(self.i.valid), self.i.ready.eq(sent), check.valid.eq(sent)]
                with m.If(sent & self.i.payload.last):
                    m.next = "HIGH"
            with m.State("HIGH"):
                m.d.comb += [offered.eq(1), byte.eq(check.crc[8:])]
                with m.If(sent):
                    m.next = "LOW"
            with m.State("LOW"):
                m.d.comb += [offered.eq(1), byte.eq(check.crc[:8])]
                with m.If(sent):
                    m.next = "END"
            with m.State("END"):
                m.d.comb += [self.o.payload.eq(END), self.o.valid.eq(1)]
                with m.If(self.o.ready):
                    m.next = "IDLE"
        return m
