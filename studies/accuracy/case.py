"""A batch, and what is known about it."""

from dataclasses import dataclass
from functools import cached_property

from cmfpga.config import preset
from cmfpga.events import Events
from cmfpga.imaging.iwe import scaled_roi_events

from .yardstick import best_contrast


@dataclass(frozen=True, eq=False)
class Case:
    """A batch, and what is known about it.

    Parameters
    ----------
    events : Events
        All events of the batch.
    roi : pair of int
        Left column and top row, px.
    truth : (float, float) or None
        True velocity, px per half batch.
    start : (float, float) or None
        Where the warm suite starts, px per half batch.
    facts : dict
        What the batch is made of, by name.
    """

    events: Events
    roi: tuple[int, int]
    truth: tuple[float, float] | None
    start: tuple[float, float] | None
    facts: dict

    @cached_property
    def scaled(self):
        """Columns and rows in the ROI, and dt, of all of the ROI's events: no buffer drops any."""
        return scaled_roi_events(preset("paper").replace(buffer_events=1 << 14), self.events, self.roi)

    @cached_property
    def best(self):
        """``(v, contrast)`` that a fine search finds, with events spread over their pixels."""
        return best_contrast(*self.scaled)

    @cached_property
    def best_unspread(self):
        """The same by the article's contrast."""
        return best_contrast(*self.scaled, spread=False)
