"""Reciprocal of the batch's time range, by a serial divider."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block


class Reciprocal(Block):
    """Computes ``mantissa = floor(2**(span_bits - 1 + reciprocal_bits) / (span << shift))``, once per batch.

    ``shift`` brings the range's top bit to the top, so that the mantissa has full precision for any range; it is
    found one bit a cycle, then the division yields one bit a cycle. ``done`` is high for one cycle,
    :attr:`latency` cycles after ``start``; the results stay until the next ``start``.

    Parameters
    ----------
    span_bits, reciprocal_bits : int
        Widths of the divisor and, less one, of the mantissa.

    Members
    -------
    start : ``In(1)``
    span : ``In(span_bits)``
        t_N − t_1 in µs, not zero (zero gives a meaningless result, in the same time).
    done : ``Out(1)``
    shift, mantissa : ``Out``
    """

    def __init__(self, *, span_bits, reciprocal_bits):
        self.span_bits, self.reciprocal_bits = span_bits, reciprocal_bits
        self.latency = span_bits + reciprocal_bits + 1
        super().__init__(
            start=In(1),
            span=In(span_bits),
            done=Out(1),
            shift=Out(bits_for(span_bits - 1)),
            mantissa=Out(reciprocal_bits + 1),
        )

    def elaborate(self, platform):
        m = Module()
        divisor = Signal(self.span_bits, reset_less=True)
        remainder = Signal(self.span_bits + 1, reset_less=True)
        fits = Signal()
        difference = Signal(self.span_bits + 2)
        step = Signal(range(self.span_bits + self.reciprocal_bits + 1))

        m.d.comb += [difference.eq(remainder - divisor), fits.eq(~difference[-1])]
        m.d.sync += self.done.eq(0)
        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [divisor.eq(self.span), remainder.eq(1 << (self.span_bits - 1)), step.eq(0)]
                with m.If(self.start):
                    m.d.sync += self.shift.eq(0)
                    m.next = "NORMALISE"
            with m.State("NORMALISE"):
                m.d.sync += step.eq(step + 1)
                with m.If(~divisor[-1]):
                    m.d.sync += [divisor.eq(divisor << 1), self.shift.eq(self.shift + 1)]
                with m.If(step == self.span_bits - 2):
                    m.next = "DIVIDE"
            with m.State("DIVIDE"):
                m.d.sync += [
                    step.eq(step + 1),
                    self.mantissa.eq((self.mantissa << 1) | fits),
                    remainder.eq(Mux(fits, difference, remainder) << 1),
                ]
                with m.If(step == self.span_bits + self.reciprocal_bits - 1):
                    m.d.sync += self.done.eq(1)
                    m.next = "IDLE"
        return m
