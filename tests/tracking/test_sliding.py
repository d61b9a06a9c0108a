"""Tracks by windows that slide: every hop's events, lengths that suit the motion, and what is refused."""

from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from studies.accuracy.known import drawn

import cmfpga
from cmfpga import cli
from cmfpga.cli import command
from cmfpga.config import preset
from cmfpga.engines import make_engine
from cmfpga.errors import ConfigError
from cmfpga.events import Events, MemoryRecording, generate, write_hdf5
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.integer.sliding import Sliding
from cmfpga.tracking import sliding
from cmfpga.tracking.ambiguity import Ambiguity
from cmfpga.tracking.fit import batch_cutter
from cmfpga.tracking.loop import _Objects, track
from cmfpga.tracking.sliding import Overlapping

#: It turns a corner after 80 ms.
SCENE = {
    "seed": 3, "texture": "lines", "position": (70.0, 90.0), "duration_us": 160_000, "noise": 0.05,
    "velocity": ((80_000, 150.0, 100.0), (80_000, 120.0, -100.0)),
}  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return generate(**SCENE)


MODEL = {"preset": "sliding", "engine": "model"}


@pytest.fixture(scope="module")
def tracked(scene):
    return cmfpga.track(scene, **MODEL)


def test_a_turn_is_followed(scene, tracked):
    assert len(tracked) > 60
    begin = tracked.t_us - tracked.window_us
    truth = np.array([scene.motion.mean_velocity(int(a), int(b)) for a, b in zip(begin, tracked.t_us, strict=True)])
    found = np.stack([tracked.vx_px_per_s, tracked.vy_px_per_s], 1)
    off = np.hypot(*(found - truth).T) * tracked.window_us / 2e6
    corner = (begin < 80_000) & (tracked.t_us > 80_000)
    told = Ambiguity.TWO_MOTIONS | Ambiguity.ELSEWHERE | Ambiguity.CHANGES
    assert tracked.trusted[~corner].mean() > 0.95 and 0.5 < (tracked.ambiguity[corner] & told > 0).mean()
    assert off[tracked.trusted & ~corner].max() < 0.6 and 5 < corner.sum() < 40
    middle = np.array(tracked.results[-1].roi_next) + 31.5
    assert np.hypot(*(middle - scene.motion.position(tracked.t_us[-1:])[0])) < 3
    moved = np.hypot(tracked.vx, tracked.vy)[tracked.trusted] * 2
    assert 5 < np.median(moved) < 7, "px in a window, as is aimed at"
    assert {one.fresh for one in tracked.results[1:]} == {round(max(tracked.roi_events) / 16)}


def test_thinned_events_make_no_longer_windows(scene, tracked, monkeypatch):
    """A window's events are those that are stored; where fewer are, it still holds the same motion."""
    monkeypatch.setattr(sliding, "LONGEST", 1.0)  # where they say too little, it is longer
    thinned = cmfpga.track(scene, **MODEL, thinning=3, batches=30)
    assert np.median(thinned.window_us) == pytest.approx(np.median(tracked.window_us[:30]), rel=0.25)
    assert max(thinned.roi_events) < 0.5 * max(tracked.roi_events[:30])


DENSE = {
    "seed": 5, "texture": "dense", "size": (90, 90), "position": (100.0, 90.0), "duration_us": 200_000,
    "velocity": (60.0, 25.0),
}  # fmt: skip


def test_of_dense_texture_so_many_events_are_left_out_that_windows_are_long_enough():
    scene = generate(**DENSE, contrast=3.0)
    found = cmfpga.track(scene, roi=(80, 60), engine="model")
    as_it_was = cmfpga.track(scene, roi=(80, 60), engine="model", thinning=2, batches=len(found))
    (thinning,) = {round((one.roi_events + one.thinned) / one.roi_events) for one in found.results[:1]}
    assert thinning > 3 and 0.75 * 8191 < found.roi_events.max() <= 8191
    off = np.hypot(found.vx_px_per_s - 60, found.vy_px_per_s - 25) * found.window_us / 2e6
    assert found.trusted.all() and off.max() < 0.3 and 5 < 2 * np.median(np.hypot(found.vx, found.vy)) < 7
    assert np.median(as_it_was.window_us) < 0.6 * np.median(found.window_us), "what is asked for is taken"


def test_the_first_window_is_borne_out_by_none_before_it():
    """Where hops end before a window is full nothing is measured, and that says nothing."""
    scene = generate(**{**DENSE, "velocity": (400.0, 250.0), "duration_us": 80_000}, contrast=1.2)
    found = cmfpga.track(scene, roi=(80, 60), engine="model", batches=3)
    assert found.trusted.tolist() == [True] * 3 and (found.ambiguity & Ambiguity.ALONE == 0).all()


def test_where_the_confidence_is_nearly_enough_windows_are_longer(monkeypatch):
    """Few events of a noisy scene, as sharp as half of what a clear one is: no window is trusted otherwise."""
    (known,) = drawn(1, 1, "usual")
    options = {"sensor": known.sensor, "roi": known.rois[0], "engine": "model", "batches": 60}
    longer = cmfpga.track(known.events, **options)
    monkeypatch.setattr(sliding, "NEARLY", np.inf)
    as_long_as_usual = cmfpga.track(known.events, **options)
    assert 1.3 < np.median(longer.window_us) / np.median(as_long_as_usual.window_us) <= sliding.LONGEST + 0.1
    assert longer.trusted.mean() > 0.9 > 0.5 > as_long_as_usual.trusted.mean()


def scene_with(contrasts, duration_us=450_000):
    """An object at (90, 30) px/s, whose edges become stronger or weaker, so that it emits more events or fewer."""
    parts = []
    for k, contrast in enumerate(contrasts):
        at = k * duration_us
        made = generate(
            seed=11, texture="lines", size=(34, 34), position=(70 + 90e-6 * at, 80 + 30e-6 * at), velocity=(90.0, 30.0),
            duration_us=duration_us, noise=0.05, contrast=contrast,
        ).events  # fmt: skip
        parts.append(Events(made.t + at, made.x, made.y, made.p))
    return Events.concatenate(parts)


@pytest.mark.parametrize("contrasts", [(0.8, 2.4), (2.4, 0.8)])
def test_windows_stay_as_long_where_events_come_faster_or_more_slowly(contrasts):
    """So many events as at the beginning take a quarter of the time, or four times as long, and that is made good."""
    events = scene_with(contrasts)
    found = cmfpga.track(events, sensor=(240, 180), roi=(39, 49), engine="model")
    begin, end = (found.t_us < 430_000), (found.t_us > 750_000)
    assert found.trusted[begin | end].mean() > 0.97
    counts, lengths = ([np.median(of[part]) for part in (begin, end)] for of in (found.roi_events, found.window_us))
    assert 2 < max(counts) / min(counts) < 4 and max(lengths) / min(lengths) < 1.35
    off = np.hypot(found.vx_px_per_s - 90, found.vy_px_per_s - 30) * found.window_us / 2e6
    assert off[begin | end].max() < 0.6
    given = cmfpga.track(events, sensor=(240, 180), roi=(39, 49), engine="model", window_events=int(counts[0]))
    assert max(given.roi_events) == int(counts[0]), "what is asked for is taken"


def fitted(way=3.0, **hop):
    """What :class:`FittedWindows` makes of windows of 1000 events, after so many hops of a kind."""
    given = replace(BatchSettings.from_config(preset("sliding")), window_events=1000, hop_events=62)
    windows = sliding.FittedWindows(preset("sliding"), given, way)
    for _ in range(hop.pop("hops", 33)):
        windows.add(hop_of(**hop))
    return windows.fit()


def hop_of(moved=3.0, flags=0, n=1000, span=50_000, kappa=300.0):
    """A result of a hop."""
    named = {"v": (moved, 0.0), "flags": Flag(flags), "span": span, "roi_events": n, "fresh": 62}
    return SimpleNamespace(**named, confidence_limit=90, kappa=kappa)


@pytest.mark.parametrize("hop, length", [
    ({}, 1000), ({"moved": 2.3}, 1000), ({"moved": 3.7}, 1000),  # by as much as is allowed
    ({"moved": 2.0}, 1500), ({"moved": 0.1}, 2000), ({"moved": 2.0, "flags": Flag.DOUBTFUL}, 1500),
    ({"moved": 4.0}, 750), ({"moved": 9.0}, 500), ({"moved": 9.0, "kappa": 93.75}, 800),
    ({"moved": 4.0, "flags": Flag.DOUBTFUL}, 1000),
    ({"moved": 0.1, "n": 400}, 1000), ({"moved": 4.0, "n": 400}, 300),  # as where an object stops; or events are few
    ({"moved": 2.0, "hops": 32}, 1000), ({"moved": 2.0, "flags": Flag.DEGENERATE}, 1000),  # too early; of nothing
    ({"moved": 2.0, "way": None}, 1000),
])  # fmt: skip
def test_how_long_windows_become(hop, length, monkeypatch):
    """They move by more or less than is allowed; less, of noise too; and no longer, where they would not be sure."""
    monkeypatch.setattr(sliding, "confidence", lambda config, result: result.kappa)
    settings = fitted(**hop)
    assert settings.window_events == length
    if length != 1000:
        assert settings.hop_events == round(length / 16) and settings.min_roi_events == length // 4
        assert settings.window_us == max(60_000, round(1.75 * 50_000 * length / hop.get("n", 1000)))


def test_windows_that_nobody_trusts_return_to_the_last_length_that_was():
    given = replace(BatchSettings.from_config(preset("sliding")), window_events=1000, hop_events=62)
    windows, lengths = sliding.FittedWindows(preset("sliding"), given, 3.0), []
    for moved in (1.0, 1.0, 1.0, 4.0):
        for _ in range(280):
            windows.add(hop_of(moved, Flag.DOUBTFUL, n=windows.given.window_events))
        lengths.append(windows.fit().window_events)
    assert lengths == [2000, 4000, 8000, 1000]


def test_a_survey_is_not_bound_by_the_longest_batch():
    """A window may have more of the sensor's events than the hardware counts in a batch."""
    scene = generate(**{**DENSE, "velocity": (48.0, 20.0), "size": (150, 150)}, contrast=3.0)
    found = cmfpga.track(scene, roi=(80, 60), engine="model", batches=3, max_batch_events=65_535)
    assert found.trusted.all() and 5 < 2 * np.median(np.hypot(found.vx, found.vy)) < 7
    assert len(scene.events) * np.median(found.window_us) / DENSE["duration_us"] > 65_535


@pytest.mark.parametrize("fields", [{}, {"background": 1, "background_us": 3000}])
def test_what_lies_far_from_the_roi_says_nothing_of_a_trial(fields):
    scene = generate(seed=6, size=(120, 100), noise=0.2, duration_us=60_000).events
    config = preset("sliding").replace(sensor_width=240, sensor_height=180, **fields)
    with closing(make_engine("model", config)) as engine:
        (near,) = _Objects(engine, [(90, 60)], 1).trial(scene, None)
        (every,) = engine.trial(scene, None)
    assert near.events < len(scene) == every.events and near.thinned == every.thinned
    for name in ("v", "sums", "sum_squares", "curvature", "roi_events", "span", "flags"):
        assert str(getattr(near, name)) == str(getattr(every, name)), name


def test_rows_tell_the_events_of_their_windows(scene):
    config = preset("sliding").replace(window_events=300, hop_events=40, window_us=30_000, min_roi_events=30)
    events, start = scene.events, scene.roi_start(64, 64)
    recording = MemoryRecording(events, config.sensor_width, config.sensor_height, "events")
    given = replace(BatchSettings.from_config(config, roi=start), min_roi_events=75)
    wanted = [*Sliding(config, given).run(events.t, events.x, events.y)]
    first = next(k for k, one in enumerate(wanted) if Flag.DEGENERATE not in one.flags)
    rows = list(track(make_engine("model", config), batch_cutter(recording, config), roi=start))
    assert [row.result for row in rows][1:] == wanted[first + 1 :] and len(rows) > 40
    # The first row has the events of the hops that were passed over.
    for name in ("events", "outside", "time_back", "fresh"):
        assert getattr(rows[0].result, name) == sum(getattr(one, name) for one in wanted[: first + 1])
    assert rows[0].result.v == wanted[first].v
    end = np.cumsum([one.events for one in wanted])
    for row, last in zip(rows, end[first:], strict=True):
        result, own = row.result, row.events
        assert own.first_event + len(own) == last and own.t[-1] <= result.t_us
        assert own.t[0] == events.t[np.searchsorted(events.t, result.t_first)] and row.t_us == own.t[-1]


def test_nothing_is_said_to_stay_where_the_roi_follows_every_v(scene):
    lost = cmfpga.track(scene, **MODEL, confidence_limit=341.0, window_events=300, batches=120)
    (warning,) = [text for text in lost.verdict.warnings() if "lost" in text]
    assert "stayed" not in warning and "cold" not in warning, warning


def test_every_few_results_are_kept(scene, tracked):
    few = cmfpga.track(scene, **MODEL, every=5, batches=7)
    assert [one.v for one in few.results] == [one.v for one in tracked.results[:35:5]]
    assert few.events.sum() == tracked.events[:31].sum()


def test_windows_are_borne_out_by_two_thirds_of_those_that_share_their_time():
    def at(begin, end):
        t = np.array([begin, end])
        return Events(t, t, t, t % 2)

    overlapping, sure = Overlapping(), (1, 0, 1, 1, 0, 1, 1)
    found = [overlapping.bear_out(at(10 * k, 10 * k + 35), bool(one)) for k, one in enumerate(sure)]
    # Each shares its time with the three before it.
    assert found == [True, False, True, True, False, True, True]
    assert overlapping.bear_out(at(500, 535), True), "no other shares its time"
    assert not overlapping.bear_out(Events.empty(), False)


def test_an_engine_that_is_seldom_sure_is_not_trusted(scene, tracked):
    """Whichever results are kept, those between them count."""
    options = MODEL | {"window_events": int(max(tracked.roi_events))}
    few = cmfpga.track(scene, **options, confidence_limit=110.0, batches=60)
    sure = few.confidence >= 110
    assert 0.1 < sure.mean() and (few.ambiguity[sure] & Ambiguity.ALONE).any()
    third = cmfpga.track(scene, **options, confidence_limit=110.0, every=3, batches=20)
    assert third.trusted.tolist() == few.trusted[::3].tolist()


def test_the_tracker_finds_the_same_in_pieces(scene, tracked):
    found = []
    with cmfpga.Tracker(sensor=(240, 180), roi=scene.roi_start(64, 64), **MODEL) as tracker:
        for at in range(0, len(scene.events), 777):
            found += tracker.push(scene.events[at : at + 777])
        tracking = tracker.tracking
    assert tracking.results == tracked.results
    assert [one.result for one in found] == tracked.results[: len(found)] and len(found) > 50


@pytest.mark.parametrize("wrong, message", [
    ({"batch_events": 500}, "batch_events: windows = batches is needed; windows = sliding has none"),
    ({"preset": "fast", "every": 2}, "every = 2: windows = sliding is needed"),
    ({"every": 0}, "every = 0: an integer of 1 or more is needed"),
    ({"engine": "float"}, "engine float: windows = batches is needed; rtl and model have windows that slide"),
])  # fmt: skip
def test_what_is_refused(scene, wrong, message):
    with pytest.raises(ConfigError, match=f"^{message}"):
        cmfpga.track(scene, **MODEL | wrong)


def test_the_command(tmp_path, capsys):
    arguments = ["track", "--preset", "sliding", "--engine", "model", "--every", "3", "--batches", "5"]
    arguments += ["--no-picture", "--out", str(tmp_path)]
    assert cli.run(command.main, arguments) == 0
    head, *rows = (tmp_path / "track.csv").read_text().splitlines()
    assert head.startswith("batch,t_us,window_us,t_ref_us,events,") and len(rows) == 5
    assert "5 of 5 windows are to be trusted" in capsys.readouterr().out
    batches = "windows = batches is needed"
    for more, what in (
        (["--batch-events", "500"], f"--batch-…: {batches}"), (["--wave", "2"], f"--wave: {batches}"),
        (["--roi", "1,1"] * 2, "sliding"),
    ):  # fmt: skip
        assert cli.run(command.main, [*arguments, *more]) == 2
        assert what in capsys.readouterr().err


def test_what_knows_batches_alone_says_so(scene, tracked, capsys, tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match=r"^trace: windows = batches is needed"):
        tracked.trace(3)
    write_hdf5(tmp_path / "a.h5", scene.events, width=240, height=180)
    sweep = ["sweep", f"{tmp_path / 'a.h5'}@39,59", "--preset", "sliding", "--out", str(tmp_path / "out")]
    assert cli.run(command.main, sweep) == 2
    assert "sweep: windows = batches is needed" in capsys.readouterr().err
    monkeypatch.setattr("cmfpga.engines.cannot_compile", lambda: "no C++ compiler found")
    why = r"^windows = sliding: engine rtl needs a C\+\+ compiler: no C\+\+ compiler found"
    with pytest.raises(ConfigError, match=why):
        make_engine("rtl", preset("sliding"))
