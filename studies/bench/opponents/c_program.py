"""The C programs: compiled here and now, for this processor; one thread, or for dense flow several."""

import ctypes
import math
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmfpga.events import Events

COMPILERS = ("cc", "gcc", "clang")
#: With leave to reorder sums, without which no compiler vectorises them. Not -ffast-math itself: a library linked with
#: it changes the floating-point mode of the whole process.
OPTIONS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math")


class Unavailable(Exception):
    """A program cannot run here; the message is a line that says what is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One batch and what is to be done with it."""

    events: Events  # all N of the batch
    roi: tuple[int, int]  # left column and top row, px
    width: int  # of the ROI, px
    height: int
    iterations: int  # T
    eta: float = 1.0  # step of the constant ascent
    schedule: tuple | None = None  # of ScheduleEntry, one per iteration: sign ascent instead
    dither: bool = False  # add the sub-pixel offsets of cmfpga.reference.floating.dither
    probes: bool = False  # then evaluate the four gradients of the confidence, at v ± 0.75 px along each axis
    v_start: tuple[float, float] = (0.0, 0.0)  # px per half batch

    def __post_init__(self):
        if self.schedule is not None and len(self.schedule) != self.iterations:
            raise ValueError(f"{len(self.schedule)} entries of a schedule for {self.iterations} iterations")


def _layout(*groups):
    return [(name, kind) for kind, names in groups for name in names.split()]


class JobOfC(ctypes.Structure):
    """``Job`` of program.h."""

    _fields_ = _layout(
        (ctypes.c_void_p, "t x y"),
        (ctypes.c_int64, "events"),
        (ctypes.c_int32, "roi_x roi_y width height iterations dither probes"),
        (ctypes.c_void_p, "levels steps strides"),
        (ctypes.c_double, "eta"),
        (ctypes.c_double * 2, "v_start v"),
        (ctypes.c_double * 8, "g"),
    )


def _plan(schedule):
    """Levels, steps and strides of a schedule, as the programs read them."""
    levels, strides = (np.array([getattr(each, name) for each in schedule], np.int32) for name in ("level", "stride"))
    return [levels, np.array([2.0**each.log2_step for each in schedule], np.float64), strides]


class Loaded:
    """A job in a program. ``batch`` before ``ascent``."""

    def __init__(self, library, job):
        self._library = library
        events = job.events
        self._keep = [events.t, events.x, events.y, *([] if job.schedule is None else _plan(job.schedule))]
        pointers = [array.ctypes.data for array in self._keep] + [None] * 3
        self._job = JobOfC(
            *pointers[:3], len(events), *job.roi, job.width, job.height, job.iterations, job.dither, job.probes,
            *pointers[3:6], job.eta, (ctypes.c_double * 2)(*job.v_start),
        )  # fmt: skip
        self._rooms = []
        self._work = self._room("work_new", f"a batch of {len(events)} events")

    def _room(self, function, what):
        """Memory that the program makes for the job."""
        make = getattr(self._library, function)
        make.restype = ctypes.c_void_p
        self._rooms.append(ctypes.c_void_p(make(ctypes.byref(self._job))))
        if not self._rooms[-1]:
            raise MemoryError(f"no memory for {what}")
        return self._rooms[-1]

    def _run(self, function, count):
        function(self._work, ctypes.byref(self._job), ctypes.c_int64(count))
        if math.isnan(self._job.v[0]):
            raise OverflowError("integers of 16 bits hold 127 events a pixel at most, and images of 250 px a side")
        return tuple(self._job.v)

    def batch(self, count=1):
        """The whole job, ``count`` times: crop, scale, T iterations. Returns v."""
        return self._run(self._library.run_batch, count)

    def ascent(self, count=1):
        """What is left to do when the last event has arrived, ``count`` times: all but the cropping. Returns v."""
        return self._run(self._library.run_ascent, count)

    @property
    def probes(self):
        """The last batch's gradients below and above v along x, then along y."""
        return np.reshape(self._job.g, (4, 2))

    def gradient(self, v, level=0):
        """G/P = S − ΣI·ΣD/P at v, in the image of pixels 2^level px wide; P is that of the ROI at every level.

        The derivatives are those by v in units of that level's pixels, as in the hardware.
        """
        g = (ctypes.c_double * 2)()
        at = (ctypes.c_double * 2)(*v)
        self._library.run_gradient(self._work, ctypes.byref(self._job), at, ctypes.c_int32(level), g)
        return tuple(g)

    def close(self):
        """Free what the job holds."""
        while self._rooms:
            self._library.work_free(self._rooms.pop())


class CProgram:
    """``form``.c of this package, or of a folder ``sources``, compiled with ``options`` beside :data:`OPTIONS`.

    Raises :exc:`Unavailable`: there is no C compiler, or it refuses the program.
    """

    loads = Loaded

    def __init__(self, form, sources=None, options=()):
        self.form, self.name = form, f"C, {form}"
        compiler = next((path for path in map(shutil.which, COMPILERS) if path), None)
        if compiler is None:
            raise Unavailable(f"no C compiler ({', '.join(COMPILERS)}) was found: no C programs")
        with tempfile.TemporaryDirectory(prefix="cmfpga-") as folder:
            library = str(Path(folder) / f"{form}.so")
            arguments = ("-std=gnu11", "-fPIC", "-shared", f"{form}.c", "-o", library, "-lm")
            call, here = [compiler, *OPTIONS, *options, *arguments], sources or Path(__file__).parent
            done = subprocess.run(call, cwd=here, capture_output=True, text=True)
            if done.returncode:
                why = next((line for line in done.stderr.splitlines() if "error" in line), "no reason given")
                raise Unavailable(f"{Path(compiler).name} does not compile {form}.c ({why}): no program {self.name!r}")
            self.library = ctypes.CDLL(library)
        version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()
        self.how = f"{version[0] if version else compiler}, {' '.join((*OPTIONS, *options))}"

    def load(self, job):
        """The job with all memory that it needs, ready to be timed."""
        return self.loads(self.library, job)


class _Tile(ctypes.Structure):
    """``Tile`` of flow.c."""

    _fields_ = _layout(
        (ctypes.c_int32, "x y width height left top parent stride iterations"),
        (ctypes.c_void_p, "levels steps strides"),
    )


class _Flow(ctypes.Structure):
    """``Flow`` of flow.c."""

    _fields_ = _layout(
        (JobOfC, "window"),
        (ctypes.c_int32, "sensor_width sensor_height bin_bits most tiles coarse threads"),
        (ctypes.c_void_p, "tile v probes"),
    )


class FlowProgram(CProgram):
    """flow.c, on threads."""

    def __init__(self):
        super().__init__("flow", options=("-pthread",))

    def load_window(self, config, regions, events, settings, threads):
        """A function of a count that measures a window so often, and returns v of each region: float64 [regions, 2].

        Of ``regions`` those without a parent come first. ``settings`` have the schedules; v starts at 0. ``threads``: 1
        to 64.
        """
        plans, tiles = [_plan(settings.cold), _plan(settings.warm)], (_Tile * len(regions))()
        children = [region.start == "parent" for region in regions]
        for number, (region, child) in enumerate(zip(regions, children, strict=True)):
            place = region.x, region.y, region.width, region.height, *region.corner(config)
            pointers = (each.ctypes.data for each in plans[child])
            parent, count = region.parent if child else -1, len(plans[child][0])
            tiles[number] = _Tile(*place, parent, region.stride, count, *pointers)
        v, probes = np.zeros((len(regions), 2)), np.zeros((len(regions), 8))
        window = JobOfC(*(axis.ctypes.data for axis in (events.t, events.x, events.y)), len(events))
        window.width, window.height, window.dither, window.probes = config.roi_width, config.roi_height, 1, 1
        flow = _Flow(
            window, config.sensor_width, config.sensor_height, config.bin_bits, config.buffer_events, len(regions),
            children.count(False), threads, ctypes.addressof(tiles), v.ctypes.data, probes.ctypes.data,
        )  # fmt: skip

        def run(count=1, keep=(plans, tiles, probes)):
            if not self.library.run_flow(ctypes.byref(flow), ctypes.c_int64(count)):
                raise MemoryError(f"no memory for a window of {len(events)} events on {threads} threads")
            return v

        return run


class LoadedHop(Loaded):
    """A window in the program, its events cropped and dithered, as they are before a hop ends."""

    def __init__(self, library, job):
        super().__init__(library, job)
        self.batch()  # without iterations: crops and dithers
        self._hop = self._room("hop_new", "four images")
        self.follow()

    def round(self, count=1):
        """What is left when the hop has ended, where nothing followed: times, four gradients, a step. Returns v."""
        return self._run(self._library.run_round, count)

    def follow(self, count=1):
        """All of the window's events but the last one, one after the other, into the sums of four evaluations."""
        self._library.run_follow(self._hop, self._work, ctypes.byref(self._job), ctypes.c_int64(count))

    def tail(self, count=1):
        """What is left when the closing event comes, after :meth:`follow`: that event, and a step. Returns v."""
        self._library.run_tail(self._hop, self._work, ctypes.byref(self._job), ctypes.c_int64(count))
        return tuple(self._job.v)


class HopProgram(CProgram):
    """hop.c; its jobs are windows."""

    loads = LoadedHop

    def __init__(self, sources=None):
        super().__init__("hop", sources)
