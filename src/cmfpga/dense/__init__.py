"""Dense optical flow of a recording, tile by tile: many regions of one accelerator.

- :mod:`~.tiles` makes the table of regions: a grid of tiles in two levels;
- :mod:`~.window` cuts the windows and measures them;
- :mod:`~.fields` fits one motion to a field.

:mod:`cmfpga.api.flow` is the Python function, :mod:`cmfpga.show.flow` shows what it found.
"""

from .fields import MODELS, Field, fit_field
from .tiles import Tiles, grid
from .window import Window

__all__ = ["MODELS", "Field", "Tiles", "Window", "fit_field", "grid"]
