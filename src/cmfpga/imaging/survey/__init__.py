"""What a recording holds, and an ROI and batches that suit it: for ``info`` and ``track --roi auto``. NumPy only.

A batch is measured best where the image moves by 3 to 5 px per half batch; below 1 px every method scatters. So, where
many events are (:mod:`~.statistics`), the motion is estimated in a window of time (:mod:`~.proposal`). The window is
made longer or shorter until the image moves by 4 px per half of it, and the next windows must confirm the velocity.
"""

from .proposal import ALLOWED_PX, Proposal, estimate, propose, require, survey_and_propose
from .statistics import Survey, hot_mask, survey_all, usual_survey, without_hot_pixels

__all__ = [
    "ALLOWED_PX", "Proposal", "Survey", "estimate", "hot_mask", "propose", "require", "survey_all",
    "survey_and_propose", "usual_survey", "without_hot_pixels",
]  # fmt: skip
