"""What a person can get wrong, a full disk, an interruption: one clear line, exit status 2, never a traceback."""

import argparse
import io
import os
import re
import stat
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from filelock import FileLock
from hypothesis import given, settings
from hypothesis import strategies as st

from cmfpga import cli
from cmfpga.cli import build, track
from cmfpga.config import Config

MODEL = ["--engine", "model", "--no-picture"]
BATCHES = ["--batch-events", "90", "--batches", "2"]
HUGE = str(10**30)
DOT = ["--roi", "8,9"]


@pytest.fixture
def refused(command, small, tmp_path):
    """``refused(recording, argument, …)``: the error of ``track`` with the small configuration and the model engine."""

    def refused(recording, *arguments):
        done = command(track, recording, *MODEL, "--out", tmp_path / "out", *small, *arguments)
        assert done.out == ""
        return done.error

    return refused


RECORDINGS = [
    # name, how it is made, message; what else the readers refuse is in tests/events
    ("missing.h5", None, r"no such file"),
    ("html.txt", lambda path: path.write_text("<!DOCTYPE html>\n<p>Not Found</p>\n"), r", line 1: 2 fields in .*"),
    ("wide.npz", lambda path: np.savez(path, t=range(200), x=[65536] * 200, y=[0] * 200, p=[1] * 200),
     r"x of event 0 is 65536; 0 to 31 is allowed on a sensor of 32×24 px"),
    *((f"{name}.h5", None, "no such file") for name in ("größe", "事件", "two\nlines", "$x$", "\udce9")),
]  # fmt: skip


@pytest.mark.parametrize("name, make, message", RECORDINGS, ids=[row[0] for row in RECORDINGS])
def test_recordings(refused, tmp_path, name, make, message):
    path = tmp_path / name
    if make:
        make(path)
    error = refused(path, *DOT, "--sensor", "32,24", "--batch-events", "90", "--time-unit", "us")
    assert error.startswith(str(path).replace("\n", " ")) and re.search(message + "$", error), error


def test_a_recording_that_turns_bad_after_some_batches(refused, rows, tmp_path):
    """What was tracked before is kept."""
    times = [k / 10_000 if k != 280 else 0.0001 for k in range(1, 301)]
    (tmp_path / "late.txt").write_text("".join(f"{t:.6f} {k % 30} {k % 20} 1\n" for k, t in enumerate(times)))
    refused(tmp_path / "late.txt", *DOT, "--sensor", "32,24", "--batch-events", "90")
    assert len(rows(tmp_path / "out")) in (0, 3)  # a chunk is checked as a whole


@pytest.mark.parametrize("name", ["davis346_traffic.aedat4", "prophesee_spinner_640x480_evt2.raw"])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_truncated_originals(command, rows, data_dir, tmp_path, name, share):
    """What was tracked before the place where the file ends is kept."""
    content = (data_dir / "original_formats" / name).read_bytes()
    path = tmp_path / name
    path.write_bytes(content[: int(share * len(content)) // 4 * 4 + 1])
    options = ["--roi", "100,100", *MODEL, "--batch-events", 1000, "--set", "cold=0:1:1"]
    done = command(track, path, *options, "--out", tmp_path)
    assert done.error.startswith(f"{path}: ") and "truncated" in done.error
    assert len(rows(tmp_path)) >= 2


@pytest.mark.parametrize("roi", ["25,0", "0,17", "32,24", f"{10**30},0", "-1,5", "5,-1"])
def test_an_roi_outside_the_sensor(refused, dot, roi, monkeypatch):
    monkeypatch.setattr(track, "open_engine", None)  # refused before a simulator is compiled
    error = f"ROI at {roi}: 0,0 to 24,16 is needed for 8×8 px on a sensor of 32×24 px"
    assert refused(dot, f"--roi={roi}", *BATCHES) == error


def test_sizes_that_do_not_fit(command, dot, tmp_path):
    larger = ["--preset", "paper", "--set", "roi_width=242", "--set", "sensor_width=256"]
    for arguments, message in (
        ([dot, *DOT], "roi_width = 64: at most 32 is allowed (sensor_width)"),
        (["--roi", "177,0"], "ROI at 177,0: 0,0 to 176,116 is needed for 64×64 px on a sensor of 240×180 px"),
        (larger, "ROI of 242×64 px: 1×1 to 240×180 is allowed (sensor)"),
    ):
        assert command(track, *arguments, *MODEL, "--out", tmp_path).error == message


HINT = " (--help lists the options)"
WHOLE = "a whole number of 1 or more is needed" + HINT
PAIR = "two whole numbers, is needed" + HINT
OPTIONS = [
    # arguments after a good recording, ROI and configuration; message
    *((["--roi", roi], f"argument --roi: '{roi}': X,Y, {PAIR}") for roi in ("8", "8,9,10", "8.0,9", "", "nan,inf")),
    (["--roi=--"], "argument --roi: '--' is no value" + HINT),
    ([], "--roi X,Y: the ROI's left column and top row are needed with a recording; or --roi auto"),
    *(([option, value], f"argument {option}: '{value}': {WHOLE}") for option, value in
      (("--batches", "0"), ("--batches", "-1"), ("--batches", "1.5"), ("--batch-events", "0"),
       ("--batch-events", "1e3"), ("--batch-us", ""), ("--batch-roi-events", "all"))),
    *((["--batch-us", "9", option, "9"], f"argument {option}: not allowed with argument --batch-us" + HINT)
      for option in ("--batch-events", "--batch-roi-events")),
    *((["--start-event", value], f"argument --start-event: '{value}': a whole number of 0 or more is needed" + HINT)
      for value in ("-1", "x")),
    *((["--start-event", value, *BATCHES], f"DOT: first event {value}; 0 to 599 is allowed")
      for value in ("600", HUGE)),
    (["--start-event", "590", "--batch-events", "11"], "DOT: too few events for one batch after event 590 (10 left)"),
    (["--batch-us", HUGE, "--set", "max_batch_events=600"],
     "DOT: too few events for one batch after event 0 (600 left)"),
    *(([option, value], f"{option} {value}: at most 100 is allowed (max_batch_events)") for option, value in
      (("--batch-events", "101"), ("--batch-roi-events", "101"), ("--batch-events", HUGE))),
    (["--engine", "fpga"], "argument --engine: engine 'fpga': one of rtl, model, float, axi, serial:PORT is needed"),
    (["--time-unit", "h"], "argument --time-unit: invalid choice: 'h' (choose from "),
    (["--preset", "fsat"], "preset 'fsat': did you mean 'fast'? One of paper, fast, "),
    (["--preset", ""], "preset '': one of paper, fast, "),
    (["--sensor", "32"], "argument --sensor: '32': W,H, " + PAIR),
    *((["--sensor", f"{width},24"], f"DOT: sensor of {width}×24 px; 1 to 65536 each is allowed")
      for width in ("0", HUGE)),
    (["--sensor", "1,1"], "sensor_width = 1: 2 to 4096 is needed"),
    (["--sensor", "16,24", *BATCHES], "DOT: x of event "),
    (["--set", "two\nlines=1"], r"'two\nlines': no such field; "),
    (["--set", "größe=1"], "'größe': no such field; "),
    (["--set", "eta", "1"], "unrecognized arguments: 1" + HINT),
    (["--ste", "eta=1"], "unrecognized arguments: --ste eta=1; did you mean '--set'?" + HINT),
    (["--bacth-us=9"], "unrecognized arguments: --bacth-us=9; did you mean '--batch-us'?" + HINT),
    (["--quick"], "unrecognized arguments: --quick" + HINT),
    (["--batch", "1"], "ambiguous option: --batch could match "),
    (["another.h5"], "unrecognized arguments: another.h5" + HINT),
]  # fmt: skip


@pytest.mark.parametrize("arguments, message", OPTIONS, ids=[" ".join(row[0])[:40] for row in OPTIONS])
def test_options(refused, dot, arguments, message):
    error = refused(dot, *([] if not arguments or arguments[0].startswith("--roi") else DOT), *arguments)
    assert error.startswith(message.replace("DOT", str(dot))), error
    fields = ", ".join(Config().to_dict())  # grow with the hardware
    assert len(error.replace(fields, "")) < (100 if fields in error else 700)


def test_what_is_said_of_a_recording_that_is_not_there(command, tmp_path):
    for option in (["--sensor", "32,24"], ["--time-unit", "us"]):
        error = command(track, *MODEL, *option, "--out", tmp_path).error
        assert error.startswith(option[0]) and error.endswith("a RECORDING is needed; the synthetic scene has its own")


@pytest.mark.parametrize("module", [track, build])
def test_folders_that_cannot_be_written(command, dot, small, tmp_path, module):
    (tmp_path / "file").write_text("mine")
    arguments = [dot, *DOT, *BATCHES, *MODEL] if module is track else []
    for out, reason in (
        (tmp_path / "file", "File exists|Not a directory"),
        (tmp_path / "file" / "sub", "Not a directory"),
        (tmp_path / ("x" * 300), "File name too long"),
        ("nul\0byte", "embedded null byte|.*null character.*"),
    ):
        done = command(module, *arguments, *small, "--out", out)
        assert re.fullmatch(rf"--out {re.escape(str(out))}: cannot be written: ({reason})", done.error)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(command, tmp_path):
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert command(build, "--out", tmp_path).error == f"--out {tmp_path}: cannot be written: Permission denied"


@pytest.mark.parametrize("name", ["track.csv", "track.png", "cmfpga_core.v"])
def test_a_folder_where_a_file_is_to_be(command, dot, small, tmp_path, name):
    (tmp_path / name).mkdir()
    if name.startswith("track"):
        arguments = [track, dot, *DOT, *BATCHES, "--engine", "model", *small]
    else:
        arguments = [build, "--set", "roi_width=4", "--set", "roi_height=4"]
    assert command(*arguments, "--out", tmp_path).error == f"{tmp_path / name}: Is a directory"


@pytest.mark.parametrize("arguments, message", [
    (["--preset", "fast", "--set", "warm="], "warm: 0 iterations: 1 to 32 are needed (schedule_entries)"),
    (["paper"], "unrecognized arguments: paper" + HINT),
    (["--roi", "1,2"], "unrecognized arguments: --roi 1,2" + HINT),
    (["--set", "evt3=1"], "evt3 = 1: cmfpga_core takes events, not words; a board's top decodes them: --top kv260"),
])  # fmt: skip
def test_build(command, tmp_path, arguments, message):
    done = command(build, "--out", tmp_path / "out", *arguments)
    assert done.error.startswith(message) and done.out == ""
    assert not (tmp_path / "out").exists()


def test_an_architecture_that_cannot_work(command, tmp_path):
    """No engine runs it."""
    for module, options in ((build, []), (track, ["--engine", "model"])):
        done = command(module, *options, "--preset", "full-frame", "--set", "tag_bits=4", "--out", tmp_path)
        assert done.error.startswith("tag_bits = 4: ") and "11520 words of a bank are needed" in done.error


def test_in_a_process_of_its_own(process, dot, tmp_path):
    done = process("build", "--set", "roi_gain=-1", PYTHONIOENCODING="ascii")
    assert done.error == "roi_gain = -1.0: 0.0 or more is needed"
    # Signs that the terminal has not are spelled out.
    size = ["--set", "roi_width=8", "--set", "roi_height=8"]
    done = process("track", dot, "--roi", "100,9", *size, PYTHONIOENCODING="ascii")
    assert done.error == r"ROI at 100,9: 0,0 to 24,16 is needed for 8\xd78 px on a sensor of 32\xd724 px"


def test_how_a_command_ends(monkeypatch, capsys):
    """Interrupted; its reader gone, which is no error; and defects, which keep their traceback."""
    assert cli.run(Mock(side_effect=KeyboardInterrupt)) == 130
    assert capsys.readouterr().err == "interrupted\n"
    with pytest.raises(ValueError, match="a defect"):
        cli.run(Mock(side_effect=ValueError("a defect")))
    stderr = io.StringIO()
    monkeypatch.setattr("sys.stderr", stderr)
    assert cli.run(Mock(side_effect=BrokenPipeError)) == 1 and stderr.closed


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("name, options", [
    ("track.csv", ["--no-picture"]), ("track.png", []), ("track.npz", ["--report"]), ("report.html", ["--report"]),
])  # fmt: skip
def test_a_full_disk(command, dot, small, tmp_path, name, options):
    (tmp_path / name).symlink_to("/dev/full")
    done = command(track, dot, *DOT, "--engine", "model", *BATCHES, *small, *options, "--out", tmp_path)
    assert done.error == f"{tmp_path / name}: No space left on device"


def test_two_tracks_into_one_folder(command, dot, small, tmp_path):
    options = (track, dot, *DOT, *MODEL, *BATCHES, *small, "--out", tmp_path)
    with FileLock(tmp_path / ".lock"):
        assert command(*options).error.startswith(f"--out {tmp_path}: another command is writing there")
    assert command(*options).status == 0 and [path.name for path in tmp_path.iterdir()] == ["track.csv"]


INTERRUPTED = {
    # No warnings of Amaranth about blocks that were made and not used.
    "while a block is elaborated": """
import sys; from cmfpga import cli; from cmfpga.cli import build
from cmfpga.rtl.image.voter import BilinearVoter
def interrupt(*_): raise KeyboardInterrupt
BilinearVoter.elaborate = interrupt; sys.exit(cli.run(build.main, ['--out', sys.argv[1]]))
""",
    # Python ignores what is raised there.
    "in a destructor": """
import signal, sys, time; from cmfpga import cli
signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it is ignored
class Held:
    def __del__(self): signal.raise_signal(signal.SIGINT)
def main(_): Held(); time.sleep(60)
sys.exit(cli.run(main))
""",
}


@pytest.mark.parametrize("when", INTERRUPTED)
def test_interrupted(tmp_path, when):
    done = subprocess.run([sys.executable, "-c", INTERRUPTED[when], tmp_path], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_a_number_of_too_many_digits():
    """For Python's own conversion."""
    with pytest.raises(argparse.ArgumentTypeError, match="needed"):
        cli.positive("9" * 5000)


# Values that are small if they are good, so that no example runs long.
VALUES = st.sampled_from(
    ["", "--", "auto", "a=8,9", "0", "-1", "1", "2", "8", "-0", "1.0", "8,9", "8,", "٣", "1_0", " 8", "nan", "-inf",
     "1e400", "-1e-400", "0x8", "1e1", "=", "8=8", "last", "zero", "ä", "\n", "\t", "-", "'", "%s", "\udce9", "\0",
     "model", "us", "9" * 40]
)  # fmt: skip
FIELDS = st.sampled_from(
    ["eta", "iterations", "roi_width", "roi_height", "buffer_events", "start", "v_start_x", "roi_gain", "dt_frac",
     "v_int", "v_frac", "position_frac", "weight_frac", "reciprocal_bits", "gradient_frac", "max_batch_events",
     "time_bits", "span_bits", "min_roi_events", "sensor_width", "nope", ""]
)  # fmt: skip
ARGUMENT = st.one_of(
    st.tuples(st.sampled_from(["--roi", "--batch-events", "--batch-us", "--batch-roi-events", "--start-event",
                               "--sensor", "--time-unit", "--preset", "--engine", "--batch", "--x"]), VALUES),
    st.builds(lambda field, value: ("--set", f"{field}={value}"), FIELDS, VALUES),
    st.builds(lambda field, value: ("--set", f"{field}={value}"), FIELDS, st.integers(-1, 17)),
    st.builds(lambda option, value: (option, f"{value}"), st.sampled_from(["--batch-events", "--batch-us"]),
              st.integers(1, 600)),
    st.builds(lambda x, y: ("--roi", f"{x},{y}"), st.integers(0, 26), st.integers(0, 18)),
    st.builds(lambda option, value: (f"{option}={value}",), st.sampled_from(["--roi", "--sensor", "--set"]), VALUES),
)  # fmt: skip


@given(st.lists(ARGUMENT, max_size=4))
@settings(derandomize=True, deadline=None, max_examples=300)
def test_any_options_work_or_are_refused(command, dot, small, tmp_path_factory, arguments):
    out = tmp_path_factory.getbasetemp() / "any"
    given = [part for argument in arguments for part in argument]
    if "rtl" in given:
        return
    size = [] if any(part.startswith("--batch-") for part in given) else ["--batch-events", "50"]
    done = command(track, dot, *DOT, *MODEL, "--batches", "2", "--out", out, *small, *size, *given)
    if done.status == 0:
        several = given.count("--roi") + sum(part.startswith("--roi=") for part in given) > 0
        assert done.out.startswith(("0: ",) if several else ("1 batches", "2 batches"))
        assert (out / f"track{'-0' * several}.csv").exists()
    else:
        assert done.error and done.out == ""
