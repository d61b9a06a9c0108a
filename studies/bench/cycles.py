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
    first = _run(core, settings, case)  # leaves v for a warm batch; and the sweep after the reset is over
    shorter = replace(settings, iterations=settings.iterations - 1, cold=settings.cold[:-1], warm=settings.warm[:-1])
    if case.ascent == WARM:
        settings, shorter = (replace(each, roi=None) for each in (settings, shorter))
    result, less = _run(core, settings, case), _run(core, shorter, case)
    done = (first["roi_events"], result["iterations"], less["iterations"])
    if done != (case.workload.roi_events, case.iterations, case.iterations - 1):
        raise AssertionError(f"the core did {done[1]} and {done[2]} iterations on {done[0]} events")
    return {
        "cycles": result["measured_cycles"],
        "per_iteration": result["measured_cycles"] - less["measured_cycles"],
        "back_to_back": _back_to_back(core, settings, case),
        "v": tuple(config.formats.v.real(result[f"v_{axis}"]) for axis in "xy"),
    }


def _run(core, settings, case):
    events = case.workload.events
    core.write_schedule(schedule_table(core.config, settings))
    (row,), _, _ = core.play([(events.t, events.x, events.y)], [settings_values(core.config, settings)])
    return row | {"measured_cycles": row["valid"] - row["offered"]}


def _back_to_back(core, settings, case):
    """Cycles between the results of the last two of four batches: the first ones find the core idle."""
    events = case.workload.events
    batches = [(events.t, events.x, events.y)] * 4
    core.write_schedule(schedule_table(core.config, settings))
    results, _, _ = core.play(batches, [settings_values(core.config, settings)] * len(batches))
    if any(result["iterations"] != case.iterations for result in results):
        raise AssertionError("the core did another number of iterations in a stream of batches")
    return results[-1]["valid"] - results[-2]["valid"]


@cache
def simulated(config):
    """The simulator of a configuration's core, made once."""
    return VerilatedCore(config)
