"""Dense optical flow of a recording, by the simulated hardware: ``cmfpga flow``.

- :mod:`~.tiles` makes the table of regions: a grid of tiles in two levels;
- :mod:`~.run` cuts the windows and measures them, :mod:`~.window` is one of them, :mod:`~.result` all;
- :mod:`~.fields` fits one motion to a field;
- :mod:`~.pictures` and :mod:`~.page` show them; :mod:`~.api` is the Python function.
"""

from ..api.flow import flow
from ..cli.flow import EXAMPLES, main
from .fields import MODELS, Field, fit_field
from ..api.flow_result import Flow
from .tiles import Tiles, grid
from .window import Window

__all__ = ["EXAMPLES", "MODELS", "Field", "Flow", "Tiles", "Window", "fit_field", "flow", "grid", "main"]
