"""Fixed-point formats: which bits stand for which range."""

from ..fixed import Q, bits_for
from .derived import Derived


class Formats(Derived):
    """The formats of a configuration, each a :class:`~cmfpga.fixed.Q`."""

    @property
    def dt(self):
        """Scaled time, −1 … 1 inclusive."""
        return Q(1, self._c.dt_frac)

    @property
    def v(self):
        """Velocity in pixels per half batch; saturates."""
        return Q(self._c.v_int, self._c.v_frac)

    @property
    def eta(self):
        """Step η of the ascent."""
        return Q(self._c.eta_int, self._c.eta_frac, signed=False)

    @property
    def roi_gain(self):
        """Gain of the ROI update."""
        return Q(self._c.roi_gain_int, self._c.roi_gain_frac, signed=False)

    @property
    def gradient(self):
        """Gradient of the contrast, ∂C/∂v, before it is multiplied by η; saturates."""
        return Q(self._c.gradient_int, self._c.gradient_frac)

    @property
    def gain(self):
        """η times the part of 2/P² that is not a power of two (see :attr:`gradient_scale`)."""
        return Q(self._c.eta_int, self._c.eta_frac + 8, signed=False)

    @property
    def roi_x(self):
        """Column of the ROI's left edge, with the fraction bits that the ROI update needs to be exact."""
        return Q(bits_for(self._c.geometry.roi_x_max), self._c.v_frac + self._c.roi_gain_frac, signed=False)

    @property
    def roi_y(self):
        """Row of the ROI's top edge."""
        return Q(bits_for(self._c.geometry.roi_y_max), self._c.v_frac + self._c.roi_gain_frac, signed=False)

    @property
    def position_x(self):
        """Warped column relative to the ROI, clamped to −2 … roi_width (whole pixels outside vote nowhere)."""
        return Q(bits_for(self._c.roi_width), self._c.position_frac)

    @property
    def position_y(self):
        """Warped row relative to the ROI, clamped to −2 … roi_height."""
        return Q(bits_for(self._c.roi_height), self._c.position_frac)
