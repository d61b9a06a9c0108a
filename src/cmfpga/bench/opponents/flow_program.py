"""Dense flow in C: the algorithm of the hardware with a table of regions, on one thread or several."""

import ctypes

import numpy as np

from .c_program import CProgram, JobOfC


class _Tile(ctypes.Structure):
    """``Tile`` of flow.c."""

    _fields_ = (
        [(name, ctypes.c_int32) for name in ("x", "y", "width", "height", "left", "top", "parent", "stride")]
        + [("iterations", ctypes.c_int32)]
        + [(name, ctypes.c_void_p) for name in ("levels", "strides", "steps")]
    )


class _Flow(ctypes.Structure):
    """``Flow`` of flow.c."""

    _fields_ = (
        [("window", JobOfC)]
        + [(name, ctypes.c_int32) for name in ("sensor_width", "sensor_height", "bin_bits", "most")]
        + [(name, ctypes.c_int32) for name in ("tiles", "coarse", "threads")]
        + [(name, ctypes.c_void_p) for name in ("tile", "v", "probes")]
    )


class FlowProgram(CProgram):
    """flow.c, compiled; raises :exc:`~.c_program.Unavailable` as :class:`~.c_program.CProgram` does."""

    def __init__(self):
        super().__init__("flow", includes=("gather.c",), options=("-pthread",))

    def load_window(self, config, regions, events, settings, threads):
        """A function of a count that measures a window so often, and returns v of each region: float64 [regions, 2].

        Parameters
        ----------
        config : Config
        regions : sequence of Region
            First those without a parent, then those with one.
        events : Events
        settings : BatchSettings
            The schedules; v starts at 0.
        threads : int
            1 to 64.
        """
        keep = [np.ascontiguousarray(axis) for axis in (events.t, events.x, events.y)]
        plans = {name: _plan(getattr(settings, name), keep) for name in ("cold", "warm")}
        tiles, coarse = (_Tile * len(regions))(), 0
        for region, tile in zip(regions, tiles, strict=True):
            child = region.start == "parent"
            coarse += not child
            count, *pointers = plans["warm" if child else "cold"]
            place = region.x, region.y, region.width, region.height, *region.corner(config)
            parent = region.parent if child else -1
            for (name, _), value in zip(_Tile._fields_, (*place, parent, region.stride, count, *pointers), strict=True):
                setattr(tile, name, value)
        v, probes = np.zeros((len(regions), 2)), np.zeros((len(regions), 8))
        window = JobOfC(*(axis.ctypes.data for axis in keep[:3]), len(events))
        window.width, window.height, window.dither, window.probes = config.roi_width, config.roi_height, 1, 1
        flow = _Flow(
            window, config.sensor_width, config.sensor_height, config.bin_bits, config.buffer_events, len(regions),
            coarse, threads, ctypes.addressof(tiles), v.ctypes.data, probes.ctypes.data,
        )  # fmt: skip

        def run(count=1, keep=(keep, tiles, probes)):
            if not self.library.run_flow(ctypes.byref(flow), ctypes.c_int64(count)):
                raise MemoryError(f"no memory for a window of {len(events)} events on {threads} threads")
            return v

        return run


def _plan(schedule, keep):
    """Length and pointers of a schedule; the arrays are kept."""
    levels = np.array([entry.level for entry in schedule], np.int32)
    strides = np.array([entry.stride for entry in schedule], np.int32)
    steps = np.array([2.0**entry.log2_step for entry in schedule], np.float64)
    keep += [levels, strides, steps]
    return len(schedule), levels.ctypes.data, strides.ctypes.data, steps.ctypes.data
