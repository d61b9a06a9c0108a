"""What follows from a configuration's fields: sizes, fixed-point formats, and how long one pass takes."""

from ..fixed import Q, bits_for


class Geometry:
    """Sizes that follow from the sensor's and the ROI's, of a :class:`~cmfpga.config.Config`: whole numbers."""

    mask_pixels = 32  #: side by side in a word of the mask of hot pixels

    def __init__(self, config):
        width, height = self._roi = config.roi_width, config.roi_height
        self.pixels = width * height  #: P, of the ROI
        self.middle = width - 1, height - 1  #: column and row of the ROI's middle, in half pixels
        self.bank_columns = (width + 1) // 2  #: of one parity bank
        self.bank_rows = (height + 1) // 2
        self.bank_words = self.bank_columns * self.bank_rows  #: of one parity bank, that hold a pixel: P/4
        #: Address bits of a bank's column; the row stands above them, so that no multiplier is needed.
        self.bank_column_bits = bits_for(self.bank_columns - 1)
        rounds = config.ascent_rule.evaluations > 1
        #: Images that a round fills side by side; address bits that tell those apart that it fills in turn.
        self.images, self.turn_bits = (config.evaluators, 2 if config.evaluators == 1 else 0) if rounds else (1, 0)
        #: Words of one parity bank's memory, the unused ends of rows included, of all images that lie in it.
        self.bank_depth = self.bank_rows << self.bank_column_bits + self.turn_bits
        #: Of that memory: row, column, and whose turn it is.
        self.bank_address_bits = self.bank_column_bits + bits_for(self.bank_rows - 1) + self.turn_bits
        sensor = config.sensor_width, config.sensor_height
        self.sensor_x_bits, self.sensor_y_bits = (bits_for(side - 1) for side in sensor)  #: of a column, a row
        #: Columns and rows of the image behind the binning, in which ROI and v are; the sensor's without.
        self.size = self.width, self.height = tuple(-(-side >> config.binning) for side in sensor)
        self.roi_x_max = self.width - width  #: largest column of the ROI's left edge
        self.roi_y_max = self.height - height  #: largest row of its top edge
        self.x_bits, self.y_bits = (bits_for(side - 1) for side in self.size)  #: of a column, a row of that image
        self.mask_columns = -(-config.sensor_width // self.mask_pixels)  #: words of a row of the mask of hot pixels
        self.mask_column_bits = bits_for(self.mask_columns - 1)  #: the row stands above them
        self.mask_depth = config.sensor_height << self.mask_column_bits  #: words of the mask, those unused included
        cell = config.background_cell
        self.cell_columns, self.cell_rows = (-(-side >> cell) for side in sensor)
        self.cell_column_bits = bits_for(self.cell_columns - 1)  #: the row stands above them
        self.cell_depth = self.cell_rows << self.cell_column_bits  #: cells of the background's filter, as mask_depth
        step = config.undistortion_cell
        #: Nodes of the table that undistorts: one every 2^undistortion_cell px, in four banks by parity.
        self.node_columns, self.node_rows = (((side - 1) >> step) + 2 for side in self.size)
        self.node_column_bits = bits_for((self.node_columns - 1) >> 1)  #: of a bank; the row stands above them
        self.node_depth = ((self.node_rows + 1) >> 1) << self.node_column_bits  #: words of one bank

    def level_size(self, level):
        """Columns and rows of the image whose pixels are 2^level px wide."""
        return tuple(-(-size >> level) for size in self._roi)


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


class OnePass:
    """What follows from ``gradient="one_pass"`` in a :class:`~cmfpga.config.Config`."""

    def __init__(self, config):
        c, depth, rounds = config, config.geometry.bank_depth, config.ascent_rule.evaluations > 1
        warp, voter = 4 if c.max_level else 3, 3
        gradient = 4 if c.geometry.pixels & (c.geometry.pixels - 1) else 1
        sums = 5 + 4
        if rounds:  # four sums, one after the other, of four images a cycle later
            warp += 1 + (c.evaluators == 1)
            gradient, sums = gradient - 1, sums + c.geometry.images
        feed = 10 + 2 * (c.dither_frac > 0)
        if c.motion_model.basis:
            warp, gradient, sums = warp + 2, 0, sums + 2
        #: Cycles of an iteration beside its n events, in which no vote enters the banks: the latencies of warp, voter,
        #: banks, sums, gradient and ascent, less one; or where those from the banks on are shorter, of what is in front
        #: of the warp. A test holds them to those of the blocks.
        self.latency = warp + voter + max(sums + gradient + c.ascent_rule.latency(c), feed) - 1
        #: So many an iteration, or the sweep of the banks doesn't pass every word before its tag comes back.
        self.fewest_idle_cycles = -(-depth // ((1 << c.tag_bits) - 1))
        #: So many are enough for that in the cycles that are idle anyway.
        self.fewest_tag_bits = (-(-depth // self.latency)).bit_length()
