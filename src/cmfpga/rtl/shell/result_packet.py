"""Result packet: keeps a result, shows it in the registers, and sends it as one packet."""

import functools
import operator

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import memory, stream
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from ...protocol.flags import Flag
from ...protocol.results import packet_beats
from .. import Block
from .. import payloads as core
from ..regions.payloads import region_result
from . import payloads

#: Bits of a word's number in a packet.
BEAT_BITS = 5


def value_of(result, link):
    """The member of a core's result that a register's link names: ``roi_next_x`` is ``result.roi_next.x``."""
    names = result.shape().members
    if link in names:
        return result[link]
    outer = max((name for name in names if link.startswith(f"{name}_")), key=len)
    return result[outer][link[len(outer) + 1 :]]


class ResultPacket(Block):
    """Copies a result into a memory, one of :func:`packet_beats` words a cycle, and takes it with the last one.

    With a table of regions, the results of a batch make one packet, a record of so many words each.

    The memory has two halves: the registers show one, the next result goes into the other, and becomes the one that is
    shown when it is complete. The packet follows its writing by :attr:`latency` cycles, and one more in each cycle in
    which a register is read. A result that comes while a packet is being sent waits in the core; two begin at least
    2^5 cycles apart.

    Parameters
    ----------
    registers : RegisterMap

    Members
    -------
    i : ``In``, stream of :func:`cmfpga.rtl.payloads.result`, or :func:`~cmfpga.rtl.regions.payloads.region_result`
    o : ``Out``, stream of :func:`payloads.beat`
        TLAST at the end of each packet, TKEEP all ones.
    wire, config_range : ``In(1)``
        Flags that go into the result that begins in this cycle.
    stream_results, hold : ``In(1)``
        Send packets; keep the registers as they are. Both as they are when a result begins.
    wait : ``In(1)``
        No result may begin.
    forget : ``In(1)``
        Begin again with batch 1 (soft reset); not while ``writing``. A packet that is being sent is completed: one that
        waits for results of other regions by its last record, once more where that was sent.
    read, address, words : ``In(1)``, ``In``, ``Out(64)``
        In a cycle with ``read``, the two result registers from twice that number on.
    any_shown : ``Out(1)``
        There is a result; else registers are 0, not ``words``.
    written : ``Out(64)``
        From ``begun`` on, the packet's words, one a cycle.
    begun, taken, stalled, held, writing, sending : ``Out(1)``
        A result begins; it was taken; it waits for the packet ahead; the last that began is not shown; a result is
        being written, or was a few cycles ago; a packet is being sent.
    """

    #: Cycles from a result to its packet's first word.
    latency = 2

    def __init__(self, config, registers):
        self.registers = registers
        self.beats = packet_beats(config)
        assert self.beats <= 1 << BEAT_BITS
        result = (region_result if config.regions else core.result)(config)
        super().__init__(
            config,
            i=In(stream.Signature(result)),
            o=Out(stream.Signature(payloads.beat())),
            **dict.fromkeys(("wire", "config_range", "stream_results", "hold", "wait", "forget", "read"), In(1)),
            address=In(BEAT_BITS),
            words=Out(payloads.DATA_BITS),
            any_shown=Out(1),
            written=Out(payloads.DATA_BITS),
            **dict.fromkeys(("begun", "taken", "stalled", "held", "writing", "sending"), Out(1)),
        )
        self.open = Signal()  # words of a packet are still to be read

    def elaborate(self, platform):
        m = Module()
        m.submodules.store = store = memory.Memory(shape=payloads.DATA_BITS, depth=2 << BEAT_BITS, init=[])
        put, get = store.write_port(), store.read_port(domain="comb")
        number = Signal(32, init=1)
        shown = Signal()  # the half that the registers show
        # What is written; it runs on to 0 behind the last one.
        beat, following = Signal(BEAT_BITS), Signal(BEAT_BITS)
        m.d.comb += [
            self.begun.eq(self.i.valid & (beat == 0) & ~self.open & ~self.wait),
            self.stalled.eq(self.i.valid & (beat == 0) & self.open),
            self.writing.eq(self.begun | (beat != 0)),
            self.i.ready.eq(beat == self.beats - 1),
            self.taken.eq(self.i.valid & self.i.ready),
            put.addr.eq(Cat(beat, ~shown)),
            self.written.eq(self._new_word(m, number, following)),
            put.data.eq(self.written),
            following.eq(beat + self.writing),
            put.en.eq(self.writing),
            self.words.eq(get.data),
        ]
        m.d.sync += beat.eq(following)
        with m.If(self.begun):
            m.d.sync += self.held.eq(self.hold)
        with m.If(self.taken):
            m.d.sync += number.eq(number + (self.i.payload.last if self.config.regions else 1))
            with m.If(~self.held):
                m.d.sync += [shown.eq(~shown), self.any_shown.eq(1)]
        with m.If(self.forget):
            m.d.sync += [number.eq(1), self.any_shown.eq(0)]
        half, sent = self._send(m, shown, get.data)
        m.d.comb += get.addr.eq(Mux(self.read, Cat(self.address, shown), Cat(sent, half)))
        return m

    def _send(self, m, shown, data):
        """The word that was written last, or one before it, goes out: the half and the place where it is read."""
        half, sent = Signal(), Signal(BEAT_BITS)
        there, last = Signal(), Signal()
        ends, streams = (Signal(init=1), Signal()) if self.config.regions else (None, self.stream_results)
        m.d.comb += [
            there.eq(self.open & ~self.read),
            last.eq(sent == self.beats - 1),
            self.sending.eq(self.open | self.o.valid),
            self.o.payload.keep.eq(-1),
        ]
        with m.If(~self.o.valid | self.o.ready):
            m.d.sync += self.o.valid.eq(there)
            with m.If(there):
                tlast = last & ends if self.config.regions else last
                m.d.sync += [self.o.payload.data.eq(data), self.o.payload.last.eq(tlast), sent.eq(sent + 1)]
                with m.If(last):
                    m.d.sync += [sent.eq(0), self.open.eq(0)]
        with m.If(self.begun):
            m.d.sync += [self.open.eq(streams), half.eq(~shown)]
        if self.config.regions:
            self._join(m, ends, streams)
        return half, sent

    def _join(self, m, ends, streams):
        """Whether the record that is sent ends its packet, and whether the result that begins is to be sent."""
        inside, streaming, last = Signal(), Signal(), self.i.payload.last
        m.d.comb += streams.eq(Mux(inside, streaming, self.stream_results))
        with m.If(self.begun):
            m.d.sync += [inside.eq(~last), streaming.eq(streams), ends.eq(last | ~streams)]
        with m.If(self.forget):
            m.d.sync += [inside.eq(0), ends.eq(1)]
            with m.If(~ends):
                m.d.sync += self.open.eq(1)

    def _new_word(self, m, number, following):
        """The 64-bit word of the result on ``i`` that is written."""
        result = self.i.payload
        own = {
            "batch": number,
            "t_ref": (result.t_first + (result.span >> 1))[:32],
            "wire": self.wire,
            "config_range": self.config_range,
        }
        group = self.registers.group("Result")
        halves = {}, {}
        for register in group:
            word = (register.offset - group[0].offset) // 4
            halves[word % 2][word // 2] = register.fields
        return Cat(self._new_half(m, own, following, words) for words in halves)

    def _new_half(self, m, own, following, words):
        """That of its 32 bits that has the fields ``words[beat]``.

        Registers choose among four words each, a cycle before; all but one are zero. Signs in front of words have
        registers of their own. The widest words come first, so that the upper bits choose among few. What is not known
        a cycle before is chosen in the first word's cycle.
        """
        sums = [k for k, fields in words.items() if any(f.link.startswith("sums_") for f in fields)]
        bits, signs = {}, {}
        for k, fields in words.items():
            bits[k], *signs[k] = self._bits(fields, own)
        width = {k: max((i + 1 for i, bit in enumerate(found) if not isinstance(bit, Const)), default=0)
                 for k, found in bits.items()}  # fmt: skip
        late = 0 if any(f.link in ("wire", "config_range") for f in words[0]) else None
        ranked = sorted((k for k in width if width[k] and k != late), key=width.get, reverse=True)
        parts = [Mux(self.begun, Cat(bits[late]), 0)] if late is not None else []
        nothing = Signal()  # they mean nothing then
        m.d.comb += nothing.eq(self.i.payload.flags[Flag.DEGENERATE.bit_length() - 1] & following.matches(*sums))
        place = Cat(following.matches(*(k for rank, k in enumerate(ranked) if rank >> bit & 1)) for bit in range(2))
        for first in range(0, len(ranked), 4):
            found = ranked[first : first + 4]
            chosen = Signal(32, init=own["batch"].init if 0 in found else 0, reset_less=True)
            m.d.sync += chosen.eq(0)
            with m.If(following.matches(*found) & ~nothing):
                m.d.sync += chosen.eq(Array(Cat(bits[k]) for k in found)[place[: bits_for(len(found) - 1)]])
            parts.append(chosen)
        begins = sorted({begin for _, begin in signs.values() if begin < 32})
        negative = Signal(len(begins), reset_less=True)  # a word whose sign begins there, or below
        for bit, begin in enumerate(begins):
            found = ((following == k) & sign for k, (sign, other) in signs.items() if other <= begin)
            m.d.sync += negative[bit].eq(~nothing & Cat(found).any())
        below = [sum(begin <= bit for begin in begins) for bit in range(32)]
        parts.append(Cat(negative[count - 1] if count else Const(0) for count in below))
        return functools.reduce(operator.or_, parts)

    def _bits(self, fields, own):
        """Of a word: those of its fields, its sign, and the bit from which on there is nothing but that."""
        bits, sign, begin = [Const(0)] * 32, Const(0), 32
        for f in fields:
            value = Value.cast(own[f.link] if f.link in own else value_of(self.i.payload, f.link))
            taken = [value[bit] for bit in range(f.link_lsb, min(len(value), f.link_lsb + f.width))]
            bits[f.lsb : f.lsb + len(taken)] = taken
            if value.shape().signed and len(taken) < f.width:
                assert f.lsb + f.width == 32
                sign, begin = value[-1], f.lsb + len(taken)
        return bits, sign, begin
