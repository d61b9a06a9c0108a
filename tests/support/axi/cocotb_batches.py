"""Events in, results out: against the models, value by value."""

import dataclasses

import cocotb
import numpy as np

from cmfpga.events.arrays import Events
from cmfpga.protocol.words import encode, swap_halves
from cmfpga.reference.wire import BatchEnds, to_beats
from cmfpga.rtl.axi.top import AxiTop
from support.axi.batches import FORMATS, ROI, RUN, begin, compare, following, nothing_lost
from support.axi.board import CONFIG
from support.axi.expected import Expected, links, moving_events, same


@cocotb.test()
async def all_formats_under_back_pressure(dut):
    """EVT 2.1, EVT 2.0 and packed words, with and without the swap; gaps and stalls on every channel."""
    board, expected, settings = await begin(dut, seed=1, pauses=0.3)
    seed = 0
    for form in FORMATS:
        for swap in (0, 1):
            await board.write("INPUT", FORMAT=form, SWAP=swap)
            await board.until("STATUS", "INPUT_PENDING", 0)
            words = [encode(moving_events(CONFIG, 50, seed + k, t0=5000 * seed), form) for k in range(2)]
            seed += 2
            batches = []
            beats = [beat for packet in words for beat in to_beats(packet)]
            batches, rest = expected.receive(beats, form)
            assert len(batches) == 2 and not rest
            for packet in words:
                await board.send(swap_halves(packet) if swap else packet)
            settings = await compare(board, expected, batches, settings)
    await nothing_lost(board, expected)


@cocotb.test()
async def ten_batches_back_to_back(dut):
    """At full rate, no pause between them; and what each costs, to the cycle."""
    board, expected, settings = await begin(dut, form="EVT21", ends=BatchEnds(events=70, by_tlast=False))
    events = moving_events(CONFIG, 700, 3, step=8)
    # A word an event: none of the ten batches waits for its input.
    words = encode(events, "EVT21")
    batches, rest = expected.receive(to_beats(words), "EVT21", BatchEnds(events=70, by_tlast=False))
    assert len(batches) == 10 and not rest
    sending = cocotb.start_soon(board.send(words))
    cycles = []
    for batch in batches:
        wanted = expected.result(batch, settings)
        found = await board.result()
        cycles.append(found["cycles"])
        same(found, wanted)
        settings = following(settings)
    await sending
    counted = await nothing_lost(board, expected)
    assert counted["beats_in"] == len(words) == len(board.taken) and counted["longest_batch"] == max(cycles)
    ends = [cycle for cycle, last in board.sent if last]
    starts = [cycle for k, (cycle, _) in enumerate(board.sent) if k == 0 or board.sent[k - 1][1]]
    assert len(ends) == len(starts) == 10
    beats = AxiTop(CONFIG).shell.result_packet.beats
    assert {end - start for end, start in zip(ends, starts, strict=True)} == {beats - 1}


@cocotb.test()
async def cycles_of_the_wrapper(dut):
    """None per event; from the core's result to TLAST at most 20; measured at the ports, for every format."""
    board, expected, settings = await begin(dut, form="PACKED")
    shell = AxiTop(CONFIG).shell
    assert shell.result_latency <= 20
    # After a reset the image is cleared before the first event is taken in.
    await board.cycles(CONFIG.roi_width * CONFIG.roi_height)
    for form, count in (("PACKED", 200), ("PACKED", 90), ("EVT21", 150), ("EVT20", 151)):
        await board.write("INPUT", FORMAT=form)
        await board.until("STATUS", "INPUT_PENDING", 0)
        await board.write("ROI_LOAD", LOAD=1)
        # One time stamp for all but the last: no time words in between, one event per word.
        t = np.full(count, 64 * 1000)
        t[-1] += 50
        rng = np.random.default_rng(count)
        events = Events(t, rng.integers(20, 40, count), rng.integers(20, 40, count), np.zeros(count))
        words = encode(events, form)
        (batch,), _ = expected.receive(to_beats(words), form)
        del board.taken[:], board.sent[:]
        await board.send(words)
        found = await board.result()
        same(found, expected.result(batch, settings))
        # The core's own formula holds: no event had to wait.
        runs = {name: found[name] for name in ("events", "roi_events", "iterations")}
        assert found["cycles"] == shell.core.cycles(**runs), form
        # From the first event's word at the port to the core; each word before the first event takes a cycle.
        first = board.taken[0] + {"PACKED": 0, "EVT21": 1, "EVT20": 1}[form]
        offered = first + shell.event_latency
        assert board.sent[-1][0] == offered + found["cycles"] + shell.result_latency, form


@cocotb.test()
async def batches_end_by_number_duration_tlast_or_command(dut):
    kinds = {
        "number": BatchEnds(events=60, by_tlast=False),
        "duration": BatchEnds(duration=400, by_tlast=False),
        "duration and tlast": BatchEnds(duration=700),
        "all": BatchEnds(events=50, duration=500),
    }
    board, expected, settings = await begin(dut, form="EVT21")
    roi = ROI
    for k, (kind, ends) in enumerate(kinds.items()):
        if not ends.by_tlast or kind == "all":
            await board.write("CTRL", SOFT_RESET=1)
            totals, expected = expected.totals, Expected(CONFIG)
            assert totals["batches"] > 0 or k == 0
            settings = dataclasses.replace(settings, roi=roi)
        await board.apply(links(CONFIG, settings, ends))
        await board.write("CTRL", **RUN)
        words = encode(moving_events(CONFIG, 200, 70 + k, t0=10_000 * (k + 1)), "EVT21")
        batches, rest = expected.receive(to_beats(words), "EVT21", ends)
        await board.send(words)
        settings = await compare(board, expected, batches, settings)
        if rest:  # what the command ends
            expected.totals["events_taken"] += len(rest)
            await board.write("CTRL", END_BATCH=1, **RUN)
            last = (*np.array(rest, np.int64).T, False)
            settings = await compare(board, expected, [last], settings)
        assert len(batches) > 1 or "tlast" in kind
        await nothing_lost(board, expected)


@cocotb.test()
async def batches_end_by_roi_events(dut):
    """The core's own end: the batch has exactly so many stored events, wherever the next one begins."""
    board, expected, settings = await begin(dut, form="PACKED", ends=BatchEnds(by_tlast=True))
    await board.write("BATCH_ROI_EVENTS", 30)
    events = moving_events(CONFIG, 260, 5)
    await board.send(encode(events, "PACKED"))
    position = 0
    while position < len(events):
        found = await board.result()
        part = events[position : position + found["events"]]
        batch = (part.t, part.x.astype(np.int64), part.y.astype(np.int64), False)
        same(found, expected.result(batch, settings))
        settings = following(settings)
        position += found["events"]
        assert found["roi_events"] == 30 or position == len(events)
    expected.totals["events_in"] = expected.totals["events_taken"] = len(events)
    assert expected.batches > 2
    await nothing_lost(board, expected)
