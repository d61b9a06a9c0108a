"""What the cocotb tests of batches share: begin, compare, account."""

import dataclasses

from cmfpga.protocol.results import COUNTS
from support.axi.board import CONFIG, Board
from support.axi.expected import Expected, default_settings, links, same

FORMATS = {"EVT21": 0, "EVT20": 1, "PACKED": 2}
ROI = ((CONFIG.sensor_width - CONFIG.roi_width) // 2, (CONFIG.sensor_height - CONFIG.roi_height) // 2)
RUN = {"START": 1, "AUTO_RESTART": 1}


async def begin(dut, *, seed=0, pauses=0.0, ends=None, form="PACKED", swap=0, **changes):
    """A board out of reset, its settings written, ROI loaded, running: ``(board, expected, settings of batch 1)``."""
    board = Board(dut, seed=seed, pauses=pauses)
    await board.reset()
    settings = dataclasses.replace(default_settings(CONFIG, ROI), **changes)
    await board.apply(links(CONFIG, settings, ends))
    await board.write("INPUT", FORMAT=form, SWAP=swap)
    await board.write("CTRL", **RUN)
    return board, Expected(CONFIG), settings


def following(settings):
    """Settings of the next batch: the ROI is loaded once."""
    return dataclasses.replace(settings, roi=None)


async def compare(board, expected, batches, settings, **flags):
    """Results of these batches, one packet each; the last one in the registers too."""
    for batch in batches:
        wanted = expected.result(batch, settings, **flags)
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
