"""ROI updater: holds the ROI's position and moves it with the object."""

from amaranth.hdl import Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..fixed import round_half_up
from . import payloads
from .arithmetic import saturate


class RoiUpdater(wiring.Component):
    """position ← position + roi_gain·v, limited to the sensor (Eq. roi_update of the article, whose gain is 1).

    The position keeps all fraction bits, so that slow motion adds up; ``roi`` is it rounded to whole pixels.
    ``new_batch`` takes one cycle, ``move`` :attr:`latency` cycles.

    Parameters
    ----------
    config : Config
        Sensor and ROI size, formats.

    Members
    -------
    new_batch, load : ``In(1)``
        A batch begins: forget ``clamped``, and where ``load``, take ``x`` and ``y``.
    move : ``In(1)``
        Add ``roi_gain``·``v``.
    x, y : ``In``
        Whole pixels of the sensor.
    v : ``In``, :func:`payloads.velocity`
    roi_gain : ``In``
    roi : ``Out``, :func:`payloads.roi_corner`
        The ROI's corner; (0, 0) after a reset.
    clamped : ``Out(1)``
        Whether a load or move since ``new_batch`` was limited to the sensor.
    """

    latency = 3

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "new_batch": In(1),
                "load": In(1),
                "move": In(1),
                "x": In(config.x_bits),
                "y": In(config.y_bits),
                "v": In(payloads.velocity(config)),
                "roi_gain": In(config.roi_gain_format.width),
                "roi": Out(payloads.roi_corner(config)),
                "clamped": Out(1),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        move_s1, move_s2 = Signal(), Signal()
        m.d.sync += [move_s1.eq(self.move), move_s2.eq(move_s1)]
        out_of_range = []
        for axis, wanted, limit, fmt in (
            ("x", self.x, config.roi_x_max, config.roi_x_format),
            ("y", self.y, config.roi_y_max, config.roi_y_format),
        ):
            position = Signal(fmt.width, name=f"position_{axis}")
            step_s1 = Signal(signed(len(self.v[axis]) + len(self.roi_gain)), name=f"step_{axis}_s1", reset_less=True)
            target_s2 = Signal(signed(max(fmt.width, len(step_s1)) + 2), name=f"target_{axis}_s2", reset_less=True)
            m.d.sync += [
                step_s1.eq(self.v[axis] * self.roi_gain),  # stage 1
                target_s2.eq(position + step_s1),  # stage 2
            ]
            largest = limit << fmt.f
            with m.If(self.new_batch & self.load):
                m.d.sync += position.eq(saturate(wanted, 0, limit) << fmt.f)
            with m.Elif(move_s2):  # stage 3
                m.d.sync += position.eq(saturate(target_s2, 0, largest))
            m.d.comb += self.roi[axis].eq(round_half_up(position, fmt.f))
            out_of_range.append((wanted > limit, (target_s2 < 0) | (target_s2 > largest)))
        with m.If(self.new_batch):
            m.d.sync += self.clamped.eq(self.load & (out_of_range[0][0] | out_of_range[1][0]))
        with m.Elif(move_s2 & (out_of_range[0][1] | out_of_range[1][1])):
            m.d.sync += self.clamped.eq(1)
        return m
