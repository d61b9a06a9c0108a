"""Clock cycles of each batch, and with lanes what they go to."""

from types import SimpleNamespace

import numpy as np

from ...config.schedule import used_events
from ...protocol.flags import Flag
from ...protocol.settings import BatchSettings
from ...rtl.core import Core
from ...rtl.regions.regions import Regions
from ...tracking.replay import Replay

#: What the cycles after a batch's last event go to, with lanes.
PARTS = (
    "votes of the lanes",
    "waits of votes for one bank",
    "probes of v's confidence",
    "ways through the pipeline",
)


def hardware_cycles(kept):
    """Clock cycles of each batch, and what they go to.

    Returns
    -------
    cycles : float64 array [B]
        NaN for a degenerate batch.
    by_formula : bool
        The engine has no clock, so they are those that the cycle formula gives; with lanes the most that it allows.
    parts : dict
        Of those behind the last event, cycles by :data:`PARTS`, float64 [B] each, NaN for a degenerate batch. Empty
        with one lane, which never waits, and by the formula, which does not know how long votes wait.
    """
    counted = kept.numbers("cycles")
    by_formula, lanes = bool(np.isnan(counted).all()), kept.config.lanes
    if not by_formula and lanes == 1:
        return counted, False, {}
    cycles, parts = [], []
    core = (Regions if kept.config.regions else Core)(kept.config)
    for total, (size, plan) in zip(counted, _batches(kept), strict=True):
        if by_formula:
            total = core.cycles(**size, iterations=plan, most=True) if plan else np.nan
        cycles.append(total)
        if not by_formula:
            parts.append(_parts(core, size, plan, total) if plan else [np.nan] * len(PARTS))
    found = {} if by_formula else dict(zip(PARTS, np.array(parts, np.float64).T, strict=True))
    return np.array(cycles), by_formula, found


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


def _parts(core, size, plan, total):
    """Cycles by :data:`PARTS` of a batch that took ``total``."""
    ascent, least = (core.cycles(**size, iterations=plan, judge=judge) for judge in (0, None))
    votes = sum(-(-n // core.config.lanes) for n in used_events(plan, size["roi_events"]))
    taken = max(size["events"], core.shortest_batch)
    return votes, total - least, least - ascent, ascent - taken - votes
