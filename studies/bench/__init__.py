"""The core's clock cycles beside the time that programs need for the same work: ``python -m studies.bench``.

:mod:`~.cases` makes what is measured; :mod:`~.cycles` measures the core, :mod:`~.programs` the :mod:`~.opponents`;
:mod:`~.table` makes the text of the numbers.
"""

from .command import EXAMPLES, main

__all__ = ["EXAMPLES", "main"]
