"""What the core takes, in clock cycles counted in the simulated Verilog."""

import warnings
from dataclasses import dataclass, replace
from functools import cache

from ..engines.rtl import find_compiler
from ..protocol.settings import BatchSettings, schedule_table, settings_values
from .cases import WARM


@dataclass(frozen=True, kw_only=True)
class CoreRow:
    """What a core takes for a case, in clock cycles.

    Parameters
    ----------
    measured : bool
        Counted in the simulated Verilog; otherwise computed by ``Core.cycles`` because there is no C++ compiler.
    cycles : int
        From the offer of the batch's first event to its result.
    formula : int
        ``Core.cycles`` for the same batch.
    per_iteration : int
        What one iteration more takes.
    after_last : int
        From the last event's being taken to the result. Events are taken in N cycles after the first is offered.
    back_to_back : int or None
        From one result to the next where batches are offered without a pause: with two buffers, one is taken in while
        the one before is optimised. None if it was not simulated.
    v : (float, float) or None
        Result, px per half batch.
    """

    name: str
    measured: bool
    iterations: int
    cycles: int
    formula: int
    per_iteration: int
    after_last: int
    back_to_back: int | None
    v: tuple | None


def measure(case, name):
    """The :class:`CoreRow` of one of the case's cores, from the simulated Verilog where there is a C++ compiler."""
    config, events, iterations = case.designs[name], len(case.workload.events), case.iterations
    roi_events = case.workload.roi_events
    if find_compiler() is None:
        return _computed(case, name)
    core = simulated(config)
    settings = BatchSettings.from_config(config, case.workload.roi)
    first = _run(core, settings, case)  # leaves v for a warm batch; and the sweep after the reset is over
    shorter = _one_iteration_less(settings)
    if case.ascent == WARM:
        settings, shorter = (replace(each, roi=None) for each in (settings, shorter))
    result, less = _run(core, settings, case), _run(core, shorter, case)
    done = (first["roi_events"], result["iterations"], less["iterations"])
    if done != (roi_events, iterations, iterations - 1):
        raise AssertionError(f"the core did {done[1]} and {done[2]} iterations on {done[0]} events")
    cycles = result["measured_cycles"]
    return CoreRow(
        name=name,
        measured=True,
        iterations=iterations,
        cycles=cycles,
        formula=core.core.cycles(events=events, roi_events=roi_events, iterations=iterations),
        per_iteration=cycles - less["measured_cycles"],
        after_last=cycles - events,
        back_to_back=_back_to_back(core, settings, case),
        v=tuple(config.formats.v.real(result[f"v_{axis}"]) for axis in "xy"),
    )


def _run(core, settings, case):
    events = case.workload.events
    core.write_schedule(schedule_table(core.config, settings))
    return core.run(events.t, events.x, events.y, settings_values(core.config, settings))[0]


def _back_to_back(core, settings, case):
    """Cycles between the results of the last two of four batches: the first ones find the core idle."""
    events = case.workload.events
    batches = [(events.t, events.x, events.y)] * 4
    core.write_schedule(schedule_table(core.config, settings))
    results, _ = core.stream(batches, [settings_values(core.config, settings)] * len(batches))
    if any(result["iterations"] != case.iterations for result in results):
        raise AssertionError("the core did another number of iterations in a stream of batches")
    return results[-1]["valid"] - results[-2]["valid"]


def _one_iteration_less(settings):
    return replace(settings, iterations=settings.iterations - 1, cold=settings.cold[:-1], warm=settings.warm[:-1])


@cache
def simulated(config):
    """The simulator of a configuration's core, made once."""
    from ..engines.verilated import VerilatedCore

    return VerilatedCore(config)


def _computed(case, name):
    from amaranth.hdl import UnusedElaboratable

    from ..rtl.core import Core

    warnings.filterwarnings("ignore", category=UnusedElaboratable)  # it is only asked for numbers
    core = Core(case.designs[name])
    batch = {"events": len(case.workload.events), "roi_events": case.workload.roi_events}
    cycles = core.cycles(**batch, iterations=case.iterations)
    return CoreRow(
        name=name,
        measured=False,
        iterations=case.iterations,
        cycles=cycles,
        formula=cycles,
        per_iteration=cycles - core.cycles(**batch, iterations=case.iterations - 1),
        after_last=cycles - batch["events"],
        back_to_back=None,
        v=None,
    )
