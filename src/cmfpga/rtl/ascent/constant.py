"""The article's ascent: along the gradient, by a constant η."""

from amaranth.hdl import Cat, Signal, signed

from ...fixed import floor_shift, round_half_up
from ..arithmetic import delay, register, saturate, wide_product
from .ascent import Ascent


class ConstantAscent(Ascent):
    """v ← v + η·∂C/∂v (Eq. v_update of the article), in formats that saturate.

    ∂C/∂v = G·2^-shift/ρ (see :attr:`cmfpga.config.widths.Widths.gradient_scale`): the shift costs nothing, and 1/ρ is
    multiplied into η when a batch begins, so an iteration has one multiplication per parameter.

    A gradient every two cycles. See :class:`Ascent` for members and attributes.
    """

    latency = 5

    def __init__(self, config):
        formats = config.formats
        product_bits = formats.gradient.width + formats.gain.width
        target_bits = max(formats.v.width, product_bits - config.widths.step_shift) + 2
        super().__init__(config, target_bits=target_bits)

    def elaborate(self, platform):
        config, run = self.config, self.run
        m = self.begin(warm=run.settings.start_last)
        m.d.comb += run.planned.eq(run.settings.iterations)
        _, mantissa = config.widths.gradient_scale
        gain = Signal(config.formats.gain.width, reset_less=True)
        m.d.sync += gain.eq(round_half_up(run.settings.eta * mantissa, 8))
        clipped = [self._target(m, name, gain) for name in config.motion_model.names]
        m.d.comb += [
            self.velocity.move.eq(delay(m, self.i.valid, ConstantAscent.latency - 1, name="valid", valid=True)),
            self.velocity.clipped.eq(Cat(*clipped).any()),
        ]
        return m

    def _target(self, m, name, gain):
        """Where one parameter is to go; returns, at stage 4, whether its slope was limited."""
        config = self.config
        fmt, shift = config.formats.gradient, config.widths.step_shift
        # Stage 1: ∂C/∂v but for 1/ρ, limited to its format.
        slope = floor_shift(self.i.payload[name], config.widths.gradient_shift)
        slope_s1 = register(signed(fmt.width), f"slope_s1_{name}")
        clipped_s1 = register(1, f"clipped_s1_{name}")
        m.d.sync += [
            slope_s1.eq(saturate(slope, fmt.min, fmt.max)),
            clipped_s1.eq((slope > fmt.max) | (slope < fmt.min)),
        ]
        # Stages 2, 3: times the gain.
        product_s3 = wide_product(m, slope_s1, gain, 2, name=f"product_{name}")
        # Stage 4: round and add. Stage 5, in the velocity: limit.
        target_s4 = register(self.velocity.target[name].shape(), f"target_s4_{name}")
        m.d.sync += target_s4.eq(self.v[name] + round_half_up(product_s3, shift))
        m.d.comb += self.velocity.target[name].eq(target_s4)
        return delay(m, clipped_s1, 3, name=f"clipped_{name}")
