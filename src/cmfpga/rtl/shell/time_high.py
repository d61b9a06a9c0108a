"""Time word: keeps the high bits of EVT 2.x time stamps."""

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...protocol.word_format import HIGH_BITS, LOW_BITS


class TimeHigh(wiring.Component):
    """Remembers the last time word; the bits of a later event complete it.

    Members
    -------
    load : ``In(1)``
        A time word is here.
    high : ``In``
        Its 28 bits.
    low : ``In``
        An event's six low bits.
    t : ``Out``
        Time stamp of that event, with the time words before this cycle.
    known : ``Out(1)``
        There was a time word.
    back : ``Out(1)``
        The time word that is loaded steps back: by less than half the range, or it would be a wrap.
    """

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "load": In(1),
                "high": In(HIGH_BITS),
                "low": In(LOW_BITS),
                "t": Out(config.time_bits),
                "known": Out(1),
                "back": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        kept = Signal(HIGH_BITS)
        with m.If(self.load):
            m.d.sync += [kept.eq(self.high), self.known.eq(1)]
        m.d.comb += [
            self.t.eq(Cat(self.low, kept)),
            # The sign of the difference.
            self.back.eq(self.load & self.known & (self.high[-1] ^ kept[-1] ^ (self.high[:-1] < kept[:-1]))),
        ]
        return m
