"""The C programs: compiled here and now, for this processor, one thread."""

import ctypes
import importlib.resources
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from .job import Loaded, Program, Unavailable

COMPILERS = ("cc", "gcc", "clang")
#: With leave to reorder sums, without which no compiler vectorises them. Not -ffast-math itself: a library linked with
#: it changes the floating-point mode of the whole process.
OPTIONS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math")


class JobOfC(ctypes.Structure):
    """``Job`` of program.h."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name in ("t", "x", "y")]
        + [("events", ctypes.c_int64)]
        + [(name, ctypes.c_int32) for name in ("roi_x", "roi_y", "width", "height", "iterations", "dither")]
        + [(name, ctypes.c_void_p) for name in ("levels", "steps", "strides")]
        + [("eta", ctypes.c_double)]
        + [("v_start", ctypes.c_double * 2), ("v", ctypes.c_double * 2)]
    )


class CProgram(Program):
    """``form``.c, compiled.

    Parameters
    ----------
    form : {"literal", "gather", "flow"}
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
        self.name = f"C, {form}"
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
        return _LoadedC(self.library, job)


class _LoadedC(Loaded):
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
            *pointers[:3], len(events), *job.roi, job.width, job.height, job.iterations, job.dither,
            *pointers[3:6], job.eta, (ctypes.c_double * 2)(*job.v_start),
        )  # fmt: skip
        self._work = ctypes.c_void_p(library.work_new(ctypes.byref(self._job)))
        if not self._work:
            raise MemoryError(f"no memory for a batch of {len(events)} events")

    def _run(self, function, count):
        function(self._work, ctypes.byref(self._job), ctypes.c_int64(count))
        return tuple(self._job.v)

    def batch(self, count=1):
        return self._run(self._library.run_batch, count)

    def ascent(self, count=1):
        return self._run(self._library.run_ascent, count)

    def gradient(self, v, level=0):
        g = (ctypes.c_double * 2)()
        at = (ctypes.c_double * 2)(*v)
        self._library.run_gradient(self._work, ctypes.byref(self._job), at, ctypes.c_int32(level), g)
        return tuple(g)

    def close(self):
        if self._work:
            self._library.work_free(self._work)
            self._work = None


MAKERS = (lambda: CProgram("gather"), lambda: CProgram("literal"))
