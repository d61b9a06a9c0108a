"""The hardware itself, cycle by cycle, as an engine."""

import os
import shlex
import shutil
from abc import abstractmethod

import numpy as np

from ..protocol.batch import BatchResult, Flag, Trace
from .base import Engine

COMPILERS = ("c++", "g++", "clang++")


def find_compiler():
    """The command of a C++ compiler, as a shell takes it: ``$CXX``, or the first of :data:`COMPILERS`; None without.

    Whether it works is found out by using it.
    """
    given = os.environ.get("CXX", "").strip()
    return given or next((shlex.quote(path) for path in map(shutil.which, COMPILERS) if path), None)


def make_rtl_engine(config):
    """The emitted Verilog compiled by Verilator, or Amaranth's simulator where there is no C++ compiler that works."""
    why = "no C++ compiler found"
    if find_compiler():
        from ..verilog.compile import CompilerError
        from .verilated import VerilatedEngine

        try:
            return VerilatedEngine(config)
        except CompilerError as error:
            why = str(error)
    from .amaranth_sim import AmaranthEngine

    return AmaranthEngine(config, why)


def settings_values(config, settings):
    """The hardware's settings inputs, by the names of :func:`cmfpga.rtl.payloads.settings`."""
    x, y = settings.roi or (0, 0)
    plans = {}
    if config.ascent == "sign":
        plans = {
            "cold_first": 0,
            "cold_count": len(settings.cold),
            "warm_first": len(settings.cold) % config.schedule_entries,
            "warm_count": len(settings.warm),
        }
    return plans | {
        "roi_load": int(settings.roi is not None),
        "roi_x": x,
        "roi_y": y,
        "batch_events": 0,  # batches end with an event that is marked as the last
        "batch_roi_events": 0,
        "thinning": settings.thinning,
        "thin_target": settings.thin_target,
        "iterations": settings.iterations,
        "eta": settings.eta,
        "roi_gain": settings.roi_gain,
        "start_last": int(settings.start_last),
        "v_start_x": settings.v_start[0],
        "v_start_y": settings.v_start[1],
        "min_roi_events": settings.min_roi_events,
    }


def schedule_table(config, settings):
    """The table of schedules, cold then warm: tuple of (level, shift), as :func:`settings_values` points at it."""
    return tuple((entry.level, entry.log2_step + config.formats.v.f) for entry in (*settings.cold, *settings.warm))


class RtlEngine(Engine):
    """Common part of the engines that have a clock.

    Attributes
    ----------
    ports : dict of str to int
        Result ports of the last batch, by name without ``result_``.
    core : Core or VerilogCore
        Knows how many cycles a batch takes.
    """

    name = "rtl"

    def __init__(self, config):
        super().__init__(config)
        self._v = (0.0, 0.0)
        self.ports = {}

    @property
    def v(self):
        return self._v

    def _run(self, events, settings):
        result, trace = self._simulate(events, settings)
        self.ports = result
        batch = to_batch_result(self.config, result, trace)
        self._v = batch.v
        return batch

    @abstractmethod
    def _simulate(self, events, settings):
        """``(result, trace)``: the result ports by name (without ``result_``); int64 [T, 7] trace ports."""


def to_batch_result(config, result, trace):
    """A :class:`BatchResult` of raw port values."""
    v = (result["v_x"], result["v_y"])
    return BatchResult(
        **{
            name: result[name]
            for name in ("events", "roi_events", "outside", "overflow", "thinned", "time_back", "time_span")
        },
        span=result["span"],
        roi=(result["roi_x"], result["roi_y"]),
        roi_next=(result["roi_next_x"], result["roi_next_y"]),
        v=(config.formats.v.real(v[0]), config.formats.v.real(v[1])),
        iterations=result["iterations"],
        flags=Flag(result["flags"]),
        trace=Trace(v=np.vstack([trace[:, :2], [v]]), sum_i=trace[:, 2], sum_d=trace[:, 3:5], s=trace[:, 5:7]),
        cycles=result["cycles"],
    )
