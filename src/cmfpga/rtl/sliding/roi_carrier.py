"""ROI carrier: carries the ROI on from reference time to reference time."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for, half_of, round_half_up
from .. import Block, payloads
from ..arithmetic import delay, saturate


class RoiCarrier(Block):
    """c ← c − v·since, limited to the sensor: the corner at the window's reference time.

    ``since`` is the last reference time as an event of this window has it, scaled: below 0. A window that starts cold
    takes the crop for the place of the object at its begin: c ← crop + v. Events are cropped at c + v, where the object
    is at the window's end, rounded to whole pixels and limited.

    A bit of ``since`` is multiplied a cycle, because a move happens once a hop: :attr:`latency` cycles from ``move``
    until what follows from it is there.

    Members
    -------
    load : ``In(1)``
        The ROI is ``crop``, and at rest.
    move, cold : ``In(1)``
        Carry it on; with ``cold`` from ``crop``.
    v, since, crop : ``In``, :func:`payloads.velocity`, raw dt, :func:`payloads.roi_corner`
        v and ``since`` stay until it is done. ``crop`` is where the window's newest events were cropped.
    image, next_crop : ``Out``, :func:`payloads.roi_corner`
        Where the next window's image lies, and events are cropped.
    clamped : ``Out(1)``
        The last move was limited.
    """

    def __init__(self, config):
        bits = config.formats.dt.width
        self.latency = bits + 5
        where = payloads.roi_corner(config)
        super().__init__(
            config,
            **dict.fromkeys(("load", "move", "cold"), In(1)),
            v=In(payloads.velocity(config)),
            since=In(signed(bits)),
            crop=In(where),
            image=Out(where),
            next_crop=Out(where),
            clamped=Out(1),
        )

    def elaborate(self, platform):
        config, shift = self.config, self.config.dt_frac
        frac = config.v_frac + shift
        m = Module()
        # Minus since, from its sign on: a bit a cycle. Cold, it is 1.
        factor, running = Signal.like(self.since), Signal(len(self.since))
        begin = Mux(self.cold, -1 << shift, self.since)
        m.d.sync += [factor.eq(Mux(self.move, begin, factor << 1)), running.eq((running << 1) | self.move)]
        placed = delay(m, running[-1], 2, name="placed", valid=True)
        cropped = delay(m, placed, 2, name="cropped", valid=True)
        out = []
        for axis, limit in (("x", config.geometry.roi_x_max), ("y", config.geometry.roi_y_max)):
            most = limit << frac
            v = delay(m, self.v[axis], 1, name=f"v_{axis}")  # from far away
            place = Signal(bits_for(limit) + frac, name=f"place_{axis}")
            step = Signal(signed(config.formats.v.width + len(factor)), name=f"step_{axis}")
            target = Signal(signed(max(len(place), len(step)) + 2), name=f"target_{axis}", reset_less=True)
            ahead = Signal(signed(max(len(place), config.formats.v.width + shift) + 2), name=f"ahead_{axis}")
            with m.If(self.move):
                m.d.sync += step.eq(0)
            with m.Elif(running.any()):
                # The sign counts −1: minus that is plus v.
                # What counts negative is inverted, and what shifts in carries.
                bit, inverts = Mux(factor[-1], v, 0), ~running[0]
                bit = (bit.as_unsigned() ^ inverts.replicate(len(v))).as_signed()
                m.d.sync += step.eq(Cat(inverts, step).as_signed() + bit)
            m.d.sync += target.eq(place + step)
            with m.If(self.load | (self.move & self.cold)):
                m.d.sync += place.eq(self.crop[axis] << frac)
            with m.Elif(placed):
                m.d.sync += place.eq(saturate(target, 0, most))
            # v, and what rounds half up: known long before the place is.
            ahead_v = Signal(signed(max(config.formats.v.width + shift, frac) + 1), name=f"ahead_v_{axis}")
            m.d.sync += [ahead_v.eq((v << shift) + half_of(frac)), ahead.eq((place + ahead_v) >> frac)]
            with m.If(self.load):
                m.d.sync += self.next_crop[axis].eq(self.crop[axis])
            with m.Elif(cropped):
                m.d.sync += self.next_crop[axis].eq(saturate(ahead, 0, limit))
            moved = Signal(name=f"moved_out_{axis}")
            with m.If(placed):
                m.d.sync += moved.eq((target < 0) | (target > most))
            out.append(moved | (ahead < 0) | (ahead > limit))
            m.d.comb += self.image[axis].eq(round_half_up(place, frac))
        with m.If(cropped):
            m.d.sync += self.clamped.eq(out[0] | out[1])
        return m
