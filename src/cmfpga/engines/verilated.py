"""The emitted Verilog in Verilator: its compiled library, driven from here."""

import ctypes

import numpy as np

from ..protocol.settings import schedule_table, settings_values
from ..rtl.top import VerilogCore
from ..verilog.compile import compile_library, is_sound, load, port_names
from ..verilog.emit import cache_folder
from .rtl import RtlEngine


class _Run(ctypes.Structure):
    """``struct Run`` of harness.cpp."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name in ("settings", "t", "x", "y", "gaps")]
        + [(name, ctypes.c_int64) for name in ("events", "open_end", "result_stall", "max_cycles")]
        + [("result", ctypes.c_void_p), ("trace", ctypes.c_void_p), ("trace_rows", ctypes.c_int64)]
        + [("pixels", ctypes.c_void_p), ("pixel_rows", ctypes.c_int64)]
        + [(name, ctypes.c_int64) for name in ("accepted", "trace_count", "pixel_count", "cycles")]
    )


class _Stream(ctypes.Structure):
    """``struct Stream`` of harness.cpp."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name in ("settings", "t", "x", "y", "ends", "gaps", "stalls")]
        + [(name, ctypes.c_int64) for name in ("batches", "max_cycles")]
        + [(name, ctypes.c_void_p) for name in ("results", "offered", "valid", "trace")]
        + [(name, ctypes.c_int64) for name in ("trace_rows", "trace_count", "results_count")]
    )


class VerilatedCore:
    """One simulated core, driven batch by batch.

    Parameters
    ----------
    config : Config
        Hardware fields choose the library; it is compiled on first use and kept in the user's cache.
    seed : int
        Of the random contents that memories and reset-less registers start with.
    core : VerilogCore, optional
        The core of this configuration, where it has further outputs, such as :class:`cmfpga.tracking.wave.WaveCore`.
    """

    def __init__(self, config, *, seed=1, core=None):
        core, library = _core_and_library(config) if core is None else (core, compile_library(core))
        self.config = config
        self.core = core
        self.settings_names = port_names(core.inputs, "settings_")
        self.result_names = port_names(core.outputs, "result_")
        self.trace_names = port_names(core.outputs, "trace_", but="trace_pixels")
        self.pixel_names = port_names(core.outputs, "trace_pixels_")
        self._library = load(library)
        self._library.core_new.restype = ctypes.c_void_p
        self._library.core_wave_count.restype = ctypes.c_int64
        self._handle = ctypes.c_void_p(self._library.core_new(seed))
        self._table = ()
        self.reset()

    def reset(self, cycles=2):
        """Hold the core's reset for some clock cycles."""
        self._library.core_reset(self._open(), ctypes.c_int64(cycles))

    def _open(self):
        if not self._handle:
            raise ValueError("the simulated core is closed")
        return self._handle

    def write_schedule(self, table):
        """Fill the table of schedules with (level, shift, stride), from address 0 on; between batches only."""
        if table == self._table:
            return
        self._table = table
        rows = np.array(table, np.int64).reshape(-1, 3)
        self._library.core_write_schedule(self._open(), ctypes.c_void_p(rows.ctypes.data), ctypes.c_int64(len(rows)))

    def start_waves(self):
        """Record the outputs whose names begin with ``wave_``, from the next clock cycle on."""
        self._library.core_wave_start(self._open())

    def take_waves(self):
        """``(cycles, ports, values)`` of what changed since :meth:`start_waves`: int32, int32, int64 arrays.

        Cycles are counted from 0; ``ports`` are numbers of the ``wave_`` outputs, all of which change in cycle 0.
        """
        count = self._library.core_wave_count(self._open())
        cycles, ports, values = np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros(count, np.int64)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (cycles, ports, values)]
        self._library.core_wave_take(self._open(), *pointers)
        return cycles, ports, values

    def close(self):
        """Free the simulation. Safe to call twice."""
        if self._handle:
            self._library.core_free(self._handle)
            self._handle = None

    def __del__(self):
        if getattr(self, "_handle", None):
            self.close()

    def run(self, t, x, y, settings, *, gaps=None, result_stall=0, open_end=False, keep_pixels=False, max_cycles=None):
        """One batch.

        Parameters
        ----------
        t, x, y : int64 arrays [N]
            Events.
        settings : dict of str to int
            Settings inputs by name, all of them.
        gaps : int array [N], optional
            Idle cycles before each event is offered.
        result_stall : int
            Clock cycles for which the result is left waiting.
        open_end : bool
            Do not mark the last event: the core must end the batch by itself.
        keep_pixels : bool
            Return what every sweep read.
        max_cycles : int, optional
            Give up after these; by default twice what the batch can take.

        Returns
        -------
        result : dict of str to int
            Result ports, and ``measured_cycles`` and ``accepted`` (events taken) as the test bench counted them.
        trace : int64 array [T, 7]
            The trace ports of every iteration, in the order of ``trace_names``.
        pixels : int64 array [T, P/4, 12], or None
            I, Dx, Dy of banks 0 to 3 in the order of the sweep.
        """
        inputs = [np.ascontiguousarray(a, np.int64) for a in (t, x, y)]
        row = np.array([settings[name] for name in self.settings_names], np.int64)
        waits = None if gaps is None else np.ascontiguousarray(gaps, np.int64)
        iterations = max(int(settings.get(name, 0)) for name in ("iterations", "cold_count", "warm_count"))
        words = self.config.geometry.bank_words
        if max_cycles is None:
            max_cycles = 2 * self.core.cycles(events=len(inputs[0]), roi_events=len(inputs[0]), iterations=iterations)
            max_cycles += 2 * words + result_stall + (0 if waits is None else int(waits.sum())) + 1000
        result = np.zeros(len(self.result_names), np.int64)
        trace = np.zeros((max(1, iterations), len(self.trace_names)), np.int64)
        pixels = np.zeros((max(1, iterations) * words, len(self.pixel_names)), np.int64) if keep_pixels else None
        run = _Run(
            settings=row.ctypes.data,
            t=inputs[0].ctypes.data,
            x=inputs[1].ctypes.data,
            y=inputs[2].ctypes.data,
            gaps=None if waits is None else waits.ctypes.data,
            events=len(inputs[0]),
            open_end=int(open_end),
            result_stall=result_stall,
            max_cycles=max_cycles,
            result=result.ctypes.data,
            trace=trace.ctypes.data,
            trace_rows=len(trace),
            pixels=None if pixels is None else pixels.ctypes.data,
            pixel_rows=0 if pixels is None else len(pixels),
        )
        status = self._library.core_run(self._open(), ctypes.byref(run))
        if status == 1:
            raise TimeoutError(
                f"no result after {max_cycles} clock cycles: {run.accepted} of {run.events} events accepted, "
                f"{run.trace_count} of {iterations} iterations seen"
            )
        if status == 2:
            raise AssertionError("the result changed while it was waiting to be taken")
        values = dict(zip(self.result_names, result.tolist(), strict=True))
        values |= {"measured_cycles": run.cycles, "accepted": run.accepted}
        if run.trace_count != values["iterations"]:
            raise AssertionError(f"{run.trace_count} iterations traced, {values['iterations']} reported")
        trace = trace[: run.trace_count]
        if pixels is not None:
            pixels = pixels[: run.pixel_count].reshape(run.trace_count, words, len(self.pixel_names))
        return values, trace, pixels

    def stream(self, batches, settings, *, gaps=None, stalls=None):
        """Several batches without a pause between them: the next one is offered while results are awaited.

        Parameters
        ----------
        batches : list of (t, x, y)
            Events; at least one per batch.
        settings : list of dict
            Settings inputs of each batch.
        gaps : int array, optional
            Idle cycles before each event of all batches.
        stalls : list of int, optional
            Clock cycles for which each result is left waiting.

        Returns
        -------
        results : list of dict
            Result ports of each batch; ``offered`` and ``valid`` are the cycles of its first offer and its result.
        traces : list of int64 arrays [T, 7]
        """
        t, x, y = (np.ascontiguousarray(np.concatenate(axis), np.int64) for axis in zip(*batches, strict=True))
        ends = np.cumsum([len(batch[0]) for batch in batches])
        rows = np.array([[row[name] for name in self.settings_names] for row in settings], np.int64)
        waits = None if gaps is None else np.ascontiguousarray(gaps, np.int64)
        delays = np.array(stalls if stalls is not None else [0] * len(batches), np.int64)
        plans = [max(int(row.get(name, 0)) for name in ("iterations", "cold_count", "warm_count")) for row in settings]
        longest = sum(
            self.core.cycles(events=len(batch[0]), roi_events=len(batch[0]), iterations=plan)
            for batch, plan in zip(batches, plans, strict=True)
        )
        spare = int(delays.sum()) + (0 if waits is None else int(waits.sum())) + 2 * self.config.geometry.bank_depth
        results = np.zeros((len(batches), len(self.result_names)), np.int64)
        offered, valid = np.zeros((2, len(batches)), np.int64)
        trace = np.zeros((max(1, sum(plans)), len(self.trace_names)), np.int64)
        run = _Stream(
            settings=rows.ctypes.data,
            t=t.ctypes.data,
            x=x.ctypes.data,
            y=y.ctypes.data,
            ends=ends.ctypes.data,
            gaps=None if waits is None else waits.ctypes.data,
            stalls=delays.ctypes.data,
            batches=len(batches),
            max_cycles=2 * longest + spare + 1000 * len(batches),
            results=results.ctypes.data,
            offered=offered.ctypes.data,
            valid=valid.ctypes.data,
            trace=trace.ctypes.data,
            trace_rows=len(trace),
        )
        status = self._library.core_stream(self._open(), ctypes.byref(run))
        if status == 1:
            raise TimeoutError(f"{run.results_count} of {len(batches)} results after {run.max_cycles} clock cycles")
        if status == 2:
            raise AssertionError("a result changed while it was waiting to be taken")
        values = [dict(zip(self.result_names, row, strict=True)) for row in results.tolist()]
        for row, first, last in zip(values, offered.tolist(), valid.tolist(), strict=True):
            row |= {"offered": first, "valid": last}
        cuts = np.cumsum([row["iterations"] for row in values])
        if run.trace_count != cuts[-1]:
            raise AssertionError(f"{run.trace_count} iterations traced, {cuts[-1]} reported")
        return values, np.split(trace[: run.trace_count], cuts[:-1])


class VerilatedEngine(RtlEngine):
    """Runs the emitted Verilog in Verilator."""

    def __init__(self, config):
        super().__init__(config)
        self._core = VerilatedCore(config)

    @property
    def core(self):
        return self._core.core

    def _simulate(self, events, settings):
        values = settings_values(self.config, settings)
        self._core.write_schedule(schedule_table(self.config, settings))
        result, trace, _ = self._core.run(events.t, events.x, events.y, values)
        return result, trace

    def close(self):
        self._core.close()


_known = {}  # what _core_and_library has returned to this process


def _core_and_library(config):
    """The :class:`VerilogCore` of a hardware, and its library; once a process, for emitting alone takes seconds."""
    key = config.hardware_hash, cache_folder()
    if key not in _known or not is_sound(_known[key][1]):
        core = VerilogCore(config)
        _known[key] = core, compile_library(core)
    return _known[key]
