"""The few arithmetic and pipelining idioms that several blocks share."""

from amaranth.hdl import Cat, Mux, Signal


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


def small_product(value, factor):
    """``value · factor`` (``factor`` unsigned, a few bits) in LUTs, where a DSP would be wasted: an adder a bit."""
    low, rest = [], Mux(factor[0], value, 0)
    for bit in factor[1:]:
        low.append(rest[0])
        rest = (rest >> 1) + Mux(bit, value, 0)
    product = Cat(*low, rest)
    return product.as_signed() if value.shape().signed else product


def select(index, choices):
    """``choices[index]``; an index beyond the end gives the last."""
    chosen = choices[-1]
    for number in reversed(range(len(choices) - 1)):
        chosen = Mux(index == number, choices[number], chosen)
    return chosen


def accumulate(m, values, total, first, active, *, name):
    """Add four values per cycle to ``total``: two pairs, then both onto the total; two cycles.

    Where ``first``, the total starts from zero. ``first`` and ``active`` come with the values.
    """
    pairs = []
    for n in (0, 2):
        pair = Signal((values[n] + values[n + 1]).shape(), name=f"pair_{name}_{n}", reset_less=True)
        m.d.sync += pair.eq(values[n] + values[n + 1])
        pairs.append(pair)
    active = delay(m, active, 1, name=f"active_{name}", valid=True)
    first = delay(m, first, 1, name=f"first_{name}")
    with m.If(active):
        with m.If(first):
            m.d.sync += total.eq(pairs[0] + pairs[1])
        with m.Else():
            m.d.sync += total.eq(total + pairs[0] + pairs[1])
