"""The driver of an accelerator with a table of regions: a small one, what is sent to it, and what must come back."""

import dataclasses

import numpy as np

from cmfpga.events import Events
from cmfpga.protocol.regions import Region
from cmfpga.protocol.results import counts_of
from support.regions import CONFIGS

CONFIG = CONFIGS["two units"].replace(regions=5, undistortion="on", camera="36,35,18.3,16.8,-0.3,0.1,0,0,0")
TABLE = [
    Region(x=4, y=4, width=12, height=10, start="last", moves=True),
    Region(x=20, y=10, width=16, height=12),
    Region(x=22, y=12, width=8, height=8, start="parent", parent=1),
]


def events_of(window):
    return Events(*window, np.arange(len(window[0])) % 2)


def clouds(rng, count=120, t0=0):
    """Two clouds of points that move, where :data:`TABLE` looks."""
    t = t0 + np.sort(rng.integers(0, 1000, count))
    phase = 4 * ((t - t0) / 1000 - 0.5)
    which = np.arange(count) % 2
    x = np.where(which, 27 + phase, 9 - phase) + rng.integers(-3, 4, count)
    y = np.where(which, 15, 8) + rng.integers(-2, 3, count)
    return t, np.round(x).clip(0, 39).astype(int), y.clip(0, 29)


def same(result, wanted):
    """All outcomes and all that is known of the batch are equal; each event is counted once in every region."""
    found = [dataclasses.replace(region, cycles=None) for region in result.regions]
    assert found == [dataclasses.replace(region, trace=None) for region in wanted.regions]  # a packet has no trace
    for name in ("t_first", "span", "events", "time_back", "time_span"):
        assert getattr(result, name) == getattr(wanted, name), name
    for region in result.regions:
        counts = {**vars(result), **vars(region)}
        assert result.events == sum(counts[name] for name in counts_of(CONFIG))
