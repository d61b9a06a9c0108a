"""Sizes of sensor, ROI and banks."""

from ..fixed import bits_for
from .derived import Derived


class Geometry(Derived):
    """Sizes that follow from the sensor's and the ROI's."""

    def level_size(self, level):
        """Columns and rows of the image whose pixels are 2^level px wide."""
        return -(-self._c.roi_width // (1 << level)), -(-self._c.roi_height // (1 << level))

    @property
    def pixels(self):
        """P, the ROI's number of pixels."""
        return self._c.roi_width * self._c.roi_height

    @property
    def bank_columns(self):
        """Columns of one parity bank."""
        return (self._c.roi_width + 1) // 2

    @property
    def bank_rows(self):
        """Rows of one parity bank."""
        return (self._c.roi_height + 1) // 2

    @property
    def bank_words(self):
        """Words of one parity bank that hold a pixel: P/4."""
        return self.bank_columns * self.bank_rows

    @property
    def bank_column_bits(self):
        """Address bits of a bank's column; the row stands above them, so that no multiplier is needed."""
        return bits_for(self.bank_columns - 1)

    @property
    def bank_depth(self):
        """Words of one parity bank's memory, the unused ends of rows included."""
        return self.bank_rows << self.bank_column_bits

    @property
    def roi_x_max(self):
        """Largest column of the ROI's left edge."""
        return self._c.sensor_width - self._c.roi_width

    @property
    def roi_y_max(self):
        """Largest row of the ROI's top edge."""
        return self._c.sensor_height - self._c.roi_height

    @property
    def x_bits(self):
        """Bits of a sensor column."""
        return bits_for(self._c.sensor_width - 1)

    @property
    def y_bits(self):
        """Bits of a sensor row."""
        return bits_for(self._c.sensor_height - 1)
