"""The core under test: batches that are offered to it, results that are taken, and the model that it must equal."""

import functools
from dataclasses import dataclass, field

import numpy as np

from cmfpga.engines.rtl import nested
from cmfpga.protocol.confidence import Curvature
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import COUNTS, not_judged
from cmfpga.protocol.settings import BatchSettings, settings_values, table_entry
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.rtl import payloads
from cmfpga.rtl.core import Core
from support.values import Port, random_values
from support.votes import bank_pixels


@dataclass(frozen=True, kw_only=True)
class Batch:
    """A batch, and how the core learns where it ends."""

    events: list  # (t, x, y)
    settings: BatchSettings
    #: "last" marks the last event, "count" sets ``batch_events``; "cut" does neither, nor does "roi".
    end: str = "last"
    #: The batch ends with as many stored events, where "roi" is its end.
    batch_roi_events: int = 0

    def raw_settings(self, config, table):
        """The core's ``settings``; ``table`` holds the schedules."""
        values = settings_values(config, self.settings) | {"batch_roi_events": self.batch_roi_events}
        if config.ascent_rule.has_table:
            values |= {f"{name}_first": place(table, getattr(self.settings, name)) for name in ("cold", "warm")}
        if self.end == "count":
            values["batch_events"] = len(self.events)
        return nested(payloads.settings(config), values)


def place(table, plan):
    """Where a schedule begins in a table of schedules; None if it is not there."""
    return next((k for k in range(len(table) + 1) if table[k : k + len(plan)] == plan), None)


def schedules(batches):
    """A table of all batches' schedules: tuple of :class:`ScheduleEntry`."""
    table = ()
    for plan in (plan for batch in batches for plan in (batch.settings.cold, batch.settings.warm)):
        table += plan if place(table, plan) is None else ()
    return table


@dataclass
class Outcome:
    result: dict = None
    trace: list = field(default_factory=list)
    pixels: list = field(default_factory=list)
    opened: int = None  # cycle before the first event was accepted: the one in which it was offered to an idle core
    done: int = None  # first cycle of the result


def drive_core(core, batches, *, rng, gap=0.0, stall=0.0, eager=True, before_tick=None):
    """Offer batches, take results: a test bench, and the list of :class:`Outcome` that it fills.

    ``gap`` and ``stall`` are the probabilities of an idle cycle at the input and of an unready one at the output.
    An ``eager`` source offers a batch's first event while the core is still busy with the batch before; another one
    waits until that result is taken. The settings are right only while a first event is offered; at all other
    times they are random. All schedules are written before the first batch. ``before_tick(ctx, cycle)`` may
    interfere; the bench ends early where it returns True.

    Streams keep their rules, and the core must: what is offered stays until it is taken.
    """
    config = core.config
    event, i_valid, i_ready = Port(core.i.payload), Port(core.i.valid), Port(core.i.ready)
    result, o_valid, o_ready = Port(core.o.payload), Port(core.o.valid), Port(core.o.ready)
    settings = Port(core.settings)
    trace, trace_valid = Port(core.trace.payload), Port(core.trace.valid)
    shown = hasattr(core, "pixels")
    if shown:
        pixels, pixels_valid = Port(core.pixels.payload), Port(core.pixels.valid)
    if hasattr(core, "schedule_write"):
        write, write_valid = Port(core.schedule_write.payload), Port(core.schedule_write.valid)
    noise = random_values(core.i.payload.shape(), rng)
    settings_noise = random_values(core.settings.shape(), rng)
    outcomes = [Outcome() for _ in batches]
    # Twice what all batches take one after the other, and as much again for idle cycles.
    limit = 500 + 2 * config.geometry.bank_words
    table = schedules(batches)
    for batch in batches:
        chosen = batch.settings
        iterations = max(chosen.iterations, len(chosen.cold), len(chosen.warm)) + 6 * config.confidence
        events = len(batch.events) << config.geometry.turn_bits
        busy = iterations * (events + config.geometry.bank_words + core.iteration_latency)
        limit += 2 * (len(batch.events) + busy + core.batch_latency) + 20
    limit = int(limit / (1 - min(0.9, max(gap, stall))))

    async def bench(ctx):
        queue = [
            (number, k, {"t": t, "x": x, "y": y, "last": int(batch.end == "last" and k == len(batch.events) - 1)})
            for number, batch in enumerate(batches)
            for k, (t, x, y) in enumerate(batch.events)
        ]
        taken_in = [batch.raw_settings(config, table) for batch in batches]
        position, offering, held, finished = 0, False, None, 0
        for address, values in enumerate(table):
            entry = dict(zip(payloads.schedule_entry(config).members, table_entry(config, values), strict=True))
            write.set(ctx, {"address": address, "entry": entry})
            write_valid.set(ctx, 1)
            await ctx.tick()
            write_valid.set(ctx, 0)
        for cycle in range(limit):
            # Input.
            number, k, payload = queue[position] if position < len(queue) else (len(batches), 0, None)
            if not offering:
                wanted = payload is not None and (eager or k > 0 or number == finished)
                offering = wanted and rng.random() >= gap
            i_valid.set(ctx, int(offering))
            event.set(ctx, payload if offering else next(noise))
            settings.set(ctx, taken_in[number] if offering and k == 0 else next(settings_noise))
            # Output.
            ready = rng.random() >= stall
            o_ready.set(ctx, int(ready))
            current = outcomes[finished]
            if trace_valid.get(ctx):
                current.trace.append(trace.get(ctx))
            if shown and pixels_valid.get(ctx):
                current.pixels.append(pixels.get(ctx))
            if o_valid.get(ctx):
                bits = result.get(ctx)
                assert held is None or bits == held, f"cycle {cycle}: the result changed while it waited"
                current.done = cycle if current.done is None else current.done
                held = None if ready else bits
                if ready:
                    current.result = bits
                    finished += 1
            else:
                assert held is None, f"cycle {cycle}: the result went away before it was taken"
            if offering and i_ready.get(ctx):
                if k == 0:
                    outcomes[number].opened = cycle - 1
                position, offering = position + 1, False
            if before_tick and before_tick(ctx, cycle):
                return
            await ctx.tick()
            if finished == len(batches):
                # Nothing may follow the last result.
                i_valid.set(ctx, 0)
                for _ in range(30):
                    assert not (o_valid.get(ctx) or trace_valid.get(ctx) or i_ready.get(ctx))
                    await ctx.tick()
                return
        raise AssertionError(
            f"no result of batch {finished} of {len(batches)} after {limit} cycles: {position} of {len(queue)} events "
            f"accepted, {len(current.trace)} iterations traced, {len(current.pixels)} words of images"
        )

    return bench, outcomes


def check_core(config, batches, outcomes, *, model=None, free=False):
    """Compare with the model, everything that leaves the core; returns the model's results.

    ``free``: the source had no gap, and no batch was offered while another was under way, unless the core has one
    buffer: the closed formula holds.
    """
    model, names = model or IntegerCore(config), config.motion_model.names
    results = []
    for number, (batch, outcome) in enumerate(zip(batches, outcomes, strict=True)):
        t, x, y = (np.array(column, np.int64) for column in zip(*batch.events, strict=True))
        wanted = model.run(t, x, y, batch.settings, cut=batch.end == "cut", keep=True)
        results.append(wanted)
        degenerate = Flag.DEGENERATE in wanted.flags
        result = dict(outcome.result)
        sums, cycles = result.pop("sums"), result.pop("cycles")
        raw = {
            "v": dict(zip(names, model.v, strict=True)),
            "t_first": int(t[0]),
            "roi": dict(zip("xy", wanted.roi, strict=True)),
            "roi_next": dict(zip("xy", wanted.roi_next, strict=True)),
            "flags": int(wanted.flags),
        }
        assert {*raw, "span", "events", "iterations", *COUNTS, *not_judged(config)} <= {*result}
        assert result == {name: raw[name] if name in raw else _named(getattr(wanted, name)) for name in result}, (
            f"batch {number}"
        )
        assert wanted.events == sum(result[name] for name in COUNTS)
        each = config.ascent_rule.evaluations  # of an iteration, whose v is that of a round's centre
        velocities = [dict(zip(names, v, strict=True)) for v in wanted.trace.v.tolist()]
        steps = [{"v": velocities[k // each], "sums": i.sums.named(config)} for k, i in enumerate(model.iterations)]
        assert outcome.trace == steps, f"batch {number}"
        if config.gradient == "sweep":
            images = [words for iteration in model.iterations for words in bank_pixels(config, iteration.images)]
            assert outcome.pixels == images, f"batch {number}: images"
        if not degenerate:
            last = [step["sums"] for step in steps[-each:]]
            assert sums == {name: sum(one[name] for one in last) // each for name in sums}
        elif config.confidence:
            assert not any(sums.values())
        assert cycles == outcome.done - outcome.opened
        if free and not degenerate:
            counts = {"events": wanted.events, "roi_events": wanted.roi_events, "iterations": model.plan}
            assert cycles == _core(config).cycles(**counts, judge=bool(wanted.confidence_limit)), f"batch {number}"
    return results


def _named(value):
    """The curvature by the names of its parts."""
    if not isinstance(value, tuple):
        return value
    return dict(zip(Curvature._fields if len(value) == 3 else ("least",), value, strict=True))


#: For the formula of its cycles.
_core = functools.cache(Core)
