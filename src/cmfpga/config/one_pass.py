"""The gradient in one pass: how long an iteration takes, and how many tags it needs."""

from ..errors import ConfigError
from .derived import Derived


class OnePass(Derived):
    """What follows from ``gradient="one_pass"``."""

    @property
    def latency(self):
        """Cycles of an iteration beside its n events, in which no vote enters the banks.

        The latencies of warp, voter, banks, sums, gradient and ascent, less one; or where those from the banks on are
        shorter, of what is in front of the warp. A test holds them to those of the blocks.
        """
        warp, voter = 4 if self._c.max_level else 3, 3
        gradient = 4 if self._c.geometry.pixels & (self._c.geometry.pixels - 1) else 1
        sums = 4 + 4
        if self._c.ascent_rule.evaluations > 1:  # four sums, one after the other
            warp, gradient, sums = warp + 1, gradient - 1, sums + self._c.geometry.images - 1
        feed = 10 + (self._c.dither_frac > 0)
        if self._c.motion_model.basis:
            warp, gradient, sums = warp + 2, 0, sums + 2
        return warp + voter + max(sums + gradient + self._c.ascent_rule.latency(self._c), feed) - 1

    @property
    def fewest_idle_cycles(self):
        """So many an iteration, or the sweep of the banks doesn't pass every word before its tag comes back."""
        return -(-self._c.geometry.bank_depth // ((1 << self._c.tag_bits) - 1))

    def check(self):
        """Raise :exc:`ConfigError` if there are too few tags."""
        idle, tags = self.latency, (1 << self._c.tag_bits) - 1
        if idle < self.fewest_idle_cycles:
            raise ConfigError(
                f"tag_bits = {self._c.tag_bits}: (2^tag_bits − 1) · {idle} idle cycles an iteration "
                f"= {tags * idle}, at least the {self._c.geometry.bank_depth} words of a bank are needed"
            )
