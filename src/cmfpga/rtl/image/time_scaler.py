"""t_ref/dt scaler: turns an event's time into dt = (t − t_ref)/((t_N − t_1)/2)."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for, round_half_up
from .. import Block, payloads
from ..arithmetic import carry, delay


class TimeScaler(Block):
    """Scales times to −1 … 1 (Eqs. t_ref and dt of the article) by the reciprocal of the batch's range.

    dt = (2t − span)/span with t counted from t_1, so t_ref's half microsecond is not lost. Two multipliers, one
    for each half of a number that is too wide for those of some devices.

    Where a window slides, ``span`` is known before the events are: later ones count as at its end, and times before t_1
    are limited to −2.

    One event per cycle; latency :attr:`latency` cycles.

    Parameters
    ----------
    event : StructLayout, optional
        Of a window that slides: ``t``, signed with a bit more, ``x``, ``y`` and ``last``.

    Members
    -------
    i : ``In``, flow of :func:`payloads.dithered_event`, or of ``event``
    o : ``Out``, flow of :func:`payloads.scaled_event`, or of ``event`` with ``dt`` in place of ``t``
    basis : ``In``, :func:`payloads.basis`
        That of the event that goes out; only where the motion has one.
    span, shift, mantissa : ``In``
        The range and its reciprocal; may change only while no event is in flight.
    """

    latency = 6

    def __init__(self, config, event=None):
        self.config, self._slides = config, event is not None
        scaled = payloads.scaled_event(config)
        if self._slides:
            rest = {name: event.members[name] for name in ("x", "y", "last")}
            scaled = payloads.layout(dt=payloads.Fixed(config.formats.dt), **rest)
        super().__init__(
            i=In(payloads.flow(event or payloads.dithered_event(config))),
            **payloads.with_basis(config, In),
            o=Out(payloads.flow(scaled)),
            span=In(config.span_bits),
            shift=In(bits_for(config.span_bits - 1)),
            mantissa=In(config.reciprocal_bits + 1),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        width = config.span_bits + 1 + self._slides
        numerator_s1 = Signal(signed(width + self._slides), reset_less=True)
        numerator_s2 = Signal(signed(width), reset_less=True)
        numerator_s3 = Signal(signed(width), reset_less=True)
        low = width // 2
        low_s4 = Signal(low + config.reciprocal_bits + 1, reset_less=True)
        high_s4 = Signal(signed(width - low + config.reciprocal_bits + 1), reset_less=True)
        product_s5 = Signal(signed(width + config.reciprocal_bits + 1), reset_less=True)

        # Stage 1: twice the distance to t_ref.
        m.d.sync += numerator_s1.eq((self.i.payload.t << 1) - self.span)
        # Stages 2, 3: normalise as the divisor was, in two steps; |2t − span| ≤ span, so nothing overflows.
        m.d.sync += numerator_s2.eq(numerator_s1 << Cat(Const(0, 2), self.shift[2:]))
        m.d.sync += numerator_s3.eq(numerator_s2 << self.shift[:2])
        # Stage 4: multiply.
        mantissa = delay(m, self.mantissa, 1, name="mantissa")  # in the multipliers' own registers
        m.d.sync += [low_s4.eq(numerator_s3[:low] * mantissa), high_s4.eq(numerator_s3[low:].as_signed() * mantissa)]
        # Stage 5: add.
        m.d.sync += product_s5.eq((high_s4 << low) + low_s4)
        # Stage 6: round.
        fraction = config.span_bits - 1 + config.reciprocal_bits - config.dt_frac
        dt = round_half_up(product_s5, fraction)
        m.d.sync += self.o.payload.dt.eq(self._limited(m, numerator_s1, dt) if self._slides else dt)

        carry(m, self, "x", "y", "last")
        if self.config.motion_model.basis:
            m.d.comb += self.o.payload.basis.eq(self.basis)
        return m

    def _limited(self, m, numerator_s1, dt):
        """``dt`` from −2 to 1. From twice the span on the product means nothing."""
        low, high = self.config.formats.dt.min, 1 << self.config.dt_frac
        # Copies of the span that change long before an event comes: it is far away. And a cycle to compare.
        most, least = Signal(signed(len(self.span) + 2)), Signal(signed(len(self.span) + 2))
        m.d.sync += [most.eq(self.span << 1), least.eq(-(self.span << 1))]
        time_s2 = delay(m, numerator_s1, 1, name="time")
        beyond = delay(m, Cat(time_s2 >= most, time_s2 <= least), 3, name="beyond")
        # From ``high`` on, which is a power of two, for its bits tell.
        return Mux(beyond[1], low, Mux(beyond[0] | (~dt[-1] & (dt >> self.config.dt_frac).any()), high, dt))
