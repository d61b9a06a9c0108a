"""ROI updater: holds the ROI's position and moves it with the object."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..fixed import round_half_up
from . import payloads
from .arithmetic import saturate


class RoiUpdater(wiring.Component):
    """position ← position + roi_gain·v, limited to the sensor (Eq. roi_update of the article, whose gain is 1).

    The position keeps all fraction bits, so that slow motion adds up; ``roi`` is it rounded to whole pixels.

    With one event buffer a batch is cropped where the position is. With two, a batch is cropped before the move of the
    one ahead of it is known: where the position would be if the last move were repeated. Either way a load takes effect
    at once.

    A move takes :attr:`latency` cycles, until ``roi_next`` shows it :attr:`settle` cycles.

    Parameters
    ----------
    config : Config
        Sensor and ROI size, formats, ``buffers``.

    Members
    -------
    new_batch, load : ``In(1)``
        A batch begins: forget ``clamped``, crop it at ``roi_next``, or where ``load``, at ``x`` and ``y``.
    move, still : ``In(1)``
        Add ``roi_gain``·``v``; with ``still``, nothing (a batch that measured nothing).
    x, y : ``In``
        Whole pixels of the sensor.
    v : ``In``, :func:`payloads.velocity`
    roi_gain : ``In``
    roi : ``Out``, :func:`payloads.roi_corner`
        The corner of the batch that is being taken in; (0, 0) after a reset.
    roi_next : ``Out``, :func:`payloads.roi_corner`
        The corner of the next batch, if it does not load another.
    clamped : ``Out(1)``
        Whether a load, or what moved this batch's ROI, was limited to the sensor: with one buffer the move after it,
        with two the one before.
    """

    latency = 3
    settle = 6

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                **dict.fromkeys(("new_batch", "load", "move", "still"), In(1)),
                "x": In(config.x_bits),
                "y": In(config.y_bits),
                "v": In(payloads.velocity(config)),
                "roi_gain": In(config.roi_gain_format.width),
                "roi": Out(payloads.roi_corner(config)),
                "roi_next": Out(payloads.roi_corner(config)),
                "clamped": Out(1),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        move_s1, move_s2 = Signal(), Signal()
        m.d.sync += [move_s1.eq(self.move), move_s2.eq(move_s1)]
        out_of_range, moved_out, ahead_out = [], [], []
        for axis, wanted, limit, fmt in (
            ("x", self.x, config.roi_x_max, config.roi_x_format),
            ("y", self.y, config.roi_y_max, config.roi_y_format),
        ):
            largest = limit << fmt.f
            position = Signal(fmt.width, name=f"position_{axis}")
            step_s1 = Signal(signed(len(self.v[axis]) + len(self.roi_gain)), name=f"step_{axis}_s1", reset_less=True)
            target_s2 = Signal(signed(max(fmt.width, len(step_s1)) + 2), name=f"target_{axis}_s2", reset_less=True)
            m.d.sync += [
                step_s1.eq(Mux(self.still, 0, self.v[axis] * self.roi_gain)),  # stage 1
                target_s2.eq(position + step_s1),  # stage 2
            ]
            with m.If(self.new_batch & self.load):
                m.d.sync += position.eq(saturate(wanted, 0, limit) << fmt.f)
            with m.Elif(move_s2):  # stage 3
                m.d.sync += position.eq(saturate(target_s2, 0, largest))
            out_of_range.append(wanted > limit)
            moved_out.append((target_s2 < 0) | (target_s2 > largest))

            ahead = position
            if config.buffers == 2:
                last_step = Signal(step_s1.shape(), name=f"last_step_{axis}")
                with m.If(self.new_batch & self.load):
                    m.d.sync += last_step.eq(0)
                with m.Elif(move_s1):
                    m.d.sync += last_step.eq(step_s1)
                repeated = Signal.like(target_s2, name=f"repeated_{axis}")
                ahead = Signal(fmt.width, name=f"ahead_{axis}")
                m.d.sync += [repeated.eq(position + last_step), ahead.eq(saturate(repeated, 0, largest))]
                ahead_out.append((repeated < 0) | (repeated > largest))
            m.d.comb += self.roi_next[axis].eq(round_half_up(ahead, fmt.f))
            if config.buffers == 2:
                with m.If(self.new_batch):
                    m.d.sync += self.roi[axis].eq(Mux(self.load, saturate(wanted, 0, limit), self.roi_next[axis]))
            else:
                m.d.comb += self.roi[axis].eq(self.roi_next[axis])
        if config.buffers == 2:
            limited = Signal()
            m.d.sync += limited.eq(ahead_out[0] | ahead_out[1])
            with m.If(self.new_batch):
                m.d.sync += self.clamped.eq(Mux(self.load, out_of_range[0] | out_of_range[1], limited))
        else:
            with m.If(self.new_batch):
                m.d.sync += self.clamped.eq(self.load & (out_of_range[0] | out_of_range[1]))
            with m.Elif(move_s2 & (moved_out[0] | moved_out[1])):
                m.d.sync += self.clamped.eq(1)
        return m
