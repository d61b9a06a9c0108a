"""Clock cycles of each batch."""

from types import SimpleNamespace

import numpy as np

from ...protocol.flags import Flag
from ...protocol.settings import BatchSettings
from ...rtl.core import Core
from ...rtl.regions.regions import Regions
from ...rtl.sliding.core import SlidingCore
from ...tracking.course import Replay


def hardware_cycles(kept):
    """Clock cycles of each batch.

    Returns
    -------
    cycles : float64 array [B]
        NaN for a degenerate batch.
    by_formula : bool
        The engine has no clock, so they are those that the cycle formula gives.
    """
    counted = kept.numbers("cycles")
    if not np.isnan(counted).all():
        return counted, False
    core = (SlidingCore if kept.config.slides else Regions if kept.config.regions else Core)(kept.config)
    return np.array([core.cycles(**size, iterations=plan) if plan else np.nan for size, plan in _batches(kept)]), True


def _batches(kept):
    """Of each batch its events, those in the ROI, and its schedule, empty if it is degenerate."""
    names = ("events", "roi_events", "iterations")
    unknown = {"thinned": 0, "overflow": 0}  # not in track.csv; they decide the thinning, which is not asked for here
    columns = [[int(number) for number in kept.numbers(name)] for name in names]
    replay, rule = Replay(kept.config), kept.config.ascent_rule
    warm = len(rule.plan(BatchSettings.from_config(kept.config), True))
    for *batch, flags in zip(*columns, kept.column("flags"), strict=True):
        result = SimpleNamespace(**dict(zip(names, batch, strict=True)), **unknown, flags=Flag.parse(flags))
        result.restarted = result.iterations != warm  # or it began cold for another reason
        plan, _ = replay.settings_of(result)
        yield {"events": result.events, "roi_events": result.roi_events}, plan
