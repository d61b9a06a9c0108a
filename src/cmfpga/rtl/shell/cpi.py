"""Camera parallel interface (CPI) of a Prophesee GenX320: eight wires with EVT 2.0 words, on the sensor's clock.

Known from the register map that Prophesee publishes (OpenEB, ``genx320_registermap``) and from open drivers (OpenMV,
ST): a byte per cycle of PCLK; packets of a set number of bytes, each while HSYNC is active, with blanking between;
frames of a set number of packets, marked by VSYNC; polarities of both, and the clock's edge, are set in the sensor;
words are little-endian unless the sensor is told otherwise; time words come every 64 µs if it is told so.

Assumed here, because no public document says it: data, HSYNC and VSYNC are stable at PCLK's rising edge; VSYNC goes to
its active level before a frame's first byte, or with it; a frame begins with a word's first byte, a packet need not;
what fills a packet that has too few events is :data:`PADDING`.
"""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, stream
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.fifo import AsyncFIFO
from amaranth.lib.wiring import In, Out

from ...protocol.link import CPI_COUNTERS
from ...protocol.word_format import EVENT_TYPES, HIGH_BITS, OTHER_TYPES, TIME_HIGH
from .. import Block
from . import payloads
from .decoder import EVT

#: A word that stands for nothing: type F, which no decoder takes for an event, and ones all through.
PADDING = 0xFFFFFFFF


class CpiPort(Block):
    """Words from the pins, one to a beat. The pins are in the domain ``cpi``, all else is in ``sync``.

    Where a time word was lost, and after a pause, words are left out until the next time word. Nothing that comes whole
    is lost without being counted.

    A clock edge that is lost or doubled shifts all bytes up to the next frame, and only words tell. From the first on
    that cannot be, all are left out until a frame begins and a time word comes. These cannot be: types without a use,
    events outside the sensor, times that step back or by 2^time_bits time words or more. Words before the first
    come, and are wrong: of random events 0.4 on average, and at most five in 223 trials.

    Parameters
    ----------
    depth : int
        Words between the clocks, a power of two.
    padding : int
        The word that fills packets.
    sensor : (int, int)
        Columns and rows.

    Members
    -------
    data, hsync, vsync : ``In``
        The pins, of the domain ``cpi``.
    enable : ``In(1)``
        0: paused; the sensor goes on, and its words are counted as skipped.
    big_endian, hsync_low, vsync_low : ``In(1)``
        A word's first byte is its highest; active levels. May change while paused.
    o : ``Out``, stream of :func:`cmfpga.rtl.shell.payloads.beat`
        The upper half of a beat is absent.
    counted : ``Out``
        Totals, 32 bits each, of :data:`cmfpga.protocol.link.CPI_COUNTERS`.
    """

    #: Time words may be left out by a sensor that sees nothing for a while, 4 s here.
    time_bits = 16

    def __init__(self, depth=512, padding=PADDING, sensor=(320, 320)):
        self._depth, self._padding, self._sensor = depth, padding, sensor
        super().__init__(
            data=In(8),
            **dict.fromkeys(("hsync", "vsync", "enable", "big_endian", "hsync_low", "vsync_low"), In(1)),
            o=Out(stream.Signature(payloads.beat())),
            counted=Out(data.StructLayout({name: 32 for name in CPI_COUNTERS})),
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.fifo = fifo = AsyncFIFO(width=32, depth=self._depth, r_domain="sync", w_domain="cpi")
        counts = {}
        for name in CPI_COUNTERS:
            m.submodules[f"count_{name}"] = counts[name] = CountAcross()
            m.d.comb += self.counted[name].eq(counts[name].total)
        told = {}
        for name in ("enable", "big_endian", "hsync_low", "vsync_low"):
            told[name] = Signal(name=f"{name}_cpi")
            m.submodules[f"across_{name}"] = FFSynchronizer(getattr(self, name), told[name], o_domain="cpi")

        # Pins to words.
        byte, line, frame, frame_before = Signal(8), Signal(), Signal(), Signal()
        starts, place = Signal(), Signal(2)
        bytes_before, word, word_valid = Signal(24), Signal(32), Signal()
        m.d.cpi += [byte.eq(self.data), line.eq(self.hsync), frame.eq(self.vsync)]
        m.d.cpi += [frame_before.eq(frame ^ told["vsync_low"]), word_valid.eq(0)]
        m.d.comb += starts.eq((frame ^ told["vsync_low"]) & ~frame_before)
        cut, begins = Signal(), Signal()
        m.d.cpi += [cut.eq(starts & (place != 0)), begins.eq(starts)]
        with m.If(starts):
            m.d.cpi += place.eq(0)
        with m.If(line ^ told["hsync_low"]):
            m.d.cpi += [place.eq(Mux(starts, 1, place + 1)), bytes_before.eq(Cat(bytes_before[8:], byte))]
            with m.If((place == 3) & ~starts):
                whole = Cat(bytes_before, byte)
                swapped = Cat(*(whole[8 * k : 8 * k + 8] for k in reversed(range(4))))
                m.d.cpi += [word.eq(Mux(told["big_endian"], swapped, whole)), word_valid.eq(1)]

        # Words that count.
        in_time, is_time, is_event, real, passes = Signal(), Signal(), Signal(), Signal(), Signal()
        wrong, slipped, high, step = Signal(), Signal(), Signal(HIGH_BITS), Signal(HIGH_BITS)
        fields, found = data.View(EVT, word), Signal()
        m.d.comb += [
            is_time.eq(fields.type == TIME_HIGH),
            is_event.eq(fields.type.matches(*EVENT_TYPES)),
            step.eq(word[:HIGH_BITS] - high),
            wrong.eq(
                (is_event & ((fields.x >= self._sensor[0]) | (fields.y >= self._sensor[1])))
                | (is_time & in_time & step[self.time_bits :].any())
                | ~fields.type.matches(*EVENT_TYPES, TIME_HIGH, *OTHER_TYPES)
            ),
            real.eq(word_valid & (word != self._padding)),
            passes.eq(real & told["enable"] & (in_time | is_time) & ~wrong & ~slipped),
            found.eq(real & told["enable"] & wrong & ~slipped),
            fifo.w_data.eq(word),
            fifo.w_en.eq(passes & fifo.w_rdy),
            counts["words"].pulse.eq(fifo.w_en),
            counts["overflow"].pulse.eq(passes & ~fifo.w_rdy),
            counts["skipped"].pulse.eq(real & ~passes & ~found),
            counts["padding"].pulse.eq(word_valid & ~real),
            counts["broken"].pulse.eq(cut | found),  # never both: no word ends while one is cut
        ]
        with m.If(~told["enable"] | cut | found):
            m.d.cpi += in_time.eq(0)
        with m.Elif(passes & is_time):
            m.d.cpi += [in_time.eq(fifo.w_rdy), high.eq(word[:HIGH_BITS])]
        with m.If(begins | found):
            m.d.cpi += slipped.eq(found)

        m.d.comb += [
            self.o.valid.eq(fifo.r_rdy),
            self.o.payload.data.eq(Cat(fifo.r_data, Const(PADDING, 32))),
            self.o.payload.keep.eq(0b0000_1111),
            fifo.r_en.eq(self.o.ready),
        ]
        return m


class CountAcross(Block):
    """Counts pulses of the domain ``cpi`` in ``sync``, exactly while ``cpi`` is less than 15 times as fast.

    Members
    -------
    pulse : ``In(1)``
        Of ``cpi``.
    total : ``Out(32)``
        Of ``sync``; wraps.
    """

    bits = 4

    def __init__(self):
        super().__init__(pulse=In(1), total=Out(32))

    def elaborate(self, platform):
        m = Module()
        count, gray, seen = (Signal(self.bits, name=name) for name in ("count", "gray", "seen"))
        m.submodules.across = FFSynchronizer(gray, seen)
        m.d.cpi += [count.eq(count + self.pulse), gray.eq(count ^ (count >> 1))]
        now, before = Signal(self.bits), Signal(self.bits)
        m.d.comb += now.eq(Cat(seen[k:].xor() for k in range(self.bits)))
        m.d.sync += [before.eq(now), self.total.eq(self.total + (now - before)[: self.bits])]
        return m
