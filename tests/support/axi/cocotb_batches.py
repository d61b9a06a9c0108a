"""Events in, results out, against the models; settings, resets, bypass, and words that no camera sends."""

import dataclasses
import itertools

import cocotb
import numpy as np
from cocotb.triggers import ClockCycles

from cmfpga.events.arrays import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import COUNTS
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode, swap_halves
from cmfpga.reference.wire import BatchEnds, Beat, to_beats
from cmfpga.rtl.axi.top import AxiTop
from support.axi.board import CONFIG, Board
from support.axi.expected import Expected, links, moving_events, same

FORMATS = {"EVT21": 0, "EVT20": 1, "PACKED": 2}
ROI = ((CONFIG.sensor_width - CONFIG.roi_width) // 2, (CONFIG.sensor_height - CONFIG.roi_height) // 2)
RUN = {"START": 1, "AUTO_RESTART": 1}


async def begin(dut, *, seed=0, pauses=0.0, ends=None, form="PACKED"):
    """A board out of reset, its settings written, ROI loaded, running: ``(board, expected, settings of batch 1)``."""
    board = Board(dut, seed=seed, pauses=pauses)
    await board.reset()
    settings = BatchSettings.from_config(CONFIG, ROI)
    await board.apply(links(CONFIG, settings, ends))
    await board.write("INPUT", FORMAT=form)
    await board.write("CTRL", **RUN)
    return board, Expected(CONFIG), settings


def following(settings):
    """Settings of the next batch: the ROI is loaded once."""
    return dataclasses.replace(settings, roi=None)


async def compare(board, expected, batches, settings):
    """Results of these batches, one packet each; the last one in the registers too."""
    for batch in batches:
        wanted = expected.result(batch, settings)
        same(await board.result(), wanted)
        settings = following(settings)
    same(await board.result_registers(), wanted)
    return settings


async def nothing_lost(board, expected):
    """All counters as the models have them, and the sums that must hold."""
    await board.until("CTRL", "IDLE", 0 if (await board.read("CTRL", "START")) else 1)
    found = await board.counters()
    same({name: found[name] for name in expected.totals}, expected.totals)
    assert found["events_in"] == found["before_time"] + found["out_of_sensor"] + found["events_taken"]
    assert found["events_taken"] == sum(found[name] for name in COUNTS)
    return found


# ---------------------------------------------------------------- batches


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
            batches, rest = expected.receive([beat for packet in words for beat in to_beats(packet)], form)
            assert len(batches) == 2 and not rest
            for packet in words:
                await board.send(swap_halves(packet) if swap else packet)
            settings = await compare(board, expected, batches, settings)
    await nothing_lost(board, expected)


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


# ---------------------------------------------------------------- control


@cocotb.test()
async def settings_take_effect_at_the_next_batch(dut):
    """Written while a batch is taken in: it keeps its settings, the next one has the new ones."""
    ends = BatchEnds(events=80, by_tlast=False)
    board, expected, settings = await begin(dut, form="PACKED", ends=ends)
    events = moving_events(CONFIG, 400, 9)
    words = encode(events, "PACKED")
    batches, _ = expected.receive(to_beats(words), "PACKED", ends)

    async def half(batch):
        await board.send(words[80 * batch : 80 * batch + 40])

    async def rest(batch):
        await board.send(words[80 * batch + 40 : 80 * batch + 80])

    await half(0)
    await board.until("STATUS", "TAKING_IN")
    other = dataclasses.replace(settings, roi=(3, 5), min_roi_events=4, thinning=2, start_last=False, v_start=(16, -8))
    if CONFIG.ascent_rule.has_table:
        other = dataclasses.replace(other, cold=settings.cold[:3], warm=settings.warm[:2])
    else:
        other = dataclasses.replace(other, iterations=3, eta=settings.eta // 2)
    await board.apply(links(CONFIG, other, ends))
    await rest(0)
    same(await board.result(), expected.result(batches[0], settings))
    await half(1)
    # Locked: of what is written from here on nothing counts, not even if batches begin.
    await board.write("SETTINGS_LOCK", LOCK=1)
    await board.apply(links(CONFIG, dataclasses.replace(settings, roi=(7, 7)), ends))
    await rest(1)
    same(await board.result(), expected.result(batches[1], other))
    await half(2)
    await rest(2)
    same(await board.result(), expected.result(batches[2], following(other)))
    # Unlocked in the middle of a batch: for the next one.
    await half(3)
    await board.write("SETTINGS_LOCK", LOCK=0)
    await rest(3)
    same(await board.result(), expected.result(batches[3], following(other)))
    # The kind of input, too: what has come is still read as what it is.
    await half(4)
    await board.write("INPUT", FORMAT="EVT20")
    assert await board.read("STATUS", "INPUT_PENDING") == 1
    await rest(4)
    same(await board.result(), expected.result(batches[4], dataclasses.replace(settings, roi=(7, 7))))
    await board.until("STATUS", "INPUT_PENDING", 0)
    await nothing_lost(board, expected)
    assert await board.read("ROI_LOAD") == 0


@cocotb.test()
async def one_batch_at_a_time(dut):
    """START without AUTO_RESTART; DONE, hold, interrupts; results in registers only."""
    board = Board(dut, seed=4)
    await board.reset()
    expected, settings = Expected(CONFIG), BatchSettings.from_config(CONFIG, ROI)
    await board.apply(links(CONFIG, settings))
    await board.write("OUTPUT", STREAM_RESULTS=0)
    await board.write("INPUT", FORMAT="EVT20")
    packets = [encode(moving_events(CONFIG, 70, 30 + k), "EVT20") for k in range(4)]
    batches, _ = expected.receive([beat for words in packets for beat in to_beats(words)], "EVT20")
    sending = cocotb.start_soon(board.send(packets[0]))
    await board.cycles(100)
    # Not started: the events wait, they are not lost.
    assert await board.read("CTRL") == 0b1100 and await board.read("STATUS", "EVENTS_WAITING") == 1
    assert await board.read("RESULT_BATCH") == 0
    await board.write("GIE", ENABLE=1)
    await board.write("IER", DONE=1)
    assert dut.irq.value == 0
    await board.write("CTRL", START=1)
    for k, packet in enumerate(packets):
        if k:
            await board.write("CTRL", START=1)
            sending = cocotb.start_soon(board.send(packet))
        await sending
        await board.until("CTRL", "DONE")
        assert dut.irq.value == 1
        assert (await board.read("CTRL")) & 0xFF == 0b1110
        assert await board.read("ISR", "DONE") == 1 and await board.read("ISR", "READY") == 1
        wanted = expected.result(batches[k], settings)
        if k == 2:
            kept = await board.result_registers()
            assert kept["batch"] == 2  # held
            assert await board.read("COUNT_RESULTS_HELD_BACK") == 1
            await board.write("RESULT_HOLD", HOLD=0)
        else:
            same(await board.result_registers(), wanted)
        settings = following(settings)
        # Clearing ISR lowers the interrupt; writing zeros, or reading, does not.
        await board.write("ISR", 0)
        assert dut.irq.value == 1
        await board.write("ISR", 0x3F)
        await board.cycles(2)
        assert dut.irq.value == 0 and await board.read("ISR") == 0
        await board.write("CTRL", DONE=1)
        assert await board.read("CTRL", "DONE") == 0
        if k == 1:
            await board.write("RESULT_HOLD", HOLD=1)
    assert board.sink.empty() and not board.sent
    await nothing_lost(board, expected)
    await board.write("CTRL", CLEAR_COUNTERS=1)
    cleared = await board.counters()
    assert cleared.pop("cycles") < 200 and not any(cleared.values())


@cocotb.test()
async def reset_in_traffic(dut):
    """aresetn in the middle of a batch, of a packet and of register accesses: quiet at once, and as new afterwards."""
    board, expected, settings = await begin(dut, seed=6, pauses=0.2, form="EVT21")
    for attempt, delay in enumerate((50, 431)):
        cocotb.start_soon(board.source.send(encode(moving_events(CONFIG, 300, attempt), "EVT21").tobytes()))
        board.sink.pause = True
        await board.cycles(delay)
        board.lite.init_write(board.registers["SCRATCH"].offset, b"abcd")
        board.lite.init_read(board.registers["ID"].offset, 4)
        await board.cycles(attempt)
        dut.aresetn.value = 0
        await ClockCycles(dut.aclk, 2)
        outputs = ("s_axi_awready", "s_axi_wready", "s_axi_bvalid", "s_axi_arready", "s_axi_rvalid", "s_axis_tready")
        for _ in range(3):
            assert not any(int(getattr(dut, name).value) for name in (*outputs, "m_axis_tvalid", "irq"))
            await ClockCycles(dut.aclk, 1)
        dut.aresetn.value = 1
        await board.cycles(4)
        board.source.clear()
        board.sink.clear()
        board.pause(0.2)
        for name in ("CTRL", "BATCH_EVENTS", "SCRATCH", "INPUT", "RESULT_BATCH", "COUNT_EVENTS_IN"):
            assert await board.read(name) == {"CTRL": 0b1100}.get(name, board.registers[name].reset), name
        expected = Expected(CONFIG)
        await board.apply(links(CONFIG, settings))
        await board.write("INPUT", FORMAT="EVT21")
        await board.write("CTRL", **RUN)
        words = encode(moving_events(CONFIG, 60, 20 + attempt), "EVT21")
        batches, _ = expected.receive(to_beats(words), "EVT21")
        await board.send(words)
        await compare(board, expected, batches, settings)
        await nothing_lost(board, expected)


@cocotb.test()
async def bypass(dut):
    """Words pass unchanged, TKEEP, TLAST and all; then batches again."""
    board, expected, settings = await begin(dut, seed=8, pauses=0.4, form="EVT21")
    words = encode(moving_events(CONFIG, 60, 2), "EVT21")
    batches, _ = expected.receive(to_beats(words), "EVT21")
    await board.send(words)
    await board.write("INPUT", FORMAT="EVT21", BYPASS=1)  # during the batch: its result comes first
    settings = await compare(board, expected, batches, settings)
    await board.until("STATUS", "BYPASSING")
    for length in (1, 2, 7, 40):
        packet = [board.random.getrandbits(64) for _ in range(length)]
        await board.send(packet, wait=False)
        assert (await board.packet()).tolist() == packet
    await board.write("CTRL", SOFT_RESET=1, **RUN)  # does not break what is on its way
    expected = Expected(CONFIG)
    packet = [board.random.getrandbits(64) for _ in range(9)]
    await board.send(packet, wait=False)
    assert (await board.packet()).tolist() == packet
    counted = await board.counters()
    assert counted["beats_bypassed"] == counted["beats_in"] == 9 and counted["events_in"] == 0
    await board.write("INPUT", FORMAT="EVT21")
    await board.until("STATUS", "BYPASSING", 0)
    batches, _ = expected.receive(to_beats(words), "EVT21")
    await board.write("ROI_LOAD", LOAD=1)
    await board.send(words)
    await compare(board, expected, batches, dataclasses.replace(settings, roi=ROI))
    await nothing_lost(board, expected)


# ---------------------------------------------------------------- bad input


@cocotb.test()
async def bad_words(dut):
    """Unknown types, no time word, outside the sensor, time back and wrapping, TLAST anywhere: counted, never stuck."""
    board, expected, settings = await begin(dut, seed=9, pauses=0.1)
    rng = np.random.default_rng(5)
    for form in ("EVT21", "EVT20", "PACKED"):
        await board.write("CTRL", SOFT_RESET=1)
        # Once a packet that is being written is complete. Before EVT21: packed words, with their time.
        await board.until("STATUS", "TIME_KNOWN", form == "EVT21")
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
            last = [False] * (stop - start - 1) + [True]
            beats += map(Beat, words[start:stop], keep, last)
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
        await board.send(words)
        same(await board.result(), expected.result(batches[0], settings), but=["wire"])
        await board.write("ISR", 0x3F)


async def send_all(board, packets):
    for words, keep in packets:
        await board.send(words, keep=keep, wait=False)


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
    formats, corner = CONFIG.formats, (CONFIG.geometry.roi_x_max, CONFIG.geometry.roi_y_max)
    changes = {"roi": corner, "v_start": (formats.v.max, formats.v.min), "start_last": False, "thinning": 1}
    if CONFIG.ascent == "constant":
        changes |= {"iterations": 2, "eta": formats.eta.max}
        await board.write("ITERATIONS", 2)
    limited = dataclasses.replace(settings, roi_gain=formats.roi_gain.max, **changes)
    events = moving_events(CONFIG, 80, 14)
    x, y = events.x // 2 + CONFIG.sensor_width // 2, events.y // 2 + CONFIG.sensor_height // 2
    words = encode(Events(events.t, x, y, events.p), "PACKED")
    batches, _ = expected.receive(to_beats(words), "PACKED")
    await board.send(words)
    found = await board.result()
    wanted = expected.result(batches[0], limited, config_range=1)
    same(found, wanted | {"flags": wanted["flags"] | Flag.ROI_CLAMPED})
    assert await board.read("ISR", "CONFIG_RANGE") == 1
    await board.apply(links(CONFIG, settings))
    assert await board.read("STATUS", "CONFIG_RANGE") == 0
