"""Files that people send each other, changed at random: a result, or one line, soon, in little memory."""

import signal
import time
from pathlib import Path

import pytest

from cmfpga.cli import info, report, track
from cmfpga.events import write_hdf5
from cmfpga.tracking.kept import FILE
from support.commands import run
from support.designs import PAPER
from support.mutated_files import hdf5_changed, json_changed, npz_changed, yaml_changed
from support.small_core import options
from support.sweeping import run_here, small

SECONDS, BYTES = 10, 300 << 20  # beside what Python and the libraries take
CAMERA = """\
image_width: 32
image_height: 24
camera_name: davis
camera_matrix:
  rows: 3
  cols: 3
  data: [40.5, 0, 16.0, 0, 40.25, 12.0, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, -0.0003, -0.0008, 0]}
"""
#: Options of a track of the small recording.
TRACK = ["--roi", "8,9", "--batch-events", 90, "--batches", 2, "--engine", "model", "--no-picture", *options(PAPER)]


class Case:
    """A good file of a kind, how it is changed, and the commands that read it."""

    def __init__(self, path, change, *commands):
        self.path, self.change, self.commands, self.content = path, change, commands, path.read_bytes()


def _kept(folder, dot, _):
    assert run(track, dot, *TRACK, "--out", folder, "--report").status == 0
    return Case(folder / FILE, npz_changed, (run, report, folder))


def _camera(folder, dot, _):
    path = folder / "camera.yaml"
    path.write_text(CAMERA)
    return Case(path, yaml_changed, (run, track, dot, *TRACK, "--camera", path, "--out", folder))


def _hdf5(folder, dot, events):
    path = folder / "rec.h5"
    write_hdf5(path, events, 32, 24)
    return Case(path, hdf5_changed, (run, info, path, "--no-frame"), (run, track, path, *TRACK, "--out", folder))


def _store(folder, dot, _):
    command = (run_here, f"{dot}@8,9", *small(), "--engine", "model", "--batches", 3, "--out", folder)
    assert command[0](*command[1:]).status == 0
    (path,) = folder.glob("tasks/*.json")
    return Case(path, json_changed, command)


@pytest.fixture
def case(request, tmp_path, dot, dot_events):
    return request.param(tmp_path, dot, dot_events)


def _peak():
    """The most memory that this process has had since :func:`_forget`, bytes."""
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) << 10


def _forget():
    Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _late(*_):
    raise TimeoutError(f"more than {SECONDS} s")


def survives(case, rng, count):
    """Change the file so many times, and run what reads it; returns how often it was refused, and the worst."""
    refused, seconds, memory, before = 0, 0.0, 0, signal.signal(signal.SIGALRM, _late)
    try:
        for k in range(count):
            content = case.change(rng, case.content)
            case.path.write_bytes(content)
            for command, *arguments in case.commands:
                base, begin = _forget(), time.monotonic()
                signal.alarm(SECONDS)
                try:
                    done = command(*arguments)
                except Exception as error:
                    (case.path.parent / "refused").write_bytes(content)
                    raise AssertionError(f"change {k}: {case.path.parent / 'refused'}") from error
                finally:
                    signal.alarm(0)
                seconds, memory = max(seconds, time.monotonic() - begin), max(memory, _peak() - base)
                assert done.status == 0 or (done.error and done.status == 2)
                refused += done.status == 2
    finally:
        signal.signal(signal.SIGALRM, before)
    print(f"{count} files, {refused} refusals, at most {seconds:.2f} s and {memory >> 20} MB more")
    assert seconds < SECONDS and memory < BYTES
    return refused


pytestmark = [
    pytest.mark.parametrize("case", [_kept, _camera, _hdf5, _store], indirect=True),
    pytest.mark.filterwarnings("ignore::RuntimeWarning"),  # of NumPy, where numbers are absurd
]


def test_some_changed_files(case, rng):
    survives(case, rng, 12)


def test_many_changed_files(case, rng, long_tools):
    refused = survives(case, rng, 300)
    assert refused > 50 or case.change is json_changed  # what a sweep does not take, it computes again
