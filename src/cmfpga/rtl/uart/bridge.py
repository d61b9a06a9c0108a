"""Bridge: the requests of a serial link to a shell's registers and words, and its packets to frames."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out, connect, flipped

from ...protocol import link
from .. import Block
from ..shell import payloads
from ..shell.register_bank import RegisterBank
from .frames import FrameBuffer, FrameReader, FrameWriter

#: Counters that the bridge itself adds to.
OWN = tuple(name for name in link.COUNTERS if not name.startswith("cpi_"))


class Bridge(Block):
    """Carries out requests one by one, and answers each (:mod:`cmfpga.protocol.link`).

    Parameters
    ----------
    buffer_words : int
        Words that it keeps for the shell, a power of two.

    Members
    -------
    received : ``In``, stream of 8 bits that never waits
    error : ``In(1)``
        One cycle: a byte was lost.
    sent : ``Out``, stream of 8 bits
    bus : ``Out``, :func:`cmfpga.rtl.shell.payloads.register_bus`
        ``read_data`` a cycle late.
    words : ``Out``, stream of :func:`cmfpga.rtl.shell.payloads.beat`
        To the shell.
    packets : ``In``, stream of the same
        From the shell; TKEEP and TUSER are left out.
    source : ``Out``
        The register ``LINK_SOURCE``.
    counted : ``In``
        The counters of :data:`cmfpga.protocol.link.CPI_COUNTERS`.
    beat : ``In(1)``
        A beat is offered to the shell, from wherever.
    """

    def __init__(self, buffer_words=link.BUFFER_WORDS):
        self._buffer_words = buffer_words
        self.bank = RegisterBank(link.REGISTERS)
        byte, beat = stream.Signature(8), stream.Signature(payloads.beat())
        super().__init__(
            received=In(stream.Signature(8, always_ready=True)),
            **dict.fromkeys(("error", "beat"), In(1)),
            sent=Out(byte),
            bus=Out(payloads.register_bus()),
            words=Out(beat),
            packets=In(beat),
            source=Out(data.StructLayout({f.name.lower(): 1 for f in link.REGISTERS["LINK_SOURCE"].fields})),
            counted=In(data.StructLayout({name: 32 for name in link.CPI_COUNTERS})),
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.bank = self.bank
        m.submodules.reader = self.reader = FrameReader()
        m.submodules.buffer = self.buffer = FrameBuffer(self._buffer_words)
        m.submodules.writer = self.writer = FrameWriter()
        connect(m, flipped(self.received), self.reader.i)
        connect(m, self.buffer.o, flipped(self.words))
        connect(m, self.writer.o, flipped(self.sent))
        # An access to a register, and the reply that waits: a word is in it behind READ.
        self.access = Signal(data.StructLayout({"write": 1, "shell": 1, "link": 1, "address": 10, "data": 32}))
        self.read_data, self.reading, self.stalled = Signal(32), Signal(), Signal()
        self.reply = Signal(data.StructLayout({"sequence": 8, "status": 8, "word": 32}))
        self.with_word, self.pending, self.answered = Signal(), Signal(), Signal()
        counted = Signal(data.StructLayout(dict.fromkeys(OWN, 1)))
        self._requests(m, counted)
        self._replies(m)
        self._registers(m, counted)
        return m

    def _requests(self, m, counted):
        reader, buffer = self.reader, self.buffer
        number, command = Signal(8), Signal(8)
        place = Signal(range(10))  # bytes that have come, as far as it matters
        phase = Signal(2)  # bytes of a word
        arguments, word_ended = Signal(48), Signal()
        last_number, known = Signal(8), Signal()
        with m.If(reader.o.valid):
            with m.If(place != 9):
                m.d.sync += place.eq(place + 1)
            with m.Switch(place):
                with m.Case(0):
                    m.d.sync += number.eq(reader.o.payload)
                with m.Case(1):
                    m.d.sync += [command.eq(reader.o.payload), phase.eq(0)]
                with m.Default():
                    m.d.sync += [arguments.eq(Cat(arguments[8:], reader.o.payload)), phase.eq(phase + 1)]
        has_words = (command == link.EVENTS) | (command == link.EVENTS_LAST)
        m.d.sync += word_ended.eq(reader.o.valid & (place >= 2) & (phase == 3) & has_words)
        m.d.comb += [buffer.i.valid.eq(word_ended), buffer.i.payload.eq(arguments[16:])]

        lengths = {link.HELLO: 2, link.READ: 4, link.WRITE: 8}
        fits, busy, again, new, too_soon = Signal(), Signal(), Signal(), Signal(), Signal()
        address = Signal(16)
        m.d.comb += address.eq(Mux(command == link.READ, arguments[32:], arguments[:16]))
        with m.Switch(command):
            for known_command, length in lengths.items():
                with m.Case(known_command):
                    m.d.comb += fits.eq(place == length)
            with m.Case(link.EVENTS, link.EVENTS_LAST):
                m.d.comb += fits.eq((place >= 2) & (phase == 0))
        m.d.comb += [
            again.eq(known & (number == last_number) & (command != link.HELLO)),
            busy.eq(has_words & buffer.full & ~again),
        ]
        with m.If(reader.end | reader.bad):
            m.d.sync += place.eq(0)
        m.d.comb += [
            buffer.last.eq(command == link.EVENTS_LAST),
            reader.error.eq(self.error),
            counted.byte_errors.eq(self.error),
        ]

        with m.FSM():
            with m.State("IDLE"):
                with m.If(reader.bad):
                    m.d.comb += [buffer.drop.eq(1), counted.bad_frames.eq(1)]
                with m.Elif(reader.end & self.pending):
                    m.d.comb += [buffer.drop.eq(1), counted.overruns.eq(1)]
                with m.Elif(reader.end):
                    m.d.comb += [
                        counted.bad_frames.eq(~fits),
                        counted.repeats.eq(fits & again),
                        counted.busy.eq(fits & busy),
                        new.eq(fits & ~again & ~busy),
                        buffer.keep.eq(new & has_words),
                        buffer.drop.eq(~buffer.keep),
                    ]
                    m.d.sync += [
                        self.reply.sequence.eq(number),
                        self.reply.status.eq(Mux(~fits, link.REFUSED, Mux(busy, link.BUSY, link.DONE))),
                        self.with_word.eq(fits & (command == link.READ)),
                        self.access.address.eq(address[2:]),
                        self.access.shell.eq(address[12:] == 0),
                        self.access.link.eq(address[12:] == link.BASE >> 12),
                        self.access.data.eq(arguments[16:]),
                        self.access.write.eq(new & (command == link.WRITE)),
                    ]
                    with m.If(new):
                        m.d.sync += [last_number.eq(number), known.eq(command != link.HELLO)]
                    m.next = "ACCESS"
            with m.State("ACCESS"):
                m.d.comb += [self.reading.eq(self.with_word), too_soon.eq(1)]
                with m.If(~self.stalled):
                    m.d.sync += self.access.write.eq(0)
                    m.next = "ANSWER"
            with m.State("ANSWER"):
                m.d.comb += too_soon.eq(1)
                m.d.sync += [self.reply.word.eq(self.read_data), self.pending.eq(1)]
                m.next = "IDLE"
        with m.If(too_soon & (reader.end | reader.bad)):
            m.d.comb += [buffer.drop.eq(1), counted.overruns.eq(1)]
        with m.If(self.answered):
            m.d.sync += self.pending.eq(0)

    def _replies(self, m):
        out, packets = self.writer.i, self.packets
        shift, left = Signal(64), Signal(range(8))
        is_reply, ended = Signal(), Signal()
        beats = Signal(range(link.FRAME_BEATS + 1))
        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [is_reply.eq(self.pending), beats.eq(0)]
                m.d.sync += shift.eq(Mux(self.pending, Cat(Const(link.REPLY, 8), self.reply), link.PACKET))
                with m.If(self.pending):
                    m.d.sync += left.eq(Mux(self.with_word, 6, 2))
                    m.next = "BYTES"
                with m.Elif(packets.valid):
                    m.d.sync += left.eq(0)
                    m.next = "BYTES"
            with m.State("BYTES"):
                m.d.comb += [out.valid.eq(1), out.payload.byte.eq(shift), out.payload.last.eq(is_reply & (left == 0))]
                with m.If(out.ready):
                    m.d.sync += [shift.eq(shift[8:]), left.eq(left - 1)]
                    with m.If(left == 0):
                        m.d.comb += self.answered.eq(is_reply)
                        m.next = "BEAT"
                        with m.If(is_reply):
                            m.next = "IDLE"
            with m.State("BEAT"):  # a reply need not wait for the rest of a packet
                with m.If((beats != 0) & (ended | (beats == link.FRAME_BEATS) | (self.pending & ~packets.valid))):
                    m.d.sync += is_reply.eq(0)
                    m.next = "TRAILER"
                with m.Else():
                    m.d.comb += packets.ready.eq(1)
                    with m.If(packets.valid):
                        m.d.sync += [shift.eq(packets.payload.data), left.eq(7), ended.eq(packets.payload.last)]
                        m.d.sync += beats.eq(beats + 1)
                        m.next = "BYTES"
            with m.State("TRAILER"):
                m.d.comb += [out.valid.eq(1), out.payload.byte.eq(ended), out.payload.last.eq(1)]
                with m.If(out.ready):
                    m.d.sync += ended.eq(0)
                    m.next = "IDLE"

    def _registers(self, m, counted):
        """Those below 4 KiB are the shell's, those from :data:`~cmfpga.protocol.link.BASE` on the link's."""
        bank, access = self.bank, self.access
        for bus, asked in ((self.bus, access.shell), (bank.bus, access.link)):
            m.d.comb += [
                bus.write.valid.eq(access.write & asked),
                bus.write.payload.address.eq(access.address),
                bus.write.payload.data.eq(access.data),
                bus.write.payload.strobe.eq(0b1111),
                bus.read.eq(self.reading & asked),
                bus.read_address.eq(access.address),
            ]
            with m.If(asked):
                m.d.comb += [self.read_data.eq(bus.read_data), self.stalled.eq(access.write & ~bus.write.ready)]
        m.d.comb += [
            self.buffer.flush.eq(bank.commands.link_flush_now),
            bank.status.link_waiting_words.eq(self.buffer.waiting),
            bank.status.link_waiting_beat.eq(self.beat),
        ]
        for name in self.source.shape().members:
            m.d.comb += self.source[name].eq(bank.values[f"link_source_{name}"])
        for name in link.COUNTERS:
            value = self.counted[name.removeprefix("cpi_")] if name not in OWN else Signal(32, name=name)
            if name in OWN:
                m.d.sync += value.eq(value + counted[name])
            m.d.comb += bank.status[f"count_{name}_value"].eq(value)
