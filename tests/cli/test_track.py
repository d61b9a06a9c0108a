"""``cmfpga track``: the CSV, the picture and the summary, on made-up and on real recordings."""

import csv
import json
import re

import numpy as np
import pytest
from matplotlib.image import AxesImage
from matplotlib.patches import Ellipse
from matplotlib.text import Text
from PIL import Image, ImageSequence

import cmfpga
from cmfpga.cli import track
from cmfpga.config import Config
from cmfpga.engines import usual_preset
from cmfpga.events import Events, write_hdf5
from cmfpga.show.gallery import Gallery
from support.designs import PAPER
from support.recordings import text_lines
from support.tracks import but_cycles, flags, floats, looks_like_a_track

DOT = ["--roi", "8,9"]


@pytest.fixture
def follow(command, dot, small, tmp_path):
    """``follow(argument, …)``: the dot, or ``recording``, by the model in batches of 90, unless told otherwise."""

    def follow(*arguments, recording=dot, roi=DOT, engine="model", size=("--batch-events", 90), out=tmp_path):
        return command(track, recording, *roi, *size, *small, "--engine", engine, *arguments, "--out", out)

    return follow


MODES = [("--batch-events", "90", 6), ("--batch-us", "900", 6), ("--batch-roi-events", "30", None)]


@pytest.mark.parametrize("mode, size, count", MODES, ids=[mode[0] for mode in MODES])
def test_verilog_and_model_write_the_same(compiler, follow, rows, tmp_path, mode, size, count):
    written = {}
    for engine in ("rtl", "model"):
        done = follow("--no-picture", size=(mode, size), engine=engine, out=tmp_path / engine)
        assert done.status == 0 and done.err == ""
        written[engine] = rows(tmp_path / engine)
        assert sorted(path.name for path in (tmp_path / engine).iterdir()) == ["track.csv"]
        assert done.out.splitlines()[0].startswith(f"{len(written[engine])} batches tracked ({engine} engine), ")
    assert but_cycles(written["rtl"]) == written["model"]
    assert len(written["rtl"]) == count or (count is None and len(written["rtl"]) >= 10)
    assert {row["cycles"] for row in written["model"]} == {""}


def test_the_picture_shows_v_and_how_sure_it_is(command, monkeypatch, tmp_path):
    """An arrow from the ROI's middle, the way in 0.2 s; at its tip what holds 95 % of a plane's normal distribution.

    The verdict stands above it.
    """
    titles, made, figure = [], [], Gallery.figure

    def watched(self, verdict=""):
        titles.append(verdict)
        made.append(figure(self, verdict))
        return made[0]

    monkeypatch.setattr(Gallery, "figure", watched)
    done = command(track, "--batches", 3, "--engine", "model", "--out", tmp_path)
    ((share, velocity),) = (title.split("\n") for title in titles)
    assert done.status == 0 and " windows are to be trusted" in share and velocity.startswith("velocity ")
    assert share in done.out and velocity in done.out
    with (tmp_path / "track.csv").open(newline="") as file:
        seconds, found = 0.2, [*csv.DictReader(file)]
    assert f"v: the way in {seconds} s, " in made[0].legends[0].get_texts()[-1].get_text()
    frames = [axes for axes in made[0].axes if axes.get_title().startswith("window ") and axes.texts]
    assert len(frames) == len(found) == 3
    for axes, row in zip(frames, found, strict=True):
        (ellipse,) = (one for one in axes.patches if isinstance(one, Ellipse))
        begin, end = axes.texts[0].xyann, axes.texts[0].xy
        angle, radii = np.radians(ellipse.angle), np.array([ellipse.width, ellipse.height]) / 2
        cos, sin = np.cos(angle), np.sin(angle)
        extent = [np.hypot(*(radii * turned)) for turned in ((cos, sin), (sin, cos))]
        for k, axis in enumerate("xy"):
            v, sd = (float(row[f"v{axis}_px_per_s{end}"]) for end in ("", "_sd"))
            assert begin[k] == int(row[f"roi_{axis}"]) + 32
            assert end[k] - begin[k] == pytest.approx(v * seconds, abs=1e-3)
            assert extent[k] == pytest.approx(5.991**0.5 * sd * seconds, abs=0.01)


def test_the_defaults(command, rows, tmp_path):
    """Windows that slide, ./cmfpga-track; without confidence batches of 5000 events, which a note says.

    The text file says its sensor's size.
    """
    lines = ["240 180"] + [f"{k * 1e-5:.6f} {k % 64} {k % 7} {k % 2}" for k in range(5001)]
    (tmp_path / "events.txt").write_text("\n".join(lines))
    how = "--roi 0,0 --engine model --set buffer_events=5000 --set judge=0 --time-unit s".split()
    done = command(track, tmp_path / "events.txt", *how, "--out", tmp_path / "a")
    told = "in batches: how long windows are follows from the confidence, which is not measured"
    assert done.err == f"note: {told}\n" and [row["events"] for row in rows(tmp_path / "a")] == ["5000"]
    options = track.parser().parse_args(["x"])
    assert (options.engine, options.out, options.preset, options.start_event) == ("rtl", "cmfpga-track", None, 0)
    assert usual_preset({}, engine="model") == ("sliding", None)
    assert usual_preset({"thin_target": 9}, engine="model")[1].startswith("in batches: thin_target = 9: ")
    assert usual_preset({"motion": "rotatoin"}, engine="model") == ("fast", None)  # which refuses it, too


def test_a_summary_as_json(follow, tmp_path):
    done = follow("--json")
    summary = json.loads(done.out)
    assert done.err == ""
    config = summary.pop("config")
    assert Config(**config).sensor_width == 32 and config["roi_width"] == 8 and config["iterations"] == 15
    assert re.fullmatch(r"\[\d+, \d+\]", str(summary.pop("roi_next")))
    assert summary == {
        "engine": "model", "batches": 6, "events_left_over": 60,
        "batches_with_warnings": summary["batches_with_warnings"], "cycles": None,
        "files": [str(tmp_path / "track.csv"), str(tmp_path / "track.png")],
        "trusted_batches": None, "lost_batches": [], "short_batches": None,
        "ambiguous_batches": None, "standard_deviation": {"vx_px_per_s": None, "vy_px_per_s": None},
        **{name: summary[name] for name in ("vx_px_per_s", "vy_px_per_s", "px_per_s", "median_px_per_half_batch")},
    }  # fmt: skip
    assert 2300 < summary["vx_px_per_s"] < 2900 and set(summary["px_per_s"]) == {"lowest", "median", "highest"}


def test_every_format_gives_the_same_track(follow, rows, dot, dot_events, tmp_path):
    t, x, y, p = dot_events.t, dot_events.x, dot_events.y, dot_events.p
    (tmp_path / "dot.txt").write_text(text_lines(t, x, y, p))
    np.savez(tmp_path / "dot.npz", t=t, x=x, y=y, p=p)
    np.save(tmp_path / "dot.npy", np.stack([t * 1000, x, y, p], axis=1).astype(np.int64))
    results = []
    for path, options in (
        (dot, []),
        (tmp_path / "dot.txt", ["--sensor", "32,24"]),
        (tmp_path / "dot.npz", ["--sensor", "32,24", "--time-unit", "us"]),
        (tmp_path / "dot.npy", ["--set", "sensor_width=32", "--set", "sensor_height=24", "--time-unit", "ns"]),
    ):
        done = follow("--no-picture", *options, recording=path)
        assert (done.status, done.complaints) == (0, [])
        results.append(rows(tmp_path))
    assert len(results[0]) == 6 and all(result == results[0] for result in results)
    done = follow("--no-picture", recording=tmp_path / "dot.npz")
    assert done.status == 0 and done.err == (
        f"note: {tmp_path / 'dot.npz'} does not say its unit of time: taking us, a guess; say it with --time-unit\n"
        f"note: {tmp_path / 'dot.npz'} does not say how large its sensor is: taking 240×180 px; "
        "say it with --sensor W,H\n"
    )


def test_files_are_written_anew(follow, rows, tmp_path):
    out = tmp_path / "Ausgabe für Ωμέγα" / "事件 $x$"
    for batches in (2, 1):
        done = follow("--batches", batches, out=out)
        assert done.status == 0 and str(out / "track.png") in done.out
        assert len(rows(out)) == batches
    assert sorted(path.name for path in out.iterdir()) == ["track.csv", "track.png"]


@pytest.mark.parametrize("name", ["a$\\foo$.h5", "事件.h5", "a_b^c{.h5", "line\nbreak.h5", "\udce9.h5", "$.h5"])
def test_any_name_of_a_recording(follow, dot, tmp_path, name):
    """Matplotlib would take some of them for formulas, and has no glyph for others."""
    try:
        (tmp_path / name).write_bytes(dot.read_bytes())
    except (OSError, UnicodeError):
        pytest.skip("not a name of a file on this system")
    done = follow("--batches", 1, recording=tmp_path / name)
    assert (done.status, done.err) == (0, "")
    assert (tmp_path / "track.png").stat().st_size > 10_000


def test_pictures_as_files_of_other_kinds(follow, tmp_path):
    done = follow("--picture", tmp_path / "a.pdf", "--picture", tmp_path / "b.gif", roi=["--roi", "my-star_1=8,9"])
    files = ["a-my-star_1.pdf", "b-my-star_1.gif", "track-my-star_1.csv"]
    assert done.status == 0 and sorted(path.name for path in tmp_path.iterdir()) == files
    assert (tmp_path / files[0]).read_bytes().startswith(b"%PDF") and f"wrote {tmp_path}/{files[1]}" in done.out
    with Image.open(tmp_path / files[1]) as moving:
        assert moving.n_frames == 6 and moving.info["loop"] == 0  # a batch each, over and over
        frames = [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(moving)]
    # The ROI's frame, tab:red, moves to the right.
    left = [np.nonzero(np.abs(frame - (214, 39, 40)).max(axis=2) < 12)[1].min() for frame in (frames[0], frames[-1])]
    assert left[1] > left[0] + 50


@pytest.mark.parametrize("name, message", [
    ("a.bmp", "picture a.bmp: a name that ends in .png, .pdf, .svg, .gif is needed"),
    ("nowhere/a.pdf", "'nowhere/a.pdf': no such folder"),
])  # fmt: skip
def test_pictures_that_cannot_be(follow, name, message):
    assert f"argument --picture: {message}" in follow("--picture", name).error
    assert "not allowed with argument" in follow("--picture", "a.pdf", "--no-picture").error


def test_nothing_of_the_picture_is_cut(dot, tmp_path):
    """All text lies on the page, whatever the recording is called; ON and OFF have their colours and a legend."""
    path = tmp_path / f"{'a long name ' * 15}.h5"
    path.write_bytes(dot.read_bytes())
    figure = cmfpga.track(path, roi=(8, 9), batch_events=90, engine="model", **PAPER).plot()
    figure.canvas.draw()
    texts = {text.get_text() for text in figure.findobj(Text)}
    assert {"OFF (darker)", "ON (brighter)", "ROI", "recording's clock [s]", "batch 0, 0.050 s"} <= texts
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert 0 <= drawn.x0 and drawn.x1 <= width and 0 <= drawn.y0 and drawn.y1 <= height
    assert len({tuple(colour) for colour in figure.findobj(AxesImage)[0].get_array().reshape(-1, 3)}) == 3


def test_the_synthetic_scene_shows_its_true_motion(compiler, command, rows, tmp_path):
    slid = command(track, "--out", tmp_path / "slid", "--no-picture")
    count = len((tmp_path / "slid" / "track.csv").read_text().splitlines()) - 1
    assert slid.out.startswith(f"{count} windows tracked (rtl engine), 0 with warnings, ") and count > 200
    told = re.search(rf"^(\d+) of {count} windows are to be trusted", slid.out, re.MULTILINE)
    assert int(told[1]) > 0.97 * count  # a few hold both sides of the corner
    done = command(track, "--preset", "fast", "--out", tmp_path)
    assert done.status == 0 and set(line.split(":")[0] for line in done.err.splitlines()) <= {"warning"}
    lines = done.out.splitlines()
    trusted = r"^\d of 9 batches are to be trusted\nvelocity 1[78]\d px/s in the median, "
    assert re.search(trusted, done.out, re.MULTILINE)
    head = lines.index("batch   true vx, vy [px/s]      found vx, vy [px/s]")
    table = np.array([line.split() for line in lines[head + 1 :]], float)
    written = rows(tmp_path)
    assert len(table) == len(written) == 9
    np.testing.assert_array_equal(table[:, 0], range(len(table)))
    # What is printed as found is what is written.
    for column, name in ((3, "vx_px_per_s"), (4, "vy_px_per_s")):
        np.testing.assert_allclose(table[:, column], floats(written, name), atol=0.051)
    # It turns a corner: down to the right, then up to the right, in batch 5.
    assert table[0, 1:3].tolist() == [150, 100] and table[-1, 1:3].tolist() == [120, -100]
    np.testing.assert_allclose(table[:5, 3:], table[:5, 1:3], atol=12)
    assert set(flags(written)) <= {"", "thinned", "doubtful", "thinned|doubtful"}
    share = looks_like_a_track(tmp_path / "track.png")
    assert share((0.1216, 0.4667, 0.7059)) > 1e-4 and share((1.0, 0.498, 0.0549)) > 1e-4  # vx, vy


def test_the_scene_with_other_options(command, rows, tmp_path):
    how = "--engine float --roi 40,60 --batch-us 20000 --batches 3 --preset paper --set iterations=2 --json".split()
    done = command(track, *how, "--no-picture", "--out", tmp_path)
    assert json.loads(done.out)["config"]["eta"] == 4.0  # the scene's own
    assert rows(tmp_path)[0]["roi_x"] == "40"


@pytest.fixture
def flagged(follow, rows, dot_events, tmp_path):
    """``flagged(option, …, x=…)``: rows of the track of the dot with changed columns, and what was said."""

    def flagged(*options, status=0, picture=False, note="", **given):
        columns = {name: given.pop(name) for name in "txyp" if name in given}
        events = Events(**{name: columns.get(name, getattr(dot_events, name)) for name in "txyp"})
        write_hdf5(tmp_path / "events.h5", events, 32, 24)
        done = follow(*options, *["--no-picture"] * (not picture), recording=tmp_path / "events.h5", **given)
        assert done.status == status and (status or re.fullmatch(note, done.err))
        found = rows(tmp_path)
        if picture:
            looks_like_a_track(tmp_path / "track.png", moves=len({(row["roi_x"], row["roi_y"]) for row in found}) > 1)
        return found, done

    return flagged


def test_all_events_at_one_moment(flagged):
    note = "note: .*: 100% of the first 600 events share the time 77 µs, so no motion .* too coarse\\?\n"
    found, _ = flagged(t=np.full(600, 77), picture=True, note=note)
    for row in found:
        assert row["flags"].split("|")[0] == "degenerate" and float(row["vx"]) == float(row["vy"]) == 0
        assert row["t_ref_us"] == "77.0" and (row["vx_px_per_s"], row["vy_px_per_s"]) == ("", "")
        assert (row["roi_x"], row["roi_y"], row["iterations"], row["contrast"]) == ("8", "9", "0", "0.000000")


def test_no_event_in_the_roi(flagged, dot_events):
    """Said in one line; the CSV is there, and every batch is flagged."""
    found, done = flagged(status=2, roi=["--roi", "24,16"], x=dot_events.x % 8, y=dot_events.y % 8)
    assert done.error == "ROI at 24,16: none of the events is in it, in 6 batches; an ROI with an object is needed"
    assert flags(found) == ["degenerate"] * 6 and {row["roi_events"] for row in found} == {"0"}
    assert {(row["roi_x"], row["roi_y"]) for row in found} == {("24", "16")}


def test_windows_without_events(flagged, dot_events):
    """Time goes on: a pause of 3 ms in the middle is three empty windows."""
    paused = dot_events.t + 3000 * (np.arange(600) >= 300)
    found, _ = flagged(size=("--batch-us", 1000), t=paused, picture=True)
    assert [row["events"] for row in found] == ["100"] * 3 + ["0"] * 3 + ["100"] * 2
    for row in found[3:6]:
        assert (row["t_ref_us"], row["flags"], row["iterations"], row["cycles"]) == ("", "degenerate", "0", "")
        assert (row["roi_x"], row["vx"]) == (found[6]["roi_x"], found[2]["vx"])


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


def test_without_a_compiler_a_note_and_the_same_csv(follow, rows, tmp_path, monkeypatch):
    monkeypatch.setattr("cmfpga.engines.cannot_compile", lambda: "no C++ compiler found")
    done = follow("--batches", 2, "--set", "iterations=3", "--no-picture", engine="rtl")
    assert done.status == 0
    assert done.err.startswith("note: no C++ compiler found: using Amaranth's simulator") and done.err.count("\n") == 1
    slow = rows(tmp_path)
    assert all(int(row["cycles"]) > 0 for row in slow)
    follow("--batches", 2, "--set", "iterations=3", "--no-picture")
    assert but_cycles(slow) == rows(tmp_path)


def test_list_fields(process):
    done = process("track", "--list-fields", PYTHONIOENCODING="ascii")
    assert done.status == 0 and done.err == ""
    lines = done.out.splitlines()
    assert [line.split(" = ")[0] for line in lines] == list(Config().to_dict()) and done.out.isascii()
    assert "roi_width = 64 [px]: columns of the region of interest (ROI), even" in lines
    assert any(line.startswith("eta = 1.0 [") and line.endswith("; run-time") for line in lines)
