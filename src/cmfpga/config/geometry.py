"""Sizes of sensor, ROI and banks."""

from ..fixed import bits_for


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
        self.roi_x_max = config.sensor_width - width  #: largest column of the ROI's left edge
        self.roi_y_max = config.sensor_height - height  #: largest row of its top edge
        self.x_bits = bits_for(config.sensor_width - 1)  #: of a sensor column
        self.y_bits = bits_for(config.sensor_height - 1)  #: of a sensor row
        self.mask_columns = -(-config.sensor_width // self.mask_pixels)  #: words of a row of the mask of hot pixels
        self.mask_column_bits = bits_for(self.mask_columns - 1)  #: the row stands above them
        self.mask_depth = config.sensor_height << self.mask_column_bits  #: words of the mask, those unused included
        cell = config.background_cell
        self.cell_columns, self.cell_rows = (-(-size >> cell) for size in (config.sensor_width, config.sensor_height))
        self.cell_column_bits = bits_for(self.cell_columns - 1)  #: the row stands above them
        self.cell_depth = self.cell_rows << self.cell_column_bits  #: cells of the background's filter, as mask_depth
        step = config.undistortion_cell
        #: Nodes of the table that undistorts: one every 2^undistortion_cell px, in four banks by parity.
        self.node_columns, self.node_rows = (
            ((size - 1) >> step) + 2 for size in (config.sensor_width, config.sensor_height)
        )
        self.node_column_bits = bits_for((self.node_columns - 1) >> 1)  #: of a bank; the row stands above them
        self.node_depth = ((self.node_rows + 1) >> 1) << self.node_column_bits  #: words of one bank

    def level_size(self, level):
        """Columns and rows of the image whose pixels are 2^level px wide."""
        return tuple(-(-size >> level) for size in self._roi)
