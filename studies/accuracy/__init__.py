"""How well the motion is found, on batches whose motion is known and on real ones: ``python -m studies.accuracy``.

Rules that look at events, never at results, choose the batches. docs/accuracy.md tells what they show.

- :mod:`~.synthetic` and :mod:`~.real` make batches, of which :mod:`~.yardstick` searches the best contrast;
- :mod:`~.table` measures an engine; :mod:`~.suites` and :mod:`~.studies` print the tables.
"""

from .command import EXAMPLES, main
from .suites import brief

__all__ = ["EXAMPLES", "brief", "main"]
