"""Bad words, sources that stop, settings out of range: counted and limited, never stuck."""

import dataclasses
import itertools

import cocotb
import numpy as np

from cmfpga.events.arrays import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.words import encode
from cmfpga.reference.wire import BatchEnds, Beat, to_beats
from support.axi.batches import ROI, RUN, begin, compare, following, nothing_lost
from support.axi.board import CONFIG
from support.axi.expected import Expected, links, moving_events, same


@cocotb.test()
async def bad_words(dut):
    """Unknown types, no time word, outside the sensor, time back and wrapping, TLAST anywhere: counted, never stuck."""
    board, expected, settings = await begin(dut, seed=9, pauses=0.1)
    rng = np.random.default_rng(5)
    for form in ("EVT21", "EVT20", "PACKED"):
        await board.write("CTRL", SOFT_RESET=1)
        await board.write("INPUT", FORMAT=form)
        await board.until("STATUS", "INPUT_PENDING", 0)
        expected, settings = Expected(CONFIG), dataclasses.replace(settings, roi=ROI)
        await board.write("ROI_LOAD", LOAD=1)
        await board.write("CTRL", **RUN)
        events = moving_events(CONFIG, 240, 11, t0=(1 << 34) - 1500)
        t = events.t.copy()
        t[100:] += 3000  # past the wrap
        t[130] -= 2000  # a step back
        x = np.where(rng.random(240) < 0.1, CONFIG.sensor_width + rng.integers(0, 900, 240), events.x)
        words = encode(Events(t, x, events.y, events.p), form).tolist()
        damage = [int(kind) << 60 | int(kind) << 28 | 77 for kind in (2, 3, 7, 9, 0xA, 0xE, 0xF, 0xB)]
        if form != "PACKED":
            words = [1 << 60 | 1 << 28 | 3, *words[:30], *damage, *words[30:]]
        cuts = [0, 1, 3, len(words) // 2, len(words) // 2 + 1, len(words) - 7, len(words)]
        beats, packets = [], []
        for start, stop in itertools.pairwise(cuts):
            keep = [0xFF] * (stop - start)
            if start == cuts[3]:
                keep[0] = 0x7F  # a part of a word
            if start == cuts[4]:
                keep[0] = 0  # none of it
                keep[1] = 0x0F
            packets.append((words[start:stop], keep))
            beats += [
                Beat(w, k, n == stop - start - 1) for n, (w, k) in enumerate(zip(words[start:stop], keep, strict=True))
            ]
        batches, rest = expected.receive(beats, form)
        assert not rest and len(batches) >= 3
        sending = cocotb.start_soon(send_all(board, packets))
        for batch in batches:
            same(await board.result(), expected.result(batch, settings), but=["wire"])
            settings = following(settings)
        await sending
        counted = await nothing_lost(board, expected)
        assert counted["out_of_sensor"] > 5 and counted["format_errors"] >= (2 if form == "PACKED" else 5)
        if form != "PACKED":
            assert counted["before_time"] > 0 and counted["other_words"] >= 3 and counted["time_high_back"] > 0
            assert await board.read("ISR", "TIME") == 1
        assert await board.read("ISR", "WIRE") == 1
        # And the next batch is right.
        words = encode(moving_events(CONFIG, 60, 12), form)
        batches, _ = expected.receive(to_beats(words), form)
        counts = {name: expected.totals[name] for name in ("time_high_back",)}
        await board.send(words)
        same(await board.result(), expected.result(batches[0], settings), but=["wire"])
        expected.totals |= counts
        await board.write("ISR", 0x3F)


async def send_all(board, packets):
    for words, keep in packets:
        await board.send(words, keep=keep, wait=False)


@cocotb.test()
async def a_source_that_stops(dut):
    """In mid-batch: END_BATCH gives the result of what came; the next batch is right."""
    board, expected, settings = await begin(dut, form="EVT21", ends=BatchEnds(events=500, by_tlast=False))
    events = moving_events(CONFIG, 120, 13)
    words = encode(events, "EVT21")
    await board.send(words)
    await board.until("STATUS", "EVENTS_WAITING")
    for _ in range(20):
        assert await board.read("CTRL", "DONE") == 0
    await board.write("CTRL", END_BATCH=1, **RUN)
    batches, _ = expected.receive(to_beats(words), "EVT21")
    settings = await compare(board, expected, batches, settings)
    await board.write("CTRL", END_BATCH=1, **RUN)  # nothing to end: no result, but counted
    await board.cycles(10)
    expected.totals["empty_ends"] += 1
    await nothing_lost(board, expected)
    assert board.sink.empty()
    await board.send(words)
    await board.write("CTRL", END_BATCH=1, **RUN)
    batches, _ = expected.receive(to_beats(words), "EVT21")
    expected.totals["time_high_back"] += 1
    await compare(board, expected, batches, settings)
    await nothing_lost(board, expected)


@cocotb.test()
async def settings_out_of_range(dut):
    """Limited, and flagged in the status, in the interrupt and in the result."""
    board, expected, settings = await begin(dut, form="PACKED")
    assert await board.read("STATUS", "CONFIG_RANGE") == 0
    big = 0xFFFFFFFF
    for name in ("ROI_GAIN", "MIN_ROI_EVENTS", "THINNING", "ITERATIONS", "ETA"):
        if name in board.registers:
            await board.write(name, big)
    await board.write("V_START_X", 0x7FFFFFFF)
    await board.write("V_START_Y", 0x80000000)
    await board.write("THINNING", 0)
    await board.write("MIN_ROI_EVENTS", 1)
    await board.write("START_MODE", LAST=0)
    await board.write("ROI", X=0xFFFF, Y=0xFFFF)
    assert await board.read("V_START_X") == 0x7FFFFFFF  # as written
    assert await board.read("STATUS", "CONFIG_RANGE") == 1
    limited = dataclasses.replace(
        settings,
        roi=(CONFIG.geometry.roi_x_max, CONFIG.geometry.roi_y_max),
        roi_gain=CONFIG.formats.roi_gain.max,
        v_start=(CONFIG.formats.v.max, CONFIG.formats.v.min),
        start_last=False,
        thinning=1,
    )
    if CONFIG.ascent == "constant":
        limited = dataclasses.replace(limited, iterations=CONFIG.max_iterations, eta=CONFIG.formats.eta.max)
        await board.write("ITERATIONS", 2)
        limited = dataclasses.replace(limited, iterations=2)
    events = moving_events(CONFIG, 80, 14)
    moved = Events(
        events.t, events.x // 2 + CONFIG.sensor_width // 2, events.y // 2 + CONFIG.sensor_height // 2, events.p
    )
    words = encode(moved, "PACKED")
    batches, _ = expected.receive(to_beats(words), "PACKED")
    await board.send(words)
    found = await board.result()
    wanted = expected.result(batches[0], limited, config_range=1)
    same(found, wanted | {"flags": wanted["flags"] | Flag.ROI_CLAMPED})
    assert await board.read("ISR", "CONFIG_RANGE") == 1
    await board.apply(links(CONFIG, settings))
    assert await board.read("STATUS", "CONFIG_RANGE") == 0
