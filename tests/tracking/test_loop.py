"""The tracker: settings, ROIs and batches in order, and the rows of the CSV, with engines and cutters made up here."""

import dataclasses
import io

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.engines import Engine
from cmfpga.engines.model import FloatEngine
from cmfpga.events import BatchCutter, Feed, generate
from cmfpga.imaging.iwe import contrast
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import BatchResult
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.trace import Trace
from cmfpga.tracking.columns import COLUMNS
from cmfpga.tracking.loop import CsvConsumer, TrackedBatch, track
from support.commands import HEADER
from support.tracks import recording
from support.values import required

CONFIG = Config(sensor_width=40, sensor_height=30, roi_width=12, roi_height=8, start="given", v_start_x=1.0)
NO_TRACE = Trace(v=np.zeros((1, 2)), sum_i=np.zeros(0), sum_d=np.zeros((0, 2)), s=np.zeros((0, 2)))


class Recorder(Engine):
    """Remembers what it was asked, and moves its ROI by (2, 1) px a batch."""

    name = "recorder"
    v = (1.5, -0.25)

    def __init__(self, config=CONFIG, **result):
        super().__init__(config)
        self.asked = []
        self._result, self._at = result, None

    def _run(self, events, settings):
        self.asked.append((events, settings))
        self._at = settings.roi or self._at
        roi, self._at = self._at, (self._at[0] + 2, self._at[1] + 1)
        values = required(
            "batch", "region", events=len(events), roi_events=3, outside=len(events) - 3, roi=roi, roi_next=self._at,
            span=int(events.t[-1] - events.t[0]), v=self.v, iterations=5, flags=Flag(0), trace=NO_TRACE,
        )  # fmt: skip
        return [BatchResult(**{**values, **self._result})]


def tracked(engine, t=range(0, 1000, 10), roi=(4, 5), batches=None, **mode):
    cutter = BatchCutter(recording(t), **{"max_events": 1000, **mode})
    return list(track(engine, cutter, roi=roi, batches=batches))


def test_only_the_first_batch_places_the_roi():
    engine = Recorder()
    batches = tracked(engine, events=30)
    assert [len(events) for events, _ in engine.asked] == [30, 30, 30]
    np.testing.assert_array_equal(np.concatenate([events.t for events, _ in engine.asked]), range(0, 900, 10))
    asked = [BatchSettings.from_config(CONFIG, roi) for roi in ((4, 5), None, None)]
    assert [settings for _, settings in engine.asked] == asked
    assert [batch.index for batch in batches] == [0, 1, 2]
    assert [batch.result.roi for batch in batches] == [(4, 5), (6, 6), (8, 7)]


@pytest.mark.parametrize("limit, count", [(1, 1), (2, 2), (3, 3), (4, 3), (10**9, 3)])
def test_stops_after_the_batches_asked_for(limit, count):
    engine = Recorder()
    assert len(tracked(engine, events=30, batches=limit)) == len(engine.asked) == count


def test_batches_by_roi_events_are_cut_with_the_roi_of_the_moment():
    class Cutter:
        asked = []  # noqa: RUF012

        def next(self, roi):
            self.asked.append(roi)
            return BatchCutter(recording(range(50)), events=50, max_events=50).next()

    list(track(Recorder(), Cutter(), roi=(4, 5), batches=3))
    assert Cutter.asked == [(4, 5, 12, 8), (6, 6, 12, 8), (8, 7, 12, 8)]


def test_where_there_are_no_events_yet_the_track_waits():
    feed, engine = Feed((40, 30), "made up"), Recorder()
    batches = track(engine, BatchCutter(feed, start_event=2, events=30, max_events=1000), roi=(4, 5))
    assert next(batches) is None and next(batches) is None
    events = next(recording(range(0, 1000, 10)).chunks())
    feed.push(events[:1])
    feed.push(events[1:31])
    assert next(batches) is None
    feed.push(events[31:])
    feed.end()
    assert [batch.index for batch in batches] == [0, 1, 2]
    np.testing.assert_array_equal(np.concatenate([taken.t for taken, _ in engine.asked]), range(20, 920, 10))


def test_an_empty_window_keeps_the_roi_waiting_for_events():
    engine = Recorder()
    batches = tracked(engine, t=[0, 1, 2, 500, 501, 502, 900], duration_us=100)
    assert [len(batch.events) for batch in batches] == [3, 0, 0, 0, 0, 3, 0, 0, 0]
    assert [batch.result.roi for batch in batches] == [(4, 5), *[(6, 6)] * 5, *[(8, 7)] * 3]
    assert [settings.roi for _, settings in engine.asked] == [(4, 5), None]
    assert batches[1].row()[:6] == ("1", "", "0", "0", "6", "6")
    assert batches[1].row()[8:] == ("", "", "", "", "0", "", "0.000000", "", "0", "degenerate", "0")


def test_a_batch_that_was_cut_short_says_so():
    batches = tracked(Recorder(flags=Flag.SATURATED), duration_us=500, max_events=30)
    assert [batch.flags for batch in batches] == [Flag.SATURATED | Flag.CUT, Flag.SATURATED, Flag.SATURATED | Flag.CUT]
    assert [len(batch.events) for batch in batches] == [30, 20, 30]
    assert batches[0].row()[-2] == "cut|saturated"


class List(list):
    add = list.append


def test_consumers_take_each_batch_before_it_is_yielded():
    file, taken = io.StringIO(), List()
    cutter = BatchCutter(recording(range(0, 1000, 10)), events=30, max_events=1000)
    takers = [taken, CsvConsumer(file, CONFIG)]
    for count, batch in enumerate(track(Recorder(), cutter, roi=(4, 5), consumers=takers), 1):
        assert len(taken) == count and taken[-1] is batch
    lines = file.getvalue().split("\n")
    assert lines == [",".join(COLUMNS), *(",".join(batch.row()) for batch in taken), ""] and len(taken) == 3
    assert '"' not in file.getvalue() and file.getvalue().count(",") == 4 * 18, "plain CSV"


def one(engine, **changes):
    (batch,) = tracked(engine, **{"t": range(1000, 1201, 2), "events": 101, **changes})
    return batch


def test_columns_are_those_that_users_read_and_show_what_they_declare():
    assert ",".join(COLUMNS) == HEADER
    batch = one(Recorder(cycles=4711))
    for column in COLUMNS.values():
        shown = column.value(batch)
        assert isinstance(shown, column.dtype) or (shown is None and column.may_be_missing)
        assert column.title and column.doc
    missing = one(Recorder(flags=Flag.DEGENERATE, span=0)).values
    for name, column in COLUMNS.items():
        assert missing[name] is not None or (column.may_be_missing and np.isnan(column.array([None, 1]))[0])


def test_a_row():
    batch = one(Recorder(cycles=4711))
    # 1.5 px per half batch of 100 µs is 15,000 px/s.
    assert batch.v_px_per_s == (15000.0, -2500.0)
    expected = contrast(CONFIG, batch.events, (4, 5), (1.5, -0.25))
    assert expected > 0
    assert dict(zip(COLUMNS, batch.row(), strict=True)) == {
        "batch": "0", "t_ref_us": "1100.0", "events": "101", "roi_events": "3", "roi_x": "4", "roi_y": "5",
        "vx": "1.5", "vy": "-0.25", "vx_px_per_s": "15000.000", "vy_px_per_s": "-2500.000",
        "vx_px_per_s_sd": "", "vy_px_per_s_sd": "", "iterations": "5", "trusted": "0",
        "cycles": "4711", "contrast": f"{expected:.6f}", "confidence": "", "flags": "", "ambiguity": "0",
    }  # fmt: skip


def test_what_a_row_lacks_and_does_not_lose():
    """``repr`` of a float reads back as the same float; 12 fraction bits need up to 12 decimals."""
    row = dict(zip(COLUMNS, one(Recorder(flags=Flag.OVERFLOW | Flag.TIME_SPAN)).row(), strict=True))
    assert row["cycles"] == "" and row["flags"] == "overflow|time_span"
    batch = one(Recorder(flags=Flag.DEGENERATE, span=0))
    assert batch.v_px_per_s is None and batch.t_ref == 1000.0, "it has v but measures no speed"
    row = dict(zip(COLUMNS, batch.row(), strict=True))
    assert (row["vx"], row["vx_px_per_s"], row["vy_px_per_s"], row["flags"]) == ("1.5", "", "", "degenerate")
    batch = one(Recorder(v=(-4097 / 4096, 2**-12)))
    assert tuple(map(float, batch.row()[6:8])) == (-4097 / 4096, 2**-12)


def test_half_a_microsecond_of_a_unix_time_is_kept():
    start = 1_700_000_000_000_000
    batch = one(Recorder(), t=range(start, start + 102))
    assert batch.row()[1] == "1700000000000050.0"
    batch = TrackedBatch(0, CONFIG, batch.events, dataclasses.replace(batch.result, span=1))
    assert batch.row()[1] == "1700000000000000.5"


def test_the_roi_follows_the_object():
    """It moves by 3 and 1.5 px per batch: 24 and 12 px from the first to the last."""
    how = {"texture": "dense", "size": (14, 14), "position": (14, 14), "velocity": (60.0, 30.0)}
    scene = generate(seed=3, width=56, height=48, **how)
    engine = FloatEngine(Config(sensor_width=56, sensor_height=48, roi_width=20, roi_height=20, iterations=40))
    cutter = BatchCutter(scene.recording(), duration_us=50_000, max_events=5000)
    batches = list(track(engine, cutter, roi=scene.roi_start(20, 20)))
    assert len(batches) == 9 and batches[0].result.roi == (5, 5)
    for batch in batches:
        result = batch.result
        assert result.events == result.roi_events + result.outside > 400 and not batch.flags
        offset = np.add(result.roi, 9.5) - scene.motion.position(batch.t_ref)
        assert np.abs(offset).max() < 6, f"batch {batch.index}"
        assert np.hypot(*np.subtract(batch.v_px_per_s, (60, 30))) < 25, f"batch {batch.index}"
