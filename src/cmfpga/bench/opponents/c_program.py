"""The C programs: compiled here and now, for this processor, one thread."""

import ctypes
import importlib.resources
import math
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...events import Events

COMPILERS = ("cc", "gcc", "clang")
#: With leave to reorder sums, without which no compiler vectorises them. Not -ffast-math itself: a library linked with
#: it changes the floating-point mode of the whole process.
OPTIONS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math")


class Unavailable(Exception):
    """A program cannot run here; the message is a line that says what is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One batch and what is to be done with it.

    Parameters
    ----------
    events : Events
        All N events of the batch.
    roi : (int, int)
        Left column and top row of the ROI, px.
    width, height : int
        Size of the ROI, px.
    iterations : int
        T.
    eta : float
        Step of the constant ascent.
    schedule : tuple of ScheduleEntry, or None
        Sign ascent instead, one entry per iteration.
    dither : bool
        Add the sub-pixel offsets of :func:`cmfpga.reference.floating.dither`.
    probes : bool
        Then evaluate the four gradients of the confidence, at v ± 0.75 px along each axis.
    v_start : (float, float)
        Start, px per half batch.
    """

    events: Events
    roi: tuple[int, int]
    width: int
    height: int
    iterations: int
    eta: float = 1.0
    schedule: tuple | None = None
    dither: bool = False
    probes: bool = False
    v_start: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self):
        if self.schedule is not None and len(self.schedule) != self.iterations:
            raise ValueError(f"{len(self.schedule)} entries of a schedule for {self.iterations} iterations")


class JobOfC(ctypes.Structure):
    """``Job`` of program.h."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name in ("t", "x", "y")]
        + [("events", ctypes.c_int64)]
        + [(name, ctypes.c_int32) for name in ("roi_x", "roi_y", "width", "height", "iterations", "dither", "probes")]
        + [(name, ctypes.c_void_p) for name in ("levels", "steps", "strides")]
        + [("eta", ctypes.c_double)]
        + [(name, ctypes.c_double * size) for name, size in (("v_start", 2), ("v", 2), ("g", 8))]
    )


class CProgram:
    """``form``.c, compiled.

    Parameters
    ----------
    form : {"gather", "int16", "flow"}
    sources : folder, optional
        Of the C files, if not this package.
    includes : tuple of str
        Files that it includes beside program.h.
    options : tuple of str
        For the compiler, beside :data:`OPTIONS`.

    Raises
    ------
    Unavailable
        There is no C compiler, or it refuses the program.
    """

    def __init__(self, form, sources=None, includes=(), options=()):
        self.form, self.name = form, f"C, {form}"
        compiler = next((path for path in map(shutil.which, COMPILERS) if path), None)
        if compiler is None:
            raise Unavailable(f"no C compiler ({', '.join(COMPILERS)}) was found: no C programs")
        here = sources or importlib.resources.files(__package__)
        with tempfile.TemporaryDirectory(prefix="cmfpga-") as folder:
            folder = Path(folder)
            for name in ("program.h", *includes, f"{form}.c"):
                (folder / name).write_text(here.joinpath(name).read_text(encoding="utf-8"), encoding="utf-8")
            library = folder / f"{form}.so"
            arguments = ("-std=gnu11", "-fPIC", "-shared", f"{form}.c", "-o", library.name, "-lm")
            done = subprocess.run(
                [compiler, *OPTIONS, *options, *arguments], cwd=folder, capture_output=True, text=True
            )
            if done.returncode:
                why = next((line for line in done.stderr.splitlines() if "error" in line), "no reason given")
                raise Unavailable(f"{Path(compiler).name} does not compile {form}.c ({why}): no program {self.name!r}")
            self.library = ctypes.CDLL(str(library))
        self.library.work_new.restype = ctypes.c_void_p
        version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()
        self.how = f"{version[0] if version else compiler}, {' '.join((*OPTIONS, *options))}"

    def load(self, job):
        """A :class:`Loaded`: the job with all memory that it needs, ready to be timed."""
        return Loaded(self.library, job)


class Loaded:
    """A job in a program. ``batch`` before ``ascent``."""

    def __init__(self, library, job):
        self._library = library
        events = job.events
        self._keep = [np.ascontiguousarray(a) for a in (events.t, events.x, events.y)]
        if job.schedule is not None:
            self._keep.append(np.array([entry.level for entry in job.schedule], np.int32))
            self._keep.append(np.array([2.0**entry.log2_step for entry in job.schedule], np.float64))
            self._keep.append(np.array([entry.stride for entry in job.schedule], np.int32))
        pointers = [array.ctypes.data for array in self._keep] + [None] * 3
        self._job = JobOfC(
            *pointers[:3], len(events), *job.roi, job.width, job.height, job.iterations, job.dither, job.probes,
            *pointers[3:6], job.eta, (ctypes.c_double * 2)(*job.v_start),
        )  # fmt: skip
        self._work = ctypes.c_void_p(library.work_new(ctypes.byref(self._job)))
        if not self._work:
            raise MemoryError(f"no memory for a batch of {len(events)} events")

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
        if self._work:
            self._library.work_free(self._work)
            self._work = None
