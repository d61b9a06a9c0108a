"""Gradient: joins the sums into G, whose sign and size are those of the contrast's slope."""

from amaranth.hdl import Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from . import payloads
from .arithmetic import delay


class Gradient(wiring.Component):
    """G = P·S − ΣI·ΣD for both axes, exactly: ∂C/∂v = 2·G/P² (Eq. C_v_x with the means multiplied out).

    Every gradient architecture ends here. ΣI·ΣD is ready when S arrives, because its factors are final ``lead``
    cycles earlier. P is a constant; where it is a power of two, P·S is a shift and costs no cycle.

    One item per ``lead`` cycles; latency :attr:`latency` cycles.

    Parameters
    ----------
    config : Config
        Widths and P.

    Members
    -------
    i : ``In``, flow of :func:`payloads.sums`
        ``i``, ``dx`` and ``dy`` must be final ``lead`` cycles before ``valid``, and stay until then.
    o : ``Out``, flow of a :func:`payloads.vector` of ``g_bits``
    """

    #: Registers of a multiplication, the last two inside DSPs.
    lead = 3

    def __init__(self, config):
        self.config = config
        self.latency = 1 if self._is_shift(config.pixels) else 1 + self.lead
        super().__init__(
            {
                "i": In(payloads.flow(payloads.sums(config))),
                "o": Out(payloads.flow(payloads.vector(config.g_bits))),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        sums = self.i.payload
        for axis in ("x", "y"):
            means = Signal(signed(config.sum_i_bits + config.sum_d_bits), name=f"means_{axis}", reset_less=True)
            m.d.sync += means.eq(sums.i * sums[f"d{axis}"])
            means = delay(m, means, self.latency + self.lead - 2, name=f"means_{axis}")

            scaled = sums[f"s{axis}"] * config.pixels
            if not self._is_shift(config.pixels):
                scaled = delay(m, scaled, self.lead, name=f"scaled_{axis}")
            m.d.sync += self.o.payload[axis].eq(scaled - means)
        m.d.sync += self.o.valid.eq(delay(m, self.i.valid, self.latency - 1, name="valid", valid=True))
        return m

    @staticmethod
    def _is_shift(factor):
        return factor & (factor - 1) == 0
