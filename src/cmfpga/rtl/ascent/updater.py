"""Gradient-ascent updater: holds v and moves it along the gradient."""

from amaranth.hdl import Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import floor_shift, round_half_up
from .. import payloads
from ..arithmetic import delay, saturate


class Updater(wiring.Component):
    """v ← v + η·∂C/∂v (Eq. v_update of the article), in formats that saturate.

    ∂C/∂v = G·2^-shift/ρ (see :attr:`cmfpga.config.widths.Widths.gradient_scale`): the shift costs nothing, and 1/ρ is
    multiplied into η when a batch begins, so an iteration has one multiplication per axis.

    ``v`` changes, and ``done`` is high, :attr:`latency` cycles after a gradient enters.

    Parameters
    ----------
    config : Config
        Formats.

    Members
    -------
    i : ``In``, flow of :func:`payloads.gradient`
        At least two cycles apart.
    new_batch : ``In(1)``
        A batch begins: forget ``saturated``.
    load : ``In(1)``
        Take ``start``. At least two cycles before a gradient enters.
    start : ``In``, :func:`payloads.velocity`
    eta : ``In``
        Constant from two cycles before a gradient enters.
    v : ``Out``, :func:`payloads.velocity`
        Zero after a reset.
    updating, done : ``Out(1)``
        v changes at the end of this cycle; v has changed.
    saturated : ``Out(1)``
        Whether the gradient or v was limited to its format since ``new_batch``.
    """

    latency = 5

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(payloads.flow(payloads.gradient(config))),
                "new_batch": In(1),
                "load": In(1),
                "start": In(payloads.velocity(config)),
                "eta": In(payloads.Fixed(config.formats.eta)),
                "v": Out(payloads.velocity(config)),
                "updating": Out(1),
                "done": Out(1),
                "saturated": Out(1),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        _, mantissa = config.widths.gradient_scale
        gain = Signal(config.formats.gain.width, reset_less=True)
        m.d.sync += gain.eq(round_half_up(self.eta * mantissa, 8))

        valid_s4 = delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)
        m.d.comb += self.updating.eq(valid_s4)
        m.d.sync += self.done.eq(valid_s4)
        clipped = []
        for axis in ("x", "y"):
            clipped += self._axis(m, axis, gain, valid_s4)
        with m.If(self.new_batch):
            m.d.sync += self.saturated.eq(0)
        with m.Elif(valid_s4 & (clipped[0] | clipped[1] | clipped[2] | clipped[3])):
            m.d.sync += self.saturated.eq(1)
        return m

    def _axis(self, m, axis, gain, valid_s4):
        """One axis; returns its two clip signals of stage 4."""
        config = self.config
        fmt = config.formats.gradient
        v = self.v[axis]

        def register(shape, name):
            return Signal(shape, name=f"{name}_{axis}", reset_less=True)

        # Stage 1: ∂C/∂v but for 1/ρ, limited to its format.
        slope = floor_shift(self.i.payload[axis], config.widths.gradient_shift)
        slope_s1 = register(signed(fmt.width), "slope_s1")
        clipped_s1 = register(1, "clipped_s1")
        m.d.sync += [
            slope_s1.eq(saturate(slope, fmt.min, fmt.max)),
            clipped_s1.eq((slope > fmt.max) | (slope < fmt.min)),
        ]
        # Stages 2, 3: times the gain; the second register is inside the DSP.
        product_s2 = register(signed(fmt.width + config.formats.gain.width), "product_s2")
        m.d.sync += product_s2.eq(slope_s1 * gain)
        product_s3 = delay(m, product_s2, 1, name=f"product_{axis}")
        # Stage 4: round and add. Stage 5: limit.
        target_s4 = register(signed(max(len(v), len(product_s3) - config.widths.step_shift) + 2), "target_s4")
        m.d.sync += target_s4.eq(v + round_half_up(product_s3, config.widths.step_shift))
        over, under = target_s4 > config.formats.v.max, target_s4 < config.formats.v.min
        with m.If(self.load):
            m.d.sync += v.eq(self.start[axis])
        with m.Elif(valid_s4):
            m.d.sync += v.eq(saturate(target_s4, config.formats.v.min, config.formats.v.max))
        return [delay(m, clipped_s1, 3, name=f"clipped_{axis}"), over | under]
