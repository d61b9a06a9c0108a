"""Gradient: joins the sums into G, whose sign and size are those of the contrast's slope."""

from amaranth.hdl import Const, Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from ..arithmetic import delay, wide_product


class Gradient(Block):
    """G = P·S − ΣI·ΣD for each parameter of v, exactly: ∂C/∂v = 2·G/P² (Eq. C_v_x with the means multiplied out).

    Every gradient architecture ends here. ΣI·ΣD is ready when S arrives, because its factors are final ``lead``
    cycles earlier. P is a constant; where it is a power of two, P·S is a shift and costs no cycle.

    Where only whole cells have derivatives (``border = whole``), an event's are opposite, ΣD = 0, and G is P·S. In a
    motion beyond translation, which has that border, it is S itself, at once. In a round, whose four evaluations' sums
    come one after the other, it is P·S, at once if that is a shift.

    One item per ``lead`` cycles, or of a round one a cycle; latency :attr:`latency` cycles.

    Parameters
    ----------
    lead : int
        Cycles by which the plain sums are final before ``valid``, :attr:`lead` or more.

    Members
    -------
    i : ``In``, flow of :func:`payloads.sums`
        ``i``, ``dx`` and ``dy`` are final ``lead`` cycles before ``valid``, and stay until then.
    o : ``Out``, flow of :func:`payloads.gradient`
    """

    #: Registers of a multiplication, the last two inside DSPs.
    lead = 3

    def __init__(self, config, *, lead=lead):
        self.config = config
        self._early = lead > self.lead
        self._rounds = config.ascent_rule.evaluations > 1
        self.latency = 0 if self._is_shift(config.geometry.pixels) else self.lead
        if not self._rounds:
            self.latency = 0 if config.motion_model.basis else 1 + self.latency
        super().__init__(i=In(payloads.flow(payloads.sums(config))), o=Out(payloads.flow(payloads.gradient(config))))

    def elaborate(self, platform):
        config = self.config
        m = Module()
        if not self.latency:
            m.d.comb += self.o.valid.eq(self.i.valid)
            shift = config.geometry.pixels.bit_length() - 1 if self._rounds else 0
            for name in config.motion_model.names:
                m.d.comb += self.o.payload[name].eq(self.i.payload[f"s{name}"].shift_left(shift))
            return m
        means = self._means(m) if config.border != "whole" else {}
        for name in config.motion_model.names:
            mean = delay(m, means.get(name, Const(0)), self.latency - 1, name=f"means_{name}")
            scaled = self.i.payload[f"s{name}"] * config.geometry.pixels
            if not self._is_shift(config.geometry.pixels):
                scaled = delay(m, scaled, self.lead, name=f"scaled_{name}")
            if self._rounds:
                m.d.comb += self.o.payload[name].eq(scaled)
            else:
                m.d.sync += self.o.payload[name].eq(scaled - mean)
        valid = delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)
        m.d.sync += self.o.valid.eq(valid)
        return m

    def _means(self, m):
        """ΣI·ΣD of each parameter, when ``i`` is valid.

        If a product fits one DSP, two of the three registers are enough for it, and two parameters take turns with one
        DSP. It does not matter whose turn it is: in the first two of ``lead`` cycles each has one.
        """
        config, sums = self.config, self.i.payload
        shape = signed(config.widths.sum_i_bits + config.widths.sum_d_bits)
        if (
            config.widths.sum_i_bits < 18 and config.widths.sum_d_bits <= 27 and len(config.motion_model.names) == 2
        ):  # signed
            means = {name: Signal(shape, name=f"means_{name}", reset_less=True) for name in config.motion_model.names}
            first, second = means
            turn = Signal()
            product = Signal(shape, reset_less=True)
            factor, ready = Mux(turn, sums[f"d{second}"], sums[f"d{first}"]), turn
            if self._early:  # there is time for a register in front of the multiplier, too
                factor, ready = delay(m, factor, 1, name="factor"), ~turn
            m.d.sync += [turn.eq(~turn), product.eq(sums.i * factor)]
            with m.If(ready):  # without that register it is the second's turn now, so the product is the first's
                m.d.sync += means[first].eq(product)
            with m.Else():
                m.d.sync += means[second].eq(product)
            return means
        return {
            name: wide_product(m, sums.i, sums[f"d{name}"], self.lead, name=f"means_{name}")
            for name in config.motion_model.names
        }

    @staticmethod
    def _is_shift(factor):
        return factor & (factor - 1) == 0
