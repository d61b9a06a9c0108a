"""The few arithmetic and pipelining idioms that several blocks share."""

from amaranth.hdl import Mux, Signal


def saturate(value, low, high):
    """``value`` limited to ``low … high`` (integers); the hardware twin of :func:`cmfpga.fixed.saturate`."""
    if value.shape().signed or low > 0:
        value = Mux(value < low, low, value)
    return Mux(value > high, high, value)


def delay(m, value, cycles, *, name, valid=False):
    """``value`` as it was ``cycles`` clock cycles ago.

    ``valid=True`` is for control bits, which a reset clears; everything else is datapath and has no reset, so
    that it can become a shift register LUT.
    """
    for stage in range(1, cycles + 1):
        register = Signal(value.shape(), name=f"{name}_s{stage}", reset_less=not valid)
        m.d.sync += register.eq(value)
        value = register
    return value
