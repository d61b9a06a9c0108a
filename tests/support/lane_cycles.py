"""What lanes gain on real batches: cycles from the last event to the result, with 800 events and the warm schedule.

PYTHONPATH=tests python -m support.lane_cycles FOLDER [LANES ...]    # of the recordings; minutes
"""

import sys
from dataclasses import replace

import numpy as np
from studies.accuracy.real import real_cases

from cmfpga.config import preset
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.settings import BatchSettings, schedule_table, settings_values
from cmfpga.verilog.simulation.core import VerilatedCore

EVENTS = 800


def batches(folder):
    """``[(events, roi)]`` of the real batches with enough events in the ROI, thinned evenly to :data:`EVENTS`."""
    config, found = preset("fast"), []
    for case in real_cases(folder):
        inside = events_in_roi(case.events, case.roi, config.roi_width, config.roi_height)[0]
        if len(inside) >= EVENTS:
            chosen = inside[np.arange(EVENTS) * len(inside) // EVENTS]
            found.append((case.events[chosen], case.roi))
    return found


def warm_cycles(core, batch, judge):
    """Cycles of a batch that starts where the schedule for cold ones ended on the same events."""
    events, roi = batch
    config = core.config
    first = replace(BatchSettings.from_config(config, roi), roi_gain=0, judge=judge, cold_after_doubtful=0)
    core.write_schedule(schedule_table(config, first))
    for settings in (first, replace(first, roi=None)):
        values, _, _ = core.run(events.t, events.x, events.y, settings_values(config, settings))
    assert values["iterations"] == len(config.schedules.warm) and values["roi_events"] == EVENTS
    return values["measured_cycles"] - EVENTS


def main(folder):
    found = batches(folder)
    print(f"{len(found)} real batches of {EVENTS} events: mean, most and fewest cycles after the last event")
    for lanes in map(int, sys.argv[2:] or "1248"):
        core = VerilatedCore(preset("fast").replace(lanes=lanes))
        for judge in (0, 1):
            cycles = [warm_cycles(core, batch, judge) for batch in found]
            least = core.core.cycles(events=0, roi_events=EVENTS, iterations=core.config.schedules.warm, judge=judge)
            least -= core.core.shortest_batch
            print(
                f"K = {lanes}, {'with' if judge else 'without'} confidence: {np.mean(cycles):,.0f}, {max(cycles):,}, "
                f"{min(cycles):,}; if no vote waited {least:,}"
            )
        core.close()


if __name__ == "__main__":
    main(sys.argv[1])
