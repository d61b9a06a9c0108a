"""Sweeps as users run them: on two workers, with a worker killed, stopped and started again, on a scheduler."""

import contextlib
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pandas
import psutil
import pytest
from filelock import FileLock

from cmfpga.cli import sweep
from cmfpga.events import generate, write_hdf5
from cmfpga.fpga import resources
from cmfpga.sweep import plan, task
from cmfpga.verilog.compiler import find_compiler
from support.sweeping import FILES, OPTIONS, finish, make_recording, run_here, small, started

MODEL = ["--engine", "model"]
RIGHT_NOW = 60  # s; far more than anything here takes


def assert_equal_results(folder, other):
    """Row for row: the CSVs in every byte, the Parquet files in every value and type."""
    for name in FILES:
        if name.endswith(".csv"):
            assert (folder / name).read_bytes() == (other / name).read_bytes(), name
        else:
            found, wanted = (pandas.read_parquet(where / name) for where in (folder, other))
            pandas.testing.assert_frame_equal(found, wanted, check_exact=True)
    assert len(pandas.read_csv(folder / "results.csv")) == 32


def kept(folder):
    return {path.name: path.stat().st_mtime_ns for path in (folder / "tasks").glob("*.json")}


def wait_until(condition, what):
    end = time.monotonic() + RIGHT_NOW
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.002)


def worker_processes(process):
    family = psutil.Process(process.pid).children(recursive=True)
    return [child for child in family if "spawn_main" in " ".join(child.cmdline())]


def test_two_workers_equal_the_serial_result(recordings, serial, tmp_path):
    engine = "rtl" if find_compiler() else "model"
    with started(*recordings, *OPTIONS, "--engine", engine, "--workers", 2, "--out", tmp_path) as process:
        done = finish(process)
    assert (done.status, done.err) == (0, "") and done.out.startswith("32 rows, 0 of them kept from before\n")
    assert_equal_results(tmp_path, serial(engine))


def test_a_worker_killed_in_the_middle(recordings, serial, tmp_path):
    with started(*recordings, *OPTIONS, *MODEL, "--workers", 2, "--out", tmp_path) as process:
        wait_until(lambda: len(kept(tmp_path)) >= 2, "the first rows")
        victim, *others = worker_processes(process)
        victim.kill()
        victim.wait(RIGHT_NOW)
        assert len(kept(tmp_path)) < 32 and len(others) == 1, "it was not in the middle"
        done = finish(process)
    assert (done.status, done.err) == (0, "")
    assert_equal_results(tmp_path, serial("model"))


@pytest.mark.parametrize("count, signal_number, status, said", [
    (2, signal.SIGKILL, -signal.SIGKILL, ""),
    (0, signal.SIGINT, 130, "interrupted\n"),
])  # fmt: skip
def test_stopped_and_started_again(recordings, serial, tmp_path, count, signal_number, status, said):
    with started(*recordings, *OPTIONS, *MODEL, "--workers", count, "--out", tmp_path) as process:
        wait_until(lambda: len(kept(tmp_path)) >= 3, "the first rows")
        process.send_signal(signal_number)
        done = finish(process)
    assert (done.status, done.err) == (status, said)
    before = kept(tmp_path)
    assert 3 <= len(before) < 32, "it was not in the middle"
    done = run_here(*recordings, *OPTIONS, *MODEL, "--out", tmp_path)
    assert done.status == 0 and done.out.startswith(f"32 rows, {len(before)} of them kept from before\n")
    after = kept(tmp_path)
    assert len(after) == 32 and {name: after[name] for name in before} == before
    assert_equal_results(tmp_path, serial("model"))


def test_what_is_there_is_not_run_again(recordings, serial, tmp_path, monkeypatch):
    """Not even a scheduler is looked for; with one more value, only what is new runs."""
    folder = serial("model")
    done = run_here(*recordings, *OPTIONS, *MODEL, "--scheduler", "tcp://127.0.0.1:1", "--out", folder)
    assert (done.status, done.err) == (0, "") and done.out.startswith("32 rows, 32 of them kept from before\n")

    before = kept(folder)
    shorter = [*small(iterations=None), "--vary", "iterations=4,9", "--vary", "roi_gain=1"]
    done = run_here(recordings[0], *shorter, *MODEL, "--out", folder)
    assert done.status == 0 and "2 rows, 1 of them kept" in done.out
    (new,) = kept(folder).keys() - before.keys()
    # Another name of the same content is the same recording.
    link = tmp_path / "another.h5"
    link.symlink_to(recordings[0])
    assert "2 rows, 2 of them kept" in run_here(link, *shorter, *MODEL, "--out", folder).out
    assert kept(folder).keys() == before.keys() | {new}
    # Another version is not.
    monkeypatch.setattr(plan, "version", lambda: "other")
    monkeypatch.setattr(task, "version", lambda: "other")
    assert "2 rows, 0 of them kept" in run_here(link, *shorter, *MODEL, "--out", folder).out
    run_here(*recordings, *OPTIONS, *MODEL, "--out", folder)  # as the other tests want it


def test_two_sweeps_do_not_write_to_one_folder(recordings, tmp_path):
    with FileLock(tmp_path / ".lock"):
        done = run_here(recordings[0], *small(), *MODEL, "--out", tmp_path)
    assert done.error == f"--out {tmp_path}: another command is writing there; another folder is needed"


def test_bad_recordings_are_flagged_and_the_rest_is_run(recordings, tmp_path):
    bad = tmp_path / "bad.h5"
    bad.write_bytes(recordings[0].read_bytes()[:3000])
    short = tmp_path / "short.txt"
    short.write_text("".join(f"{k} 3 4 1\n" for k in range(1, 50)))
    late = tmp_path / "late.txt"  # a good beginning
    late.write_text(short.read_text() * 2)
    corner = tmp_path / "corner.npz"  # all events at the top right
    np.savez(corner, t=np.arange(200), x=np.full(200, 30), y=np.full(200, 3), p=np.ones(200, int))
    where = [recordings[0], f"{bad}@8,8", f"{short}@8,8", f"{late}@8,8", f"{tmp_path / 'none.h5'}@1,1",
             f"{corner}@0,16", f"{corner}@25,0"]  # fmt: skip
    done = run_here(*where, *small(min_roi_events=1), *MODEL, "--sensor", "32,24", "--time-unit", "us",
                    "--out", tmp_path / "out")  # fmt: skip
    assert done.status == 0 and all(": hot pixels " in line for line in done.err.splitlines())
    rows = pandas.read_csv(tmp_path / "out" / "results.csv").set_index("recording")
    assert rows["status"].tolist() == ["ok", "failed", "failed", "failed", "failed", "empty", "failed"]
    reasons = rows["reason"].tolist()
    assert reasons[1].startswith(f"{bad}: not a readable HDF5 file")
    assert reasons[2] == f"{short}: too few events for one batch after event 0 (49 left)"
    assert reasons[3].startswith(f"{late} (columns t, x, y, p; ")
    assert "): time stamp of event 49 is 1 µs, after 49 µs of the event before" in reasons[3]
    assert reasons[4] == f"{tmp_path / 'none.h5'}: no such file"
    assert reasons[5] == "no event ever entered the ROI at 0,16"
    assert reasons[6].startswith("ROI at 25,0: 0,0 to 24,16 is needed")
    assert all(f"1 of 7 rows without a result: {reason}\n" in done.out for reason in reasons[1:])


def test_with_nothing_but_bad_recordings(recordings, tmp_path):
    assert run_here(tmp_path / "no.h5", *small(), "--out", tmp_path).error == f"{tmp_path / 'no.h5'}: no such file"
    done = run_here(recordings[0], *small(), *MODEL, "--start-event", "300", "--out", tmp_path)
    assert done.status == 2 and "error: no row has a result: " in done.err and "too few events" in done.err


def test_a_defect_is_a_failed_row_with_its_traceback(recordings, tmp_path, monkeypatch):
    def broken(job):
        if job.config.iterations == 4:
            return task.guarded(lambda _: 1 // 0, job, task.version())
        return task.run_task(job)

    monkeypatch.setattr(sweep, "run_task", broken)
    options = [*small(iterations=None), "--vary", "iterations=4,9", *MODEL, "--out", tmp_path]
    assert run_here(recordings[0], *options).status == 0
    rows = pandas.read_csv(tmp_path / "results.csv")
    assert rows["reason"].tolist()[0] == "ZeroDivisionError: integer division or modulo by zero"
    assert rows["status"].tolist() == ["failed", "ok"]
    (report,) = (tmp_path / "failures").iterdir()
    assert report.read_text().startswith("Traceback")
    monkeypatch.undo()  # it is tried again
    assert "2 rows, 1 of them kept" in run_here(recordings[0], *options).out
    assert pandas.read_csv(tmp_path / "results.csv")["status"].tolist() == ["ok", "ok"]


@pytest.mark.parametrize("address, why", [("tcp://127.0.0.1:1", ""), ("what://x", "unknown address scheme")])
def test_a_scheduler_that_is_not_there(recordings, tmp_path, address, why):
    with started(recordings[0], *small(), "--scheduler", address, "--out", tmp_path) as process:
        assert finish(process).error.startswith(f"--scheduler {address}: no scheduler answers there: {why}")


def test_a_scheduler_whose_worker_comes_late_and_then_the_scheduler_goes(recordings, serial, tmp_path):
    """The three things that can happen to a scheduler that is there already, one after the other."""
    address_file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*dask, "--no-dashboard", "--scheduler-file", address_file], **quiet) as scheduler:
        wait_until(lambda: address_file.exists() and "tcp" in address_file.read_text(), "the scheduler")
        address = re.search(r"tcp://[\d.:]+", address_file.read_text())[0]
        with started(*recordings, *OPTIONS, *MODEL, "--scheduler", address, "--out", tmp_path) as process:
            told = f"note: the scheduler at {address} has no workers yet; waiting for one\n"
            assert process.stderr.readline() == told
            worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1"]
            with subprocess.Popen([*worker, "--no-dashboard"], **quiet, cwd=tmp_path) as late:
                wait_until(lambda: len(kept(tmp_path)) >= 2, "the first rows")
                scheduler.kill()
                done = finish(process)
                late.terminate()
    gone = f"the scheduler at {address} is gone; what was done is kept, the same command goes on with the rest"
    assert done.error == gone
    done = run_here(*recordings, *OPTIONS, *MODEL, "--out", tmp_path)
    assert 2 <= int(re.search(r"32 rows, (\d+) of them kept", done.out)[1]) < 32
    assert_equal_results(tmp_path, serial("model"))


CRASH = """
import os
from cmfpga.sweep import task

def job(number):
    return os._exit(1) if number == 1 else {"status": "ok", "number": number}

if __name__ == "__main__":
    with task.pool(2) as where:
        found = dict(where.run(job, {"a": 0, "b": 1, "c": 2}))
    assert found["a"]["number"] == 0 and found["c"]["number"] == 2
    print(found["b"]["reason"])
"""


def script(path, text):
    """``(standard output, standard error)`` of a script."""
    path.write_text(text)
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=120)
    return done.stdout, done.stderr


def test_a_task_that_kills_its_worker_each_time(tmp_path):
    out, err = script(tmp_path / "crash.py", CRASH)
    assert out == "the worker died each time that it was tried: out of memory, or a crash\n", err


BESIDE = """
from cmfpga.sweep import task

if __name__ == "__main__":
    with task.pool(1):
        print("here")
"""


def test_beside_another_that_has_the_usual_port(tmp_path):
    """Two sweeps at once: dask's server of the first has port 8787, of which the second says nothing."""
    with contextlib.ExitStack() as stack:
        taken = stack.enter_context(socket.socket())
        with contextlib.suppress(OSError):  # someone else has it: so much the better
            taken.bind(("", 8787))
            taken.listen()
        assert script(tmp_path / "beside.py", BESIDE) == ("here\n", "")


def test_without_dask(recordings, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    done = run_here(recordings[0], *small(), *MODEL, "--out", tmp_path)
    assert done.error == "sweep: distributed is not installed; pip install 'cmfpga[sweep]'"


def test_processors():
    assert task.processors() == len(os.sched_getaffinity(0))


@pytest.mark.usefixtures("long_tools")
def test_resources_once_per_hardware(recordings, tmp_path, monkeypatch):
    asked = []

    def estimate(verilog):
        asked.append(verilog)
        if "broken" in os.environ:
            raise resources.EstimateError("yosys stopped")
        return {"total": dict.fromkeys(resources.KINDS, 100 * len(asked)), "yosys": "0", "estimate": "none"}

    monkeypatch.setattr(resources, "estimate", estimate)
    monkeypatch.setattr(resources, "require_yosys", lambda: "0")
    options = [*small(iterations=None), *MODEL, "--resources", "--out", tmp_path]
    vary = ["--vary", "weight_frac=4,8", "iterations=4,9"]
    assert run_here(*recordings[:2], *options, *vary).status == 0
    assert len(asked) == 2 == len(set(asked))
    rows = pandas.read_csv(tmp_path / "results.csv")
    assert rows["resources.lut"].tolist() == [{4: 100, 8: 200}[bits] for bits in rows["config.weight_frac"]]
    assert run_here(*recordings, *options, *vary).status == 0
    assert len(asked) == 2
    monkeypatch.setenv("broken", "1")
    done = run_here(recordings[0], *options, "--vary", "weight_frac=5", "iterations=9")
    assert done.status == 0 and done.err == "note: no resources: yosys stopped\n"
    assert pandas.read_csv(tmp_path / "results.csv")["resources.lut"].isna().all()


def test_the_examples_of_help_can_be_planned():
    for example in sweep.EXAMPLES:
        options = sweep.parser().parse_args(shlex.split(example, comments=True)[2:])
        plan.choices(options.preset, options.assignments, options.vary)


def test_a_false_peak_at_rest_is_not_ranked_first(tmp_path):
    """Events on whole pixels have sharp edges at v = 0. Preset paper, which does not dither, stays near it: its
    contrast is higher than where the object really moves to."""
    scene = generate(
        seed=1, width=96, height=96, texture="dense", size=(40, 40), position=(40, 40), velocity=(120.0, 80.0),
        duration_us=40_000, noise=0.1,
    )  # fmt: skip
    write_hdf5(tmp_path / "a.h5", scene.events, 96, 96)
    options = ["--vary", "preset=paper,fast", "--batch-us", 12_000, "--batches", 2, "--json"]
    roi = "{},{}".format(*scene.roi_start(64, 64))
    done = run_here(tmp_path / "a.h5", "--roi", roi, *options, *MODEL, "--out", tmp_path / "out")
    assert [entry["label"] for entry in json.loads(done.out)["ranking"]] == ["preset = fast", "preset = paper"]
    found = pandas.read_csv(tmp_path / "out" / "results.csv").set_index("preset")
    assert found.contrast_mean["paper"] > 1.05 * found.contrast_mean["fast"]
    assert found.gain_median["fast"] > 1.04 > 1 > found.gain_median["paper"]


def test_json(recordings, tmp_path):
    make_recording(tmp_path / "x.h5", 5, (300.0, 0.0), truth=False)
    done = run_here(f"{tmp_path / 'x.h5'}@10,7", recordings[0], *OPTIONS, *MODEL, "--json", "--out", tmp_path / "out")
    found = json.loads(done.out)
    assert (found["rows"], found["kept"], found["without_result"]) == (16, 0, 0)
    assert sorted(entry["configuration"] for entry in found["ranking"]) == list(range(8))
    errors = [entry["error_px"] for entry in found["ranking"]]
    assert errors == sorted(errors)
