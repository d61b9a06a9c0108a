"""The driver on the emitted AXI top with a table of regions, in Verilator: all outcomes equal the integer model's."""

import contextlib
import dataclasses

import numpy as np
import pytest
from studies.crosscheck.batches import random_regions, some_changed

from cmfpga.driver import Accelerator, DeviceError
from cmfpga.driver.engine import result_of
from cmfpga.driver.simulation import PACKET, SimulatedTop, SimulationBackend
from cmfpga.engines import make_engine
from cmfpga.errors import ConfigError
from cmfpga.events import Events
from cmfpga.events.columns import MemoryRecording
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.results import packet_beats
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode, split_packets
from cmfpga.tracking.fit import batch_cutter
from cmfpga.tracking.loop import follow
from support.board import uio_tree
from support.region_driving import CONFIG, TABLE, clouds, events_of, same
from support.regions import model_of, random_settings, random_window
from support.uio import BUFFERS, Linux

REGISTERS = register_map(CONFIG)
SIMILARITY = CONFIG.replace(motion="similarity", ascent="sign", cold="2:1 1:0 0:-1 0:-3", warm="1:0 1:-1 0:-2 0:-4")


@pytest.fixture
def accelerator(compiler):
    """Fresh hardware; its library is compiled once."""
    with Accelerator(SimulationBackend(CONFIG)) as made:
        yield made


@pytest.fixture
def top(accelerator):
    return accelerator.backend.top


def stalled(top, rng, done):
    """Let the clock run with random stalls on both streams until ``done()``."""
    for _ in range(200_000):
        top.limit(send=int(rng.integers(0, 6)), words=int(rng.integers(0, 6)))
        top.run(int(rng.integers(1, 40)))
        if done():
            break
    else:
        raise AssertionError("the stalls were too long")
    top.limit()


def write_row(accelerator, number, *, fresh=1, **changes):
    """A row by its registers: the first of :data:`TABLE`, with other values."""
    values = {
        "ROW_PLACE": {"X": 4, "Y": 4}, "ROW_BEGIN": {"X": 2, "Y": 1}, "ROW_END": {"X": 14, "Y": 11},
        "ROW_COLD": {"FIRST": 0, "COUNT": 4}, "ROW_WARM": {"FIRST": 0, "COUNT": 4},
        "ROW_HOW": {"START": 0, "PARENT": 0},
    }  # fmt: skip
    for name, fields in values.items():
        accelerator.control.write(name, **{**fields, **changes.get(name, {})})
    accelerator.control.write("ROW_WRITE", NUMBER=number, FRESH=fresh)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("config", [CONFIG, SIMILARITY], ids=lambda config: config.motion)
def test_any_table_and_any_batches_equal_the_model(compiler, config, seed):
    """Any start of every parameter."""
    rng, number, found = np.random.default_rng(seed), 0, set()
    model, regions = model_of(config), random_regions(config, rng)
    with Accelerator(SimulationBackend(config)) as accelerator:
        for _ in range(6):
            accelerator.write_regions(regions), model.write(regions)
            for k in range(3):
                window, chosen = clouds(rng) if k else random_window(config, rng), random_settings(config, rng)
                chosen = dataclasses.replace(chosen, camera=config.lens if rng.random() < 0.7 else ())
                result = accelerator.run(events_of(window), settings=chosen)
                same(result, model.run(*window, chosen))
                number += 1
                assert result.batch == number and not result.wire and not result.config_range
                found |= {region.v for region in result.regions}
            regions = some_changed(config, rng, regions) if rng.random() < 0.6 else random_regions(config, rng)
    assert len(found) > 1 and {len(v) for v in found} == {len(config.motion_model.names)}


def test_a_row_that_is_told_begins_anew(accelerator, rng):
    model, chosen, places = model_of(CONFIG), BatchSettings.from_config(CONFIG), []
    for anew in ((), (), {0}):
        accelerator.write_regions(TABLE, anew), model.write(TABLE, anew)
        window = clouds(rng)
        result = accelerator.run(events_of(window), settings=chosen)
        same(result, model.run(*window, chosen))
        places.append(result.regions[0].roi)
    assert places[0] == places[2] == (TABLE[0].x, TABLE[0].y) != places[1]


def test_the_engine_of_flow_is_this_one(compiler, rng):
    engines = [make_engine(name, CONFIG) for name in ("axi", "model")]
    chosen = random_settings(CONFIG, rng)
    for window in (clouds(rng), clouds(rng, 80)):
        found = []
        for engine in engines:
            engine.write(TABLE)
            found.append(engine.run(Events(*window, window[0] % 2), chosen)[0])
        same(*found)
        assert engines[0].cycles > len(window[0]) and engines[1].cycles is None
    for engine in engines:
        engine.close()


@pytest.mark.parametrize("seed", range(3))
def test_batches_back_to_back_under_stalls(accelerator, top, seed):
    """Words of six batches wait at the input, results wait at the output: none is lost, none is counted twice."""
    rng, model = np.random.default_rng(seed), model_of(CONFIG)
    chosen = dataclasses.replace(random_settings(CONFIG, rng), camera=CONFIG.lens)
    accelerator.write_regions(TABLE), model.write(TABLE)
    windows = [clouds(rng, 90, 2000 * k) for k in range(6)]
    columns = [np.concatenate(axis) for axis in zip(*windows, strict=True)]
    accelerator.start(events=90, settings=chosen, form="EVT21")
    accelerator.send(encode(Events(*columns, columns[0] % 2), "EVT21"))
    stalled(top, rng, lambda: not top.unsent and not accelerator.status()["computing"])
    found = [*accelerator.results(6), *accelerator.stop()]
    for result, window in zip(found, windows, strict=True):
        same(result, model.run(*window, chosen))
    assert any(Flag.DEGENERATE not in region.flags for result in found for region in result.regions)
    count, regions = accelerator.counters(), [region for result in found for region in result.regions]
    assert count["batches"] == 6 and count["events_taken"] == 540
    for name in ("roi_events", "outside", "thinned"):
        assert count[name] == sum(getattr(region, name) for region in regions)
    assert count["degenerate"] == sum(Flag.DEGENERATE in region.flags for region in regions)
    assert count["longest_batch"] == max(region.cycles for region in regions)


def test_events_with_wrong_times_are_counted_once_a_batch(accelerator, rng):
    accelerator.write_regions(TABLE)
    lost = {"time_back": 0, "time_span": 0}
    for _ in range(5):
        window = random_window(CONFIG, rng)
        result = accelerator.run(events_of(window), settings=random_settings(CONFIG, rng))
        lost = {name: count + getattr(result, name) for name, count in lost.items()}
    count = accelerator.counters()
    assert lost["time_back"] and lost == {name: count[name] for name in lost}


BAD = {  # number, other values of the row; how many rows were written before
    "beyond the sensor": (1, {"ROW_PLACE": {"X": CONFIG.sensor_width}}),
    "more bits than there are": (1, {"ROW_PLACE": {"X": 1 << 15}}),
    "beyond the image": (1, {"ROW_END": {"Y": CONFIG.roi_height + 1}}),
    "no such start": (1, {"ROW_HOW": {"START": 3}}),
    "its own parent": (1, {"ROW_HOW": {"START": 2, "PARENT": 1}}),
    "a parent behind it": (0, {"ROW_HOW": {"START": 2, "PARENT": 3}}),
    "a gap in the table": (4, {}), "no such row": (5, {}), "not fresh, and not known": (2, {"fresh": 0}),
    "beyond the schedules": (1, {"ROW_COLD": {"FIRST": CONFIG.schedule_entries}}),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_row_is_refused_and_counted(accelerator, rng, name):
    """The table stays as it was, and so do the next batch's outcomes."""
    model, chosen = model_of(CONFIG), random_settings(CONFIG, rng)
    accelerator.write_regions(TABLE[:2]), model.write(TABLE[:2])
    for k in range(2):
        window = clouds(rng, 100, 2000 * k)
        same(accelerator.run(events_of(window), settings=chosen), model.run(*window, chosen))
        if not k:
            number, changes = BAD[name]
            write_row(accelerator, number, **changes)
            assert accelerator.control.read("TABLES") == {"PENDING": 0, "ROWS_MISSING": 0, "REFUSED": 1}
            accelerator.clear_counters()
            assert accelerator.control.read("TABLES")["REFUSED"] == 0


def test_a_row_that_is_written_in_a_batch_waits_for_its_end(accelerator, top, rng):
    """What comes while it waits is refused; the batch under way is measured with the row before."""
    control, model, chosen = accelerator.control, model_of(CONFIG), random_settings(CONFIG, rng)
    accelerator.write_regions(TABLE[:1]), model.write(TABLE[:1])
    windows = [clouds(rng, 60, 2000 * k) for k in range(3)]
    accelerator.run(events_of(windows[0]), settings=chosen), model.run(*windows[0], chosen)
    accelerator.start(events=60, settings=chosen)
    accelerator.send(encode(events_of(windows[1])[:30], "PACKED"))
    top.run(500)
    plan = {"FIRST": 0, "COUNT": len(chosen.cold)}
    write_row(accelerator, 0, ROW_COLD=plan, ROW_WARM=plan)
    assert control.read("TABLES") == {"PENDING": 1, "ROWS_MISSING": 0, "REFUSED": 0}
    write_row(accelerator, 0, ROW_PLACE={"X": 0})
    assert control.read("TABLES") == {"PENDING": 1, "ROWS_MISSING": 0, "REFUSED": 7}
    both = [np.concatenate([windows[1][k][30:], windows[2][k]]) for k in range(3)]
    accelerator.send(encode(Events(*both, both[0] % 2), "PACKED"))
    found = list(accelerator.results(2))
    assert control.read("TABLES") == {"PENDING": 0, "ROWS_MISSING": 0, "REFUSED": 7}
    same(found[0], model.run(*windows[1], chosen))
    model.write([Region(x=4, y=4, width=12, height=10, cold=chosen.cold, warm=chosen.cold)])
    same(found[1], model.run(*windows[2], chosen))
    accelerator.stop()


def test_no_batch_begins_before_its_rows_are_known(accelerator, top, rng):
    control, chosen = accelerator.control, random_settings(CONFIG, rng)
    control.write_input("PACKED", False, 1)
    for count, known in ((1, 0), (2, 1)):
        control.write("ROWS", VALUE=count)
        assert control.read("TABLES")["ROWS_MISSING"]
        control.write("CTRL", START=1)
        top.send(encode(events_of(clouds(rng, 20)), "PACKED"))
        top.run(3000)
        assert not control.status("TAKING_IN") and control.read("CTRL")["START"]
        write_row(accelerator, known)
        assert not control.read("TABLES")["ROWS_MISSING"]
        top.run(30_000)
        assert len(top.take()) == count * packet_beats(CONFIG)
    # A row that was not in use is not known any more; nor is any behind a reset.
    accelerator.reset()
    for count in (3, 1, 2):
        accelerator.write_regions(TABLE[:count])
        assert len(accelerator.run(events_of(clouds(rng, 70)), settings=chosen).regions) == count
    control.write("ROWS", VALUE=3)
    assert control.read("TABLES")["ROWS_MISSING"]


def test_a_reset_in_the_middle_of_a_packet_ends_it(accelerator, top, rng):
    """Whether a record is being sent, waits, or the next one has not come; the batch behind it is right."""
    chosen, repeated, ended = random_settings(CONFIG, rng), 0, 0
    for k in range(40):
        model = model_of(CONFIG)
        accelerator.write_regions(TABLE), model.write(TABLE)
        accelerator.start(events=90, settings=chosen)
        accelerator.send(encode(events_of(clouds(rng, 90)), "PACKED"))
        top.limit(words=int(rng.integers(0, 60)) if k % 2 else -1)
        top.run(int(rng.integers(300, 1800)), PACKET)
        accelerator.control.write("CTRL", SOFT_RESET=1)
        top.run(100)
        top.limit()
        top.run(400)
        packet = top.take()
        if packet is not None:
            records = split_packets(REGISTERS, packet)  # or else it is not of whole records
            marks = [record[1] >> 19 & 1 for record in records.tolist()]
            assert len(records) <= 4 and not any(marks[:-1])
            repeated += len(records) > 1 and (records[-1] == records[-2]).all()
            ended += not marks[-1]
        assert top.take() is None and not accelerator.status()["result_waiting"]
        accelerator.reset()
        window = clouds(rng, 90)
        same(accelerator.run(events_of(window), settings=chosen), model.run(*window, chosen))
    assert repeated > 3 and ended > repeated


def test_behind_a_dma(compiler, tmp_path, monkeypatch, rng):
    """A transfer that waits for the packet lets the results out, one by one."""
    top, model = SimulatedTop(CONFIG), model_of(CONFIG)
    linux = Linux(uio_tree(tmp_path, buffers=BUFFERS), top, monkeypatch)
    with Accelerator(linux.backend_class(root=tmp_path), CONFIG) as accelerator:
        accelerator.write_regions(TABLE), model.write(TABLE)
        for k in range(3):
            window, chosen = clouds(rng, 100, 2000 * k), random_settings(CONFIG, rng)
            same(accelerator.run(events_of(window), settings=chosen), model.run(*window, chosen))
    top.close()


def test_self_test(accelerator):
    found = accelerator.self_test()
    assert found["golden batch"].endswith("as the integer model") and "5 regions" in found["golden batch"]
    assert found["interrupt"].startswith("came")


def test_what_is_refused(accelerator, rng):
    events, chosen = events_of(clouds(rng, 40)), random_settings(CONFIG, rng)
    with pytest.raises(ConfigError, match="the table of regions is empty"):
        accelerator.run(events, settings=chosen)
    with pytest.raises(ConfigError, match="region 5: at most 5 regions are allowed"):
        accelerator.write_regions([TABLE[0]] * 6)
    with pytest.raises(ConfigError, match="region 1: parent = 1: 0 to 0 is needed"):
        accelerator.write_regions([TABLE[0], dataclasses.replace(TABLE[2], parent=1)])
    for message, change in (
        (r"\d+ px along x from \d+ of the image on: at most \d+ px are allowed", {"margin": (CONFIG.roi_width, 0)}),
        (r"x = -1: 0 to \d+ is allowed", {"x": -1}),
        ("start = 'again': one of given, ", {"start": "again"}),
        ("stride = 3: a power of two up to", {"stride": 3}),
    ):
        with pytest.raises(ConfigError, match=f"^region 0: {message}"):
            accelerator.write_regions([dataclasses.replace(TABLE[0], **change)])
    accelerator.write_regions(TABLE)
    nothing = accelerator.run(events[:0], settings=chosen)
    assert [one.roi for one in nothing.regions] == [(row.x, row.y) for row in TABLE] and not nothing.batch
    with pytest.raises(ConfigError, match="batches by ROI events: the hardware has many regions"):
        accelerator.start(roi_events=30, settings=chosen)
    assert len(accelerator.run(events, settings=chosen).regions) == 3


def test_a_packet_that_is_not_whole_is_refused(accelerator, top, rng):
    accelerator.write_regions(TABLE)
    accelerator.start(events=50, settings=random_settings(CONFIG, rng))
    accelerator.send(encode(events_of(clouds(rng, 50)), "PACKED"))
    top.run(30_000)
    words = top.take()
    assert len(result_of(CONFIG, REGISTERS, words, "it").regions) == 3
    beats = packet_beats(CONFIG)
    for wrong in (words[:-1], words[:0], np.tile(words, 2)):
        with pytest.raises(DeviceError, match=f"it: a packet of {len(wrong)} words; {beats} make a result"):
            result_of(CONFIG, REGISTERS, wrong, "it")
    for wrong in (words[:-beats], np.concatenate([words, words[:beats]])):
        with pytest.raises(DeviceError, match="came in one packet; one of each is needed"):
            result_of(CONFIG, REGISTERS, wrong, "it")


def test_objects_are_followed_over_the_bus(compiler, rng):
    """With rows that begin anew, for batches change their length: every value of every batch is the model's."""
    parts = [Events(*clouds(rng, t0=1000 * k), np.arange(120) % 2) for k in range(8)]
    recording = MemoryRecording(Events.merge(parts), 40, 30, "clouds")

    def values(name):
        with contextlib.closing(make_engine(name, CONFIG)) as engine:
            cutter = batch_cutter(recording, CONFIG, first=60)
            windows = follow(engine, cutter, rois=[(1, 1), (19, 8)], consumers=[(), ()])
            return [{**batch.values, "cycles": None} for window in windows for batch in window]

    found = values("axi")
    assert found == values("model") and len(found) > 6


def test_windows_that_overlap(compiler, rng):
    """The result of a slice is that of the last ones; after a reset, and after a stream, of fewer."""
    config = CONFIG.replace(slices=3)
    with Accelerator(SimulationBackend(config)) as made:
        limit = made.registers.by_name["BATCH_LIMIT"].fields[0].reset
        assert limit == config.slice_events == config.max_batch_events // 3
        made.write_regions(TABLE)
        chosen = random_settings(config, rng)
        for what in ("begin", "reset", "stream"):
            model = model_of(config)
            model.write(TABLE)
            for number in range(5):
                window = random_window(config, rng)
                result = made.run(events_of(window), settings=chosen)
                same(result, model.run(*window, chosen))
                assert result.batch == number + 1 and made.control.read("COUNT_EMPTY_ENDS")["VALUE"] == number
                made.control.write("CTRL", END_BATCH=1)  # of a slice without events, which takes no place in a window
            if what == "reset":
                made.start(settings=chosen, events=10)
                made.send(encode(events_of(clouds(rng, 20)), made.form))
                sizes = [result.events for result in made.results(2)]
                assert sizes[1] - sizes[0] < 10 and sizes[0] > 10  # two slices of ten, behind the last two
                made.stop()
            else:
                made.reset()
        with pytest.raises(ConfigError, match=f"at most {limit} are allowed"):
            made.run(events_of(clouds(rng, limit + 1)))
