"""Widths of all sums: each is proved by the bound of what it holds."""

from ..fixed import bits_for, signed_bits_for
from .derived import Derived


class Widths(Derived):
    """Bounds, and the widths that hold them."""

    #: Width of the thinning's factor, and its largest value.
    thinning_bits, thinning_max = 8, 255

    #: Bits of the confidence's limit, and of a round's sum, or a curvature that is compared with it (its highest, with
    #: the sign).
    limit_bits, kept_bits = 10, 17

    @property
    def background_us_max(self):
        """Longest time of the filter of background activity, µs: half of what its time stamps count to."""
        return (1 << (self._c.span_bits - 1)) - 1

    @property
    def weight_max(self):
        """Largest single vote: weight 1."""
        return 1 << self._c.weight_frac

    @property
    def derivative_max(self):
        """Largest magnitude of a single derivative: |dt| = 1 times weight 1."""
        return 1 << self._c.derivative_frac

    @property
    def image_max(self):
        """Largest I of a pixel: every event of the buffer votes with weight 1."""
        return self._c.buffer_events * self.weight_max

    @property
    def image_bits(self):
        """Width of a word of I (unsigned)."""
        return bits_for(self.image_max)

    @property
    def derivative_image_max(self):
        """Largest magnitude of D of a pixel."""
        return self._c.buffer_events * self.derivative_max

    @property
    def derivative_image_bits(self):
        """Width of a word of Dx or Dy (two's complement)."""
        return signed_bits_for(self.derivative_image_max)

    @property
    def sum_i_max(self):
        """Bound of ΣI: the four weights of an event sum to 1, and each rounds by at most half a unit."""
        return self._c.buffer_events * (self.weight_max + 2)

    @property
    def sum_i_bits(self):
        """Width of ΣI (unsigned)."""
        return bits_for(self.sum_i_max)

    @property
    def sum_d_max(self):
        """Bound of |ΣD|: dropped corners leave at most two derivatives of one sign, which sum to |dt|, rounded."""
        return self._c.buffer_events * (self.derivative_max + 1)

    @property
    def sum_d_bits(self):
        """Width of ΣDx and ΣDy (two's complement)."""
        return signed_bits_for(self.sum_d_max)

    @property
    def round_bits(self):
        """Width of each sum of a round's four G, less their lowest bits that are always 0 (two's complement)."""
        return max(self.kept_bits, signed_bits_for(4 * self.g_max >> self.g_zeros))

    @property
    def round_shifts(self):
        """Bits of each shift by which those sums are normalised: by four or by one; as many as they have too many."""
        drop = self.round_bits - self.kept_bits
        fours = max(0, (drop - 3) // 4)
        return (4,) * fours + (1,) * (drop - 4 * fours)

    @property
    def s_max(self):
        """Bound of |S| = |Σ I·D| ≤ ΣI · max|D|."""
        return self.sum_i_max * self.derivative_image_max

    @property
    def s_frac(self):
        """Fraction bits of S, which with another motion than translation has those of its basis."""
        motion = self._c.motion_model
        return self._c.weight_frac + self._c.derivative_frac + (motion.frac if motion.basis else 0)

    @property
    def s_bits(self):
        """Width of Σ I·D of a parameter of the motion (two's complement)."""
        return signed_bits_for(self.moment_max if self._c.motion_model.basis else self.s_max)

    @property
    def growth_max(self):
        """Bound of what an event adds to Σ I·D along an axis: I·d + w·(D + d) for each of its votes.

        Its four |d| sum to 2·(|dt| + 1 unit) at most, its four w to 1 and half a unit each.
        """
        return self.image_max * 2 * (self.derivative_max + 1) + (self.weight_max + 2) * self.derivative_image_max

    @property
    def moment_max(self):
        """Bound of Σ I·D of a parameter, with another motion than translation: events times their basis."""
        return self._c.buffer_events * self.growth_max * self._c.motion_model.reach

    @property
    def g_max(self):
        """Bound of |G| = |P·S − ΣI·ΣD|, or of another motion than translation |S|; ΣD = 0 where border is whole."""
        if self._c.motion_model.basis:
            return self.moment_max
        means = self.sum_i_max * self.sum_d_max if self._c.border != "whole" else 0
        return self._c.geometry.pixels * self.s_max + means

    @property
    def g_bits(self):
        """Width of Gx and Gy (two's complement)."""
        return signed_bits_for(self.g_max)

    @property
    def g_zeros(self):
        """Lowest bits of G that are always 0: those of P, where G = P·S (``border = whole``)."""
        pixels = self._c.geometry.pixels
        plain = self._c.border != "whole" or self._c.motion_model.basis
        return 0 if plain else (pixels & -pixels).bit_length() - 1

    @property
    def squares_max(self):
        """Bound of Σ I² ≤ ΣI · max I."""
        return self.sum_i_max * self.image_max

    @property
    def squares_bits(self):
        """Width of Σ I² (unsigned)."""
        return bits_for(self.squares_max)

    @property
    def curvature_bits(self):
        """Width that holds each member of :class:`cmfpga.protocol.confidence.Curvature`, and the contrast (signed).

        Those along an axis are differences of two G, ``cross`` the sum of two such; 0 ≤ P·Σ I² − (ΣI)², by the
        inequality of Cauchy and Schwarz, is shifted with them. Beyond translation the least difference of two G.
        """
        if self._c.motion_model.basis:
            return signed_bits_for(2 * self.g_max)
        most = max(4 * self.g_max, self._c.geometry.pixels * self.squares_max)
        return max(self.kept_bits + 1, signed_bits_for(most))

    @property
    def judge_scales(self):
        """Factors of the sides of that comparison: 4 or 8 (see docs/rounds.md), and what fractions differ by."""
        more, motion = self._c.weight_frac - self._c.derivative_frac, self._c.motion_model
        return (8 if motion.basis else 4) << max(0, more), 1 << (max(0, -more) + (motion.frac if motion.basis else 0))

    @property
    def judge_bits(self):
        """Width of either side of the comparison with the limit (two's complement)."""
        by_n, by_limit = self.judge_scales
        if self._c.motion_model.basis:
            larger = by_n * self._c.buffer_events * 2 * self.g_max
            return signed_bits_for(larger + by_limit * ((1 << self.limit_bits) - 1) * self.squares_max)
        most = (by_n * self._c.buffer_events + by_limit * ((1 << self.limit_bits) - 1)) << (self.kept_bits - 1)
        return signed_bits_for(most)

    @property
    def gradient_scale(self):
        """``(shift, mantissa)`` of the factor that turns G into ∂C/∂v.

        With P² = ρ·2^q and 1 ≤ ρ < 2, ∂C/∂v = 2·G/(P²·2^(weight_frac + derivative_frac)) = G·2^-shift/ρ, and
        ``mantissa`` = 2^16/ρ, rounded. The shift is free; the mantissa is folded into η once per batch.
        """
        square = self._c.geometry.pixels**2
        q = square.bit_length() - 1
        mantissa = ((1 << (q + 17)) + square) // (2 * square)
        return self._c.weight_frac + self._c.derivative_frac + q - 1, mantissa

    @property
    def gradient_shift(self):
        """Bits that the gradient drops from G (floored) to have ``gradient_frac`` of them; negative: none."""
        return self.gradient_scale[0] - self._c.gradient_frac

    @property
    def step_shift(self):
        """Bits between the product gradient · gain and v."""
        return self._c.gradient_frac + self._c.formats.gain.f - self._c.v_frac

    @property
    def iteration_bits(self):
        """Width of a count of iterations; a driver may write a schedule as long as the table."""
        longest = self._c.schedule_entries if self._c.ascent_rule.has_table else 0
        return bits_for(max(self._c.max_iterations, longest))

    @property
    def exact(self):
        """Every intermediate that the integer model computes in 64 bits, with its width."""
        return {
            "G = P·S − ΣI·ΣD": self.g_bits + max(0, -self.gradient_shift),
            "gradient · gain": self._c.formats.gradient.width + self._c.formats.gain.width + 1,
            "time difference · reciprocal": self._c.span_bits + self._c.reciprocal_bits + 3,
            "dt · v": self._c.formats.dt.width + self._c.formats.v.width + 1,
            "warped position": max(self._c.geometry.x_bits, self._c.geometry.y_bits)
            + self._c.dt_frac
            + self._c.v_frac
            + self._c.v_int
            + 2,
            **({"four G": self.round_bits + self.g_zeros} if self._c.ascent_rule.evaluations > 1 else {}),
            **({"curvature of the contrast": self.curvature_bits} if self._c.confidence else {}),
            "ROI position": self._c.formats.roi_x.width + self._c.formats.roi_gain.width + 2,
        }
