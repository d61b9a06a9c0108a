"""What the core takes, in clock cycles counted in the simulated Verilog."""

from dataclasses import replace
from functools import cache

from cmfpga.protocol.settings import BatchSettings, schedule_table, settings_values
from cmfpga.rtl.core import Core
from cmfpga.verilog.compiler import cannot_compile
from cmfpga.verilog.simulation import VerilatedCore

from .cases import WARM


def measure(case, name):
    """What one of the case's cores takes, in clock cycles, JSON-ready; measured if the Verilog can be compiled.

    ``cycles`` count from the offer of the batch's first event to its result, ``after_last`` from the last event's being
    taken, ``per_iteration`` what one more takes, and ``back_to_back`` from one result to the next where batches are
    offered without a pause. That, and ``v`` in px per half batch, are None where nothing was simulated; ``formula`` is
    ``Core.cycles`` for the same batch.
    """
    config, iterations = case.designs[name], case.iterations
    size = {"events": len(case.workload.events), "roi_events": case.workload.roi_events, "judge": config.judge}
    found = {} if cannot_compile() else _simulate(case, config)
    core = simulated(config).core if found else Core(config)
    formula, shorter = (core.cycles(**size, iterations=case.plan(count)) for count in (iterations, iterations - 1))
    cycles = found.pop("cycles", formula)
    return {
        "name": name, "measured": bool(found), "iterations": iterations, "cycles": cycles, "formula": formula,
        "after_last": cycles - size["events"],
        **(found or {"per_iteration": formula - shorter, "back_to_back": None, "v": None}),
    }  # fmt: skip


def _simulate(case, config):
    core = simulated(config)
    settings = BatchSettings.from_config(config, case.workload.roi)
    settings = replace(settings, cold_after_doubtful=0)  # a warm case is measured warm
    # Leaves v for a warm batch; and the sweep after the reset is over.
    (first,) = _run(core, settings, case)
    shorter = replace(settings, iterations=settings.iterations - 1, cold=settings.cold[:-1], warm=settings.warm[:-1])
    if case.ascent == WARM:
        settings, shorter = (replace(each, roi=None) for each in (settings, shorter))
    (result,), (less,) = _run(core, settings, case), _run(core, shorter, case)
    cycles, fewer = (row["valid"] - row["offered"] for row in (result, less))
    done = (first["roi_events"], result["iterations"], less["iterations"])
    if done != (case.workload.roi_events, case.iterations, case.iterations - 1):
        raise AssertionError(f"the core did {done[1]} and {done[2]} iterations on {done[0]} events")
    stream = _run(core, settings, case, 4)  # the first ones find the core idle
    if any(row["iterations"] != case.iterations for row in stream):
        raise AssertionError("the core did another number of iterations in a stream of batches")
    return {
        "cycles": cycles,
        "per_iteration": cycles - fewer,
        "back_to_back": stream[-1]["valid"] - stream[-2]["valid"],
        "v": tuple(config.formats.v.real(result[f"v_{axis}"]) for axis in "xy"),
    }


def _run(core, settings, case, count=1):
    """What the core's ports say of a batch that comes so often, without a pause."""
    events = case.workload.events
    core.write_schedule(schedule_table(core.config, settings))
    values = settings_values(core.config, settings)
    return core.play([(events.t, events.x, events.y)] * count, [values] * count)[0]


@cache
def simulated(config):
    """The simulator of a configuration's core, made once."""
    return VerilatedCore(config)
