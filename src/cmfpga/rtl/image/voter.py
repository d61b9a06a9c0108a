"""Bilinear voter: spreads a warped event over four pixels, with the derivatives of each vote."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for, floor_shift, half_of, round_half_up
from .. import Block, payloads
from ..arithmetic import delay, negative_where, partial_products, register, select


class BilinearVoter(Block):
    """Weights and derivatives of the four corners of an event's cell (Eqs. weights and w_dx_x), sorted by bank.

    A 2×2 cell has one corner of each parity of (column, row), hence one vote per bank. A corner outside the ROI is
    dropped alone; with ``border = whole`` its event then changes no derivative. With fx, fy the fractions and one
    product of each (fx·fy, dt·fx, dt·fy; the latter in LUTs if the fractions have at most four bits), all others
    follow by subtraction: (1 − fx)·fy = fy − fx·fy, dt·(1 − fy) = dt − dt·fy.

    One event per cycle; latency :attr:`latency` cycles.

    Members
    -------
    i : ``In``, flow of :func:`payloads.warped_event`
    o : ``Out``, flow of :func:`payloads.votes`
    level : ``In``
        Coarse levels have smaller images. Changes only while no event is in flight.
    middle : ``In``, :func:`payloads.middle`
        Of a region, from which its pixels are counted; only with ``regions``. Changes as seldom.
    """

    latency = 3

    def __init__(self, config):
        super().__init__(
            config,
            i=In(payloads.flow(payloads.warped_event(config))),
            o=Out(payloads.flow(payloads.votes(config))),
            level=In(bits_for(config.max_level)),
            **payloads.with_middle(config, In),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        frac = config.position_frac
        one = 1 << frac
        event, valid = self.i.payload, self.i.valid
        dt, fx, fy = event.dt, event.x[:frac], event.y[:frac]

        # Stage 1: products.
        fx_fy_s1 = register(2 * frac, "fx_fy_s1")
        # dt·fx, dt·fy: in LUTs as two terms, which stage 2 adds, so that no stage has adders in a row.
        small = frac <= 4
        factors = partial_products if small else lambda value, factor: [value * factor]
        dt_fx_s1, dt_fy_s1 = (
            [delay(m, term, 1, name=f"{name}_{number}") for number, term in enumerate(factors(dt, factor))]
            for name, factor in (("dt_fx", fx), ("dt_fy", fy))
        )
        fx_s1, fy_s1 = register(frac, "fx_s1"), register(frac, "fy_s1")
        rest_s1 = register(signed(frac + 2), "rest_s1")
        # dt·1, and what rounds dt·(1 − fy) half up, so that one subtraction is left.
        shift = config.dt_frac + frac - config.derivative_frac
        dt_half_s1 = register(signed(config.formats.dt.width + frac + 1), "dt_half_s1")
        m.d.sync += [
            fx_fy_s1.eq(fx * fy),
            fx_s1.eq(fx),
            fy_s1.eq(fy),
            rest_s1.eq(one - fx - fy),
            dt_half_s1.eq(dt * one + half_of(shift)),
        ]

        # Stage 2: round. Corners are (right, down).
        weight_shift = 2 * frac - config.weight_frac

        def whole(value):
            half = half_of(weight_shift)  # below the value's last bit, it takes no adder of its own
            return (value << frac) + half if half >> frac else (value << frac) | half

        def weight(product):
            return floor_shift(product, weight_shift)

        def derivative(terms):
            return round_half_up(sum(terms[1:], terms[0]), shift)

        def rest(terms):
            return floor_shift(dt_half_s1 - sum(terms[1:], terms[0]), shift)

        w_s2 = {
            corner: register(config.weight_frac + 1, f"w{corner[0]}{corner[1]}_s2")
            for corner in ((0, 0), (1, 0), (0, 1), (1, 1))
        }
        slope = signed(config.derivative_frac + 2)
        # Magnitude of ∂w/∂vx on the upper and lower row, of ∂w/∂vy on the left and right column.
        dx_s2 = [register(slope, "dx_up_s2"), register(slope, "dx_down_s2")]
        dy_s2 = [register(slope, "dy_left_s2"), register(slope, "dy_right_s2")]
        m.d.sync += [
            w_s2[0, 0].eq(weight(whole(rest_s1) + fx_fy_s1)),
            w_s2[1, 0].eq(weight(whole(fx_s1) - fx_fy_s1)),
            w_s2[0, 1].eq(weight(whole(fy_s1) - fx_fy_s1)),
            w_s2[1, 1].eq(round_half_up(fx_fy_s1, weight_shift)),
            dx_s2[0].eq(rest(dt_fy_s1)),
            dx_s2[1].eq(derivative(dt_fy_s1)),
            dy_s2[0].eq(rest(dt_fx_s1)),
            dy_s2[1].eq(derivative(dt_fx_s1)),
        ]
        widths, heights = zip(
            *(config.geometry.level_size(level) for level in range(config.max_level + 1)), strict=True
        )
        column_s2, columns_inside = self._axis(m, "column", event.x >> frac, widths)
        row_s2, rows_inside = self._axis(m, "row", event.y >> frac, heights)
        counted = Const(1)
        if config.border == "whole":
            counted = delay(m, Cat(columns_inside, rows_inside).all(), 1, name="counted")

        # Stage 3: give each bank the corner of its parity.
        valid_s1 = delay(m, valid, 1, name="valid", valid=True)
        valid_s2 = delay(m, valid_s1, 1, name="valid_s1", valid=True)
        for number in range(4):
            bank = self.o.payload.banks[number]
            (right, column), (down, row) = column_s2[number & 1], row_s2[number >> 1]
            inside = valid_s1 & columns_inside[number & 1] & rows_inside[number >> 1]
            dx, dy = (Mux(far, slope[1], slope[0]) for far, slope in ((down, dx_s2), (right, dy_s2)))
            m.d.sync += [
                bank.valid.eq(delay(m, inside, 1, name=f"voted_{number}", valid=True)),
                bank.address.eq((row << config.geometry.bank_column_bits) | column[: config.geometry.bank_column_bits]),
                bank.i.eq(Mux(down, Mux(right, w_s2[1, 1], w_s2[0, 1]), Mux(right, w_s2[1, 0], w_s2[0, 0]))),
                bank.dx.eq(negative_where(right, dx)),
                bank.dy.eq(negative_where(down, dy)),
            ]
            with m.If(~counted):  # a reset, which takes no LUT
                m.d.sync += [bank.dx.eq(0), bank.dy.eq(0)]
        if config.motion_model.of_pixels:
            self._locate(m, self.o.payload.cell)
        elif config.motion_model.basis:
            m.d.sync += self.o.payload.basis.eq(delay(m, event.basis, 2, name="basis"))
        m.d.sync += [self.o.valid.eq(valid_s2), self.o.payload.last.eq(delay(m, event.last, 2, name="last"))]
        return m

    def _locate(self, m, located):
        """Where the cell's upper left pixel is, from the centre in quarters of a pixel; three cycles."""
        config = self.config
        unit = config.motion_model.place_frac
        m.d.sync += located.level.eq(delay(m, self.level, 2, name="located_level"))
        for name, odd, axis, size in (
            ("p", "odd_column", "x", config.roi_width), ("q", "odd_row", "y", config.roi_height)
        ):  # fmt: skip
            cell_s1 = delay(m, self.i.payload[axis] >> config.position_frac, 1, name=f"located_{name}")
            # The middle of a pixel 2^level px wide: (c + ½)·2^level − ½ px.
            levels = range(config.max_level + 1)
            if hasattr(self, "middle"):
                # Known long before the events, so that one addition is left.
                halves = select(self.level, [Const((1 << (level + unit)) // 2) for level in levels])
                more = delay(m, halves - ((self.middle[axis] + 1) << 1), 1, name=f"more_{name}")
                places = [cell_s1.shift_left(level + unit) + more for level in levels]
            else:
                places = [
                    cell_s1.shift_left(level + unit) + ((1 << (level + unit)) // 2 - (size << unit) // 2)
                    for level in levels
                ]
            place_s2 = delay(m, select(self.level, places), 1, name=f"place_{name}")
            m.d.sync += [located[name].eq(place_s2), located[odd].eq(delay(m, cell_s1[0], 1, name=odd))]

    def _axis(self, m, name, cell, sizes):
        """For each parity of one axis: (is it the far corner, its bank coordinate), at stage 2.

        And for each whether it is inside, a cycle earlier.
        """
        cell_s1 = delay(m, cell, 1, name=name)
        parities, insides = [], []
        # Of c and c + 1 the even one is 2·⌊(c + 1)/2⌋, the odd one 2·⌊c/2⌋ + 1.
        for parity, index in enumerate(((cell_s1 + 1) >> 1, cell_s1 >> 1)):
            far = Signal(name=f"{name}{parity}_far_s2", reset_less=True)
            coordinate = Signal(range(max(2, (sizes[0] + 1) // 2)), name=f"{name}{parity}_s2", reset_less=True)
            lengths = [(size + 1 - parity) // 2 for size in sizes]
            # Whether the index is one: told by the cell, so that no comparison follows the adder.
            from_0 = ~cell[-1] if parity else ~cell[-1] | cell.all()
            inside = from_0 & (cell < select(self.level, [2 * length - 1 + parity for length in lengths]))
            m.d.sync += [far.eq(cell_s1[0] ^ parity), coordinate.eq(index)]
            parities.append((far, coordinate))
            insides.append(delay(m, inside, 1, name=f"{name}{parity}_inside"))
        return parities, insides
