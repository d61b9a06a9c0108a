"""Serial line: bytes from and to one wire, 8 bits, no parity, one stop bit."""

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib import stream
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from .. import Block


class Receiver(Block):
    """Takes each bit in its middle, counted from the falling edge of the start bit.

    Parameters
    ----------
    divisor : int
        Clock cycles per bit, at least 4.

    Members
    -------
    wire : ``In(1)``
        Of another clock; 1 while nothing is sent.
    o : ``Out``, stream of 8 bits that never waits
    error : ``Out(1)``
        One cycle: a byte had no stop bit, and is not offered.
    """

    def __init__(self, divisor):
        self._divisor = divisor
        super().__init__(wire=In(1, init=1), o=Out(stream.Signature(8, always_ready=True)), error=Out(1))

    def elaborate(self, platform):
        m = Module()
        wire, count = Signal(), Signal(range(self._divisor))
        taken = Signal(range(10))
        m.submodules.synchronizer = FFSynchronizer(self.wire, wire, init=1)
        m.d.sync += [self.o.valid.eq(0), self.error.eq(0), count.eq(count - 1)]
        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [count.eq(self._divisor // 2 - 1), taken.eq(0)]
                with m.If(~wire):
                    m.next = "BITS"
            with m.State("BITS"):
                with m.If(count == 0):
                    m.d.sync += [count.eq(self._divisor - 1), taken.eq(taken + 1)]
                    with m.If(taken == 9):
                        m.d.sync += [self.o.valid.eq(wire), self.error.eq(~wire)]
                        m.next = "STOP"
                    with m.Elif(taken != 0):
                        m.d.sync += self.o.payload.eq(Cat(self.o.payload[1:], wire))
                    with m.Elif(wire):  # no start bit, but noise
                        m.next = "IDLE"
            with m.State("STOP"):  # what stays low is one error, and no start bit
                with m.If(wire):
                    m.next = "IDLE"
        return m


class Transmitter(Block):
    """A byte every ten bits, one after the other without a pause.

    Parameters
    ----------
    divisor : int
        Clock cycles per bit.

    Members
    -------
    i : ``In``, stream of 8 bits
    wire : ``Out(1)``
    """

    def __init__(self, divisor):
        self._divisor = divisor
        super().__init__(i=In(stream.Signature(8)), wire=Out(1, init=1))

    def elaborate(self, platform):
        m = Module()
        count = Signal(range(self._divisor))
        bits, left = Signal(9), Signal(range(11))
        m.d.comb += self.i.ready.eq((left == 0) | ((left == 1) & (count == 0)))
        with m.If(self.i.ready):
            m.d.sync += [self.wire.eq(~self.i.valid), left.eq(self.i.valid.replicate(4) & 10)]
            m.d.sync += [count.eq(self._divisor - 1), bits.eq(Cat(self.i.payload, Const(1, 1)))]
        with m.Elif(count != 0):
            m.d.sync += count.eq(count - 1)
        with m.Else():
            m.d.sync += [count.eq(self._divisor - 1), left.eq(left - 1)]
            m.d.sync += [self.wire.eq(bits[0]), bits.eq(Cat(bits[1:], Const(1, 1)))]
        return m
