"""What a person can get wrong: one clear line, exit status 2, never a traceback."""

import argparse
import os
import re
import stat

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cmfpga import build, cli, track
from cmfpga.errors import UserError
from cmfpga.events import Events, write_hdf5

MODEL = ["--engine", "model", "--no-picture"]
BATCHES = ["--batch-events", "90", "--batches", "2"]
DOT = ["--roi", "8,9"]


@pytest.fixture
def refused(command, small, tmp_path):
    """``refused(recording, argument, …)``: the error of ``track`` with the small configuration and the model engine."""

    def refused(recording, *arguments):
        done = command(track, recording, *MODEL, "--out", tmp_path / "out", *small, *arguments)
        assert done.out == ""
        return done.error

    return refused


# ---------------------------------------------------------------- the recording


def text(content):
    return lambda path: path.write_bytes(content if isinstance(content, bytes) else content.encode())


def lines(count=200, **changed):
    """A plain text recording, some of its lines (from 1) given: ``_7="0.5 x y 1"``."""
    rows = [f"{k / 10_000:.6f} {k % 30} {k % 20} {k % 2}" for k in range(1, count + 1)]
    for number, line in changed.items():
        rows[int(number[1:]) - 1] = line
    return text("\n".join(rows) + "\n")


def table(rows):
    return lambda path: np.save(path, np.array(rows))


def columns(**arrays):
    def write(path):
        values = {"t": np.arange(200), "x": np.arange(200) % 30, "y": np.arange(200) % 20, "p": np.ones(200, int)}
        np.savez(path, **{name: array for name, array in {**values, **arrays}.items() if array is not None})

    return write


def truncated(path):
    events = Events(np.arange(5000), np.arange(5000) % 30, np.arange(5000) % 20, np.zeros(5000))
    write_hdf5(path, events, 32, 24)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


RECORDINGS = [
    # name, how it is made, message
    ("missing.h5", None, r"no such file"),
    ("folder.h5", lambda path: path.mkdir(), r"a directory; a file is needed"),
    ("empty.h5", text(""), r"the file is empty"),
    ("empty.txt", text(b""), r"the file is empty"),
    ("blank.txt", text(" \n\n\t\n"), r"no events"),
    ("comments.txt", text("# t x y p\n"), r"no events"),
    (
        "not.h5",
        text("0.1 2 3 1\n" * 3 + "\0"),
        r"named like HDF5, but does not begin like it: damaged, or of another .*",
    ),
    ("bytes.bin", text(bytes(range(256))), r"format not known; one of .*HDF5 \(\.h5, .*text \(\.txt, .* is needed"),
    ("truncated.h5", truncated, r"not a readable HDF5 file \(truncated or damaged\): .+"),
    ("header.h5", text(b"\x89HDF\r\n\x1a\n"), r"not a readable HDF5 file \(truncated or damaged\): .+"),
    ("zip.npz", text(b"PK\x03\x04 and nothing"), r"not a readable \.npz archive .+"),
    ("cut.txt", lines(_200="0.02 3"), r", line 200: 2 fields in '0\.02 3'; 4 are needed \(t x y p\)"),
    ("more.txt", lines(_1="0.02 3 4 1 5"), r", line 1: 5 fields in .*; 4 are needed \(t x y p\)"),
    ("letters.txt", lines(_7="0.0007 3 y 1"), r", line 7: y is 'y'; a number is needed"),
    ("html.txt", text("<!DOCTYPE html>\n<p>Not Found</p>\n"), r", line 1: 2 fields in .*; 4 are needed \(t x y p\)"),
    ("nan.txt", lines(_9="nan 3 4 1"), r", line 9: t is nan; a finite number is needed"),
    ("inf.txt", lines(_9="0.0009 inf 4 1"), r", line 9: x is inf; a finite number is needed"),
    ("half.txt", lines(_9="0.0009 3.5 4 1"), r", line 9: x is 3\.5; a whole number is needed"),
    ("huge.txt", lines(_9="1e400 3 4 1"), r", line 9: t is 1e400; fewer than 21 digits .*"),
    ("large.txt", lines(_9="1e19 3 4 1"), r", line 9: t is 1e19; less than 2\^62 µs is allowed"),
    ("x.txt", lines(_150="0.015 32 4 1"), r"x of event 149 is 32; 0 to 31 is allowed on a sensor of 32×24 px"),
    ("y.txt", lines(_50="0.005 3 24 1"), r"y of event 49 is 24; 0 to 23 is allowed on a sensor of 32×24 px"),
    ("minus.txt", lines(_50="0.005 -3 4 1"), r"x of event 49 is -3; 0 to 31 is allowed on a sensor of 32×24 px"),
    ("p.txt", lines(_50="0.005 3 4 2"), r"polarity of event 49 is 2; 0 and 1, or -1 and 1, are allowed"),
    (
        "back.txt",
        lines(_50="0.0048 3 4 1"),
        r"time stamp of event 49 is 4800 µs, after 4900 µs of the event before; .*",
    ),
    ("nan.npy", table([[0.1, 3, 4, 1], [np.nan, 3, 4, 1]]), r"time stamp of event 1 is nan; a finite number is needed"),
    ("three.npy", table([[1, 3, 4], [2, 3, 4]]), r"array of 2×3; N×4 with columns t, x, y, p is needed"),
    ("strings.npy", table([["1", "3", "4", "1"]]), r"t holds <U1; real numbers are needed"),
    ("objects.npy", lambda path: np.save(path, np.array([{}]), allow_pickle=True), r"not a readable \.npy file .+"),
    ("none.npy", table(np.zeros((0, 4))), r"no events"),
    ("no_p.npz", columns(p=None), r"p missing; p may be named p, ps, .*"),
    ("lengths.npz", columns(x=np.zeros(3)), r"sizes \(t: 200, x: 3, y: 200, p: 200\) differ .*"),
    (
        "back.npz",
        columns(t=np.r_[0:150, 0:50]),
        r"time stamp of event 150 is 0 µs, after 149 µs of the event before; .*",
    ),
    ("wide.npz", columns(x=np.full(200, 65536)), r"x of event 0 is 65536; 0 to 31 is allowed on a sensor of 32×24 px"),
    (
        "late.npz",
        columns(t=np.full(200, 2**62)),
        r"time stamp of event 0 is 4611686018427387904 .*less than 2\^62 µs .*",
    ),
]


@pytest.mark.parametrize("name, make, message", RECORDINGS, ids=[row[0] for row in RECORDINGS])
def test_recordings(refused, tmp_path, name, make, message):
    path = tmp_path / name
    if make:
        make(path)
    error = refused(
        path, *DOT, "--sensor", "32,24", "--batch-events", "90", "--time-unit", "us" if name[-1] in "zy" else "s"
    )
    assert error.startswith(str(path)) and re.search(message + "$", error), error


def test_a_recording_that_turns_bad_after_some_batches(refused, rows, tmp_path):
    """What was tracked before is kept."""
    lines(300, _280="0.0001 3 4 1")(tmp_path / "late.txt")
    refused(tmp_path / "late.txt", *DOT, "--sensor", "32,24", "--batch-events", "90")
    assert len(rows(tmp_path / "out")) in (0, 3)  # a chunk is checked as a whole


@pytest.mark.parametrize("name", ["davis346_traffic.aedat4", "prophesee_spinner_640x480_evt2.raw"])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_truncated_originals(command, rows, data_dir, tmp_path, name, share):
    """What was tracked before the place where the file ends is kept."""
    content = (data_dir / "original_formats" / name).read_bytes()
    path = tmp_path / name
    path.write_bytes(content[: int(share * len(content)) // 4 * 4 + 1])
    done = command(
        track, path, "--roi", "100,100", *MODEL, "--batch-events", "1000", "--set", "iterations=1", "--out", tmp_path
    )
    assert done.error.startswith(f"{path}: ") and "truncated" in done.error
    assert len(rows(tmp_path)) >= 2


def test_another_real_file(refused, data_dir):
    assert "4 are needed" in refused(data_dir / "README.md", *DOT)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
def test_a_pipe_is_not_waited_for(refused, tmp_path):
    os.mkfifo(tmp_path / "pipe.txt")
    assert "not a regular file" in refused(tmp_path / "pipe.txt", *DOT)


@pytest.mark.parametrize("name", ["größe.h5", "事件.h5", "two\nlines.h5", "$x$.h5", "\udce9.h5"])
def test_names_of_any_kind_are_told_in_one_line(refused, tmp_path, name):
    assert refused(tmp_path / name, *DOT).endswith("no such file")


# ---------------------------------------------------------------- events and ROI on the sensor


@pytest.mark.parametrize("engine", ["rtl", "model", "float"])
def test_events_outside_a_sensor_that_was_assumed(command, small, tmp_path, engine):
    """The file does not say how large it is, and ``--set`` is wrong. In 5 bits x = 40 would be x = 8."""
    columns(x=np.full(200, 40))(tmp_path / "wide.npz")
    done = command(
        track, tmp_path / "wide.npz", *DOT, *small, *BATCHES, "--engine", engine, "--no-picture", "--out", tmp_path,
        "--set", "sensor_width=32", "--set", "sensor_height=24",
    )  # fmt: skip
    assert done.error.startswith("x of an event is 40: 0 to 31 is allowed on a sensor of 32×24 px (")


@pytest.mark.parametrize("roi", ["25,0", "0,17", "32,24", f"{10**30},0", "-1,5", "5,-1"])
@pytest.mark.parametrize("engine", ["rtl", "model", "float"])
def test_an_roi_outside_the_sensor(command, dot, small, tmp_path, roi, engine, monkeypatch):
    monkeypatch.setattr(track, "_engine", None)  # refused before a simulator is compiled
    done = command(track, dot, f"--roi={roi}", *small, *BATCHES, "--engine", engine, "--out", tmp_path)
    assert done.error == f"ROI at {roi}: 0,0 to 24,16 is needed for 8×8 px on a sensor of 32×24 px"


def test_an_roi_larger_than_the_sensor(command, dot, tmp_path):
    done = command(track, dot, *DOT, *MODEL, "--out", tmp_path)
    assert done.error == "roi_width = 64: at most 32 is allowed (sensor_width)"


def test_an_roi_outside_the_scene(command, tmp_path):
    done = command(track, *MODEL, "--roi", "177,0", "--out", tmp_path)
    assert done.error == "ROI at 177,0: 0,0 to 176,116 is needed for 64×64 px on a sensor of 240×180 px"
    done = command(track, *MODEL, "--set", "roi_width=242", "--set", "sensor_width=256", "--out", tmp_path)
    assert done.error == "ROI of 242×64 px: 1×1 to 240×180 is allowed (sensor)"


# ---------------------------------------------------------------- options of track

HINT = " (--help lists the options)"
OPTIONS = [
    # arguments after a good recording, ROI and configuration; message
    (["--roi", "8"], "argument --roi: '8': X,Y, two whole numbers, is needed" + HINT),
    (["--roi", "8,9,10"], "argument --roi: '8,9,10': X,Y, two whole numbers, is needed" + HINT),
    (["--roi", "8.0,9"], "argument --roi: '8.0,9': X,Y, two whole numbers, is needed" + HINT),
    (["--roi", ""], "argument --roi: '': X,Y, two whole numbers, is needed" + HINT),
    (["--roi", "nan,inf"], "argument --roi: 'nan,inf': X,Y, two whole numbers, is needed" + HINT),
    (["--roi", "-1,5"], "ROI at -1,5: 0,0 to 24,16 is needed for 8×8 px on a sensor of 32×24 px"),
    (["--roi=--"], "argument --roi: '--' is no value" + HINT),
    (["--roi"], "argument --roi: expected one argument" + HINT),
    (["--batches", "0"], "argument --batches: '0': a whole number of 1 or more is needed" + HINT),
    (["--batches", "-1"], "argument --batches: '-1': a whole number of 1 or more is needed" + HINT),
    (["--batches", "1.5"], "argument --batches: '1.5': a whole number of 1 or more is needed" + HINT),
    (["--batch-events", "0"], "argument --batch-events: '0': a whole number of 1 or more is needed" + HINT),
    (["--batch-events", "1e3"], "argument --batch-events: '1e3': a whole number of 1 or more is needed" + HINT),
    (["--batch-us", ""], "argument --batch-us: '': a whole number of 1 or more is needed" + HINT),
    (["--batch-roi-events", "all"], "argument --batch-roi-events: 'all': a whole number of 1 or more is needed" + HINT),
    (["--batch-us", "9", "--batch-events", "9"],
     "argument --batch-events: not allowed with argument --batch-us" + HINT),
    (["--batch-us", "9", "--batch-roi-events", "9"],
     "argument --batch-roi-events: not allowed with argument --batch-us" + HINT),
    (["--start-event", "-1"], "argument --start-event: '-1': a whole number of 0 or more is needed" + HINT),
    (["--start-event", "x"], "argument --start-event: 'x': a whole number of 0 or more is needed" + HINT),
    (["--start-event", "600", *BATCHES], "DOT: first event 600; 0 to 599 is allowed"),
    (["--start-event", str(10**30), *BATCHES], f"DOT: first event {10**30}; 0 to 599 is allowed"),
    (["--start-event", "590", "--batch-events", "11"], "DOT: too few events for one batch after event 590 (10 left)"),
    (["--batch-us", str(10**30), "--set", "max_batch_events=600"],
     "DOT: too few events for one batch after event 0 (600 left)"),
    (["--batch-events", "101"], "--batch-events 101: at most 100 is allowed (max_batch_events)"),
    (["--batch-roi-events", "101"], "--batch-roi-events 101: at most 100 is allowed (max_batch_events)"),
    ([], "--batch-events 5000: at most 100 is allowed (max_batch_events)"),
    (["--batch-events", str(10**30)], f"--batch-events {10**30}: at most 100 is allowed (max_batch_events)"),
    (["--engine", "fpga"], "argument --engine: invalid choice: 'fpga' (choose from "),
    (["--time-unit", "h"], "argument --time-unit: invalid choice: 'h' (choose from "),
    (["--preset", "Paper"], "preset 'Paper': one of paper, fast, "),
    (["--preset", ""], "preset '': one of paper, fast, "),
    (["--sensor", "32"], "argument --sensor: '32': W,H, two whole numbers, is needed" + HINT),
    (["--sensor", "0,24"], "DOT: sensor of 0×24 px; 1 to 65536 each is allowed"),
    (["--sensor", f"{10**30},24"], f"DOT: sensor of {10**30}×24 px; 1 to 65536 each is allowed"),
    (["--sensor", "5000,24"], "sensor_width = 5000: 2 to 4096 is needed"),
    (["--sensor", "1,1"], "sensor_width = 1: 2 to 4096 is needed"),
    (["--sensor", "16,24", *BATCHES], "DOT: x of event "),
    (["--set", "eta"], "'eta': FIELD=VALUE is needed"),
    (["--set", ""], "'': FIELD=VALUE is needed"),
    (["--set", "=1"], "'': no such field; the fields are sensor_width, "),
    (["--set", "two\nlines=1"], r"'two\nlines': no such field; the fields are "),
    (["--set", "größe=1"], "'größe': no such field; the fields are "),
    (["--set", "eta=nan"], "eta = nan: 0.0 or more is needed"),
    (["--set", "eta=-inf"], "eta = -inf: 0.0 or more is needed"),
    (["--set", "eta=1e400"], "eta = inf: 0 to 63.999 is needed (UQ6.10)"),
    (["--set", "v_start_x=nan"], "v_start_x = nan: a number is needed"),
    (["--set", "v_start_x=1e30"], "v_start_x = 1e+30: -8 to 7.99976 is needed (Q3.12)"),
    (["--set", "iterations="], "iterations = '': an integer is needed"),
    (["--set", "iterations=1e400"], "iterations = '1e400': an integer is needed"),
    (["--set", "iterations=0"], "iterations = 0: 1 to 65535 is needed"),
    (["--set", "iterations=16"], "iterations = 16: at most 15 is allowed (max_iterations)"),
    (["--set", f"buffer_events={10**30}"], f"buffer_events = {10**30}: 1 to 131072 is needed"),
    (["--set", "roi_width=7"], "roi_width = 7: an even number of pixels is needed"),
    (["--set", "start=first"], "start = 'first': one of zero, given, last is needed"),
    (["--set", "eta=0.1", "--set", "eta=x"], "eta = 'x': a number is needed"),
    (["--set", "eta", "1"], "unrecognized arguments: 1" + HINT),
    (["--ste", "eta=1"], "unrecognized arguments: --ste eta=1" + HINT),
    (["--batch", "1"], "ambiguous option: --batch could match "),
    (["another.h5"], "unrecognized arguments: another.h5" + HINT),
]  # fmt: skip


@pytest.mark.parametrize("arguments, message", OPTIONS, ids=[" ".join(row[0])[:40] for row in OPTIONS])
def test_options(refused, dot, arguments, message):
    error = refused(dot, *([] if arguments and arguments[0].startswith("--roi") else DOT), *arguments)
    assert error.startswith(message.replace("DOT", str(dot))), error
    assert len(error) < 700


def test_a_recording_needs_an_roi(refused, dot):
    expected = "--roi X,Y: the ROI's left column and top row are needed with a recording; or --roi auto"
    assert refused(dot) == expected


@pytest.mark.parametrize("option", [["--sensor", "32,24"], ["--time-unit", "us"]])
def test_what_is_said_of_a_recording_that_is_not_there(command, tmp_path, option):
    error = command(track, *MODEL, *option, "--out", tmp_path).error
    assert error.startswith(option[0]) and error.endswith("a RECORDING is needed; the synthetic scene has its own")


def test_two_recordings_side_by_side(refused, dot):
    assert refused(dot, dot, *DOT).startswith("unrecognized arguments: ")


# ---------------------------------------------------------------- where to write


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
        done = command(track, dot, *DOT, *BATCHES, "--engine", "model", *small, "--out", tmp_path)
    else:
        done = command(build, "--set", "roi_width=4", "--set", "roi_height=4", "--out", tmp_path)
    assert done.error == f"{tmp_path / name}: Is a directory"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full device on this system")
def test_a_full_disk(command, dot, small, tmp_path):
    (tmp_path / "track.csv").symlink_to("/dev/full")
    done = command(track, dot, *DOT, *BATCHES, *MODEL, *small, "--out", tmp_path)
    assert "No space left on device" in done.error


def test_a_cache_that_cannot_be_made(command, dot, small, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "file"))
    done = command(track, dot, *DOT, *BATCHES, *small, "--out", tmp_path)
    if done.status:  # there is a compiler
        assert done.error.startswith(f"{tmp_path / 'file'}: cannot be made, for compiled simulators: ")


# ---------------------------------------------------------------- build


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--set", "gradient=sweep", "--set", "roi_width=63"], "roi_width = 63: an even number of pixels is needed"),
        (["--set", "roi_height=4098", "--set", "sensor_height=4096"], "roi_height = 4098: 2 to 4096 is needed"),
        (["--set", "buffer_events=131073"], "buffer_events = 131073: 1 to 131072 is needed"),
        (["--preset", "paper", "--set", "buffer_events=131072"], "G = P·S − ΣI·ΣD needs 64 bits, more than the 63 "),
        (["--set", "gradient=scan"], "gradient = 'scan': one of sweep, one_pass is needed"),
        (["--preset", "fast", "--set", "cold=2:9"], "cold: '2:9': a log2 step of -6 to 4 is needed (Q5.6)"),
        (["--preset", "fast", "--set", "warm="], "warm: 0 iterations: 1 to 32 are needed (schedule_entries)"),
        (
            ["--preset", "paper", "--set", "ascent=sign", "--set", "cold=2:2"],
            "cold: '2:2': level 0 to 0 is needed (max_",
        ),
        (
            ["--set", "max_iterations=2", "--set", "iterations=2"],
            "cold: 15 iterations; at most 2 are allowed (max_iter",
        ),
        (["--preset", "nope"], "preset 'nope': one of paper, fast, "),
        (["--set"], "argument --set: expected one argument" + HINT),
        (["paper"], "unrecognized arguments: paper" + HINT),
        (["--roi", "1,2"], "unrecognized arguments: --roi 1,2" + HINT),
    ],
)
def test_build(command, tmp_path, arguments, message):
    done = command(build, "--out", tmp_path / "out", *arguments)
    assert done.error.startswith(message) and done.out == ""
    assert not (tmp_path / "out").exists()


def test_an_architecture_that_cannot_work(process):
    """No engine runs it."""
    for command in (("build",), ("track", "--engine", "model")):
        done = process(*command, "--preset", "full-frame", "--set", "tag_bits=4", "--out", "out")
        assert done.error.startswith("tag_bits = 4: ") and "11520 words of a bank are needed" in done.error


# ---------------------------------------------------------------- in processes of their own


def test_in_a_process_of_its_own(process, dot, tmp_path):
    assert process("track", "missing.h5", *DOT).error == "missing.h5: no such file"
    assert process("build", "--set", "eta=nan", PYTHONIOENCODING="ascii").error == "eta = nan: 0.0 or more is needed"
    done = process("track", dot, "--roi", "8", PYTHONIOENCODING="ascii")
    assert done.error == "argument --roi: '8': X,Y, two whole numbers, is needed" + HINT
    # Signs that the terminal has not are spelled out.
    done = process(
        "track", dot, "--roi", "100,9", "--set", "roi_width=8", "--set", "roi_height=8", PYTHONIOENCODING="ascii"
    )
    assert done.error == r"ROI at 100,9: 0,0 to 24,16 is needed for 8\xd78 px on a sensor of 32\xd724 px"


def test_a_closed_pipe_is_no_error(monkeypatch):
    class Closed:
        closed = False

        def close(self):
            self.closed = True

    def broken(_):
        raise BrokenPipeError

    monkeypatch.setattr("sys.stderr", Closed())
    assert cli.run(broken) == 1 and cli.sys.stderr.closed


def test_interrupted(capsys):
    def interrupted(_):
        raise KeyboardInterrupt

    assert cli.run(interrupted) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_defects_keep_their_traceback():
    """Only what a person can mend is made short."""

    def defect(_):
        raise ValueError("a defect")

    with pytest.raises(ValueError, match="a defect"):
        cli.run(defect)


def test_parsers_of_options():
    assert cli.pair("X,Y")("3,-4") == (3, -4) and cli.positive("1") == 1 and cli.natural("0") == 0
    for parse, bad in ((cli.pair("X,Y"), "3"), (cli.positive, "0"), (cli.natural, "-1"), (cli.positive, "9" * 5000)):
        with pytest.raises(argparse.ArgumentTypeError, match="needed"):
            parse(bad)
    with pytest.raises(UserError, match=r"^unrecognized arguments: --x \(--help lists the options\)$"):
        cli.parser("x", "", ()).parse_args(["--x"])


# ---------------------------------------------------------------- anything

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
