"""Basis: what a motion beyond translation makes of an event's position, before its velocity is known."""

from amaranth.hdl import Const, Module, Signal
from amaranth.lib.wiring import In, Out

from ...fixed import floor_shift, round_half_up
from .. import Block, payloads
from ..arithmetic import delay, saturate
from .time_scaler import TimeScaler


class Basis(Block):
    """p and q, an event's distance from the centre; and for a rotation xx, xy and yy, its products in focal lengths.

    The centre is that of the ROI, or of a region in it, or for a rotation the camera's principal point. It stands
    beside the time scaler, and takes as long: three multipliers for the products, three for the focal length.

    One event per cycle; latency :attr:`latency` cycles.

    Parameters
    ----------
    config : Config
        A motion with a basis (:class:`cmfpga.config.motion.MotionModel`).

    Members
    -------
    x, y : ``In``
        As in :func:`payloads.dithered_event`.
    centre : ``In``
        Of the sensor, in quarters of a pixel; ``corner``: the ROI's. With ``curve``, only for a rotation.
    curve : ``In``
        2^27/f².
    middle : ``In``, :func:`payloads.middle`
        Of a region; only with ``regions``. It stays while events come.
    o : ``Out``, :func:`payloads.basis`
    """

    latency = TimeScaler.latency

    def __init__(self, config):
        event, settings = payloads.dithered_event(config).members, payloads.settings(config).members
        camera = {name: In(settings[name]) for name in ("centre", "curve") if name in settings}
        if camera:
            camera["corner"] = In(payloads.roi_corner(config))
        places = {"x": In(event["x"]), "y": In(event["y"]), **camera, **payloads.with_middle(config, In)}
        super().__init__(config, **places, o=Out(payloads.basis(config)))

    def elaborate(self, platform):
        config, motion = self.config, self.config.motion_model
        m = Module()
        drop = config.formats.dithered_frac - motion.place_frac
        # Undistorted positions come with half a pixel more than they are.
        more = (1 << motion.place_frac) >> 1 if config.formats.event_frac else 0
        found, whole_s1 = {}, {}
        for name, axis, size in (("p", "x", config.roi_width), ("q", "y", config.roi_height)):
            middle = Const(2 * (size - 1))
            if hasattr(self, "centre"):  # it stays for a batch
                middle = delay(
                    m, self.centre[axis] - (self.corner[axis] << motion.place_frac), 1, name=f"middle_{name}"
                )
            elif hasattr(self, "middle"):
                middle = delay(m, self.middle[axis] << 1, 1, name=f"middle_{name}")
            place = floor_shift(getattr(self, axis), drop) - more
            # Stage 1: subtract.
            place_s1 = Signal(self.o[name].shape(), name=f"{name}_s1", reset_less=True)
            m.d.sync += place_s1.eq(place - middle)
            whole_s1[name] = place_s1 >> motion.place_frac
            found[name] = delay(m, place_s1, self.latency - 1, name=name)
        for name, a, b in (("xx", "p", "p"), ("xy", "p", "q"), ("yy", "q", "q")):
            if name in motion.basis:
                fmt = motion.basis[name]
                # Stages 2, 3: multiply, with a register behind. Stages 4, 5: by the curve. Stage 6: round, limit.
                product_s3 = delay(m, whole_s1[a] * whole_s1[b], 2, name=name)
                bent_s5 = delay(m, product_s3 * self.curve, 2, name=f"bent_{name}")
                found[name] = Signal(self.o[name].shape(), name=f"{name}_s6", reset_less=True)
                bent = round_half_up(bent_s5, motion.curve_frac - motion.frac)
                m.d.sync += found[name].eq(saturate(bent, fmt.min, fmt.max))
        m.d.comb += [self.o[name].eq(value) for name, value in found.items()]
        return m
