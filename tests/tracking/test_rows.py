"""Several objects on one accelerator: rows of a table of regions, and scenes in which objects cross, leave and stop."""

from types import SimpleNamespace

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.engines import Engine, make_engine
from cmfpga.errors import ConfigError
from cmfpga.events import BatchCutter, Events, generate
from cmfpga.events.columns import MemoryRecording
from cmfpga.imaging.camera import RATES
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.protocol.results import BatchResult, RegionOutcome, counts_of
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.trace import Trace
from cmfpga.tracking.fit import FittedCutter, batch_cutter
from cmfpga.tracking.loop import follow
from cmfpga.tracking.source import with_rows
from support.regions import CONFIGS, without_clock
from support.tracks import recording
from support.values import required

CONFIG = CONFIGS["two units"].replace(max_level=2, min_roi_events=3, confidence_limit=1.0)
ROIS = [(3, 4), (20, 12), (8, 15)]


def scenes():
    """Three objects on a sensor of 40×30 px go to and fro; one of them stops, and for a while there are no events."""

    def to_and_fro(x, y):
        return tuple((60_000, sign * x, sign * y) for sign in (1, -1) * 4)

    how = {"width": 40, "height": 30, "size": (9, 7), "texture": "dense", "contrast": 0.3, "duration_us": 480_000}
    made = [
        generate(seed=1, position=(10.0, 9.0), velocity=to_and_fro(130.0, 40.0), **how),
        generate(seed=2, position=(28.0, 18.0), velocity=to_and_fro(-110.0, -60.0), **how),
        generate(seed=3, position=(16.0, 20.0), velocity=to_and_fro(100.0, 0.0), **how | {"duration_us": 200_000}),
    ]
    events = Events.merge(scene.events for scene in made)
    return MemoryRecording(events[(events.t < 300_000) | (events.t > 330_000)], 40, 30, "made up")


def followed(name, config, recording, rois, batches=None, **size):
    """``[[TrackedBatch of each object] of each batch]``, and the cutter."""
    engine = make_engine(name, config)
    cutter = batch_cutter(recording, config, **size)
    try:
        return [*follow(engine, cutter, rois=rois, consumers=[()] * len(rois), batches=batches)], cutter
    finally:
        engine.close()


@pytest.mark.parametrize("size", [{"events": 130}, {"duration_us": 10_000}, {}, {"first": 60}])
def test_verilog_and_model_find_the_same(compiler, size):
    """Batches of one length; of one duration, some of them empty; of lengths that change, so that rows begin anew."""
    both = [followed(name, CONFIG, scenes(), ROIS, **size)[0] for name in ("rtl", "model")]
    assert len(both[0]) == len(both[1]) >= 5
    for rtl, model in zip(*both, strict=True):
        for one, other in zip(rtl, model, strict=True):
            assert without_clock(one.result) == other.result
            assert one.values | {"cycles": None} == other.values and one.plan == other.plan
    assert {Flag.DOUBTFUL in batch.flags for window in both[0] for batch in window} == {True, False}
    lengths = {len(window[0].events) for window in both[0]}
    assert (0 in lengths, len(lengths) > 1) == ("duration_us" in size, "duration_us" in size or "first" in size)


def test_objects_that_grow_and_turn_are_the_same_by_all_engines(compiler):
    """In batches that suit the one that moves farthest, at its edge or in its middle."""
    config = CONFIGS["similarity"].replace(max_level=2, min_roi_events=3, confidence_limit=1.0)
    rtl, axi, model = (followed(name, config, scenes(), ROIS, batches=6)[0] for name in ("rtl", "axi", "model"))
    assert len(rtl) == len(axi) == len(model) == 6
    for windows in zip(rtl, axi, model, strict=True):
        for one, other, wanted in zip(*windows, strict=True):
            assert one.values == other.values == wanted.values | {"cycles": one.values["cycles"]}
            assert without_clock(one.result) == wanted.result
    found = [batch for window in model for batch in window]
    assert set(RATES["similarity"]) <= set(found[0].values) and len({batch.rates["zoom_per_s"] for batch in found}) > 9
    assert len({len(window[0].events) for window in model}) > 1


def test_a_row_that_is_never_in_doubt_is_one_row_of_the_model():
    """Written once, it follows by itself."""
    config = CONFIG.replace(judge=0)
    found, _ = followed("model", config, scenes(), ROIS, events=120)
    engine = make_engine("model", config)
    engine.write([Region(x=x, y=y, width=16, height=12, start="last", moves=True) for x, y in ROIS])
    cutter = BatchCutter(scenes(), events=120, max_events=150)
    for window in found:
        result = engine.run(cutter.next(), BatchSettings.from_config(config, (0, 0)))[0]
        assert [batch.result.regions[0] for batch in window] == [*result.regions]
    assert cutter.next() is None and len(found) > 4


class Table(Engine):
    """An engine that remembers what was written, and gives outcomes of ``flags``."""

    def __init__(self, config, *flags):
        super().__init__(config)
        self.flags, self.written, self.asked = list(flags), [], []

    def _write(self, regions, anew):
        self.written.append({k: (regions[k].x, regions[k].y) for k in anew})

    def _run(self, events, settings):
        self.asked.append(events)
        self.cycles = 99
        flags = self.flags.pop(0) if self.flags else [Flag(0)] * len(self.regions)
        outcomes = [
            RegionOutcome(**required(
                "region", roi=(row.x, row.y), roi_next=(row.x + 1, row.y), v=(2.0, 1.0), iterations=4, flags=flag,
                roi_events=9, outside=len(events) - 9, restarted=0, confidence_limit=90, sum_squares=9, sums=(0,) * 5,
                curvature=(9e5, 9e5, 0), trace=Trace.without_iterations(self.config, (128, 64)),
            ))
            for row, flag in zip(self.regions, flags, strict=True)
        ]  # fmt: skip
        span = int(events.t[-1] - events.t[0])
        return [BatchResult(**required("batch", events=len(events), span=span, t_first=0, regions=outcomes))]


EVERY_10_US = range(0, 20_000, 10)


def test_only_what_begins_elsewhere_is_written_anew():
    """A doubtful object goes on at its last trusted velocity; the others keep their v and their place."""
    no, doubt = Flag(0), Flag.DOUBTFUL
    table = Table(CONFIG, [no, no], [no, doubt], [no, doubt], [no, doubt], [no, doubt])
    cutter = BatchCutter(recording(EVERY_10_US), events=100, max_events=150)
    [*follow(table, cutter, rois=[(3, 4), (20, 12)], batches=7, consumers=[(), ()])]
    assert table.written == [
        {0: (3, 4), 1: (20, 12)},
        {},
        {1: (24, 14)},  # twice 2 and 1 px on
        {1: (24, 16)},  # the image is 16 px wide, the sensor 40
        {1: (24, 16)},  # the third in doubt: lost, it stays where it is
        {1: (24, 16)},
        {},
    ]


def test_a_batch_of_another_length_begins_cold_where_the_rows_are():
    table = Table(CONFIG, [Flag.DEGENERATE, Flag(0)])  # the second object alone measured the first batch
    cutter = FittedCutter(recording(EVERY_10_US), CONFIG, first=30, max_events=150)  # 2.2 px: each batch is longer
    windows = [*follow(table, cutter, rois=[(3, 4), (20, 12)], batches=3, consumers=[(), ()])]
    assert [len(window[0].events) for window in windows] == [30, 54, 97]
    assert table.written == [{0: (3, 4), 1: (20, 12)}, {0: (4, 4), 1: (21, 12)}, {0: (5, 4), 1: (22, 12)}]
    assert table.cycles == 99


def test_a_window_without_events_never_reaches_the_hardware():
    table = Table(CONFIG, [Flag.DOUBTFUL, Flag(0)])
    cutter = BatchCutter(recording(np.r_[0:1000:10, 30_000:31_000:10]), duration_us=10_000, max_events=150)
    running = follow(table, cutter, rois=ROIS[:2], batches=3, consumers=[(), ()])
    _, empty = next(running), next(running)
    assert table.cycles is None and len(table.asked) == 1
    assert [batch.result.roi for batch in empty] == [(3, 4), (21, 12)]  # in doubt it stays, for there was no v before
    assert [(batch.flags, batch.result.v, batch.t_ref) for batch in empty] == [(Flag.DEGENERATE, (2.0, 1.0), None)] * 2
    assert table.written == [{0: (3, 4), 1: (20, 12)}, {0: (3, 4)}]
    first = Table(CONFIG)
    first.write([Region.roi(CONFIG, (3, 4))])
    (result,) = first.run(Events.empty(), BatchSettings.from_config(CONFIG))
    assert (result.roi, result.v, result.flags) == ((3, 4), (0, 0), Flag.DEGENERATE)


@pytest.mark.parametrize("count, full, stride", [(25, "drop", 1), (40, "drop", 2), (140, "drop", 8), (140, "thin", 1)])
def test_a_stride_leaves_room_in_the_buffer(count, full, stride):
    """37 events and a reserve; a buffer that thins by itself needs none. All events are counted."""
    config = CONFIGS["one unit"].replace(when_full=full)
    windows, _ = followed("model", config, recording(EVERY_10_US), [(3, 4)], events=count, batches=2)
    for (batch,) in windows:
        result = batch.result
        assert batch.thinning == stride and result.roi_events <= 37 and not result.overflow
        assert result.events == result.roi_events + result.thinned == count


def test_where_v_starts():
    for start in ("last", "given"):
        table = Table(CONFIG.replace(start=start, v_start_x=0.0))
        cutter = BatchCutter(recording(EVERY_10_US), events=100, max_events=150)
        [*follow(table, cutter, rois=[(3, 4)], batches=3, consumers=[()])]
        assert table.regions == [Region(x=3, y=4, width=16, height=12, start=start, moves=True)]
        assert table.written == [{0: (3, 4)}, {}, {}]


def test_rows_that_are_written_anew_forget(compiler):
    """Not the others: in Verilog as in the model."""
    regions = [Region(x=x, y=y, width=16, height=12, start="last", moves=True) for x, y in ROIS]
    results, settings = [], BatchSettings.from_config(CONFIG, (0, 0))
    for name in ("rtl", "model"):
        engine, cutter = make_engine(name, CONFIG), BatchCutter(scenes(), events=120, max_events=150)
        for anew in ((), (), (0, 2), ()):
            engine.write(regions, anew)
            results.append(without_clock(engine.run(cutter.next(), settings)[0]))
        engine.close()
    assert results[:4] == results[4:]
    before, after = results[1], results[2]
    assert [one.roi for one in after.regions] == [ROIS[0], before.regions[1].roi_next, ROIS[2]]
    assert before.regions[0].roi_next != ROIS[0] and before.regions[1].roi_next != ROIS[1]


def test_a_configuration_gets_a_table():
    found = with_rows(preset("fast"), 2, {})
    usual = preset("objects")
    assert found == usual.replace(max_batch_events=65535, ram_style="block")  # the image's is that of fast
    assert with_rows(preset("fast"), 40, {}).regions == 40
    assert with_rows(preset("fast").replace(max_batch_events=999), 2, {"max_batch_events": 999}).max_batch_events == 999
    assert with_rows(usual, 32, {}) is usual
    with pytest.raises(ConfigError, match="regions = 32: 33 objects need as many; --set regions=33"):
        with_rows(usual, 33, {})


@pytest.mark.parametrize("config, message", [
    (preset("paper"), "gradient = one_pass is needed"),
    (preset("rotation"), "motion = rotation: a region sees too little of the field"),
    (preset("fast").replace(buffers=1), "buffers = 2 is needed"),
    (preset("fast").replace(thin_target=900), "each region has a stride of its own instead"),
])  # fmt: skip
def test_hardware_that_cannot_have_regions(config, message):
    with pytest.raises(ConfigError, match=f"several objects are regions of one hardware.*{message}.*one --roi"):
        with_rows(config, 2, {})


def test_the_fastest_that_is_trusted_chooses_the_length():
    """Object 1 moves by 8 px: half as many events; in doubt, object 0 with 2 px: twice as many."""

    known = {"events": 60, "span": 600, "roi_events": 9, "outside": 51, "confidence_limit": 90, "iterations": 1}

    def batch(v, trusted):
        moved = {"v": (v, 0.0), "roi": (0, 0), "roi_next": (0, 0), "flags": Flag(0) if trusted else Flag.DOUBTFUL}
        return SimpleNamespace(result=BatchResult(**required("batch", "region", **known, **moved)))

    def after(*trusted):
        cutter = FittedCutter(recording(EVERY_10_US), CONFIG, first=60, max_events=150)
        cutter.add(list(map(batch, (2.0, 8.0), trusted)))
        return cutter.size

    assert [after(True, True), after(True, False), after(False, True), after(False, False)] == [30, 120, 30, 60]


SECOND = 1_000_000
#: Two that cross in the middle after half a second, one that leaves, one that stops.
FOUR = {
    "right": {"seed": 1, "position": (60.0, 60.0), "velocity": (120.0, 40.0), "duration_us": SECOND},
    "left": {"seed": 2, "position": (180.0, 60.0), "velocity": (-120.0, 40.0), "duration_us": SECOND},
    "leaves": {"seed": 3, "position": (200.0, 150.0), "velocity": (100.0, 20.0), "duration_us": SECOND},
    "stops": {"seed": 4, "position": (50.0, 140.0), "velocity": (80.0, 0.0), "duration_us": 400_000},
}


@pytest.fixture(scope="module")
def four():
    made = {name: generate(**fields) for name, fields in FOUR.items()}
    events = Events.merge(scene.events for scene in made.values())
    config = with_rows(preset("fast"), 4, {})
    rois = [scene.roi_start(64, 64) for scene in made.values()]
    windows, cutter = followed("model", config, MemoryRecording(events, 240, 180, "four"), rois)
    return config, made, windows, len(events), cutter


def test_objects_that_cross_leave_and_stop(four):
    """None that is trusted is wrong (by more than 0.6 px); where there is no object, or two, none is trusted."""
    _, made, windows, _, _ = four
    trusted = {name: [] for name in made}
    for window in windows:
        for batch, (name, scene) in zip(window, made.items(), strict=True):
            if batch.flags & (Flag.DOUBTFUL | Flag.DEGENERATE):
                continue
            trusted[name].append(batch.t_ref / SECOND)
            first, last = int(batch.events.t[0]), int(batch.events.t[-1])
            assert last <= scene.scene.duration_us
            off = np.hypot(*(np.array(batch.v_px_per_s) - batch.true_px_per_s(scene.motion)))
            assert off * (last - first) / 2 / SECOND < 0.6, (name, first)
    for name in ("right", "left"):
        times = np.array(trusted[name])
        assert not ((times > 0.45) & (times < 0.6)).any()  # more than half of one is on top of the other
        assert (times < 0.45).sum() >= 6 and (times > 0.6).sum() >= 3
    assert max(trusted["leaves"]) < 0.55 and len(trusted["leaves"]) >= 6
    assert max(trusted["stops"]) < 0.4 and len(trusted["stops"]) >= 6


def test_objects_that_cross_at_a_right_angle_may_change_places():
    """As the documentation says: v is trusted, but nobody tells whose it is."""
    ways = [(140 * np.cos(angle), 140 * np.sin(angle)) for angle in (np.pi / 4, -np.pi / 4)]
    made = [
        generate(seed=k + 1, position=(120 - x / 2, 90 - y / 2), velocity=(x, y), duration_us=SECOND)
        for k, (x, y) in enumerate(ways)
    ]
    recording = MemoryRecording(Events.merge(scene.events for scene in made), 240, 180, "two")
    windows, _ = followed("model", with_rows(preset("fast"), 2, {}), recording, [s.roi_start(64, 64) for s in made])
    found = [[], []]  # of each ROI: whose v it has in the batches that are trusted
    for window in windows:
        for batch, whose in zip(window, found, strict=True):
            if not batch.flags & (Flag.DOUBTFUL | Flag.DEGENERATE):
                whose.append(int(np.argmin([np.hypot(*(np.array(batch.v_px_per_s) - way)) for way in ways])))
    assert found[0][:2] == [0] * 2 and found[0][-4:] == [1] * 4 and {*found[1]} == {1}


def test_no_event_is_lost_uncounted_and_the_fastest_moves_by_3_to_5_px(four):
    config, _, windows, count, cutter = four
    assert sum(len(window[0].events) for window in windows) + cutter.leftover == count
    for k, window in enumerate(windows):
        for batch in window:
            assert sum(getattr(batch.result, name) for name in counts_of(config)) == len(batch.events)
        assert k >= 5 or 3 <= max(np.hypot(*batch.result.v) for batch in window) <= 5.1
