"""The few arithmetic and pipelining idioms that several blocks share."""

from amaranth.hdl import Cat, Const, Mux, Signal

from ..protocol.confidence import SHORT_PX

#: Bits of an unsigned factor that a multiplier of 18 signed bits takes.
PIECE = 17


def saturate(value, low, high):
    """``value`` limited to ``low … high`` (integers); the hardware twin of :func:`cmfpga.fixed.saturate`.

    The two comparisons stand side by side, of the bits that can tell. Where the limits are those of a signed word, the
    bits above it tell.
    """
    if (beyond := _beyond_word(value, low, high)) is not None:
        return Mux(beyond, Mux(value[-1], low, high), value)
    above, below = _beyond(value, low, high)
    if zeros := _zeros(high):  # what equals it but for them is greater, or the limit itself
        above = (value >> zeros) >= (high >> zeros)
    return Mux(below, low, Mux(above, high, value))


def is_beyond(value, low, high):
    """Whether :func:`saturate` limits ``value``."""
    if (beyond := _beyond_word(value, low, high)) is not None:
        return beyond
    above, below = _beyond(value, low, high)
    return above | below


def _beyond_word(value, low, high):
    """Whether it is, told by the bits above a signed word; None where the limits are not those of one."""
    width = high.bit_length()
    if value.shape().signed and len(value) > width and high == (1 << width) - 1 and low == -1 - high:
        bits = value[width:]
        return bits.any() & ~bits.all()
    return None


def _beyond(value, low, high):
    """Whether it is greater than ``high``, and less than ``low``."""
    above, below = _zeros(high + 1), _zeros(low)
    less = (value >> below) < (low >> below) if value.shape().signed or low > 0 else Const(0)
    return (value >> above) > (high >> above), less


def _zeros(limit):
    """How many bits at its end are 0."""
    return (limit & -limit).bit_length() - 1 if limit else 0


def negative_where(flag, value):
    """``value``, or −``value`` in as many bits: inverted, and a bit below carries. No choice follows."""
    inverse = value.as_unsigned() ^ flag.replicate(len(value))
    return ((Cat(Const(1, 1), inverse) + flag) >> 1)[: len(value)].as_signed()


def register(shape, name):
    """A register of the datapath: no reset clears it."""
    return Signal(shape, name=name, reset_less=True)


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


def carry(m, block, *names):
    """``valid`` and these members from ``i`` to ``o``, in the block's latency."""
    cycles, given = block.latency - 1, block.i.payload
    m.d.sync += [
        block.o.valid.eq(delay(m, block.i.valid, cycles, name="valid", valid=True)),
        *(block.o.payload[name].eq(delay(m, given[name], cycles, name=name)) for name in names),
    ]


def small_product(value, factor):
    """``value · factor`` (``factor`` unsigned, a few bits) in LUTs, where a DSP would be wasted: a tree of adders.

    Of few bits, two bits of the factor choose a multiple, which takes no adder.
    """
    if value.shape().signed or len(value) > 4:
        terms = partial_products(value, factor)
    else:
        multiples = [Const(0, 1), value, value << 1, _tripled(value)]
        digits = [factor[low : low + 2] for low in range(0, len(factor), 2)]
        terms = [select(digit, multiples[: 1 << len(digit)]) << 2 * k for k, digit in enumerate(digits)]
    while len(terms) > 1:
        terms = [sum(terms[k + 1 : k + 2], terms[k]) for k in range(0, len(terms), 2)]
    return terms[0][: len(value) + len(factor)].as_signed() if value.shape().signed else terms[0]


def _tripled(value):
    """3·``value``, unsigned, by logic: no bit depends on more than ``value`` has."""
    bits, carry = [], Const(0, 1)
    for one, other in zip([*value, Const(0, 1), Const(0, 1)], [Const(0, 1), *value, Const(0, 1)], strict=True):
        bits.append(one ^ other ^ carry)
        carry = (one & other) | (carry & (one | other))
    return Cat(bits)


def ones(value):
    """How many bits are set: a tree of adders."""
    terms = [*value]
    while len(terms) > 1:
        terms = [sum(terms[k + 1 : k + 2], terms[k]) for k in range(0, len(terms), 2)]
    return terms[0]


def partial_products(value, factor):
    """What sums to ``value · factor`` (``factor`` unsigned, a few bits): a term of one adder for two bits of it."""
    terms = [Mux(bit, value, 0) << number for number, bit in enumerate(factor)]
    return [sum(terms[k + 1 : k + 2], terms[k]) for k in range(0, len(terms), 2)]


def wide_product(m, a, b, cycles, *, name):
    """``a·b``, two cycles later or more, of factors that may be too wide for one multiplier.

    The first cycle multiplies pieces of :data:`PIECE` bits, the others add them: first those that do not overlap, which
    takes no adder.
    """
    diagonals = {}
    for k, one in enumerate(_pieces(a)):
        for j, other in enumerate(_pieces(b)):
            product = delay(m, one * other, 1, name=f"{name}_{k}{j}")
            diagonals.setdefault(k - j, []).append(product.shift_left(PIECE * (k + j)))
    terms = [term for terms in sorted(diagonals.values(), key=len, reverse=True) for term in terms]
    for left in reversed(range(cycles - 1)):
        while len(terms) > (2 if left else 1):
            terms = [sum(terms[k + 1 : k + 2], terms[k]) for k in range(0, len(terms), 2)]
        terms = [delay(m, term, 1, name=f"{name}_{left}_{n}") for n, term in enumerate(terms)]
    return terms[0]


def _pieces(value):
    """``value``, the lowest bits first; the last piece has the sign."""
    signed = value.shape().signed
    if len(value) <= PIECE + signed:
        return [value]
    rest = value[PIECE:]
    return [value[:PIECE], *_pieces(rest.as_signed() if signed else rest)]


def is_short(m, v):
    """What :func:`cmfpga.protocol.confidence.is_short` says of a velocity, a cycle later."""
    layout = v.shape().members
    parts = {name: v[name] for name in layout}
    sizes = [delay(m, Mux(one[-1], -one, one), 1, name=f"size_{name}").as_unsigned() for name, one in parts.items()]
    total, (frac,) = sum(sizes[1:], sizes[0]), {shape.q.f for shape in layout.values()}
    return Cat((total + size)[frac:] < int(2 * SHORT_PX) for size in sizes).all()


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
