"""Widths of all sums: each is proved by the bound of what it holds."""

from ..fixed import bits_for, signed_bits_for


class Widths:
    """Bounds of a :class:`~cmfpga.config.Config`, and the widths that hold them: whole numbers."""

    #: Width of the thinning's factor, and its largest value.
    thinning_bits, thinning_max = 8, 255
    #: Bits of the confidence's limit, and of a round's sum, or a curvature that is compared with it (its highest, with
    #: the sign).
    limit_bits, kept_bits = 10, 17

    def __init__(self, config):
        self._c = c = config
        motion, pixels, whole = c.motion_model, c.geometry.pixels, c.border == "whole"
        #: Longest time of the filter of background activity, µs: half of what its time stamps count to.
        self.background_us_max = (1 << (c.span_bits - 1)) - 1
        self.weight_max = 1 << c.weight_frac  #: largest single vote: weight 1
        #: Largest magnitude of a single derivative: |dt| = 1 times weight 1.
        self.derivative_max = 1 << c.derivative_frac
        self.image_max = c.buffer_events * self.weight_max  #: largest I of a pixel: every event votes with weight 1
        self.image_bits = bits_for(self.image_max)
        #: Largest magnitude of Dx or Dy of a pixel.
        self.derivative_image_max = c.buffer_events * self.derivative_max
        self.derivative_image_bits = signed_bits_for(self.derivative_image_max)
        #: Bound of ΣI: the four weights of an event sum to 1, and each rounds by at most half a unit.
        self.sum_i_max = c.buffer_events * (self.weight_max + 2)
        self.sum_i_bits = bits_for(self.sum_i_max)
        #: Bound of |ΣD|: dropped corners leave at most two derivatives of one sign, which sum to |dt|, rounded.
        self.sum_d_max = c.buffer_events * (self.derivative_max + 1)
        self.sum_d_bits = signed_bits_for(self.sum_d_max)
        self.s_max = self.sum_i_max * self.derivative_image_max  #: bound of |S| = |Σ I·D| ≤ ΣI · max|D|
        #: Bound of what an event adds to Σ I·D along an axis: I·d + w·(D + d) for each of its votes. Its four |d| sum
        #: to 2·(|dt| + 1 unit) at most, its four w to 1 and half a unit each.
        self.growth_max = (
            self.image_max * 2 * (self.derivative_max + 1) + (self.weight_max + 2) * self.derivative_image_max
        )
        #: Bound of Σ I·D of a parameter, with another motion than translation: events times their basis.
        self.moment_max = c.buffer_events * self.growth_max * motion.reach
        #: Width of Σ I·D of a parameter of the motion, and its fraction bits, which with a basis have those of it.
        self.s_bits = signed_bits_for(self.moment_max if motion.basis else self.s_max)
        self.s_frac = c.weight_frac + c.derivative_frac + (motion.frac if motion.basis else 0)
        #: Bound of |G| = |P·S − ΣI·ΣD|, or of another motion than translation |S|; ΣD = 0 where border is whole.
        self.g_max = self.moment_max
        if not motion.basis:
            self.g_max = pixels * self.s_max + (0 if whole else self.sum_i_max * self.sum_d_max)
        self.g_bits = signed_bits_for(self.g_max)
        #: Lowest bits of G that are always 0: those of P, where G = P·S (``border = whole``).
        self.g_zeros = (pixels & -pixels).bit_length() - 1 if whole and not motion.basis else 0
        #: Width of each sum of a round's four G, less those lowest bits.
        self.round_bits = max(self.kept_bits, signed_bits_for(4 * self.g_max >> self.g_zeros))
        drop = self.round_bits - self.kept_bits
        fours = max(0, (drop - 3) // 4)
        #: Bits of each shift by which those sums are normalised: by four or by one; as many as they have too many.
        self.round_shifts = (4,) * fours + (1,) * (drop - 4 * fours)
        self.squares_max = self.sum_i_max * self.image_max  #: bound of Σ I² ≤ ΣI · max I
        self.squares_bits = bits_for(self.squares_max)
        #: Width that holds each member of :class:`cmfpga.protocol.confidence.Curvature`, and the contrast. Those along
        #: an axis are differences of two G, ``cross`` the sum of two such; 0 ≤ P·Σ I² − (ΣI)², by the inequality of
        #: Cauchy and Schwarz, is shifted with them. Beyond translation the least difference of two G.
        self.curvature_bits = signed_bits_for(2 * self.g_max)
        if not motion.basis:
            most = max(4 * self.g_max, pixels * self.squares_max)
            self.curvature_bits = max(self.kept_bits + 1, signed_bits_for(most))
        more = c.weight_frac - c.derivative_frac
        #: Factors of the sides of that comparison: 4 or 8 (see docs/rounds.md), and what fractions differ by.
        self.judge_scales = by_n, by_limit = (
            (8 if motion.basis else 4) << max(0, more),
            1 << (max(0, -more) + (motion.frac if motion.basis else 0)),
        )
        limit = by_limit * ((1 << self.limit_bits) - 1)
        #: Width of either side of the comparison with the limit.
        self.judge_bits = signed_bits_for(
            by_n * c.buffer_events * 2 * self.g_max + limit * self.squares_max
            if motion.basis
            else (by_n * c.buffer_events + limit) << (self.kept_bits - 1)
        )
        q = (pixels**2).bit_length() - 1
        #: ``(shift, mantissa)`` of the factor that turns G into ∂C/∂v. With P² = ρ·2^q and 1 ≤ ρ < 2, ∂C/∂v =
        #: 2·G/(P²·2^(weight_frac + derivative_frac)) = G·2^-shift/ρ, and ``mantissa`` = 2^16/ρ, rounded. The shift is
        #: free; the mantissa is folded into η once per batch.
        self.gradient_scale = (
            c.weight_frac + c.derivative_frac + q - 1,
            ((1 << (q + 17)) + pixels**2) // (2 * pixels**2),
        )
        #: Bits that the gradient drops from G (floored) to have ``gradient_frac`` of them; negative: none.
        self.gradient_shift = self.gradient_scale[0] - c.gradient_frac
        #: Bits between the product gradient · gain and v.
        self.step_shift = c.gradient_frac + c.formats.gain.f - c.v_frac
        #: Width of a count of iterations; a driver may write a schedule as long as the table.
        self.iteration_bits = bits_for(max(c.max_iterations, c.schedule_entries if c.ascent_rule.has_table else 0))

    @property
    def exact(self):
        """Every intermediate that the integer model computes in 64 bits, with its width."""
        c, q = self._c, self._c.formats
        position = max(c.geometry.x_bits, c.geometry.y_bits) + c.dt_frac + c.v_frac + c.v_int + 2
        return {
            "G = P·S − ΣI·ΣD": self.g_bits + max(0, -self.gradient_shift),
            "gradient · gain": q.gradient.width + q.gain.width + 1,
            "time difference · reciprocal": c.span_bits + c.reciprocal_bits + 3,
            "dt · v": q.dt.width + q.v.width + 1,
            "warped position": position,
            **({"four G": self.round_bits + self.g_zeros} if c.ascent_rule.evaluations > 1 else {}),
            **({"curvature of the contrast": self.curvature_bits} if c.confidence else {}),
            "ROI position": q.roi_x.width + q.roi_gain.width + 2,
        }
