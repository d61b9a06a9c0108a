"""Blocks that take a batch in; what stands in front of the ROI filter, where the hardware has it."""

import itertools

from amaranth.lib.wiring import connect, flipped

from .binning import Binning
from .noise_filter import BackgroundFilter, HotMask
from .undistorter import Undistorter

#: Blocks with a table that is written at run time, and the core's member that fills it.
WRITES = {"hot_mask": "mask_write", "undistorter": "node_write"}


def make_front(config):
    """``{name: block}``, in the order in which events pass.

    The filters of noise know the sensor's own pixels: one hot pixel costs no neighbour, and two neighbours support one
    another. What undistorts comes after the binning, for its table is the smaller the fewer pixels there are.
    """
    there = {
        "hot_mask": (HotMask, config.hot_pixels),
        "background_filter": (BackgroundFilter, config.background),
        "binning": (Binning, config.binning),
        "undistorter": (Undistorter, config.undistortion == "on"),
    }
    return {name: make(config) for name, (make, wanted) in there.items() if wanted}


def write_ports(front):
    """The core's members that fill tables, by name."""
    return {write: front[name].signature.members["write"] for name, write in WRITES.items() if name in front}


def connect_front(m, core, source, sink, *, settings, start, clear):
    """From ``source`` to ``sink``; tables, and what is taken over or forgotten at ``start`` and ``clear``."""
    path = [source, *itertools.chain.from_iterable((block.i, block.o) for block in core.front.values()), sink]
    for one, following in zip(path[::2], path[1::2], strict=True):
        connect(m, one, following)
    for name, block in core.front.items():
        if name != "binning":
            m.d.comb += block.start.eq(start)
        if name in WRITES:
            connect(m, flipped(getattr(core, WRITES[name])), block.write)
    if "hot_mask" in core.front:
        m.d.comb += core.front["hot_mask"].enable.eq(settings.hot_mask)
    if "background_filter" in core.front:
        block = core.front["background_filter"]
        m.d.comb += [block.period.eq(settings.background_us), block.clear.eq(clear)]
    if "undistorter" in core.front:
        m.d.comb += core.front["undistorter"].enable.eq(settings.camera)
