"""Real recordings through the AXI top, against the models."""

import os
from pathlib import Path

import cocotb
import h5py
import numpy as np

from cmfpga.events.arrays import Events
from cmfpga.protocol.words import encode, read_raw, swap_halves
from cmfpga.reference.wire import BatchEnds, to_beats
from support.axi.board import CONFIG, Board
from support.axi.expected import Expected, default_settings, links, same

DATA = Path(os.environ["CMFPGA_DATA"])


def recorded(name, start, count):
    with h5py.File(DATA / name) as file:
        return Events(*(file[f"events/{axis}"][start : start + count] for axis in "txyp"))


async def run(board, words, form, ends, roi, *, swap=0, expect):
    """Stream words through a fresh top, and compare all results; the model's results by name."""
    await board.reset()
    expected, settings = Expected(CONFIG), default_settings(CONFIG, roi)
    await board.apply(links(CONFIG, settings, ends))
    await board.write("INPUT", FORMAT=form, SWAP=swap)
    await board.write("CTRL", START=1, AUTO_RESTART=1)
    batches, _ = expected.receive(to_beats(words, last=False), form, ends)
    assert len(batches) >= expect
    sending = cocotb.start_soon(board.send(swap_halves(words) if swap else words))
    results = []
    for batch in batches:
        wanted = expected.result(batch, settings)
        same(await board.result(), wanted)
        results.append(wanted)
        settings = default_settings(CONFIG)
    await sending
    assert sum(wanted["iterations"] > 0 for wanted in results) >= expect
    return results


@cocotb.test()
async def davis_as_evt21(dut):
    """Ten batches back to back out of a DAVIS 240C recording, as EVT 2.1 with exchanged halves."""
    ends = BatchEnds(events=1500, by_tlast=False)
    words = encode(recorded("davis240c_shapes_rotation_0.0s.h5", 60_000, 15_000), "EVT21")
    results = await run(Board(dut), words, "EVT21", ends, (100, 30), swap=1, expect=10)
    assert len({(wanted["v_x"], wanted["v_y"]) for wanted in results}) > 3


@cocotb.test()
async def davis_as_packed_words_by_duration(dut):
    ends = BatchEnds(duration=10_000, by_tlast=False)
    words = encode(recorded("davis240c_slider_depth_0.0s.h5", 0, 9_000), "PACKED")
    await run(Board(dut), words, "PACKED", ends, (90, 60), expect=2)


@cocotb.test()
async def prophesee_file(dut):
    """The words of a .raw file of EVT 2.0, untouched: with its own time words and what else is in it."""
    form, words = read_raw(DATA / "original_formats" / "prophesee_spinner_640x480_evt2.raw")
    ends = BatchEnds(events=4000, by_tlast=False)
    results = await run(Board(dut), words[:6200], form, ends, (216, 84), expect=2)
    assert np.sum([wanted["events"] for wanted in results]) == 12_000
