"""``python -m studies.bench --flow``: fields a second of dense flow, beside the same algorithm in C."""

import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from tqdm import tqdm

from cmfpga.api.flow import configure
from cmfpga.config import preset
from cmfpga.dense.fields import scene
from cmfpga.dense.tiles import TILE, grid
from cmfpga.events import Events, open_recording
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.sweep.task import processors
from cmfpga.verilog.compiler import cannot_compile
from cmfpga.verilog.simulation import VerilatedCore

from ..accuracy.dense import WINDOWS as RECORDINGS
from ..accuracy.foreign import FOREIGN, find
from .cases import COLD, STEPS, parse_steps
from .opponents.c_program import FlowProgram
from .programs import or_missing, processor, side_by_side, times_of

EVENTS = 30_000
WINDOWS = 3  # windows back to back; the time from the first one's end to the last one's counts
SYNTHETIC = "synthetic, the camera turns"
#: Of the program in C, from v = 0 and from the coarse tile's v.
COARSE, FINE = STEPS[COLD], "1:-1/2 1:-2/2 1:-3*2 0:-3 0:-4 0:-5"


def run(options, missing, *, runs, seconds):
    """``(lines of text, what ``--json`` writes)``; ``missing`` gets a line on each thing that is not measured.

    Of each recording in the folder a window is measured too; of a ``sensor`` the synthetic window alone, with the
    tiles, and the events of a window, that ``flow`` takes.
    """
    sensor, clock = options.sensor, options.clock
    units = (3, 4) if sensor else (5,) if options.quick else (1, 2, 4, 5, 8)
    if why := cannot_compile():
        missing.append(f"{why}: the hardware's cycles are not measured")
        units = ()
    config = preset("flow")
    tiles, made, most = grid(config), scene(*sensor or ()), EVENTS
    if sensor:
        config, tiles, _ = configure(made.recording(SYNTHETIC), "flow", {}, None, None, str)
        most = config.max_batch_events
    events = made.events[:most]
    settings = BatchSettings.from_config(config)
    windows, hardware = {SYNTHETIC: (settings, events), **_recorded(None if sensor else options.data)}, []
    with tqdm(total=len(units) + 2, unit="step", disable=None, leave=False) as bar:

        def step(what):
            bar.set_description(what)
            bar.update()

        for count in units:
            step(f"{count} units")
            of_it = config.replace(units=count)
            for name, (chosen, window) in windows.items():
                hardware.append({"window": name, **_hardware(of_it, tiles, chosen, window, clock)})
        programs = [] if sensor else _programs(config, tiles, settings, events, runs, seconds, missing, step)
    report = {
        "events": len(events), "sensor": [config.sensor_width, config.sensor_height], "regions": len(tiles.regions),
        "tiles": len(tiles), "clock_mhz_assumed": clock, "processor": processor(), "runs": runs, "hardware": hardware,
        "programs": programs,
    }  # fmt: skip
    return [*text(report), *(f"not measured: {line}" for line in missing)], report


def _recorded(data):
    """``{name: (settings, events)}`` of real windows, undistorted where there is a calibration."""
    found = {}
    for file in RECORDINGS if data is not None else ():
        with open_recording(Path(data) / file) as recording:
            config, *_ = configure(recording, "flow", {}, TILE, None, str)
            found[file] = BatchSettings.from_config(config), Events.concatenate(recording.chunks())[:EVENTS]
    return found


def _hardware(config, tiles, settings, events, clock):
    simulated = VerilatedCore(config)
    simulated.write(tiles.regions)
    *_, last = simulated.results([(events.t, events.x, events.y)] * WINDOWS, settings)
    period = (simulated.finished[-1] - simulated.finished[0]) / (WINDOWS - 1)
    first = simulated.finished[0] - simulated.offered[0] - len(events)
    simulated.close()
    busy = sum(region.cycles for region in last.regions) / (config.units * period)
    trusted = [not region.flags & (Flag.DOUBTFUL | Flag.DEGENERATE) for region in tiles.of(last)]
    return {
        "units": config.units, "cycles": period, "after_last": first, "busy": busy, "trusted_tiles": sum(trusted),
        "fields_per_s": clock * 1e6 / period, "events_per_s": clock * 1e6 / period * len(events),
    }  # fmt: skip


def with_steps(config, settings):
    """Settings whose schedules are those of the program in C."""
    return replace(settings, cold=parse_steps(config, COARSE), warm=parse_steps(config, FINE))


def _programs(config, tiles, settings, events, runs, seconds, missing, step):
    rows = []
    with or_missing(missing):
        program = FlowProgram()
        # Without a thread for what is beside, the last one waits for it.
        threads = sorted({1, processors()})
        step("C")
        settings = with_steps(config, settings)
        runners = [program.load_window(config, tiles.regions, events, settings, count) for count in threads]
        times = side_by_side(runners, runs=runs, seconds=seconds, clock=time.perf_counter)
        for count, each in zip(threads, times, strict=True):
            name = f"C, gathering, {count} thread{'s' if count > 1 else ''}"
            rows.append(_row(name, program.how, each, len(events)))
        step("eventcv")
        rows.append(_foreign(config, tiles, events))
    return rows


def _foreign(config, tiles, events):
    """A foreign program asked for each tile that has enough events, by its own search; once."""
    size = tiles.width, tiles.height
    mine = [(events[events_in_roi(events, corner, *size)[0]], corner) for corner in tiles.corners]
    mine = [(one, corner) for one, corner in mine if len(one) >= config.min_roi_events]
    find(*mine[0], *size)  # what is compiled at first use
    begun = time.perf_counter()
    for one, corner in mine:
        find(one, corner, *size)
    times = times_of([time.perf_counter() - begun])
    return _row(f"{FOREIGN}, tile by tile", f"{FOREIGN} {version(FOREIGN)}", times, len(events))


def _row(name, how, times, events):
    rates = {"fields_per_s": 1 / times["median"], "events_per_s": events / times["median"]}
    return {"name": name, "how": how, "seconds": times, **rates}


def text(report):
    """The report as lines."""
    hardware, programs = report["hardware"], report["programs"]
    lines = [
        f"Dense flow, {report['sensor'][0]}×{report['sensor'][1]} px: {report['tiles']} tiles in "
        f"{report['regions']} regions, {report['events']:,} events a window, confidence on.",
        f"Hardware: clock cycles counted in the simulated Verilog; times at an assumed {report['clock_mhz_assumed']:g} "
        "MHz. Programs: this machine's",
        f"processor, {report['processor']}; median of {report['runs']} runs (lowest–highest).",
        "",
        f"{'':<50}cycles a window   ms a window         fields/s   M events/s  units busy",
    ]
    for row in hardware:
        name = f"{row['units']} unit{'s' if row['units'] > 1 else ''}, {row['window']}"
        lines.append(
            f"{name:<50}{row['cycles']:>15,.0f}{1e3 / row['fields_per_s']:>14.3f}{row['fields_per_s']:>17,.0f}"
            f"{row['events_per_s'] / 1e6:>13.1f}{row['busy']:>12.0%}"
        )
    for row in programs:
        median, low, high = (1e3 * row["seconds"][name] for name in ("median", "low", "high"))
        span = f"{median:.2f}" if low == high else f"{median:.2f} ({low:.2f}–{high:.2f})"
        lines.append(f"{row['name']:<50}{span:>29}{row['fields_per_s']:>17,.1f}{row['events_per_s'] / 1e6:>13.2f}")
    for row in programs[:2]:
        for unit in [each for each in hardware if each["window"] == SYNTHETIC]:
            times, are = row["seconds"]["median"] * unit["fields_per_s"], "s are" if unit["units"] > 1 else " is"
            lines.append(f"{unit['units']} unit{are} {times:.1f} × as fast as {row['name']}")
    return lines
