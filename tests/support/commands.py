"""The command lines, run in this process or in their own, and a small recording for them."""

import contextlib
import csv
import io
import os
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from cmfpga import cli
from cmfpga.events import Events, write_hdf5
from support.designs import PAPER
from support.small_core import options

HEADER = (
    "batch,t_ref_us,events,roi_events,roi_x,roi_y,vx,vy,vx_px_per_s,vy_px_per_s,vx_px_per_s_sd,vy_px_per_s_sd,"
    "iterations,cycles,contrast,confidence,trusted,flags,ambiguity"
)


@dataclass(frozen=True)
class Done:
    status: int
    out: str
    err: str

    @property
    def complaints(self):
        """Lines on standard error that are no notes."""
        return [line for line in self.err.splitlines() if not line.startswith("note: ")]

    @property
    def error(self):
        """The one line of a refusal, without what all of them begin with; checks that it is one. Notes may precede."""
        lines = self.complaints
        assert self.status == 2 and len(lines) == 1, (self.status, self.err)
        assert lines[0].startswith("error: ") and self.err.endswith("\n") and "Traceback" not in self.err
        return lines[0].removeprefix("error: ")


def run(module, *arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = cli.run(module.main, [str(argument) for argument in arguments])
        except SystemExit as exit:  # --help and the like
            status = exit.code
    return Done(status, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def command():
    """``command(module, argument, …)``: :class:`Done` of a command that was run in this process."""
    return run


@pytest.fixture
def process(tmp_path):
    """``process(name, argument, …, without=(), **environment)``: the same in a process of its own, in an empty folder.

    ``without`` names packages that cannot be imported there.
    """

    def process(name, *arguments, without=(), **environment):
        blocked = "".join(f"sys.modules[{package!r}] = None; " for package in without)
        script = f"import runpy, sys; {blocked}runpy.run_module('cmfpga', run_name='__main__', alter_sys=True)"
        command = [sys.executable, "-W", "error", "-c", script, name, *map(str, arguments)]
        environment = {**os.environ, "MPLCONFIGDIR": str(tmp_path / "matplotlib"), **environment}
        texts = {"capture_output": True, "encoding": "utf-8", "errors": "backslashreplace"}
        done = subprocess.run(command, cwd=tmp_path, env=environment, **texts)
        return Done(done.returncode, done.stdout, done.stderr)

    return process


@pytest.fixture(scope="session")
def small():
    """Options that choose the small hardware, for recordings that say how large their sensor is."""
    return options(PAPER)


@pytest.fixture(scope="session")
def dot_events():
    """600 events in 6 ms: an L of 5 by 5 pixels that moves to the right by 2.5 px/ms, and some noise."""
    rng = np.random.default_rng(20)
    t = 50_000 + np.arange(600) * 10
    along = rng.integers(0, 5, 600)
    upright = rng.integers(2, size=600).astype(bool)
    x = np.floor(8.5 + np.where(upright, 0, along) + (t - 50_000) / 400).astype(int)
    y = 10 + np.where(upright, along, 4)
    noise = rng.random(600) < 0.1
    x, y = np.where(noise, rng.integers(32, size=600), x), np.where(noise, rng.integers(24, size=600), y)
    return Events(t, x, y, rng.integers(2, size=600))


@pytest.fixture(scope="session")
def dot(dot_events, tmp_path_factory):
    """A recording of a 32×24 px sensor in HDF5; nobody writes to it."""
    path = tmp_path_factory.mktemp("recordings") / "dot.h5"
    write_hdf5(path, dot_events, 32, 24)
    return path


def _rows(folder):
    """``track.csv`` as a list of dictionaries; checks its header and form."""
    text = (folder / "track.csv").read_bytes().decode("ascii")
    assert text.startswith(HEADER + "\n") and text.endswith("\n") and "\r" not in text and '"' not in text
    rows = list(csv.DictReader(io.StringIO(text), strict=True))
    assert [row["batch"] for row in rows] == [str(k) for k in range(len(rows))]
    assert all(None not in row and None not in row.values() for row in rows)
    return rows


@pytest.fixture(scope="session")
def rows():
    """``rows(folder)``: what :mod:`cmfpga.track` wrote."""
    return _rows
