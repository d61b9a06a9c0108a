"""Frame buffer: words of events, which the shell sees only once the whole frame was good."""

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from ..shell import payloads

#: What stands in a half of a beat that holds no word: a word without an event, should anyone look at it.
ABSENT = 0xFFFFFFFF


class FrameBuffer(wiring.Component):
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
            {
                "i": In(stream.Signature(32, always_ready=True)),
                **dict.fromkeys(("drop", "keep", "last", "flush"), In(1)),
                "full": Out(1),
                "o": Out(stream.Signature(payloads.beat())),
                "waiting": Out(range(depth)),
            }
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
