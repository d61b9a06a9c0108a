"""The accuracy suites: what they are made of, and the scores that the default configuration must reach on them.

The whole suites are slow; seeded parts of them are not. Each score is also asserted to be missed where it should be:
without dither, without coarse levels, by the article's ascent.
"""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from cmfpga import accuracy, cli
from cmfpga.config import preset
from cmfpga.config.schedule import MEASURED, ScheduleEntry
from cmfpga.engines import make_engine
from cmfpga.errors import RecordingError
from cmfpga.events import BatchCutter, open_recording
from cmfpga.imaging.iwe import image_of_warped_events
from cmfpga.tracking.loop import track

FAST = preset("fast")
FLAT = FAST.replace(**{name: re.sub(r"\d:(-?\d)", r"0:\1", text) for name, text in MEASURED.items()})
PART = 100  # synthetic batches of the quick tests
EVERY = 6  # of the real ones
ROOMY = {"buffer_events": accuracy.REAL_ROI_EVENTS[1]}  # what holds every real batch


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def synthetic():
    return accuracy.synthetic_cases()


@pytest.fixture(scope="session")
def real(data_dir):
    return accuracy.real_cases(data_dir)


def error_scores(config, cases, *, engine="model", **options):
    return accuracy.error_scores(accuracy.errors(make_engine(engine, config), cases, **options))


def share_scores(config, cases):
    engine = make_engine("model", config)
    return accuracy.share_scores(accuracy.contrast_shares(engine, cases))


def reaches(scores, **bars):
    return all(scores[name] >= bar for name, bar in bars.items())


COLD = {"below_0.6_px": 0.98, "below_0.3_px": 0.95}
REAL = {"at_least_97_percent": 0.98}


# -------------------------------------------------------------------- what the suites are


def test_the_synthetic_suite_is_what_it_says(synthetic):
    assert len(synthetic) == accuracy.BATCHES == 300
    facts = {name: np.array([case.facts[name] for case in synthetic]) for name in synthetic[0].facts}
    assert facts["roi_events"].min() >= 200 and facts["roi_events"].max() <= 2000
    assert (facts["texture"] == "lines").sum() == 150
    assert np.histogram(facts["speed"], 3, (0, 9))[0].min() > 75  # uniform
    assert facts["noise"].min() >= 0 and 0.28 < facts["noise"].max() <= 0.3
    assert facts["contrast"].min() == 1.0 and facts["contrast"].max() == accuracy.MAX_CONTRAST
    for case in synthetic:
        assert math.hypot(*case.truth) == pytest.approx(case.facts["speed"], rel=0.02, abs=0.01)
        assert len(case.events) == case.facts["roi_events"] == case.scaled.shape[1]
        assert math.dist(case.start, case.truth) <= accuracy.WARM_RADIUS
    directions = np.histogram([math.atan2(*case.truth) for case in synthetic], 4, (-math.pi, math.pi))[0]
    assert directions.min() > 50


def test_objects_stay_in_the_roi(synthetic):
    """Without its noise, a batch leaves the ROI's outermost pixels alone."""
    for case in synthetic[:40]:
        size, room = case.facts["size"], accuracy.ROI - 2 * np.abs(case.truth)
        assert (size + 2 * accuracy.MARGIN <= room + 0.5).all()


def test_a_part_is_the_beginning_of_the_whole(synthetic):
    for part, whole in zip(accuracy.synthetic_cases(3), synthetic, strict=False):
        assert part.truth == whole.truth and np.array_equal(part.events.t, whole.events.t)
        assert np.array_equal(part.events.x, whole.events.x) and part.start == whole.start


def test_the_real_suite_is_what_it_says(real):
    assert len(real) == 76
    assert {case.facts["file"] for case in real} == {windows.file for windows in accuracy.WINDOWS}
    low, high = accuracy.REAL_ROI_EVENTS
    for case in real:
        assert low <= case.facts["roi_events"] <= high
        assert case.scaled.shape[1] == case.facts["roi_events"]
        hot = (case.roi[0] <= 27 < case.roi[0] + 64) and (case.roi[1] <= 70 < case.roi[1] + 64)
        assert not (hot and "evbench" in case.facts["file"])
    for a in real:
        for b in real:
            if a is not b and a.events is b.events:
                assert abs(a.roi[0] - b.roi[0]) >= 64 or abs(a.roi[1] - b.roi[1]) >= 64
    windows = {(case.facts["file"], case.facts["window"]) for case in real}
    assert len(windows) == sum(windows.count for windows in accuracy.WINDOWS)


def test_a_missing_recording_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"shapes_rotation_0.0s.h5: no such file"):
        accuracy.real_cases(tmp_path)


# -------------------------------------------------------------------- yardsticks


def test_contrast_is_the_articles(synthetic, rng):
    x, y, dt = synthetic[0].scaled
    velocities = rng.uniform(-12, 12, (20, 2))
    expected = [image_of_warped_events(x, y, dt, v, width=64, height=64).var() for v in velocities]
    np.testing.assert_allclose(accuracy.contrasts(x, y, dt, velocities, spread=False), expected, rtol=1e-12)


def test_spread_is_the_mean_over_all_dithers(rng):
    x, y, dt = rng.integers(0, 64, 30).astype(float), rng.integers(0, 64, 30).astype(float), rng.uniform(-1, 1, 30)
    v, size = (2.3, -1.4), {"width": 64, "height": 64}
    offsets = (np.arange(24) + 0.5) / 24 - 0.5
    images = [image_of_warped_events(x + a, y + b, dt, v, **size) for a in offsets for b in offsets]
    assert accuracy.contrasts(x, y, dt, [v])[0] == pytest.approx(np.mean(images, axis=0).var(), rel=2e-3)


def test_the_search_finds_the_best(synthetic):
    case = synthetic[1]
    v, best = accuracy.best_contrast(*case.scaled)
    assert math.dist(v, case.truth) < 0.3
    assert accuracy.contrasts(*case.scaled, [v])[0] == best == case.best[1]
    near = np.add(v, np.random.default_rng(1).normal(0, 0.5, (200, 2)))
    far = np.random.default_rng(2).uniform(-8, 8, (200, 2))
    assert accuracy.contrasts(*case.scaled, near).max() <= best * 1.001
    assert accuracy.contrasts(*case.scaled, far).max() <= best


def test_the_articles_contrast_prefers_an_axis(real):
    """Why it is no yardstick: its best v has vx = 0 or vy = 0 exactly, whatever the motion is."""
    part = real[::EVERY]
    on_axis = [
        sum(min(map(abs, v)) < 1e-9 for v in (best[0] for best in bests))
        for bests in ([case.best_unspread for case in part], [case.best for case in part])
    ]
    assert on_axis[0] >= len(part) - 2 and on_axis[1] <= 2


def test_peak_error(synthetic):
    assert accuracy.peak_error(synthetic[1]) < 0.3


# -------------------------------------------------------------------- bars, on parts of the suites


def test_cold(synthetic):
    assert reaches(error_scores(FAST, synthetic[:PART]), **COLD)


def test_warm(synthetic):
    assert reaches(error_scores(FAST, synthetic[:PART], warm=True), **COLD)


@pytest.mark.parametrize(
    "config",
    [FAST.replace(dither_frac=0), FLAT, FAST.replace(cold="2:1*4 2:0*2")],
    ids=["no dither", "full resolution only", "no fine steps"],
)
def test_cold_is_missed_without(config, synthetic):
    scores = error_scores(config, synthetic[:PART])
    assert not reaches(scores, **COLD)


def test_warm_is_missed_from_elsewhere(synthetic):
    """The warm schedule does not reach as far as v = 0: it is not what makes the cold suite easy."""
    warm_only = FAST.replace(cold=MEASURED["warm"])
    assert not reaches(error_scores(warm_only, synthetic[:PART]), **COLD)


@pytest.mark.parametrize("fields", [{}, ROOMY], ids=["as it is", "larger buffer"])
def test_real(real, fields):
    scores = share_scores(FAST.replace(**fields), real[::EVERY])
    assert reaches(scores, **REAL)


def test_real_is_missed_where_events_are_dropped(real):
    scores = share_scores(FAST.replace(when_full="drop"), real[::EVERY])
    assert not reaches(scores, **REAL)
    large = [case for case in real[::EVERY] if case.facts["roi_events"] > FAST.buffer_events]
    assert scores["batches_that_drop_events"] == len(large) > 0


@pytest.mark.parametrize("config", [FAST.replace(dither_frac=0), FLAT], ids=["no dither", "full resolution only"])
def test_real_is_missed_without(config, real):
    assert not reaches(share_scores(config.replace(**ROOMY), real[::EVERY]), **REAL)


def test_float_is_no_better(synthetic):
    """The arithmetic costs nothing that can be seen: the float engine reaches the same, within two batches."""
    model, exact = (error_scores(FAST, synthetic[:PART], engine=name) for name in ("model", "float"))
    for name in COLD:
        assert abs(model[name] - exact[name]) <= 0.02


def test_the_articles_ascent_misses_by_far(synthetic):
    plain = preset("paper").replace(eta=2.0)  # the best of the η of the study
    scores = error_scores(plain, synthetic[: PART // 4], engine="float")
    assert scores["below_0.6_px"] < 0.7 and scores["below_0.3_px"] < 0.5


@pytest.mark.parametrize("engine", ["model", "float"])
def test_track(engine, data_dir):
    runner = make_engine(engine, accuracy.track_config(FAST, "track"))
    scores = accuracy.track_scores(accuracy.track_checkerboard(runner, data_dir), "track")
    assert scores["batches"] == scores["within_bounds"] == accuracy.TRACK_BATCHES


def test_the_track_as_it_is(data_dir):
    """Thinned out by the buffer itself."""
    runner = make_engine("model", accuracy.track_config(FAST, "track as it is"))
    scores = accuracy.track_scores(accuracy.track_checkerboard(runner, data_dir), "track as it is")
    assert scores["batches"] == scores["within_bounds"] == accuracy.TRACK_BATCHES


def test_thinned_track(data_dir):
    """At most 1024 events of 11,000: too few for strides, which the docs say."""
    config = accuracy.track_config(FAST.replace(**accuracy.BEFORE), "thinned track")
    runner = make_engine("model", config)
    with open_recording(data_dir / accuracy.TRACK_FILE) as recording:
        cutter = BatchCutter(recording, events=accuracy.TRACK_EVENTS, max_events=FAST.max_batch_events)
        results = [batch.result for batch in track(runner, cutter, roi=accuracy.TRACK_ROI, batches=10)]
    assert all(600 < result.roi_events <= 1024 and result.thinned > 9 * result.roi_events for result in results)
    scores = accuracy.track_scores(accuracy.track_checkerboard(make_engine("model", config), data_dir), "thinned track")
    assert scores["batches"] == scores["within_bounds"] == accuracy.TRACK_BATCHES


def test_track_can_fail(data_dir):
    """With a schedule that does not reach the motion, no batch is within the bounds; a degenerate one is not either."""
    config = accuracy.track_config(FAST.replace(dither_frac=0, cold="0:-5", warm="0:-5"), "track")
    speeds = accuracy.track_checkerboard(make_engine("model", config), data_dir, batches=2)
    scores = accuracy.track_scores(speeds, "track")
    assert scores["within_bounds"] == 0
    nothing = accuracy.track_scores(np.full((2, 2), math.nan), "track")
    assert nothing["within_bounds"] == 0


# -------------------------------------------------------------------- bars, on the whole suites


@pytest.mark.slow
def test_cold_and_warm_whole(synthetic):
    cold, warm = (accuracy.errors(make_engine("model", FAST), synthetic, warm=warm) for warm in (False, True))
    assert reaches(accuracy.error_scores(cold), **COLD)
    assert reaches(accuracy.error_scores(warm), **{"below_0.6_px": 0.98, "below_0.3_px": 0.94})
    fast = np.array([case.facts["speed"] >= 1 for case in synthetic])
    for values in (cold, warm):
        assert reaches(accuracy.error_scores(values[fast]), **{"below_0.6_px": 0.99, "below_0.3_px": 0.96})


@pytest.mark.slow
def test_real_whole(real):
    assert reaches(share_scores(FAST.replace(**ROOMY, **accuracy.BEFORE), real), **REAL, at_least_99_percent=0.92)
    assert reaches(share_scores(FAST, real), **REAL)


@pytest.mark.slow
def test_real_whole_is_what_the_readme_says(real):
    """Of the preset as shipped; the integer model has one result, so these are no bars."""
    scores = share_scores(FAST, real)
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (row,) = [line for line in readme.splitlines() if line.startswith("| real batches with ≥ 97 %")]
    assert f" {100 * scores['at_least_97_percent']:.1f} %" in row.split("|")[3]
    assert f"{scores['batches_that_drop_events']} of {scores['batches']} drop events" in row


@pytest.mark.slow
def test_the_objectives_peak_is_the_limit(synthetic):
    """An ascent that found the peak exactly would not be nearer to the truth."""
    peaks = accuracy.error_scores(np.array([accuracy.peak_error(case) for case in synthetic]))
    found = error_scores(FAST, synthetic)
    assert found["below_0.3_px"] >= peaks["below_0.3_px"] - 0.01
    assert found["below_0.6_px"] >= peaks["below_0.6_px"] - 0.01


@pytest.mark.slow
def test_rtl_finds_the_same(synthetic):
    with_clock, model = make_engine("rtl", FAST), make_engine("model", FAST)
    try:
        for case in synthetic[:30]:
            for warm in (False, True):
                assert accuracy.run_case(with_clock, case, warm=warm).v == accuracy.run_case(model, case, warm=warm).v
    finally:
        with_clock.close()


# -------------------------------------------------------------------- command


def run(*arguments):
    return cli.run(accuracy.main, [*map(str, arguments)])


def test_command(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    assert run("--batches", 4, "--json", tmp_path / "scores.json") == 0
    shown = capsys.readouterr()
    assert "Synthetic batches: error of v, px per half batch" in shown.out and "| model  | cold " in shown.out
    assert "synthetic batches only" in shown.err
    written = json.loads((tmp_path / "scores.json").read_text())
    assert written["config"] == FAST.to_dict()
    cold = written["results"]["synthetic, cold, model"]
    assert len(cold["values"]) == cold["scores"]["batches"] == 4
    assert cold["scores"]["median_px"] == pytest.approx(np.median(cold["values"]))


@pytest.mark.parametrize("study", accuracy.STUDIES)
def test_studies(study, capsys, monkeypatch):
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    monkeypatch.setattr(accuracy, "PLAIN_ETAS", (2.0,))
    assert run("--study", study, "--batches", 2) == 0
    out = capsys.readouterr().out
    assert "px" in out and out.count("\n| ") >= 3


def test_all_suites_by_two_engines(capsys, data_dir, monkeypatch):
    monkeypatch.setattr(accuracy, "ENGINES", ("rtl", "float", "model"))
    monkeypatch.setattr(accuracy, "make_engine", lambda name, config: make_engine("model", config))
    monkeypatch.setattr(accuracy, "WINDOWS", accuracy.WINDOWS[1:2])
    assert run("--engine", "all", "--batches", 3, "--data", data_dir) == 0
    out = capsys.readouterr().out
    assert "Real batches" in out and "Checkerboard, tracked" in out
    assert "real: rtl and model agree exactly in 5 of 5 batches" in out
    assert "track: rtl and model agree exactly in 10 of 10 batches" in out


def test_real_batches_run_with_the_configuration_as_it_is(capsys, data_dir, monkeypatch, tmp_path):
    """No larger buffer in secret: in the suites, in a study, and in what the bench prints of them."""
    monkeypatch.setattr(accuracy, "WINDOWS", accuracy.WINDOWS[1:2])  # five batches
    cases = accuracy.real_cases(data_dir)
    events = [case.facts["roi_events"] for case in cases]
    assert max(events) > FAST.buffer_events
    drop = ("--set", "when_full=drop")
    assert run("--batches", 1, "--data", data_dir, "--json", tmp_path / "a.json", *drop) == 0
    found = json.loads((tmp_path / "a.json").read_text())["results"]["real, model"]
    dropped = [max(0, n - FAST.buffer_events) for n in events]
    assert [int(row[2]) for row in found["values"]] == dropped
    assert found["scores"]["batches_that_drop_events"] == np.count_nonzero(dropped)
    assert "batches that drop events" in capsys.readouterr().out
    monkeypatch.setattr(accuracy, "WIDTHS", accuracy.WIDTHS[2:3])  # those of the preset
    assert run("--study", "widths", "--batches", 1, "--data", data_dir, "--json", tmp_path / "b.json", *drop) == 0
    studied = json.loads((tmp_path / "b.json").read_text())["results"]
    assert studied["real, widths 8, 6, 4, 4, 4, 4"] == found
    told = accuracy.brief("model", data=data_dir, batches=1)
    assert told["text"][-1].endswith("; 0 drop events")


def test_a_difference_between_rtl_and_model_is_said(capsys):
    accuracy._compare_with_model({("rtl", "cold"): np.array([1.0, 2.0]), ("model", "cold"): np.array([1.0, 2.5])})
    assert capsys.readouterr().out == "cold: rtl and model agree exactly in 1 of 2 batches\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--data", "nowhere"], "--data nowhere: no such folder"),
        (["--batches", "0"], "argument --batches: '0': a whole number of 1 or more is needed"),
        (["--set", "roi_width=32"], "ROI of 32×64 px: the suites are for 64×64 px"),
        (["--study", "magic"], "argument --study: invalid choice: 'magic'"),
        (["--study", "schedules", "--preset", "paper"], "ascent = 'constant': schedules belong to ascent = sign"),
        (["--json", "no/such/folder/scores.json"], "no/such/folder/scores.json: No such file or directory"),
    ],
)
def test_mistakes_get_one_line(arguments, message, capsys, monkeypatch):
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    assert run(*arguments) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"error: {message}")


def test_help_has_examples():
    shown = subprocess.run([sys.executable, "-m", "cmfpga.accuracy", "--help"], capture_output=True, text=True)
    assert shown.returncode == 0 and "examples:\n  python -m cmfpga.accuracy" in shown.stdout


def test_every_schedule_of_the_study_fits_the_format():
    for text in (*accuracy.SCHEDULES, *accuracy.WARM_SCHEDULES):
        entries = FAST.replace(cold=text, schedule_entries=64).cold_schedule
        assert all(isinstance(entry, ScheduleEntry) for entry in entries)
    assert MEASURED["cold"] in accuracy.SCHEDULES and MEASURED["warm"] in accuracy.WARM_SCHEDULES
