"""``python -m cmfpga.track``: the CSV, the picture and the summary, on made-up and on real recordings."""

import json
import re

import matplotlib.image
import numpy as np
import pytest

from cmfpga import build, cli, track
from cmfpga.config import Config
from cmfpga.engines import make_engine
from cmfpga.events import BatchCutter, Events, open_recording, write_hdf5
from cmfpga.protocol.flags import Flag
from cmfpga.tracking import loop as tracker
from cmfpga.verilog.compiler import find_compiler

DOT = ["--roi", "8,9"]


@pytest.fixture
def compiler():
    if find_compiler() is None:
        pytest.skip("no C++ compiler")


def floats(rows, name):
    return np.array([float(row[name]) for row in rows])


def flags(rows):
    return [row["flags"] for row in rows]


def but_cycles(rows):
    return [{**row, "cycles": ""} for row in rows]


def looks_like_a_track(path, *, moves=True):
    """Large enough to read, and with what must be on it: the ROI in red, and in cyan its trail if it moves."""
    pixels = matplotlib.image.imread(path)[..., :3]
    height, width, _ = pixels.shape
    assert 800 <= height <= 1200 and 1300 <= width <= 1800
    assert 20_000 < path.stat().st_size < 2_000_000
    assert 0.1 < pixels.mean() < 0.95 and pixels.std() > 0.1

    def share(colour):
        return (np.abs(pixels - colour).max(axis=2) < 0.02).mean()

    assert share((0, 0, 0)) > 0.05  # sensor frames, black where no event was
    assert share((0.8392, 0.1529, 0.1569)) > 1e-4  # tab:red
    assert (share((0.0902, 0.7451, 0.8118)) > 1e-5) == moves  # tab:cyan
    return share


# ---------------------------------------------------------------- engines and files


MODES = [("--batch-events", "90", 6), ("--batch-us", "900", 6), ("--batch-roi-events", "30", None)]


@pytest.mark.parametrize("mode, size, count", MODES, ids=[mode[0] for mode in MODES])
def test_verilog_and_model_write_the_same(compiler, command, rows, dot, small, tmp_path, mode, size, count):
    written = {}
    for engine in ("rtl", "model"):
        done = command(
            track, dot, *DOT, mode, size, *small, "--engine", engine, "--no-picture", "--out", tmp_path / engine
        )
        assert done.status == 0 and done.err == ""
        written[engine] = rows(tmp_path / engine)
        assert sorted(path.name for path in (tmp_path / engine).iterdir()) == ["track.csv"]
        assert done.out.splitlines()[0].startswith(f"{len(written[engine])} batches tracked ({engine} engine), ")
    assert but_cycles(written["rtl"]) == written["model"]
    assert len(written["rtl"]) == count or (count is None and len(written["rtl"]) >= 10)
    assert {row["cycles"] for row in written["model"]} == {""}
    measured = [row for row in written["rtl"] if "degenerate" not in row["flags"]]
    assert len(measured) > 5
    for row in measured:
        # N + T·(n + 16 + L) + constant, from a core of 8×8 px
        assert int(row["cycles"]) == int(row["events"]) + 15 * (int(row["roi_events"]) + 16 + 19) + 44
        assert row["iterations"] == "15"


def test_the_float_engine(command, rows, dot, small, tmp_path):
    done = command(track, dot, *DOT, "--batch-events", 90, *small, "--engine", "float", "--out", tmp_path)
    assert done.status == 0 and "6 batches tracked (float engine)" in done.out and "cycles" not in done.out
    assert {row["cycles"] for row in rows(tmp_path)} == {""}
    looks_like_a_track(tmp_path / "track.png")


def test_the_roi_follows_the_dot(command, rows, dot, small, tmp_path):
    """It moves by 2.25 px, which is 1.125 px per half batch, in each of six batches."""
    done = command(
        track, dot, *DOT, "--batch-events", 90, *small, "--engine", "model", "--out", tmp_path, "--no-picture"
    )
    assert done.status == 0
    found = rows(tmp_path)
    assert found[0]["roi_x"] == "8" and 17 <= int(found[-1]["roi_x"]) <= 21
    np.testing.assert_allclose(floats(found, "vx_px_per_s").mean(), 2500, rtol=0.2)
    for row in found:
        half_range = 89 * 10 / 2e6
        assert float(row["vx_px_per_s"]) == pytest.approx(float(row["vx"]) / half_range, abs=5e-4)
        assert float(row["vy_px_per_s"]) == pytest.approx(float(row["vy"]) / half_range, abs=5e-4)
        assert float(row["t_ref_us"]) == 50_000 + 900 * int(row["batch"]) + 445


def test_batches_begin_where_they_are_told_and_stop(command, rows, dot, dot_events, small, tmp_path):
    done = command(
        track, dot, *DOT, "--batch-events", 50, *small, "--engine", "model", "--start-event", 123, "--batches", 3,
        "--out", tmp_path, "--no-picture",
    )  # fmt: skip
    assert done.status == 0 and "3 batches tracked" in done.out
    found = rows(tmp_path)
    assert floats(found, "t_ref_us").tolist() == [float(dot_events.t[123 + 50 * k]) + 245 for k in range(3)]
    # All the events of the first ROI, counted here.
    x, y = dot_events.x[123:173].astype(int) - 8, dot_events.y[123:173].astype(int) - 9
    assert int(found[0]["roi_events"]) == ((x >= 0) & (x < 8) & (y >= 0) & (y < 8)).sum()


def test_left_over_events_are_counted(command, dot, small, tmp_path):
    done = command(track, dot, *DOT, "--batch-events", 90, *small, "--engine", "model", "--out", tmp_path)
    assert "6 batches tracked (model engine), " in done.out and ", 60 events left over" in done.out
    assert done.out.splitlines()[-2:] == [f"wrote {tmp_path / name}" for name in ("track.csv", "track.png")]
    looks_like_a_track(tmp_path / "track.png")


def test_the_defaults(command, rows, tmp_path):
    """5000 events, preset fast, ./cmfpga-track; here with a text file that says its sensor's size."""
    lines = ["240 180"] + [f"{k * 1e-5:.6f} {k % 64} {k % 7} {k % 2}" for k in range(5001)]
    (tmp_path / "events.txt").write_text("\n".join(lines))
    done = command(
        track, tmp_path / "events.txt", "--roi", "0,0", "--engine", "model", "--set", "buffer_events=5000",
        "--out", tmp_path / "a",
    )  # fmt: skip
    assert done.err == "" and [row["events"] for row in rows(tmp_path / "a")] == ["5000"]
    options = track._parser().parse_args(["x"])
    assert (options.engine, options.out, options.preset, options.start_event) == ("rtl", "cmfpga-track", "fast", 0)


def test_a_summary_as_json(command, dot, small, tmp_path):
    done = command(track, dot, *DOT, "--batch-events", 90, *small, "--engine", "model", "--json", "--out", tmp_path)
    summary = json.loads(done.out)
    assert done.err == ""
    config = summary.pop("config")
    assert Config(**config).sensor_width == 32 and config["roi_width"] == 8 and config["iterations"] == 15
    assert re.fullmatch(r"\[\d+, \d+\]", str(summary.pop("roi_next")))
    assert summary == {
        "engine": "model", "batches": 6, "events_left_over": 60,
        "batches_with_warnings": summary["batches_with_warnings"], "cycles": None,
        "files": [str(tmp_path / "track.csv"), str(tmp_path / "track.png")],
    }  # fmt: skip


def test_every_format_gives_the_same_track(command, rows, dot, dot_events, small, tmp_path):
    t, x, y, p = dot_events.t, dot_events.x, dot_events.y, dot_events.p
    (tmp_path / "dot.txt").write_text(
        "".join(f"{a / 1e6:.6f} {b} {c} {d}\n" for a, b, c, d in zip(t, x, y, p, strict=True))
    )
    np.savez(tmp_path / "dot.npz", t=t, x=x, y=y, p=p)
    np.save(tmp_path / "dot.npy", np.stack([t * 1000, x, y, p], axis=1).astype(np.int64))
    results = []
    for path, options in (
        (dot, []),
        (tmp_path / "dot.txt", ["--sensor", "32,24"]),
        (tmp_path / "dot.npz", ["--sensor", "32,24", "--time-unit", "us"]),
        (tmp_path / "dot.npy", ["--set", "sensor_width=32", "--set", "sensor_height=24", "--time-unit", "ns"]),
    ):
        done = command(
            track, path, *DOT, *options, "--batch-events", 90, *small, "--engine", "model", "--no-picture",
            "--out", tmp_path,
        )  # fmt: skip
        assert (done.status, done.err) == (0, "")
        results.append(rows(tmp_path))
    assert len(results[0]) == 6 and all(result == results[0] for result in results)


def test_a_sensor_that_nobody_tells(command, dot_events, small, tmp_path):
    np.savez(tmp_path / "dot.npz", t=dot_events.t, x=dot_events.x, y=dot_events.y, p=dot_events.p)
    done = command(
        track, tmp_path / "dot.npz", *DOT, "--batch-events", 90, *small, "--engine", "model", "--out", tmp_path,
        "--no-picture",
    )  # fmt: skip
    assert done.status == 0
    assert done.err == (
        f"note: {tmp_path / 'dot.npz'} does not say how large its sensor is: taking 240×180 px; "
        "say it with --sensor W,H\n"
    )


def test_files_are_written_anew(command, rows, dot, small, tmp_path):
    out = tmp_path / "Ausgabe für Ωμέγα" / "事件 $x$"
    for batches in (5, 2):
        done = command(
            track, dot, *DOT, "--batch-events", 90, *small, "--engine", "model", "--out", out, "--batches", batches
        )
        assert done.status == 0 and str(out / "track.png") in done.out
        assert len(rows(out)) == batches
    assert sorted(path.name for path in out.iterdir()) == ["track.csv", "track.png"]


@pytest.mark.parametrize(
    "name", ["a$\\foo$.h5", "事件.h5", "größe.h5", "a_b^c{.h5", "line\nbreak.h5", "\udce9.h5", "$.h5"]
)
def test_any_name_of_a_recording(command, dot, small, tmp_path, name):
    """Matplotlib would take some of them for formulas, and has no glyph for others."""
    try:
        (tmp_path / name).write_bytes(dot.read_bytes())
    except (OSError, UnicodeError):
        pytest.skip("not a name of a file on this system")
    done = command(
        track, tmp_path / name, *DOT, "--batch-events", 90, "--batches", 1, *small, "--engine", "model",
        "--out", tmp_path,
    )  # fmt: skip
    assert (done.status, done.err) == (0, "")
    assert (tmp_path / "track.png").stat().st_size > 10_000


# ---------------------------------------------------------------- without a recording


def test_the_synthetic_scene_shows_its_true_motion(compiler, command, rows, tmp_path):
    done = command(track, "--out", tmp_path)
    assert done.status == 0 and done.err == ""
    lines = done.out.splitlines()
    head = lines.index("batch   true vx, vy [px/s]      found vx, vy [px/s]")
    table = np.array([line.split() for line in lines[head + 1 :]], float)
    written = rows(tmp_path)
    assert len(table) == len(written) >= 20
    np.testing.assert_array_equal(table[:, 0], range(len(table)))
    # What is printed as found is what is written.
    for column, name in ((3, "vx_px_per_s"), (4, "vy_px_per_s")):
        np.testing.assert_allclose(table[:, column], floats(written, name), atol=0.051)
    # It turns a corner: down to the right, then up to the right; found to within half a pixel per batch or so.
    assert table[0, 1:3].tolist() == [150, 100] and table[-1, 1:3].tolist() == [120, -100]
    np.testing.assert_allclose(np.median(table[:, 3:] - table[:, 1:3], axis=0), 0, atol=25)
    assert np.abs(table[:, 3:] - table[:, 1:3]).max() < 100
    assert flags(written) == [""] * len(written)
    share = looks_like_a_track(tmp_path / "track.png")
    assert share((0.1216, 0.4667, 0.7059)) > 1e-4 and share((1.0, 0.498, 0.0549)) > 1e-4  # vx, vy


def test_the_synthetic_scene_as_json_is_only_json(command, tmp_path):
    done = command(
        track, "--engine", "model", "--set", "iterations=1", "--batches", 2, "--json", "--no-picture", "--out", tmp_path
    )
    assert json.loads(done.out)["batches"] == 2 and json.loads(done.out)["config"]["eta"] == 4.0


def test_the_scene_with_other_options(command, rows, tmp_path):
    done = command(
        track, "--engine", "float", "--roi", "40,60", "--batch-us", "20000", "--batches", 3, "--set", "iterations=2",
        "--set", "eta=0.5", "--out", tmp_path, "--no-picture", "--json",
    )  # fmt: skip
    assert json.loads(done.out)["config"]["eta"] == 0.5
    assert rows(tmp_path)[0]["roi_x"] == "40"


# ---------------------------------------------------------------- flags


def run_model(command, rows, tmp_path, events, *options, size=(32, 24), status=0):
    """Rows of the model engine's track of ``events``."""
    write_hdf5(tmp_path / "events.h5", events, *size)
    done = command(track, tmp_path / "events.h5", *options, "--engine", "model", "--out", tmp_path / "out")
    assert (done.status, done.err) == (status, "")
    found = rows(tmp_path / "out")
    moves = len({(row["roi_x"], row["roi_y"]) for row in found}) > 1
    looks_like_a_track(tmp_path / "out" / "track.png", moves=moves)
    return found, done


def test_a_full_buffer(command, rows, dot_events, small, tmp_path):
    found, done = run_model(
        command, rows, tmp_path, dot_events, *DOT, "--batch-events", "90", *small, "--set", "buffer_events=16"
    )
    assert flags(found)[:3] == ["overflow"] * 3 and {row["roi_events"] for row in found[:3]} == {"16"}
    assert f"{sum(map(bool, flags(found)))} with warnings" in done.out


def test_all_events_at_one_moment(command, rows, dot_events, small, tmp_path):
    still = Events(np.full(600, 77), dot_events.x, dot_events.y, dot_events.p)
    found, _ = run_model(command, rows, tmp_path, still, *DOT, "--batch-events", "90", *small)
    for row in found:
        assert row["flags"].split("|")[0] == "degenerate" and float(row["vx"]) == float(row["vy"]) == 0
        assert row["t_ref_us"] == "77.0" and (row["vx_px_per_s"], row["vy_px_per_s"]) == ("", "")
        assert (row["roi_x"], row["roi_y"], row["iterations"], row["contrast"]) == ("8", "9", "0", "0.000000")


def test_no_event_in_the_roi(command, rows, dot_events, small, tmp_path):
    """Said in one line; the CSV is there, and every batch is flagged."""
    corner = Events(dot_events.t, dot_events.x % 8, dot_events.y % 8, dot_events.p)
    write_hdf5(tmp_path / "events.h5", corner, 32, 24)
    done = command(
        track, tmp_path / "events.h5", "--roi", "24,16", "--batch-events", "90", *small, "--engine", "model",
        "--out", tmp_path,
    )  # fmt: skip
    assert done.error == "ROI at 24,16: none of the events is in it, in 6 batches; an ROI with an object is needed"
    found = rows(tmp_path)
    assert flags(found) == ["degenerate"] * 6 and {row["roi_events"] for row in found} == {"0"}
    assert {(row["roi_x"], row["roi_y"]) for row in found} == {("24", "16")}


def test_windows_without_events(command, rows, dot_events, small, tmp_path):
    """Time goes on: a pause of 3 ms in the middle is three empty windows."""
    paused = Events(dot_events.t + 3000 * (np.arange(600) >= 300), dot_events.x, dot_events.y, dot_events.p)
    found, _ = run_model(command, rows, tmp_path, paused, *DOT, "--batch-us", "1000", *small)
    assert [row["events"] for row in found] == ["100"] * 3 + ["0"] * 3 + ["100"] * 2
    for row in found[3:6]:
        assert (row["t_ref_us"], row["flags"], row["iterations"], row["cycles"]) == ("", "degenerate", "0", "")
        assert (row["roi_x"], row["vx"]) == (found[6]["roi_x"], found[2]["vx"])


def test_an_empty_window_in_the_verilog(compiler, command, rows, dot_events, small, tmp_path):
    paused = Events(dot_events.t + 3000 * (np.arange(600) >= 100), dot_events.x, dot_events.y, dot_events.p)
    write_hdf5(tmp_path / "paused.h5", paused, 32, 24)
    done = command(track, tmp_path / "paused.h5", *DOT, "--batch-us", 1000, *small, "--out", tmp_path, "--no-picture")
    assert done.status == 0
    found = rows(tmp_path)
    assert [bool(row["cycles"]) for row in found] == [True] + [False] * 3 + [True] * 4


def test_a_window_of_too_many_events_is_cut(command, rows, dot_events, small, tmp_path):
    found, _ = run_model(
        command, rows, tmp_path, dot_events, *DOT, "--batch-us", "1000", *small, "--set", "max_batch_events=70"
    )
    assert [row["events"] for row in found][:4] == ["70", "30", "70", "30"]
    assert ["cut" in text for text in flags(found)][:4] == [True, False] * 2


def test_a_batch_that_lasts_too_long(command, rows, dot_events, small, tmp_path):
    slow = Events(dot_events.t * 10, dot_events.x, dot_events.y, dot_events.p)
    found, _ = run_model(command, rows, tmp_path, slow, *DOT, "--batch-events", "90", *small, "--set", "span_bits=12")
    # 41 events of 100 µs each are within 4095 µs, so t_ref is at 2000 µs.
    assert all("time_span" in text for text in flags(found))
    assert floats(found, "t_ref_us").tolist() == [500_000.0 + 9000 * k + 2000 for k in range(6)]


def test_at_the_edge_of_the_sensor(command, rows, dot_events, small, tmp_path):
    options = ["--set", "start=given", "--set", "v_start_x=-5", "--set", "eta=0", "--set", "roi_gain=2"]
    found, _ = run_model(command, rows, tmp_path, dot_events, *DOT, "--batch-events", "90", *small, *options)
    assert found[0]["flags"] == "roi_clamped" and found[1]["roi_x"] == "0"


# ---------------------------------------------------------------- in a process of its own


def test_as_users_run_it(compiler, process, rows, dot, small, tmp_path):
    """Without torch and without a locale that has its signs."""
    done = process("track", dot, *DOT, "--batch-events", 90, *small, without=["torch"], PYTHONIOENCODING="ascii")
    assert (done.status, done.err) == (0, "")
    assert done.out.endswith("wrote cmfpga-track/track.csv\nwrote cmfpga-track/track.png\n")
    assert len(rows(tmp_path / "cmfpga-track")) == 6
    looks_like_a_track(tmp_path / "cmfpga-track" / "track.png")


@pytest.mark.parametrize("engine", ["model", "float"])
def test_torch_is_asked_for_where_it_is_needed(process, dot, small, engine):
    done = process("track", dot, *DOT, "--batch-events", 90, *small, "--engine", engine, without=["torch"])
    assert done.error == f"--engine {engine}: torch is not installed; pip install 'cmfpga[reference]'"


def test_without_a_compiler_a_note_and_the_same_csv(command, rows, dot, small, tmp_path, monkeypatch):
    monkeypatch.setattr("cmfpga.engines.find_compiler", lambda: None)
    done = command(
        track, dot, *DOT, "--batch-events", 90, "--batches", 2, *small, "--out", tmp_path / "slow", "--no-picture"
    )
    assert done.status == 0
    assert done.err.startswith("note: no C++ compiler found: using Amaranth's simulator") and done.err.count("\n") == 1
    slow = rows(tmp_path / "slow")
    assert all(int(row["cycles"]) > 0 for row in slow)
    command(
        track, dot, *DOT, "--batch-events", 90, "--batches", 2, *small, "--engine", "model", "--out", tmp_path / "model"
    )
    assert but_cycles(slow) == rows(tmp_path / "model")


def test_help_names_every_option_and_the_examples_parse(command):
    done = command(track, "--help")
    assert done.status == 0
    for option in (
        "--roi", "--batch-events", "--batch-us", "--batch-roi-events", "--start-event", "--batches", "--preset",
        "--set", "--engine", "--sensor", "--time-unit", "--out",
    ):  # fmt: skip
        assert option in done.out
    for example in track.EXAMPLES:
        assert example in done.out
        options = track._parser().parse_args(example.partition("#")[0].split()[3:])
        cli.make_config(options)


def test_list_fields(process):
    done = process("track", "--list-fields", PYTHONIOENCODING="ascii")
    assert done.status == 0 and done.err == ""
    lines = done.out.splitlines()
    assert [line.split(" = ")[0] for line in lines] == list(Config().to_dict())
    assert "roi_width = 64 [px]: columns of the region of interest (ROI), even" in lines
    assert any(line.startswith("eta = 1.0 [") and line.endswith("; run-time") for line in lines)


# ---------------------------------------------------------------- real recordings


@pytest.fixture(scope="module")
def star(data_dir, tmp_path_factory, command, rows):
    """The recording in which a star moves to the right, its track by the Verilog, and the folder."""
    if find_compiler() is None:
        pytest.skip("no C++ compiler")
    folder = tmp_path_factory.mktemp("star")
    recording = data_dir / "davis240c_shapes_rotation_0.0s.h5"
    options = ["--start-event", 15000, "--roi", "100,30", "--batches", 20, "--batch-events", 5000]
    done = command(track, recording, *options, "--preset", "paper", "--out", folder)
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("20 batches tracked (rtl engine), 0 with warnings, 0 events left over\n")
    return recording, options, rows(folder), folder


def test_the_roi_follows_the_star_to_the_right(star):
    _, _, found, folder = star
    assert len(found) == 20 and flags(found) == [""] * 20 and {row["events"] for row in found} == {"5000"}
    x, y, vx, vy = (floats(found, name) for name in ("roi_x", "roi_y", "vx", "vy"))
    assert (x[0], y[0]) == (100, 30)
    moving = slice(0, 17)  # it stops after batch 16
    assert (vx[moving] > 1).all() and (vx[moving] < 2).all() and (np.abs(vy) < 0.35).all()
    assert (np.diff(x[:18]) >= 0).all() and (np.abs(np.diff(x)) <= 4).all() and (np.abs(np.diff(y)) <= 1).all()
    assert x[17] - x[0] > 45 and np.abs(y - 30).max() <= 2
    assert (vx[-2:] < -1).all()  # it has turned
    # The speed in px/s, as it was measured by others for this stretch.
    speed = floats(found, "vx_px_per_s")
    assert 90 < np.median(speed[3:16]) < 140
    # ROI by twice v, up to the rounding of the position.
    np.testing.assert_allclose(np.diff(x), 2 * vx[:-1], atol=1)
    assert (floats(found, "contrast") > 0.5).all()
    looks_like_a_track(folder / "track.png")


def test_cycles_of_the_star_are_those_that_build_promises(star, command, tmp_path):
    assert command(build, "--preset", "paper", "--out", tmp_path).status == 0
    formula = json.loads((tmp_path / "build-info.json").read_text())["cycles"]["formula"]
    words, latency, constant = map(int, re.fullmatch(r"N \+ T·\(n \+ (\d+) \+ (\d+)\) \+ (\d+)", formula).groups())
    assert words == 1024
    for row in star[2]:
        n, t, roi_events = int(row["events"]), int(row["iterations"]), int(row["roi_events"])
        assert t == 100 and int(row["cycles"]) == n + t * (roi_events + words + latency) + constant


def test_the_model_follows_the_star_alike(star, command, rows, tmp_path):
    recording, options, found, _ = star
    done = command(
        track, recording, *options, "--preset", "paper", "--engine", "model", "--no-picture", "--out", tmp_path
    )
    assert done.status == 0
    assert rows(tmp_path) == but_cycles(found)
    # Line for line in the files as well.
    lines = [line.split(",") for line in (star[3] / "track.csv").read_text().splitlines()]
    column = lines[0].index("cycles")
    for line in lines[1:]:
        line[column] = ""
    assert (tmp_path / "track.csv").read_text() == "".join(",".join(line) + "\n" for line in lines)


def test_the_float_engine_follows_the_star_nearly_alike(star, command, rows, tmp_path):
    recording, options, found, _ = star
    done = command(
        track, recording, *options, "--preset", "paper", "--engine", "float", "--no-picture", "--out", tmp_path
    )
    assert done.status == 0
    other = rows(tmp_path)
    np.testing.assert_allclose(floats(other, "roi_x"), floats(found, "roi_x"), atol=1)
    np.testing.assert_allclose(floats(other, "vx"), floats(found, "vx"), atol=0.15)
    np.testing.assert_allclose(floats(other, "contrast"), floats(found, "contrast"), rtol=0.15)


def test_the_fast_hardware_follows_the_star(star, command, rows, tmp_path):
    """The default preset, in a fifteenth of the cycles, Verilog and model alike."""
    recording, options, slow, _ = star
    for engine in ("rtl", "model"):
        done = command(track, recording, *options, "--engine", engine, "--no-picture", "--out", tmp_path / engine)
        assert (done.status, done.err) == (0, "")
    found = rows(tmp_path / "rtl")
    assert rows(tmp_path / "model") == but_cycles(found) and flags(found) == [""] * 20
    assert [row["iterations"] for row in found] == ["15"] + ["8"] * 19
    x, vx = floats(found, "roi_x"), floats(found, "vx")
    assert (np.diff(x[:18]) >= 0).all() and (np.abs(np.diff(x)) <= 4).all() and (vx[:17] > 0.8).all()
    np.testing.assert_allclose(x, floats(slow, "roi_x"), atol=4)
    assert floats(found, "cycles").sum() < floats(slow, "cycles").sum() / 15


@pytest.mark.parametrize(
    "name, engine, options, vx, vy",
    [
        # Up at 500 to 620 px/s, and slowing.
        ("davis240c_shapes_translation_52.0s.h5", "rtl",
         ["--roi", "100,60", "--batch-events", 4000, "--preset", "paper"], (-30, 30), (-700, -420)),
        # To the left at about 120 px/s (ground truth from the gyroscope).
        ("davis240c_shapes_rotation_2.1s_gtflow.h5", "rtl",
         ["--roi", "100,60", "--batch-us", 20000], (-150, -110), (-30, 0)),
        # Up, measured at 30 to 33 px/s over the whole image.
        ("davis240b_evbench_seq0002.h5", "model",
         ["--roi", "60,100", "--batch-roi-events", 1500, "--batches", 5], (-10, 10), (-50, -28)),
    ],
)  # fmt: skip
def test_other_recordings_and_other_batches(data_dir, command, rows, tmp_path, name, engine, options, vx, vy):
    if engine == "rtl" and find_compiler() is None:
        pytest.skip("no C++ compiler")
    done = command(track, data_dir / name, *options, "--engine", engine, "--out", tmp_path, "--no-picture")
    assert (done.status, done.err) == (0, "")
    found = rows(tmp_path)
    assert len(found) >= 4 and flags(found) == [""] * len(found)
    for axis, (low, high) in (("vx_px_per_s", vx), ("vy_px_per_s", vy)):
        assert low < np.median(floats(found, axis)) < high
    if "--batch-roi-events" in options:
        assert {row["roi_events"] for row in found} == {"1500"}


def test_a_text_recording_as_it_was_published(compiler, data_dir, command, rows, tmp_path):
    path = data_dir / "original_formats" / "davis240c_slider_depth_0.0s_events.txt"
    done = command(
        track, path, "--roi", "100,60", "--batch-roi-events", 600, "--batches", 2, "--out", tmp_path, "--no-picture"
    )
    assert done.status == 0 and done.err.startswith("note: ") and "taking 240×180 px" in done.err
    assert [row["roi_events"] for row in rows(tmp_path)] == ["600", "600"]


def test_a_real_overflow(data_dir, command, rows, tmp_path):
    """A bright dot with more events than the buffer holds, on another sensor than the default's."""
    done = command(
        track, data_dir / "prophesee_spinner_640x480.h5", "--roi", "216,85", "--batches", 2, "--engine", "model",
        "--set", "iterations=2", "--out", tmp_path, "--json",
    )  # fmt: skip
    assert done.status == 0 and done.err == ""
    assert json.loads(done.out)["config"]["sensor_width"] == 640 and json.loads(done.out)["batches_with_warnings"] == 2
    assert flags(rows(tmp_path)) == ["overflow"] * 2
    looks_like_a_track(tmp_path / "track.png", moves=False)


@pytest.mark.parametrize(
    "name, roi, changes, expected",
    [
        ("davis240c_shapes_rotation_0.0s.h5", (100, 30), {"buffer_events": 64}, Flag.OVERFLOW),
        ("davis240c_shapes_translation_52.0s.h5", (0, 0), {"span_bits": 10}, Flag.TIME_SPAN),
        ("davis240c_translboxes_imu.h5", (176, 116), {"time_bits": 14, "span_bits": 13}, Flag.TIME_BACK),
        ("prophesee_spinner_640x480.h5", (210, 80), {"buffer_events": 100, "span_bits": 8}, Flag.OVERFLOW),
    ],
)
def test_no_event_of_a_real_recording_is_lost_uncounted(data_dir, name, roi, changes, expected):
    """Even with hardware that is far too small for it."""
    with open_recording(data_dir / name) as recording:
        config = Config(
            sensor_width=recording.width, sensor_height=recording.height, iterations=1, roi_width=32, roi_height=32,
            **changes,
        )  # fmt: skip
        cutter = BatchCutter(recording, events=4000, max_events=4000)
        seen = Flag(0)
        for batch in tracker.track(make_engine("model", config), cutter, roi=roi, batches=6):
            result = batch.result
            assert result.events == len(batch.events) == 4000
            counts = [result.roi_events, result.outside, result.overflow, result.time_back, result.time_span]
            assert sum(counts) == 4000 and min(counts) >= 0
            for count, flag in zip(counts[2:], (Flag.OVERFLOW, Flag.TIME_BACK, Flag.TIME_SPAN), strict=True):
                assert bool(count) == (flag in batch.flags)
            seen |= batch.flags
        assert expected in seen
