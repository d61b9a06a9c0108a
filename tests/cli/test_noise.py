"""``--hot-pixels`` and ``--background-us`` of ``track``, what ``info`` says of them, and the same from Python."""

import json
import re

import numpy as np
import pytest

import cmfpga
from cmfpga.cli import flow, info, track
from cmfpga.errors import ConfigError
from cmfpga.events import Events, generate, write_hdf5
from cmfpga.imaging.survey import usual_survey
from cmfpga.sweep import plan, task

HOT = {(20, 30): 900, (200, 11): 400}


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """A recording with an object that moves, noise, and two hot pixels outside of it."""
    scene = generate(seed=2, position=(132.0, 62.0), velocity=(90.0, 20.0), duration_us=300_000, noise=0.3)
    made, rng = scene.events, np.random.default_rng(0)
    columns = [np.array([made.t, made.x, made.y, made.p], np.int64)]
    for (x, y), count in HOT.items():
        columns.append(np.array([rng.integers(0, 300_000, count), [x] * count, [y] * count, [1] * count]))
    t, x, y, p = np.concatenate(columns, axis=1)
    order = np.argsort(t, kind="stable")
    path = tmp_path_factory.mktemp("noisy") / "noisy.h5"
    write_hdf5(path, Events(t[order], x[order], y[order], p[order]), width=240, height=180)
    return path


ONE = ["--roi", "100,31", "--batches", 1, "--engine", "model", "--no-picture"]
TWO = {"roi": (100, 31), "batch_events": 4000, "batches": 2, "engine": "model"}


@pytest.fixture
def tracked(command, noisy, tmp_path):
    """``tracked(option, …)``: the summary of two batches."""

    def tracked(*options):
        arguments = [*ONE, "--batches", 2, "--batch-events", 4000, "--json", "--out", tmp_path]
        done = command(track, noisy, *arguments, *options)
        assert done.status == 0
        return json.loads(done.out)

    return tracked


def events_of(noisy, pixels):
    with cmfpga.events.open_recording(noisy) as recording:
        events = next(recording.chunks(0, 8000))
    return sum(int(((events.x == x) & (events.y == y)).sum()) for x, y in pixels)


def test_hot_pixels_by_hand_from_a_file_and_found(noisy, tracked, tmp_path):
    (tmp_path / "hot.txt").write_text("# of this sensor\n20,30\n\n200,11  # the other\n")
    wanted = events_of(noisy, HOT)
    assert wanted > 100
    for told in ("20,30;200,11", str(tmp_path / "hot.txt"), "auto", None):
        found = tracked(*(["--hot-pixels", told] if told else []))
        assert found["dropped"] == {"hot": wanted, "noise": 0}
        assert found["config"]["hot_pixels"] == 1 and found["config"]["background"] == 0
    for told in (["--hot-pixels", "none"], ["--set", "hot_pixels=0"]):
        assert "dropped" not in tracked(*told)


NOTE = "hot pixels 20,30 (900 events), 200,11 (400 events): "


@pytest.mark.usefixtures("long_tools")
def test_a_note_says_which_are_dropped_by_default(command, noisy, tmp_path):
    """Alike by track, flow, sweep and Python; what info calls hot."""
    for module, options in ((track, ONE), (flow, ["--windows", 1, "--no-picture", "--engine", "model"])):
        done = command(module, noisy, *options, "--out", tmp_path / module.__name__)
        assert done.status == 0
        (note,) = [line for line in done.err.splitlines() if "hot" in line]
        assert note.startswith(f"note: {NOTE}") and note.endswith("which are dropped; --hot-pixels none keeps them")
    for run, more in ((cmfpga.track, TWO), (cmfpga.flow, {"windows": 1, "engine": "model"})):
        with pytest.warns(UserWarning, match=f"^{re.escape(NOTE)}.* hot_pixels=0 keeps them$"):
            found = run(noisy, **more)
        assert found.config.hot == tuple(HOT)
    found = cmfpga.track(noisy, **TWO, hot_pixels=1, hot_mask="auto")
    assert sum(one.hot for one in found.results) == events_of(noisy, HOT)
    (subject,) = plan.subjects([f"{noisy}@100,31"], None, task.Run(engine="model"))
    for assignments, hot in (([], tuple(HOT)), (["hot_pixels=0"], ())):
        (choice,), _ = plan.choices("fast", assignments, [])
        assert choice.config(subject).hot == hot


@pytest.mark.parametrize("engine", ["axi", "serial:/dev/null"])
def test_hardware_without_a_mask_gets_none(noisy, engine):
    with cmfpga.events.open_recording(noisy) as recording:
        assert usual_survey(recording, engine, {}) is None and usual_survey(recording, "rtl", {"hot_mask": ""}) is None
        assert usual_survey(recording, "rtl", {}).hot_pixels() == [(*at, count) for at, count in HOT.items()]


def test_background_activity_goes_and_the_object_stays(noisy, tracked):
    """Of the sensor's uniform noise most, of the object little: its contrast stays, and v."""
    plain = cmfpga.track(noisy, **TWO, hot_pixels=0)
    fields = {"hot_pixels": 1, "hot_mask": "auto", "background": 1, "background_us": 20_000}
    clean = cmfpga.track(noisy, **TWO, **fields)
    dropped = tracked("--hot-pixels", "auto", "--background-us", 20_000)["dropped"]
    assert dropped == {name: sum(getattr(one, name) for one in clean.results) for name in ("hot", "noise")}
    assert dropped["hot"] == events_of(noisy, HOT) and 500 < dropped["noise"] < 3000
    for found in (clean, plain):
        np.testing.assert_allclose(found.vx_px_per_s, 90, atol=7)
    assert (clean.contrast > 0.6 * plain.contrast).all() and (clean.contrast != plain.contrast).all()
    assert [len(clean.trace(k).t) for k in (0, 1)] == [one.roi_events for one in clean.results]


def test_the_text_says_what_was_dropped(command, noisy, tmp_path):
    done = command(track, noisy, *ONE, "--hot-pixels", "20,30", "--out", tmp_path)
    assert done.status == 0 and f"\n{events_of(noisy, [])} events" not in done.out
    assert " events of hot pixels dropped, 0 of background activity\n" in done.out


@pytest.mark.parametrize("options, message", [
    (["--hot-pixels", "20;30"], "hot_mask: '20': X,Y of a pixel is needed, pixels separated by ';'"),
    (["--hot-pixels", "nowhere.txt"],
     "--hot-pixels nowhere.txt: auto, none, X,Y;X,Y, or a text file is needed (No such "),
    (["--background-us", "-1"], "argument --background-us: '-1': a whole number of 0 or more is needed"),
    (["--background-us", "5", "--wave", "0", "--engine", "model"], "--wave: one batch by itself does not know"),
])  # fmt: skip
def test_what_is_refused(command, noisy, tmp_path, options, message):
    done = command(track, noisy, "--roi", "100,31", "--batches", 1, "--out", tmp_path, *options)
    assert done.error.startswith(message)


def test_a_stream_has_no_hot_pixels_to_find():
    class Stream:
        name, width, height, seekable = "camera", 240, 180, False

        def chunks(self, start, size):
            yield Events.empty()

    with pytest.raises(ConfigError, match=r"^camera: hot pixels: auto: its events come only once; say which"):
        cmfpga.track(Stream(), roi=(8, 8), hot_pixels=1, hot_mask="auto")
    assert usual_survey(Stream(), "rtl", {}) is None  # by default none are looked for


def test_info_proposes_them(command, noisy):
    done = command(info, noisy, "--json")
    found = json.loads(done.out)
    assert done.status == 0 and {(pixel["x"], pixel["y"]): pixel["events"] for pixel in found["hot_pixels"]} == HOT
    mask, background = found["noise"]
    assert mask == {"options": "--hot-pixels auto", "share": round(1300 / found["events"], 4)}
    assert background["options"] == "--background-us 40000" and 0.02 < background["share"] < 0.3
    done = command(info, noisy, "--no-frame", "--no-proposal")
    assert done.status == 0 and "\nnoise       --hot-pixels auto drops " in done.out
    assert "--background-us" not in done.out
