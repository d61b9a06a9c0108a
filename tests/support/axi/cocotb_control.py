"""Settings, resets, bypass: when they take effect, against the models."""

import dataclasses

import cocotb
from cocotb.triggers import ClockCycles

from cmfpga.protocol.words import encode
from cmfpga.reference.wire import BatchEnds, to_beats
from support.axi.batches import ROI, RUN, begin, compare, following, nothing_lost
from support.axi.board import CONFIG, Board
from support.axi.expected import Expected, default_settings, links, moving_events, same


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
    expected, settings = Expected(CONFIG), default_settings(CONFIG, ROI)
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
async def soft_reset(dut):
    """In the middle of a batch: the same result as after aresetn, with the settings kept; a packet is completed."""
    board, expected, settings = await begin(dut, form="EVT20")
    words = encode(moving_events(CONFIG, 90, 1), "EVT20")
    board.sink.pause = True
    await board.send(words)
    await board.until("STATUS", "RESULT_WAITING")
    await board.send(words[:20])  # TLAST with the last of them: a batch whose result cannot go out
    await board.cycles(30)
    await board.write("CTRL", SOFT_RESET=1, **RUN)
    await board.cycles(20)
    board.sink.pause = False
    batches, _ = expected.receive(to_beats(words), "EVT20")
    same(await board.result(), expected.result(batches[0], settings))
    expected = Expected(CONFIG)
    assert (await board.counters())["batches"] == 0
    assert await board.read("STATUS", "TIME_KNOWN") == 0
    await board.write("ROI_LOAD", LOAD=1)
    batches, _ = expected.receive(to_beats(words), "EVT20")
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
    beats = 0
    for length in (1, 2, 7, 40):
        packet = [board.random.getrandbits(64) for _ in range(length)]
        beats += length
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
