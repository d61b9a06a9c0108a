"""How well the motion is found, on batches whose motion is known and on real ones: ``python -m studies.accuracy``.

Rules that look at events, never at results, choose the batches. docs/accuracy.md tells what they show.

- :mod:`~.synthetic` and :mod:`~.real` make batches (:mod:`~.case`), :mod:`~.checkerboard` tracks a recording;
- :mod:`~.yardstick` searches the best contrast of a batch, :mod:`~.scores` measures an engine;
- :mod:`~.suites` and :mod:`~.studies` print the tables (:mod:`~.table`).
"""

from .command import EXAMPLES, main
from .suites import brief

__all__ = ["EXAMPLES", "brief", "main"]
