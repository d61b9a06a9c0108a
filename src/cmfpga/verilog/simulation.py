"""The emitted Verilog of a core, or of a table of regions, in Verilator: its compiled library, driven from here."""

import ctypes
import dataclasses
import weakref

import numpy as np

from ..imaging.camera import node_writes
from ..protocol.regions import RegionTable
from ..protocol.settings import PLANS, schedule_table, settings_values
from ..protocol.tables import mask_writes
from ..protocol.trace import to_batch_result
from ..rtl.top import verilog_top
from .compile import TABLES, compile_library, is_sound, load, port_names, trace_prefixes
from .emit import cache_folder

#: The members of ``struct Run`` of harness.cpp, in order.
ARRAYS = ("settings", "t", "x", "y", "ends", "gaps", "stalls", "results", "offered", "valid", "trace", "pixels")
NUMBERS = ("batches", "outcomes", "open_end", "max_cycles", "trace_rows", "pixel_rows")
RETURNED = ("accepted", "trace_count", "pixel_count", "results_count")

TIMED_OUT, RESULT_CHANGED = 1, 2


class _Run(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ARRAYS]
    _fields_ += [(name, ctypes.c_int64) for name in (*NUMBERS, *RETURNED)]


def _pointer(array):
    return None if array is None else ctypes.c_void_p(array.ctypes.data)


def _zeros(*shape):
    return np.zeros(shape, np.int64)


class VerilatedCore:
    """One simulated core, driven batch by batch.

    Hardware fields of ``config`` choose the library, which is compiled on first use and kept in the user's cache.
    Memories and reset-less registers start with random contents from ``seed``. ``core`` is the core of this
    configuration where it has further outputs, such as :class:`cmfpga.show.wave.WaveCore`.

    Attributes
    ----------
    table : RegionTable or None
    offered, finished : list of int
        Of the batches of the last :meth:`results`: the clock cycle of the first event's offer, and of the last result.
    """

    def __init__(self, config, *, seed=1, core=None):
        core, library = _core_and_library(config) if core is None else (core, compile_library(core))
        self.config = config
        self.core = core
        self.settings_names = port_names(core.inputs, "settings_")
        self.result_names = port_names(core.outputs, "result_")
        self.trace_names = port_names(core.outputs, trace_prefixes(core)[0], but="trace_pixels")
        self.pixel_names = port_names(core.outputs, "trace_pixels_")
        self._library = load(library)
        self._library.core_new.restype = ctypes.c_void_p
        self._library.core_wave_count.restype = ctypes.c_int64
        self._handle = ctypes.c_void_p(self._library.core_new(seed))
        self._free = weakref.finalize(self, self._library.core_free, self._handle)
        self._written = {"schedule": ()}  # what the tables hold
        self.table = RegionTable(config) if config.regions else None
        self.offered, self.finished = [], []
        self.reset()

    def reset(self, cycles=2):
        """Hold the core's reset for some clock cycles."""
        self._library.core_reset(self._open(), ctypes.c_int64(cycles))
        if self.table:
            self.table.forget()

    def _open(self):
        if not self._free.alive:
            raise ValueError("the simulated core is closed")
        return self._handle

    def write_schedule(self, table):
        """Fill the table of schedules with (level, shift, stride), from address 0 on; between batches only."""
        if self._is_new("schedule", table):
            self._write("schedule", [(address, *row) for address, row in enumerate(table)])

    def write_tables(self, settings):
        """Fill all tables as a batch with these :class:`BatchSettings` needs them; between batches only."""
        schedule = schedule_table(self.config, settings)
        if self.table:
            rows, schedule = self.table.changes(settings)
            if rows:
                self._write("row", rows)
        self.write_schedule(tuple(schedule))
        marked = self._written.get("mask")
        if settings.hot_mask and self._is_new("mask", settings.hot_mask):
            self._write("mask", mask_writes(self.config, settings.hot_mask, marked))
        if settings.camera and self._is_new("node", settings.camera):
            self._write("node", node_writes(self.config, settings.camera))

    def _is_new(self, table, content):
        self._open()
        before, self._written[table] = self._written.get(table), content
        return content != before

    def _write(self, table, rows):
        rows = np.array(rows, np.int64)
        number, width = TABLES.index(table), rows.size // max(1, len(rows))
        sizes = ctypes.c_int64(width), ctypes.c_int64(len(rows))
        self._library.core_write_table(self._open(), number, _pointer(rows), *sizes)

    def start_waves(self):
        """Record the outputs whose names begin with ``wave_``, from the next clock cycle on."""
        self._library.core_wave_start(self._open())

    def take_waves(self):
        """``(cycles, ports, values)`` of what changed since :meth:`start_waves`: int32, int32, int64 arrays.

        Cycles are counted from 0; ``ports`` are numbers of the ``wave_`` outputs, all of which change in cycle 0.
        """
        count = self._library.core_wave_count(self._open())
        (cycles, ports), values = np.zeros((2, count), np.int32), _zeros(count)
        self._library.core_wave_take(self._open(), _pointer(cycles), _pointer(ports), _pointer(values))
        return cycles, ports, values

    def close(self):
        """Free the simulation. Safe to call twice."""
        self._free()

    def play(
        self, batches, settings, *, gaps=None, stalls=None, open_end=False, keep_pixels=False, max_cycles=None
    ):  # fmt: skip
        """Batches without a pause between them: the next one is offered while results are awaited.

        ``batches`` are (t, x, y), int64 arrays, of one event or more each; ``settings`` has of each all settings inputs
        by name. ``gaps`` are idle cycles before each event of all batches is offered, ``stalls`` those for which each
        result is left waiting. With ``open_end`` no last event is marked: the core must end each batch. It gives up
        after ``max_cycles``, by default twice what the batches can take one after the other.

        Returns
        -------
        results : list of dict of str to int
            Result ports of each batch; ``offered`` and ``valid``, the cycles of its first offer and its result, and
            ``accepted`` (events taken), as the test bench counted them.
        traces : list of int64 arrays [T, 7]
            Of each batch the trace ports of every iteration, or evaluation, in the order of ``trace_names``.
        pixels : int64 array [T, P/4, 12], or None without ``keep_pixels``
            What every sweep read: I, Dx, Dy of banks 0 to 3 in the order of the sweep, of all batches.
        """
        plans = [max(int(row.get(name, 0)) for name in ("iterations", "cold_count", "warm_count")) for row in settings]
        stalls = [0] * len(batches) if stalls is None else stalls
        if max_cycles is None:
            max_cycles = self._patience(gaps, stalls)
            for (t, _, _), plan in zip(batches, plans, strict=True):
                max_cycles += 2 * self.core.cycles(events=len(t), roi_events=len(t), iterations=plan) + 1000
        values, trace, pixels, offered = self._drive(
            batches, settings, gaps, stalls, sum(plans), max_cycles, open_end=open_end, keep_pixels=keep_pixels
        )
        for row, cycle in zip(values, offered, strict=True):
            row["offered"] = cycle
        return values, np.split(trace, np.cumsum([self._traced(row["iterations"]) for row in values])[:-1]), pixels

    def write(self, regions, anew=()):
        """Replace the table of regions; a row that changes, or is one of ``anew``, begins anew."""
        self.table.replace(regions, anew)

    def results(self, batches, settings, *, gaps=None, stalls=None, max_cycles=None):
        """Batches without a pause between them: a list of :class:`BatchResult`, as the integer model's.

        For the parameters see :meth:`play`; ``settings``, a :class:`BatchSettings`, are those of all batches, and there
        is a stall of each region's result. By default it gives up after more cycles than the batches can take.
        """
        config, regions = self.config, self.table.regions if self.table else [None]
        if not regions:
            raise ValueError("there are no regions: write some first")
        count = len(regions)
        settings = dataclasses.replace(settings, rows=count)
        self.write_tables(settings)
        values = [settings_values(config, settings)] * len(batches)
        stalls = [0] * count * len(batches) if stalls is None else stalls
        if self.table:
            plans, limit = self._bounds(batches, settings, regions)
            limit = max_cycles or limit + self._patience(gaps, stalls)
            iterations = sum(plans) * len(batches)
            rows, trace, _, self.offered = self._drive(batches, values, gaps, stalls, iterations, limit)
            # Iterations of one region come one after the other, also those of two batches.
            which = self.trace_names.index("region")
            steps = {k: np.delete(trace[trace[:, which] == k], which, 1) for k in range(count)}
        else:
            rows, traces, _ = self.play(batches, values, gaps=gaps, stalls=stalls, max_cycles=max_cycles)
            self.offered, steps = [row["offered"] for row in rows], {0: np.concatenate(traces)}
        self.finished = [row["valid"] for row in rows[count - 1 :: count]]
        return [self._result(rows[at : at + count], steps) for at in range(0, len(rows), count)]

    def slide(self, t, x, y, settings, *, gaps=None, stalls=None, each=False):
        """Events into a core whose windows slide, which goes on where it was: a :class:`BatchResult` of each hop.

        See :meth:`results` for the settings, and ``valid`` of the attribute :attr:`finished`. With ``each``,
        :attr:`offered` has the clock cycle in which each event was offered first, else that of the first one.
        """
        config = self.config
        self.write_tables(settings)
        plans = [len(getattr(settings, name)) for name in PLANS]
        turns, most = config.ascent_rule.evaluations << config.geometry.turn_bits, 2 * len(t) + 1
        events = [(t[k : k + 1], x[k : k + 1], y[k : k + 1]) for k in range(len(t))] if each else [(t, x, y)]
        stalls = np.resize([0] if stalls is None else stalls, most)
        limit = self._patience(gaps, stalls) + len(t)
        limit += most * (sum(plans) * (turns * config.buffer_events + 200) + config.buffer_events + 1000)
        rows, trace, _, self.offered = self._drive(
            events, [settings_values(config, settings)] * len(events), gaps, stalls, most * max(plans), limit,
            open_end=each,
        )  # fmt: skip
        self.finished, steps = [row["valid"] for row in rows], {0: trace}
        return [self._result([row], steps) for row in rows]

    def _bounds(self, batches, settings, regions):
        """Iterations that each region may have, and clock cycles that the batches may take."""
        config, limit = self.config, 4 * self.config.store.bins
        plans = [max(len(settings.cold if r.cold is None else r.cold), len(settings.warm if r.warm is None else r.warm))
                 for r in regions]  # fmt: skip
        turns = 1 << config.geometry.turn_bits
        for t, _, _ in batches:
            # With the slices before, as large as they can be.
            window = len(t) + (config.slices - 1) * config.slice_events
            stored = min(window, config.buffer_events)
            limit += 2 * window + sum((plan + 4) * (turns * stored + 100) + 2 * window + 5000 for plan in plans)
        return plans, limit

    def _result(self, rows, steps):
        """The next result, of a row of each region; its part of each region's trace leaves ``steps``."""
        if [row.get("last", 1) for row in rows] != [0] * (len(rows) - 1) + [1]:
            raise AssertionError("the last result of a batch is not marked")
        rows, paths = sorted(rows, key=lambda row: row.get("region", 0)), []
        for number, row in enumerate(rows):
            if row.get("region", 0) != number:
                raise AssertionError("a region has no result, or two")
            own, steps[number] = np.split(steps[number], [self._traced(row["iterations"])])
            paths.append(own)
        return to_batch_result(self.config, rows, paths)

    def _traced(self, iterations):
        """Rows of the trace: an iteration has one, a round one for each of its evaluations."""
        return iterations * self.config.ascent_rule.evaluations

    def _patience(self, gaps, stalls):
        """Clock cycles that a run may take beside those of its batches."""
        geometry = self.config.geometry
        clearing = geometry.bank_depth + geometry.cell_depth * self.config.background
        return 2 * clearing + int(sum(stalls) + sum([] if gaps is None else gaps))

    def _drive(self, batches, settings, gaps, stalls, iterations, limit, *, open_end=False, keep_pixels=False):
        """Play batches until as many results have come as there are ``stalls``; at most so many ``iterations``.

        Returns ``(ports of each result, trace of all iterations, pixels of all sweeps or None, cycles of the first
        offers)``; ``valid`` among the ports is the cycle of the result, ``accepted`` counts events.
        """
        lengths, words = [len(t) for t, _, _ in batches], self.config.geometry.bank_words
        arrays = dict(zip("txy", (np.concatenate(axis) for axis in zip(*batches, strict=True)), strict=True))
        arrays |= {
            "settings": [[row[name] for name in self.settings_names] for row in settings],
            "ends": np.cumsum(lengths),
            "gaps": gaps,
            "stalls": stalls,
            "results": _zeros(len(stalls), len(self.result_names)),
            "offered": _zeros(len(batches)),
            "valid": _zeros(len(stalls)),
            "trace": _zeros(max(1, self._traced(iterations)), len(self.trace_names)),
            "pixels": _zeros(max(1, iterations) * words, len(self.pixel_names)) if keep_pixels else None,
        }
        arrays = {name: None if it is None else np.ascontiguousarray(it, np.int64) for name, it in arrays.items()}
        run = _Run(
            **{name: _pointer(array) for name, array in arrays.items()},
            batches=len(batches),
            outcomes=len(stalls),
            open_end=int(open_end),
            max_cycles=limit,
            trace_rows=len(arrays["trace"]),
            pixel_rows=len(arrays["pixels"]) if keep_pixels else 0,
        )
        status = self._library.core_run(self._open(), ctypes.byref(run))
        if status == TIMED_OUT:
            raise TimeoutError(
                f"{run.results_count} of {len(stalls)} results after {limit} clock cycles: {run.accepted} of "
                f"{sum(lengths)} events accepted, {run.trace_count} of {iterations} iterations seen"
            )
        if status == RESULT_CHANGED:
            raise AssertionError("a result changed while it was waiting to be taken")
        rows = arrays["results"][: run.results_count].tolist()
        values = [dict(zip(self.result_names, row, strict=True)) for row in rows]
        for number, row in enumerate(values):
            row |= {"valid": int(arrays["valid"][number]), "accepted": run.accepted}
        done = self._traced(sum(row["iterations"] for row in values))
        if run.trace_count != done:
            raise AssertionError(f"{run.trace_count} rows traced, {done} reported")
        pixels = arrays["pixels"]
        if keep_pixels:
            pixels = pixels[: run.pixel_count].reshape(done, words, len(self.pixel_names))
        return values, arrays["trace"][:done], pixels, arrays["offered"].tolist()


_known = {}  # what _core_and_library has returned to this process


def _core_and_library(config):
    """The top of a hardware, and its library; once a process, for emitting alone takes seconds."""
    key = config.hardware_hash, cache_folder()
    if key not in _known or not is_sound(_known[key][1]):
        core = verilog_top(config)
        _known[key] = core, compile_library(core)
    return _known[key]
