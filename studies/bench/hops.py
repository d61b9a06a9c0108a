"""From the event that closes a hop to its result: every hop of recordings, at their own time stamps, in the Verilog;
and what a program takes for such a hop."""

import contextlib
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cmfpga.config import preset
from cmfpga.config.schedule import AUTO
from cmfpga.errors import ConfigError
from cmfpga.events import open_recording
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.sliding.core import SlidingCore
from cmfpga.verilog.compiler import cannot_compile
from cmfpga.verilog.simulation import VerilatedCore

from ..accuracy.real import counts
from .cases import make_workload
from .opponents.c_program import HopProgram, Job
from .programs import or_missing, processor, side_by_side

#: A longer pause, in clock cycles, changes nothing for warm hops: the round has caught up, and the one after has ended.
LONGEST_PAUSE = 1500
WINDOWS = 400, 800, 2000  # lengths of a window that programs are timed for, events


def run(options, missing, *, runs, seconds):
    """``(lines of text, what ``--json`` writes)``; ``missing`` gets a line where no program can be measured."""
    files = sorted(Path(options.data).glob("*.h5")) if options.data else []
    if not files:
        raise ConfigError("--hops needs --data DIR, a folder of recordings (*.h5)")
    if why := cannot_compile():
        raise ConfigError(f"--hops counts cycles in the simulated Verilog: {why}")
    window, events = 800, 4000 if options.quick else 20_000
    rows, timed, program = [], [], None
    with or_missing(missing):
        program = HopProgram()
    for file in tqdm(files, unit="recording", disable=None, leave=False):
        rows.append({"recording": file.stem, **row_of(*play(*load(file, window, events), options.clock))})
        timed += programs(file, program, events=events, runs=runs, seconds=seconds) if program else []
    plans = {"search and judging round": AUTO, "search alone": ""}
    rates = {plan: {n: rate(n, after) for n in WINDOWS} for plan, after in plans.items()}
    lines = text(rows, rates, options.clock, window)
    if timed:
        lines += text_of_programs(timed, options.clock, program.how, processor())
    lines += [f"not measured: {line}" for line in missing]
    report = {"clock_mhz_assumed": options.clock, "window_events": window, "hops": rows, "programs": timed}
    return lines, report | {"rates": rates, "processor": processor()}


def row_of(events, held, warm, cold, degenerate):
    """JSON-ready, of what :func:`play` gives: how many, and the cycles."""
    low, mid, high = (int(x) for x in np.percentile(warm, (0, 50, 100))) if warm else (None,) * 3
    return {
        "events": events, "held": held, "warm": len(warm), "fewest": low, "median": mid, "most": high,
        "within_130": sum(one <= 130 for one in warm), "cold": len(cold), "cold_most": max(cold, default=None),
        "degenerate": degenerate,
    }  # fmt: skip


def load(path, window, count):
    """``(configuration, events, corner)`` of the first ``count`` events of a file, the ROI where most of them are."""
    with open_recording(path) as recording:
        width, height = recording.width, recording.height
        found = next(recording.chunks(0, count))
    config = _sliding(window, sensor_width=width, sensor_height=height)
    of_each = counts(found, (width, height), config.roi_px, [side // 4 for side in config.roi_px])
    return config, found, max(sorted(of_each), key=of_each.get)


def _sliding(window, **fields):
    """Windows of so many events, whatever time they take."""
    lengths = {"window_events": window, "hop_events": window // 16, "window_us": 0, "hop_us": 0}
    return preset("sliding").replace(**lengths, **fields)


def programs(path, program, *, events, **options):
    """What a program takes for the last window of a file's first ``events``, a row for each of :data:`WINDOWS`.

    Seconds, medians: ``round`` from the hop's end on, where nothing followed; ``follow`` for the whole window, event by
    event; ``tail`` from the closing event on, where that was done before.
    """
    rows = []
    for window in WINDOWS:
        config, found, corner = load(path, window, events)
        width, height = config.roi_px
        inside = found[events_in_roi(found, corner, width, height)[0]][-window:]
        if len(inside) < window:
            continue
        job = Job(events=inside, roi=corner, width=width, height=height, iterations=0, schedule=(), dither=True)
        with contextlib.closing(program.load(job)) as loaded:
            times = side_by_side([loaded.round, loaded.follow, loaded.tail], **options)
        taken = {what: each["median"] for what, each in zip(("round", "follow", "tail"), times, strict=True)}
        rows.append({"recording": path.stem, "window": window, **taken})
    return rows


def play(config, events, corner, clock):
    """``events`` offered at their own times; hops close by their number. ``clock`` in MHz.

    Returns ``(events, held, warm, cold, degenerate)``: clock cycles from the closing event to the result, of warm hops
    and of cold ones; ``held`` are the events that the core did not take when they were offered, and those behind them
    come later by as much.
    """
    settings = BatchSettings.from_config(config, roi=corner)
    t = np.asarray(events.t, np.int64)
    gaps = np.clip(np.diff(t, prepend=t[:1]) * clock - 1, 0, LONGEST_PAUSE).astype(np.int64)
    with contextlib.closing(VerilatedCore(config)) as core:
        results = core.slide(t, events.x, events.y, settings, gaps=gaps, each=True)
        offered, finished = np.array(core.offered), core.finished
    held = np.count_nonzero(np.diff(offered)[1:] - 1 > gaps[2:])  # the first one waits until the banks are cleared
    closed, warm, cold, degenerate = np.cumsum([one.events for one in results]), [], [], 0
    for result, last, cycle in zip(results, closed - 1, finished, strict=True):
        if Flag.DEGENERATE in result.flags:
            degenerate += 1
            continue
        kind = warm if result.iterations == len(settings.follow) else cold
        kind.append(int(cycle - offered[last] - 1))
    return len(t), int(held), warm, cold, degenerate


def rate(window, after=AUTO):
    """Clock cycles from result to result where events never pause, in windows of so many events.

    ``after=""`` leaves out the round that judges.
    """
    config = _sliding(window, after=after)
    made = make_workload("", events=3 * window, roi_events=3 * window)
    with contextlib.closing(VerilatedCore(config)) as core:
        core.slide(made.events.t, made.events.x, made.events.y, BatchSettings.from_config(config, roi=made.roi))
        return int(np.median(np.diff(core.finished[-20:])))


def text(rows, rates, clock, window):
    """Lines for people, of the rows of :func:`row_of`, and of cycles by :func:`rate`, ``{plan: {window: cycles}}``."""
    lines = [
        f"cycles after the event that closes a hop, to its result; windows of {window} events; at {clock:g} MHz "
        "(assumed) the events come at their own times",
        f"{'recording':40} {'events':>8} {'held':>6} {'warm':>6} {'fewest':>7} {'median':>7} {'most':>7} {'≤ 130':>6} "
        f"{'cold':>5} {'most':>7}",
    ]
    widths = {"warm": 6, "fewest": 7, "median": 7, "most": 7, "within_130": 6, "cold": 5, "cold_most": 7}
    for row in rows:
        shown = (f"{'-' if row[name] is None else row[name]:>{width}}" for name, width in widths.items())
        lines.append(f"{row['recording']:40} {row['events']:8,} {' '.join(shown)}")
    warm, within = (sum(row[name] for row in rows) for name in ("warm", "within_130"))
    lines.append(f"{within:,} of {warm:,} warm hops within 130 cycles")
    for plan, found in rates.items():
        rate_of = (f"n = {n:,}: {clock * 1e6 / cycles:,.0f} ({cycles:,} cycles)" for n, cycles in found.items())
        lines.append(f"results a second, {plan}, an event a cycle: {', '.join(rate_of)}")
    return lines


def text_of_programs(rows, clock, how, processor):
    """The same of :func:`programs`: medians over recordings, and how many times as fast the core's tail is."""
    core = SlidingCore(preset("sliding")).tail + 3
    lines = [
        f"C on one thread ({processor}; {how}), median of recordings, µs, and how many times as long as the core's "
        f"{core} cycles at {clock:g} MHz:",
    ]
    for window in sorted({row["window"] for row in rows}):
        those = [row for row in rows if row["window"] == window]
        after, tail, all_of_it = (np.median([row[what] for row in those]) for what in ("round", "tail", "follow"))
        times = [f"{each * 1e6:.2f} ({each * 1e6 * clock / core:.2g} ×)" for each in (after, tail)]
        lines.append(
            f"  {window:5,} events, {len(those)} recordings: after the hop {times[0]}; following {times[1]}, "
            f"and {all_of_it / window * 1e9:.0f} ns an event"
        )
    return lines
