"""One configuration: random batches through the hardware and the integer model, everything ``==``."""

import dataclasses

import numpy as np

from cmfpga.engines import make_engine
from cmfpga.engines.rtl import to_batch_result
from cmfpga.events import Events
from cmfpga.protocol.results import fields_of
from cmfpga.protocol.settings import BatchSettings, settings_values
from cmfpga.verilog.compiler import cannot_compile
from .batches import PATTERNS, random_events, random_lens, random_mask, random_schedules, random_settings

BATCHES = 3 * len(PATTERNS)
#: Clock cycles after which no further batch begins: seconds of Verilator, and of Amaranth's simulator.
CYCLES, SLOW_CYCLES = 1_500_000, 15_000


class MismatchError(Exception):
    """The hardware and the integer model differ; says in what."""


def check(config, seed):
    """Compare random batches, one by one and then back to back: (batches, iterations) that were equal.

    Raises
    ------
    MismatchError
    """
    counts = _one_by_one(config, np.random.default_rng([seed, 1]))
    if not cannot_compile():
        counts += _back_to_back(config, np.random.default_rng([seed, 2]))
    return counts


def _one_by_one(config, rng):
    """By the engines, as ``track`` runs them; the first batch with the configuration's own settings."""
    rtl, model = make_engine("rtl", config), make_engine("model", config)
    core = rtl.core
    limit = SLOW_CYCLES if cannot_compile() else CYCLES
    counts, cycles = np.zeros(2, int), 0
    for number in range(BATCHES):
        settings, roi = random_settings(config, rng, model.roi)
        if number == 0:
            settings = BatchSettings.from_config(config, roi)
        name, events = random_events(config, rng, roi)
        if rng.random() < 0.05:
            name, events = "nothing", Events.empty()
        expected, found = model.run(events, settings), rtl.run(events, settings)
        where = f"batch {number} ({name})"
        _same(where, found, expected)
        if found.iterations and found.events >= core.shortest_batch:
            done = {"events": found.events, "roi_events": found.roi_events, "iterations": model.core.plan}
            wanted = core.cycles(**done, judge=settings.judge)
            _equal(where, "cycles", found.cycles, wanted, "formula")
        counts += 1, found.iterations
        cycles += found.cycles or 0
        if cycles > limit:
            break
    rtl.close()
    return counts


def _back_to_back(config, rng):
    from cmfpga.verilog.simulation.core import VerilatedCore

    core = VerilatedCore(config, seed=int(rng.integers(1, 1 << 30)))
    counts = compare_stream(core, rng, BATCHES, gaps=0.1, stalls=0.3)
    core.close()
    return counts


def compare_stream(core, rng, most, *, gaps, stalls):
    """Random batches without a pause between them: the next one is offered while the one before is optimised.

    Parameters
    ----------
    core : VerilatedCore
        After a reset.
    rng : numpy.random.Generator
    most : int
        So many batches, or fewer if they take long.
    gaps, stalls : float
        How often an event comes late, and a result has to wait.

    Returns
    -------
    int array [2]
        Batches and iterations that were equal.

    Raises
    ------
    MismatchError
    """
    config, model = core.config, make_engine("model", core.config)
    fixed = random_schedules(config, rng) if config.ascent_rule.has_table else {}
    fixed |= {"hot_mask": random_mask(config, rng, model.roi), "camera": random_lens(config, rng)}
    batches, rows, expected, cycles = [], [], [], 0
    while len(batches) < most and cycles < CYCLES:
        settings, roi = random_settings(config, rng, model.roi)
        settings = dataclasses.replace(settings, **fixed)
        if batches and rng.random() < 0.7:
            settings, roi = dataclasses.replace(settings, roi=None), model.roi
        _, events = random_events(config, rng, roi)
        batches.append((events.t, events.x, events.y))
        rows.append(settings_values(config, settings))
        expected.append(model.run(events, settings))
        done = expected[-1]
        cycles += core.core.cycles(events=done.events, roi_events=done.roi_events, iterations=model.core.plan)
    core.write_tables(settings)
    count = sum(len(t) for t, _, _ in batches)
    late = rng.integers(0, 40, count) * (rng.random(count) < gaps)
    waits = rng.integers(0, 3000, len(batches)) * (rng.random(len(batches)) < stalls)
    results, traces = core.stream(batches, rows, gaps=late, stalls=waits)
    for number, (ports, trace) in enumerate(zip(results, traces, strict=True)):
        _same(f"batch {number} (back to back)", to_batch_result(config, ports, trace), expected[number])
    return np.array([len(batches), sum(result.iterations for result in expected)])


def _same(where, found, expected):
    """Equal in everything but the cycles, which only the hardware has; of the traces, in every iteration."""
    for part in (field.name for field in dataclasses.fields(expected.trace)):
        one, other = (np.asarray(getattr(result.trace, part)).tolist() for result in (found, expected))
        _equal(where, f"trace.{part}", one, other, "model")
    for name in (field.name for field in fields_of("batch", "region")):
        if name != "cycles":
            _equal(where, name, getattr(found, name), getattr(expected, name), "model")


def _equal(where, name, found, expected, of):
    if found == expected:
        return
    if isinstance(found, list) and len(found) == len(expected):
        row = next(k for k, pair in enumerate(zip(found, expected, strict=True)) if pair[0] != pair[1])
        name, found, expected = f"{name}[{row}]", found[row], expected[row]
    raise MismatchError(f"{where}: {name}: rtl {found}, {of} {expected}")
