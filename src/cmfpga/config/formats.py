"""Fixed-point formats: which bits stand for which range."""

from ..fixed import Q, bits_for


class Formats:
    """The formats of a :class:`~cmfpga.config.Config`, each a :class:`~cmfpga.fixed.Q`."""

    def __init__(self, config):
        c = config
        self.dt = Q(1, c.dt_frac)  #: scaled time, −1 … 1 inclusive
        self.v = Q(c.v_int, c.v_frac)  #: velocity in pixels per half batch; saturates
        self.eta = Q(c.eta_int, c.eta_frac, signed=False)  #: step η of the ascent
        self.roi_gain = Q(c.roi_gain_int, c.roi_gain_frac, signed=False)  #: gain of the ROI update
        #: ∂C/∂v before it is multiplied by η; saturates
        self.gradient = Q(c.gradient_int, c.gradient_frac)
        #: η times the part of 2/P² that is not a power of two (see :attr:`Widths.gradient_scale`)
        self.gain = Q(c.eta_int, c.eta_frac + 8, signed=False)
        # Left column and top row of the ROI, with the fraction bits that the ROI update needs to be exact.
        self.roi_x, self.roi_y = (
            Q(bits_for(last), c.v_frac + c.roi_gain_frac, signed=False)
            for last in (c.geometry.roi_x_max, c.geometry.roi_y_max)
        )
        #: Fraction bits of an event's position when it is stored, and when it is dithered.
        self.event_frac = c.undistortion_frac if c.undistortion == "on" else 0
        self.dithered_frac = max(c.dither_frac, self.event_frac)
        #: How far a node of the table that undistorts moves an event: two bits more than the position has.
        self.node_x, self.node_y = (Q(bits, c.undistortion_frac + 2) for bits in (c.geometry.x_bits, c.geometry.y_bits))
        #: What an event moves by in half a batch, along either axis: v, and with a basis the terms that it has.
        motion = c.motion_model
        self.flow = Q(bits_for(motion.stretch << c.v_int), c.v_frac) if motion.basis else self.v
        # Warped position relative to the ROI, clamped to −2 … its size (whole pixels outside vote nowhere).
        self.position_x, self.position_y = (Q(bits_for(size), c.position_frac) for size in (c.roi_width, c.roi_height))
