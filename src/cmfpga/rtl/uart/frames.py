"""Frames of the serial link (:mod:`cmfpga.protocol.link`) from bytes, bytes of frames, and a buffer for their words."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, memory, stream
from amaranth.lib.crc import catalog
from amaranth.lib.wiring import In, Out

from ...protocol.link import END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE
from .. import Block
from ..shell import payloads


def crc():
    """The checksum of a frame."""
    return catalog.CRC16_IBM_3740(data_width=8).create()


class FrameReader(Block):
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
        super().__init__(i=In(byte), error=In(1), o=Out(byte), end=Out(1), bad=Out(1))

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


class FrameWriter(Block):
    """Puts a CRC behind each frame, escapes, and :data:`~cmfpga.protocol.link.END` before and behind it.

    Members
    -------
    i : ``In``, stream of a byte and of ``last``, which ends its frame
    o : ``Out``, stream of 8 bits
    """

    def __init__(self):
        byte = data.StructLayout({"byte": 8, "last": 1})
        super().__init__(i=In(stream.Signature(byte)), o=Out(stream.Signature(8)))

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


#: What stands in a half of a beat that holds no word: a word without an event, should anyone look at it.
ABSENT = 0xFFFFFFFF


class FrameBuffer(Block):
    """Two words make a beat, the lower one first. A beat takes five cycles or more, a word of a serial line hundreds.

    Parameters
    ----------
    depth : int
        Words, a power of two.

    Members
    -------
    i : ``In``, stream of 32 bits that never waits
        A word of the frame under way. Not in the cycle of ``keep`` or the three after it.
    full : ``Out(1)``
        A word of the frame under way found no room.
    drop : ``In(1)``
        Forget the frame under way.
    keep, last : ``In(1)``
        The frame was good: pass it on, with TLAST if ``last``. Not where ``full``.
    flush : ``In(1)``
        Forget all words.
    o : ``Out``, stream of :func:`cmfpga.rtl.shell.payloads.beat`
    waiting : ``Out``
        Words of good frames.
    """

    def __init__(self, depth):
        self._depth = depth
        super().__init__(
            i=In(stream.Signature(32, always_ready=True)),
            **dict.fromkeys(("drop", "keep", "last", "flush"), In(1)),
            full=Out(1),
            o=Out(stream.Signature(payloads.beat())),
            waiting=Out(range(depth)),
        )

    def elaborate(self, platform):
        m = Module()
        entry = data.StructLayout({"word": 32, "present": 1, "last": 1})
        m.submodules.words = words = memory.Memory(shape=entry, depth=self._depth, init=[])
        write, read = words.write_port(), words.read_port()
        begin, end, written = (Signal(range(self._depth), name=name) for name in ("begin", "end", "written"))
        m.d.comb += [write.addr.eq(written), read.addr.eq(begin), self.waiting.eq(end - begin)]

        # Two places are for what completes a frame.
        used, room, add = Signal.like(end), Signal(), Signal()
        m.d.comb += [used.eq(written - begin), room.eq(used < self._depth - 3)]
        with m.If(add):
            m.d.comb += write.en.eq(1)
            m.d.sync += written.eq(written + 1)
        last = Signal()
        with m.FSM():
            with m.State("FRAME"):
                m.d.comb += [write.data.word.eq(self.i.payload), write.data.present.eq(1), add.eq(self.i.valid & room)]
                with m.If(self.i.valid & ~room):
                    m.d.sync += self.full.eq(1)
                with m.If(self.drop):
                    m.d.sync += [written.eq(end), self.full.eq(0)]
                with m.If(self.keep):
                    m.d.sync += last.eq(self.last)
                    m.next = "COMPLETE"
            with m.State("COMPLETE"):  # a beat; TLAST behind whole beats has one of its own, without words
                m.d.comb += [write.data.word.eq(ABSENT), write.data.last.eq(last & written[0])]
                with m.If(written[0] | last):
                    m.d.comb += add.eq(1)
                with m.Else():
                    m.next = "PASS"
                with m.If(written[0]):
                    m.d.sync += last.eq(0)
            with m.State("PASS"):
                m.d.sync += end.eq(written)
                m.next = "FRAME"
        beat, upper, settled = Signal(payloads.beat()), Signal(), Signal()
        m.d.comb += [
            self.o.payload.data.eq(beat.data),
            self.o.payload.keep.eq(beat.keep),
            self.o.payload.last.eq(beat.last),
        ]
        m.d.sync += settled.eq(1)
        with m.If(self.o.valid & self.o.ready):
            m.d.sync += self.o.valid.eq(0)
        with m.If(settled & (begin != end) & ~self.o.valid):
            m.d.sync += [
                begin.eq(begin + 1),
                settled.eq(0),
                upper.eq(~upper),
                self.o.valid.eq(upper),
                beat.data.eq(Cat(beat.data[32:], read.data.word)),
                beat.keep.eq(Cat(beat.keep[4:], read.data.present.replicate(4))),
                beat.last.eq(read.data.last | (upper & beat.last)),
            ]
        with m.If(self.flush):
            m.d.sync += [begin.eq(end), upper.eq(0), settled.eq(0)]
        return m
