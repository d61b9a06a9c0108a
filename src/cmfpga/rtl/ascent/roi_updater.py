"""ROI updater: holds the ROI's position and moves it with the object."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import round_half_up
from .. import Block, payloads
from ..arithmetic import delay, saturate


def corner(config):
    """Signature of where the ROI is.

    Members
    -------
    roi
        :func:`payloads.roi_corner` of the batch that is being taken in; (0, 0) after a reset.
    roi_next
        That of the next batch, if it does not load another.
    clamped
        Whether a load, or what moved this batch's ROI, was limited to the sensor: with one buffer the move after it,
        with two the one before.
    """
    where = payloads.roi_corner(config)
    return wiring.Signature({"roi": Out(where), "roi_next": Out(where), "clamped": Out(1)})


class RoiUpdater(Block):
    """position ← position + roi_gain·v, limited to the sensor (Eq. roi_update of the article, whose gain is 1).

    The position keeps all fraction bits, so that slow motion adds up; ``roi`` is it rounded to whole pixels.

    With one event buffer a batch is cropped where the position is. With two, a batch is cropped before the move of the
    one ahead of it is known: where the position would be if the last move were repeated. Either way a load takes effect
    at once.

    A bit of the gain is multiplied a cycle, because a move happens once a batch. It takes :attr:`latency` cycles, until
    ``corner.roi_next`` shows it :attr:`settle` cycles.

    Members
    -------
    new_batch, load : ``In(1)``
        A batch begins: forget ``clamped``, crop it at ``roi_next``, or where ``load``, at ``x`` and ``y``.
    move, still : ``In(1)``
        Add ``roi_gain``·``v``; with ``still``, nothing (a batch that measured nothing). ``v`` stays until that is done.
    x, y : ``In``
        Whole pixels of the sensor.
    v : ``In``, :func:`payloads.velocity`
    roi_gain : ``In``
    corner : ``Out``, :func:`corner`
    """

    def __init__(self, config):
        self.latency = config.formats.roi_gain.width + 1 + 2 * config.buffers
        self.settle = self.latency + 1 + config.buffers
        super().__init__(
            config,
            **dict.fromkeys(("new_batch", "load", "move", "still"), In(1)),
            x=In(config.geometry.x_bits),
            y=In(config.geometry.y_bits),
            v=In(payloads.velocity(config)),
            roi_gain=In(payloads.Fixed(config.formats.roi_gain)),
            corner=Out(corner(config)),
        )

    def elaborate(self, platform):
        config, corner = self.config, self.corner
        m = Module()
        asked = self.new_batch & self.load
        load = delay(m, asked, config.buffers - 1, name="load", valid=True)  # with two the position has time
        gain, running = Signal.like(self.roi_gain), Signal(len(self.roi_gain))
        m.d.sync += [gain.eq(Mux(self.move, self.roi_gain, gain << 1)), running.eq((running << 1) | self.move)]
        with m.If(self.move & self.still):
            m.d.sync += gain.eq(0)
        move = delay(m, running[-1], 2 * config.buffers, name="move", valid=True)
        still = dict.fromkeys(("x", "y"), Const(0, signed(config.formats.v.width)))
        v = still | {parameter.moves_roi: self.v[parameter.name] for parameter in config.motion_model.parameters}
        out_of_range, moved_out = [], []
        for axis, wanted, limit, fmt in (
            ("x", self.x, config.geometry.roi_x_max, config.formats.roi_x),
            ("y", self.y, config.geometry.roi_y_max, config.formats.roi_y),
        ):
            largest = limit << fmt.f
            position = Signal(fmt.width, name=f"position_{axis}")
            step_s1 = Signal(signed(len(v[axis]) + len(gain)), name=f"step_{axis}_s1")
            target_s2 = Signal(signed(max(fmt.width, len(step_s1)) + 2), name=f"target_{axis}_s2", reset_less=True)
            limited = Signal(fmt.width, name=f"limited_{axis}")
            with m.If(asked | self.move):
                m.d.sync += step_s1.eq(0)
            with m.Elif(running.any()):
                m.d.sync += step_s1.eq((step_s1 << 1) + Mux(gain[-1], v[axis], 0))  # stage 1, a cycle a bit
            m.d.sync += target_s2.eq(position + step_s1)  # stage 2
            # What lies in the last whole pixel, but on it, is beyond: no fraction need be compared.
            beyond = (target_s2 >> fmt.f) >= limit
            # With two buffers the target stays meanwhile.
            sides = delay(m, Cat(target_s2[-1], beyond), config.buffers - 1, name=f"sides_{axis}")
            m.d.comb += limited.eq(Mux(sides[0], 0, Mux(sides[1], largest, target_s2)))
            out_of_range.append(wanted > limit)
            start = delay(m, saturate(wanted, 0, limit), config.buffers - 1, name=f"start_{axis}")
            out = (target_s2 < 0) | (target_s2 > largest)
            moved_out.append(delay(m, out, config.buffers - 1, name=f"out_{axis}"))

            ahead, moved = position, limited
            if config.buffers == 2:  # the last step is still there: three cycles later the target is the next one
                ahead = moved = Signal(fmt.width, name=f"ahead_{axis}")
                m.d.sync += ahead.eq(limited)
            with m.If(load):
                m.d.sync += position.eq(start << fmt.f)
            with m.Elif(move):  # stage 3, or 5
                m.d.sync += position.eq(moved)
            m.d.comb += corner.roi_next[axis].eq(round_half_up(ahead, fmt.f))
            if config.buffers == 2:
                with m.If(self.new_batch):
                    m.d.sync += corner.roi[axis].eq(Mux(self.load, saturate(wanted, 0, limit), corner.roi_next[axis]))
            else:
                m.d.comb += corner.roi[axis].eq(corner.roi_next[axis])
        if config.buffers == 2:
            ahead_out = delay(m, moved_out[0] | moved_out[1], 1, name="ahead_out")
            with m.If(self.new_batch):
                m.d.sync += corner.clamped.eq(Mux(self.load, out_of_range[0] | out_of_range[1], ahead_out))
        else:
            with m.If(self.new_batch):
                m.d.sync += corner.clamped.eq(self.load & (out_of_range[0] | out_of_range[1]))
            with m.Elif(move & (moved_out[0] | moved_out[1])):
                m.d.sync += corner.clamped.eq(1)
        return m
