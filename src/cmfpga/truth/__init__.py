"""What is known of a recording's motion, and how right what was found is by that."""

from .accuracy import REACH_S, WRONG_PX, Accuracy
from .known import FIELD, Known, of_pieces, read_known
from .pieces import Truth, read_truth, sidecar

__all__ = [
    "FIELD", "REACH_S", "WRONG_PX", "Accuracy", "Known", "Truth", "of_pieces", "read_known", "read_truth", "sidecar",
]  # fmt: skip
