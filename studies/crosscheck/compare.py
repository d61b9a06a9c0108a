"""One configuration: random batches through the hardware's ports and the integer model, everything ``==``."""

import contextlib
import dataclasses

import numpy as np

from cmfpga.engines import make_engine
from cmfpga.events import Events
from cmfpga.protocol.results import fields_of
from cmfpga.protocol.settings import BatchSettings, clamp_roi, settings_values
from cmfpga.protocol.trace import to_batch_result
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.integer.sliding import Sliding
from cmfpga.reference.regions import RegionSequence
from cmfpga.verilog.compiler import cannot_compile
from cmfpga.verilog.simulation import VerilatedCore

from .batches import (
    PATTERNS,
    random_events,
    random_lens,
    random_mask,
    random_regions,
    random_schedules,
    random_settings,
    some_changed,
)

BATCHES = 3 * len(PATTERNS)
#: What of a hop's settings is the configuration's.
LENGTHS = ("cold", "warm", "follow", "after", "window_events", "window_us", "hop_events", "hop_us")
#: Clock cycles after which no further batch begins: seconds of Verilator, and of Amaranth's simulator.
CYCLES, SLOW_CYCLES = 1_500_000, 15_000
ITERATIONS = 2500  # the same in iterations of regions, which cost the model more than the hardware
RUNS = 6  # runs of batches back to back, before each of which tables are written, or the hardware is reset in mid-batch


class MismatchError(Exception):
    """The hardware and the integer model differ; says in what."""


def check(config, seed, shell=False):
    """Compare random batches, one by one and then back to back: (batches, iterations) that were equal.

    With ``shell`` only by the AXI top. Raises :exc:`MismatchError`.
    """
    rng = np.random.default_rng([seed, 2])
    if shell:
        from .shell import through_the_shell

        return through_the_shell(config, rng)
    if config.regions:
        return _tables_of_regions(config, rng)
    if config.slides:
        return _hops(config, rng)
    counts = _one_by_one(config, np.random.default_rng([seed, 1]))
    if not cannot_compile():
        counts += _back_to_back(config, rng)
    return counts


def _one_by_one(config, rng):
    """By the engines, as ``track`` runs them; the first batch with the configuration's own settings."""
    rtl, model = make_engine("rtl", config), make_engine("model", config)
    core = rtl.core
    limit = SLOW_CYCLES if cannot_compile() else CYCLES
    counts, cycles = np.zeros(2, int), 0
    for number in range(BATCHES):
        settings, roi = random_settings(config, rng, model.places[0])
        if number == 0:
            settings = BatchSettings.from_config(config, roi)
        name, events = random_events(config, rng, roi)
        if rng.random() < 0.05:
            name, events = "nothing", Events.empty()
        expected, found = model.run(events, settings)[0], rtl.run(events, settings)[0]
        where = f"batch {number} ({name})"
        same(where, found, expected)
        if found.iterations and found.events >= core.shortest_batch:
            done = {"events": found.events, "roi_events": found.roi_events, "iterations": model.core.plan}
            wanted = core.cycles(**done, judge=settings.judge)
            equal(where, "cycles", found.cycles, wanted, "formula")
        counts += 1, found.iterations
        cycles += found.cycles or 0
        if cycles > limit:
            break
    rtl.close()
    return counts


def _back_to_back(config, rng):
    core, model = VerilatedCore(config, seed=int(rng.integers(1, 1 << 30))), None
    counts = np.zeros(2, int)
    for number in range(RUNS):
        if number and rng.random() < 0.5:
            settings, roi = random_settings(config, rng, model.places[0])
            _reset_in_mid_batch(core, rng, random_events(config, rng, roi)[1], settings)
            model = None
        model = model or make_engine("model", config)
        counts += compare_stream(core, rng, BATCHES // RUNS + 1, **_pauses(rng), model=model)
    core.close()
    return counts


def _hops(config, rng):
    """Runs of events, in pieces, after each of which the hardware is reset, somewhere."""
    counts, cycles, core = np.zeros(2, int), 0, VerilatedCore(config, seed=int(rng.integers(1, 1 << 30)))
    for number in range(RUNS):
        settings, roi = random_settings(config, rng, (0, 0))
        usual = BatchSettings.from_config(config, roi)
        own = {name: getattr(usual, name) for name in LENGTHS}
        settings = dataclasses.replace(settings, roi=roi, **own) if number else usual
        parts = [random_events(config, rng, roi)[1] for _ in range(rng.integers(1, 5))]
        model, pauses = Sliding(config, settings), _pauses(rng)
        core.reset(int(rng.integers(1, 4)))
        for part in parts:
            delays = _delays(rng, pauses, len(part), 50, 300)
            found = core.slide(part.t, part.x, part.y, settings, **delays)
            wanted = list(model.run(part.t, part.x, part.y))
            equal(f"run {number}", "hops", len(found), len(wanted), "model")
            for k, (one, other) in enumerate(zip(found, wanted, strict=True)):
                same(f"run {number}, hop {k}", one, other)
            counts += len(wanted), sum(one.iterations for one in wanted)
            cycles += core.finished[-1] if core.finished else 0
        if cycles > CYCLES:
            break
    core.close()
    return counts


def _pauses(rng):
    """How often an event comes late, and how often a result has to wait; each by itself, too."""
    return {"gaps": float(rng.choice([0, 0.1, 0.5])), "stalls": float(rng.choice([0, 0.3, 1]))}


def _reset_in_mid_batch(core, rng, events, settings):
    """Somewhere between a batch's first event and its last result; or behind it, where it is over sooner."""
    with contextlib.suppress(TimeoutError):
        most = int(np.exp(rng.uniform(0, np.log(20 * len(events) + 2000))))
        core.results([(events.t, events.x, events.y)], settings, max_cycles=most)
    core.reset(int(rng.integers(1, 4)))


def _tables_of_regions(config, rng):
    """Runs of batches; before each the table is new, changed or as it was, or the hardware is reset in mid-batch."""
    hardware, model = VerilatedCore(config, seed=int(rng.integers(1, 1 << 30))), None
    counts, cycles, number = np.zeros(2, int), 0, 0
    while number < RUNS or (cycles < CYCLES and counts[1] < ITERATIONS and number < BATCHES):
        settings, regions, anew = random_settings(config, rng, (0, 0))[0], hardware.table.regions, ()
        if model is None or rng.random() < 0.2:
            if regions:
                _reset_in_mid_batch(hardware, rng, events_of(config, rng, regions), settings)
            model = RegionSequence(IntegerCore(config))
            hardware.reset()
            model.write(hardware.table.regions)
        if not regions or rng.random() < 0.3:
            regions = random_regions(config, rng)
        elif rng.random() < 0.5:
            regions = some_changed(config, rng, regions)
            anew = {row for row in range(len(regions)) if rng.random() < 0.2}
        for one in (hardware, model):
            one.write(regions, anew)
        events = [events_of(config, rng, regions) for _ in range(rng.integers(1, 5))]
        batches, pauses = [(one.t, one.x, one.y) for one in events], _pauses(rng)
        delays = _delays(rng, pauses, sum(map(len, events)), len(batches) * len(regions), 1000)
        found = hardware.results(batches, settings, **delays)
        for batch, result in zip(batches, found, strict=True):
            expected = model.run(*batch, settings)
            same(f"run {number}, batch {counts[0]}", result, expected)
            counts += 1, sum(region.iterations for region in expected.regions)
        cycles += hardware.finished[-1]
        number += 1
    hardware.close()
    return counts


def events_of(config, rng, regions):
    """Events of a random pattern, about one of the regions; no longer than a slice."""
    region = regions[rng.integers(len(regions))]
    return random_events(config, rng, clamp_roi(config, (region.x, region.y))[0])[1]


def _delays(rng, shares, events, results, longest):
    """Clock cycles by which events, and results, come late: ``longest`` is that of results."""
    counts = {"gaps": (events, 40), "stalls": (results, longest)}
    return {
        what: rng.integers(0, most, count) * (rng.random(count) < shares[what])
        for what, (count, most) in counts.items()
    }


def compare_stream(core, rng, most, *, gaps, stalls, model=None):
    """Random batches without a pause between them: the next one is offered while the one before is optimised.

    ``most`` batches, or fewer if they take long, of a :class:`VerilatedCore`. ``gaps`` and ``stalls`` say how often an
    event comes late, and a result has to wait. The ``model`` has had the same batches as the core; by default the core
    comes out of a reset. Returns batches and iterations that were equal, int [2]; raises :exc:`MismatchError`.
    """
    config, model = core.config, model or make_engine("model", core.config)
    fixed = random_schedules(config, rng) if config.ascent_rule.has_table else {}
    fixed["hot_mask"] = random_mask(config, rng, model.places[0])
    fixed["camera"] = random_lens(config, rng, image=config.geometry)
    batches, rows, expected, cycles = [], [], [], 0
    while len(batches) < most and cycles < CYCLES:
        settings, roi = random_settings(config, rng, model.places[0])
        settings = dataclasses.replace(settings, **fixed)
        if batches and rng.random() < 0.7:
            settings, roi = dataclasses.replace(settings, roi=None), model.places[0]
        _, events = random_events(config, rng, roi)
        batches.append((events.t, events.x, events.y))
        rows.append(settings_values(config, settings))
        expected.append(model.run(events, settings)[0])
        done = expected[-1]
        cycles += core.core.cycles(events=done.events, roi_events=done.roi_events, iterations=model.core.plan)
    core.write_tables(settings)
    delays = _delays(rng, {"gaps": gaps, "stalls": stalls}, sum(len(t) for t, *_ in batches), len(batches), 3000)
    results, traces, _ = core.play(batches, rows, **delays)
    for number, (ports, trace) in enumerate(zip(results, traces, strict=True)):
        same(f"batch {number} (back to back)", to_batch_result(config, [ports], [trace]), expected[number])
    return np.array([len(batches), sum(result.iterations for result in expected)])


def same(where, found, expected, *, traced=True):
    """Equal in everything but the cycles, which only the hardware has; where it is ``traced``, in every iteration."""
    names = [f"{where}, region {number}" for number in range(len(found.regions))]
    regions = [*zip(names if len(names) > 1 else [where], found.regions, expected.regions, strict=True)]
    for of_region, one, other in regions if traced else ():
        for part in (field.name for field in dataclasses.fields(other.trace)):
            sums = (np.asarray(getattr(result.trace, part)).tolist() for result in (one, other))
            equal(of_region, f"trace.{part}", *sums, "model")
    for kind, of_part, one, other in [("batch", where, found, expected), *(("region", *each) for each in regions)]:
        for name in (field.name for field in fields_of(kind) if field.name != "cycles"):
            equal(of_part, name, getattr(one, name), getattr(other, name), "model")


def equal(where, name, found, expected, of):
    if found == expected:
        return
    if isinstance(found, list) and len(found) == len(expected):
        row = next(k for k, pair in enumerate(zip(found, expected, strict=True)) if pair[0] != pair[1])
        name, found, expected = f"{name}[{row}]", found[row], expected[row]
    raise MismatchError(f"{where}: {name}: rtl {found}, {of} {expected}")
