"""Where batches are cropped: the ROI that follows v, in the integer model's numbers or in the float reference's."""

from ..fixed import saturate


def move_within(position, step, limits):
    """``position + step``, each axis limited to 0 … limit; and whether a limit was met."""
    target = tuple(p + s for p, s in zip(position, step, strict=True))
    moved = tuple(saturate(p, 0 * limit, limit) for p, limit in zip(target, limits, strict=True))
    return moved, moved != target


class RoiFollower:
    """The ROI's position between batches (Eq. roi_update), as :mod:`cmfpga.rtl.ascent.roi_updater` keeps it.

    With one event buffer a batch is cropped where the position is. With two, it is cropped before the move of the
    batch ahead of it is known: where the position would be if the last known move were repeated.

    Parameters
    ----------
    config : Config
        Sensor and ROI size, ``buffers``.
    pixel : int or float
        One pixel in the unit of positions: a power of two for raw integers, 1.0 for px.

    Attributes
    ----------
    position : pair of numbers
        Left edge and top edge of the ROI.
    """

    def __init__(self, config, pixel):
        self.buffers = config.buffers
        self.limits = (config.geometry.roi_x_max * pixel, config.geometry.roi_y_max * pixel)
        self.pixel = pixel
        self.position = (0 * pixel, 0 * pixel)
        self._still = self.position
        self._last_step = self._still  # the move that led to the position
        self._coming_step = None  # with two buffers: the last batch's, which follows when the next batch is cropped

    def crop(self, roi=None):
        """Corner of the batch that begins, px, and whether it was limited to the sensor; ``roi`` loads another."""
        if roi is not None:
            wanted = tuple(axis * self.pixel for axis in roi)
            self.position, limited = move_within(wanted, self._still, self.limits)
            self._last_step = self._coming_step = self._still
            return self._corner(self.position), limited
        position, limited = self._next()
        if self._coming_step is not None:
            self.position, _ = move_within(self.position, self._coming_step, self.limits)
            self._last_step = self._coming_step
        return self._corner(position), limited

    def move(self, step):
        """Follow by ``step``, None for a batch that measured nothing; whether the sensor limited that at once."""
        if self.buffers == 2:
            self._coming_step = self._still if step is None else step
            return False
        if step is None:
            return False
        self.position, limited = move_within(self.position, step, self.limits)
        return limited

    @property
    def next_corner(self):
        """Corner of the next batch, px, unless it loads another."""
        return self._corner(self._next()[0])

    def _next(self):
        if self.buffers == 1:
            return self.position, False
        return move_within(self.position, self._last_step, self.limits)

    def _corner(self, position):
        return tuple(int((p + self.pixel / 2) // self.pixel) for p in position)
