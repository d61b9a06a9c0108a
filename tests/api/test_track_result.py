"""``cmfpga.track(…)``: the command's numbers as arrays, and every intermediate equal to the engine's."""

import csv
import inspect
import io
import sys

import numpy as np
import pytest
import torch
from matplotlib.text import Text

import cmfpga
from cmfpga.cli import track as command_module
from cmfpga.errors import ConfigError, RecordingError, UserError
from cmfpga.events import Events, MemoryRecording, open_recording, write_hdf5
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference import floating
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.tracking.columns import COLUMNS
from cmfpga.tracking.trace import BatchTrace
from cmfpga.verilog.compiler import find_compiler
from support.designs import FAST, PAPER


def follow(recording, engine="model", config=PAPER, **options):
    if engine == "rtl" and find_compiler() is None:
        pytest.skip("no C++ compiler")
    return cmfpga.track(recording, roi=(8, 9), batch_events=90, engine=engine, **{**config, **options})


def test_the_package_shows_what_it_has_and_help_can_tell_its_arguments():
    assert {"track", "Tracker", "flow", "Events"} <= {*dir(cmfpga)} and callable(cmfpga.track)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = cmfpga.nonsense
    parameters = inspect.signature(cmfpga.track).parameters
    assert [*parameters][:4] == ["recording", "roi", "preset", "engine"] and parameters["preset"].default is None
    assert "roi : (int, int)" in cmfpga.track.__doc__


@pytest.mark.parametrize("engine", ["rtl", "model", "float"])
def test_arrays_are_the_columns_of_the_csv(command, rows, dot, small, tmp_path, engine):
    tracking = follow(dot, engine)
    options = ["--preset", "paper", "--engine", engine, "--out", tmp_path, "--no-picture"]
    done = command(command_module, dot, "--roi", "8,9", "--batch-events", 90, *small, *options)
    assert done.status == 0
    assert len(tracking) == 6
    for name in COLUMNS:
        values, texts = getattr(tracking, name), [row[name] for row in rows(tmp_path)]
        assert values.shape == (6,)
        if name == "flags":
            assert values.tolist() == texts
        else:
            # As text, the CSV has 1 to 6 digits less.
            np.testing.assert_allclose(values, [float(text or "nan") for text in texts], rtol=0, atol=0.05)
    for name in ("batch", "events", "roi_events", "roi_x", "roi_y", "iterations"):
        assert getattr(tracking, name).dtype == np.int64
    assert np.isnan(tracking.cycles).all() == (engine != "rtl")
    tracking.to_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "track.csv").read_bytes()


def test_a_notebook_shows_the_table_and_the_picture(dot, monkeypatch):
    tracking = follow(dot, batches=5)
    shown = tracking._repr_html_()
    assert shown.count("<tr>") == 6 and f"<td>{tracking.vx[4].item()!r}</td>" in shown
    assert "middle of the batch [µs]" in shown and "data:image/png;base64,iVBORw0KGgo" in shown
    monkeypatch.setattr("cmfpga.api.track_result._SHOWN", 2)
    shown = tracking._repr_html_()
    assert shown.count("<tr>") == 6 and shown.count("<td>…</td>") == len(COLUMNS)


def test_data_frame(dot):
    pandas = pytest.importorskip("pandas")
    tracking = follow(dot, batches=3)
    frame = tracking.to_pandas()
    assert list(frame.columns) == list(COLUMNS) and len(frame) == 3
    assert list(tracking.to_arrays()) == list(COLUMNS) and frame["roi_x"].tolist() == tracking.roi_x.tolist()
    assert frame["vx"].tolist() == tracking.vx.tolist()
    assert next(csv.reader(io.StringIO(frame.to_csv(index=False)))) == list(COLUMNS)
    assert pandas.isna(frame["cycles"]).all()


@pytest.mark.parametrize("library, extra, call", [
    ("pandas", "pandas", lambda tracking: tracking.to_pandas()),
    ("torch", "reference", lambda tracking: tracking.trace(0)),
])  # fmt: skip
def test_what_is_not_installed_is_asked_for(dot, monkeypatch, library, extra, call):
    tracking = follow(dot, batches=1)
    monkeypatch.delitem(sys.modules, "cmfpga.tracking.trace")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ConfigError, match=rf"pip install 'cmfpga\[{extra}\]'"):
        call(tracking)


def test_plot_is_the_picture_of_the_command(dot, tmp_path):
    figure = follow(dot).plot(tmp_path / "a.png")
    shown = [text.get_text() for text in figure.findobj(Text)]
    assert "dot.h5: 6 batches" in shown and "trail of its centre" in shown
    assert (tmp_path / "a.png").stat().st_size > 20_000
    of_one_place = [text.get_text() for text in follow(dot, batches=1).plot().findobj(Text)]
    assert "ROI" in of_one_place and "trail of its centre" not in of_one_place


def test_what_can_be_tracked(dot, dot_events):
    expected = follow(dot, batches=3)
    with open_recording(dot) as opened:
        found = [follow(opened, batches=3)]
    found.append(follow(dot_events, batches=3, sensor=(32, 24)))
    found.append(follow(MemoryRecording(dot_events, 32, 24), batches=3))
    columns = tuple(getattr(dot_events, name) for name in "txyp")
    for data in (columns, np.stack(columns, axis=1).astype(int), dict(zip("txyp", columns, strict=True))):
        found.append(follow(data, batches=3, sensor=(32, 24)))
    found.append(follow((dot_events.t / 1e6, *columns[1:]), batches=3, sensor=(32, 24), time_unit="s"))
    for tracking in found:
        assert tracking.vx.tolist() == expected.vx.tolist() and tracking.contrast.tolist() == expected.contrast.tolist()


def test_a_live_source_is_tracked_but_not_read_again(dot, dot_events):
    class Live:
        name, width, height, seekable = "camera", 32, 24, False

        def __init__(self):
            self._events = iter([dot_events[:100], dot_events[100:101], dot_events[101:]])

        def chunks(self, start, size):
            assert start == 0
            return self._events

    tracking, expected = follow(Live()), follow(dot)
    assert len(tracking) == 6 and tracking.source.name == "camera"
    assert tracking.vx.tolist() == expected.vx.tolist() and tracking.t_ref_us.tolist() == expected.t_ref_us.tolist()
    with pytest.raises(RecordingError, match="camera: its events cannot be read again; a recording is needed"):
        tracking.trace(0)


@pytest.mark.parametrize("options, message", [
    ({"roi": None}, "roi: the ROI's left column"),
    ({"roi": (40, 0)}, "ROI at 40,0: 0,0 to 24,16 is needed"),
    ({"nonsense": 1}, "'nonsense': no such field"),
    ({"batch_us": 100}, "events and duration_us given"),
    ({"start_event": 590}, "too few events for one batch after event 590 \\(10 left\\)"),
    ({"start_event": 1.5}, "start_event = 1.5: an integer of 0 or more is needed"),
    ({"batches": 1.5}, "batches = 1.5: an integer of 1 or more is needed"),
    ({"roi": "1,2"}, "roi = '1,2': left column and top row, two whole numbers, are needed"),
    ({"sensor": "240x180"}, "sensor '240x180'; \\(width, height\\) in whole pixels is needed"),
    ({"preset": ["fast"]}, "preset \\['fast'\\]: one of paper"), ({"engine": []}, "engine \\[\\]: one of rtl"),
])  # fmt: skip
def test_mistakes_are_told_in_one_line(dot, options, message):
    with pytest.raises(UserError, match=message) as caught:
        cmfpga.track(dot, **{"roi": (8, 9), "batch_events": 90, "engine": "model", **PAPER, **options})
    assert "\n" not in str(caught.value)


def test_mistakes_with_what_is_tracked(dot_events, tmp_path):
    with pytest.raises(ConfigError, match="sensor: \\(width, height\\)"):
        follow(dot_events)
    with pytest.raises(RecordingError, match="events in memory: sensor '240x180'; "):
        follow(dot_events, sensor="240x180")
    with pytest.raises(RecordingError, match="events: list; \\(t, x, y, p\\), a structured array, or N×4"):
        follow([1, 2, 3])
    np.savez(tmp_path / "a.npz", t=dot_events.t, x=dot_events.x, y=dot_events.y, p=dot_events.p)
    with pytest.warns(UserWarning) as told:
        follow(tmp_path / "a.npz", batches=1)
    unit, sensor = (str(warning.message) for warning in told)
    assert "taking us, a guess; say it with time_unit=" in unit and "taking 240×180 px" in sensor


@pytest.mark.parametrize("config", [PAPER, {**FAST, "cold_after_doubtful": 0}], ids=["paper", "fast"])
@pytest.mark.parametrize("engine", ["rtl", "model"])
def test_every_intermediate_is_that_of_the_model(dot, engine, config):
    """Of the integer core itself, run over the same batches and asked to keep everything."""
    tracking = follow(dot, engine, config)
    steps, start, iterations = tracking.config, (8, 9), 0
    core, each = IntegerCore(steps), steps.ascent_rule.evaluations
    with open_recording(dot) as recording:
        for batch in range(len(tracking)):
            events = next(recording.chunks(90 * batch, 90))
            core.run(events.t, events.x, events.y, BatchSettings.from_config(steps, start), keep=True)
            start, trace = None, tracking.trace(batch)
            assert len(trace) == len(core.iterations) == each * tracking.iterations[batch]
            np.testing.assert_array_equal(trace.v[-1], tracking.results[batch].v)
            if len(trace):
                assert (trace.dt * 2**steps.dt_frac == core.dt.numpy()).all()
            for k, expected in enumerate(core.iterations):
                got = trace[k]
                rows, columns = got.iwe.shape
                assert (columns, rows) == steps.geometry.level_size(got.level) and got.level == trace.levels[k]
                for name, image in (("iwe", expected.images.i), ("iwe_dx", expected.images.dx)):
                    assert (got.raw[name] == image.numpy()[:rows, :columns]).all()
                    assert not image.numpy()[rows:].any() and not image.numpy()[:, columns:].any()
                found = expected.v_next or tracking.results[batch].trace.v[k // each + 1]
                assert tuple(got.raw["v"]) == expected.v and tuple(got.raw["v_next"]) == tuple(found)
                assert tuple(got.raw["g"]) == expected.g and got.raw["sum_i"] == expected.sums.i
                assert got.sum_i == got.iwe.sum() and got.s[1] == (got.iwe * got.iwe_dy).sum()
                iterations += 1
    assert iterations > 20
    levels = {level for batch in range(6) for level in tracking.trace(batch).levels}
    assert levels == ({0} if config is PAPER else {0, 1, 2})


@pytest.mark.parametrize("config", [PAPER, FAST], ids=["paper", "fast"])
def test_every_intermediate_of_the_float_engine(dot, config):
    tracking = follow(dot, "float", config)
    trace, result = tracking.trace(1), tracking.results[1]
    size = {"width": 8, "height": 8, "border": tracking.config.border}
    events = (torch.from_numpy(trace.x_dithered), torch.from_numpy(trace.y_dithered), torch.from_numpy(trace.dt))
    assert np.abs(trace.dt).max() <= 1
    each = tracking.config.ascent_rule.evaluations
    assert len(trace) == each * result.iterations > 0
    for k in range(len(trace)):
        got = trace[k]
        expected = floating.evaluate(*events, trace.v[k], level=got.level, **size)
        rows, columns = got.iwe.shape
        np.testing.assert_array_equal(got.iwe, expected.image.numpy()[:rows, :columns])
        assert got.raw is None and got.sum_i == result.trace.sum_i.flatten()[k]
        np.testing.assert_allclose(got.v_next, result.trace.v[k // each + 1], atol=1e-12)
        moved = trace.x_dithered - trace.dt * got.v[0]
        np.testing.assert_allclose(got.x, (moved + 0.5) / 2**got.level - 0.5, atol=1e-12)
    dithered = np.abs(trace.x_dithered - trace.x).max()
    assert (0 < dithered <= 0.5) if config is not PAPER else dithered == 0


@pytest.mark.parametrize("engine", ["rtl", "model", "float"])
@pytest.mark.parametrize("changes", [{"thinning": 3}, {"thin_target": 12}, {"buffer_events": 16}, {"start": "zero"}])
def test_what_the_engine_left_out_is_left_out(dot, engine, changes):
    tracking = follow(dot, engine, FAST, **changes)
    traces = [(tracking.trace(batch), result.roi_events) for batch, result in enumerate(tracking.results)]
    assert all(len(trace.t) == len(trace.dt) == count for trace, count in traces)
    assert sum(len(trace[k].x) == count for trace, count in traces for k in range(len(trace))) > 10
    if "start" not in changes:
        assert any(flag in result.flags for result in tracking.results for flag in (Flag.THINNED, Flag.OVERFLOW))


def test_batches_without_events_or_motion(dot_events):
    pause = Events(dot_events.t + 3000 * (np.arange(600) >= 300), dot_events.x, dot_events.y, dot_events.p)
    options = {**FAST, "engine": "model", "roi": (8, 9), "sensor": (32, 24), "cold_after_doubtful": 0}
    tracking = cmfpga.track(pause, batch_us=1000, **options)
    assert tracking.events.tolist() == [100] * 3 + [0] * 3 + [100] * 2
    for batch in range(8):
        trace = tracking.trace(batch)
        assert len(trace) == 4 * tracking.iterations[batch] == len(trace.levels)
        assert [trace[k].level for k in range(len(trace))] == trace.levels.tolist()
    # A window without events never reaches the hardware, which goes on where it was.
    assert tracking.iterations.tolist()[:7] == [3, 2, 2, 0, 0, 0, 2]
    with pytest.raises(IndexError):
        tracking.trace(0)[12]
    with pytest.raises(ConfigError, match="batch 8: 0 to 7 is needed"):
        tracking.trace(8)


@pytest.mark.parametrize("engine", ["model", "float"])
def test_after_a_degenerate_batch_the_ascent_begins_cold(dot_events, engine):
    """All events of batch 2 lie far from the ROI."""
    x, y = (np.where(np.arange(600) // 90 == 2, 0, at) for at in (dot_events.x, dot_events.y))
    elsewhere = Events(dot_events.t, x, y, dot_events.p)
    options = {"start": "last", "min_roi_events": 10, "cold_after_doubtful": 0, "hot_pixels": 0}
    tracking = follow(elsewhere, engine, FAST, sensor=(32, 24), **options)
    assert tracking.flags[2] == "degenerate" and tracking.iterations.tolist()[:4] == [3, 2, 0, 3]
    for batch in range(6):
        trace = tracking.trace(batch)
        assert [trace[k].level for k in range(len(trace))] == trace.levels.tolist()
    assert tracking.trace(3).levels.tolist() == [2] * 4 + [1] * 4 + [0] * 4


def test_a_recording_that_has_changed(dot_events, tmp_path):
    path = tmp_path / "a.h5"
    write_hdf5(path, dot_events, 32, 24)
    tracking = follow(path)
    x = dot_events.x.copy()
    x[95:100] = 31
    write_hdf5(path, Events(dot_events.t, x, dot_events.y, dot_events.p), 32, 24)
    tracking.trace(0)
    with pytest.raises(RecordingError, match="the recording has changed"):
        tracking.trace(1)


def test_other_settings_than_the_engines_are_noticed(dot):
    """The check that makes a trace trustworthy can fail."""
    tracking = follow(dot, config=FAST)
    with open_recording(dot) as recording:
        events = next(recording.chunks(0, 90))
    result, (_, plan, thinning, _) = tracking.results[0], tracking._runs[0]
    for config, steps in (
        (tracking.config.replace(dither_frac=3), plan),
        (tracking.config.replace(weight_frac=5), plan),
        (tracking.config, plan[::-1]),
    ):
        wrong = BatchTrace(config, "model", events, result, plan=steps, thinning=thinning, name="x")
        with pytest.raises(RecordingError, match="changed"):
            for k in range(len(wrong)):
                _ = wrong[k]
