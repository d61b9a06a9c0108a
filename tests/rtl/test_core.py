"""The core against its model: everything that leaves it, in every iteration of batches that follow one another."""

import functools
import importlib
import itertools
import warnings

import numpy as np
import pytest
from amaranth.hdl import Module, ResetInserter, Signal, UnusedElaboratable

from cmfpga import rtl
from cmfpga.config import ASCENTS, Config
from cmfpga.protocol.flags import Flag
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.rtl import core
from cmfpga.rtl.core import Core
from cmfpga.rtl.iteration_control import IterationControl
from support import core_batches
from support.bench import Repeated
from support.core import Batch, check_core, drive_core
from support.core_batches import CONFIGS, FLOWS, PLANS, centered, moving_points, random_batch, run, settings, spread


@pytest.mark.parametrize("flow", ["free", "gaps", "both"])  # stalls alone: below
@pytest.mark.parametrize("name", CONFIGS)
def test_matches_model(name, flow, rng):
    """Batches back to back without a reset, with different sizes, ROIs and settings: state that leaks is found."""
    config = CONFIGS[name]
    batches = [random_batch(config, rng, bad_times=0.15 * (k % 2)) for k in range(10)]
    run(config, batches, rng, **FLOWS[flow], eager=flow in ("free", "both"))


@pytest.mark.parametrize("name", ["two", "two, one pass", "fast"])
def test_two_buffers_give_the_same_whenever_a_batch_comes(name, rng):
    """Results are the model's, which knows neither gaps nor stalls, nor whether the next batch is offered early."""
    batches = [random_batch(CONFIGS[name], rng) for _ in range(8)]
    for flow, eager in itertools.product(FLOWS.values(), (True, False)):
        run(CONFIGS[name], batches, rng, **flow, eager=eager)


@pytest.mark.parametrize("name", ["two", "fast"])
def test_with_two_buffers_the_next_batch_is_taken_in_during_the_iterations(name, rng):
    """All of it, and once only: the batch after that waits until the first has handed its result over."""
    config = CONFIGS[name]
    batches = [spread(config, rng, 30, iterations=4) for _ in range(4)]
    _, outcomes = run(config, batches, rng)
    for before, outcome in itertools.pairwise(outcomes):
        assert outcome.opened < before.done
    each, _, judged = LATENCIES[name]
    busy = len(config.schedules.warm) * (4 * 30 + each) + judged if config.confidence else 4 * (30 + each)
    assert all(busy < after.done - before.done < busy + 90 for before, after in itertools.pairwise(outcomes))
    for first, third in zip(outcomes, outcomes[2:], strict=False):
        assert third.opened > first.done


def test_random_batches_meet_everything():
    met = Flag(0)
    for name, config in CONFIGS.items():
        model = IntegerCore(config)
        for number in range(30):
            batch = random_batch(config, np.random.default_rng([number, len(name)]))
            columns = zip(*batch.events, strict=True)
            met |= model.run(*map(np.array, columns), batch.settings, cut=batch.end == "cut").flags
    assert set(met) == set(Flag) - {Flag.SCHEDULE}


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("name", ["small", "narrow", "one pass"])
def test_words_hold_every_event_on_one_pixel(name, late, rng):
    """The largest I and Dx that there are: a full buffer at one end of the batch, at the other an event elsewhere."""
    config = CONFIGS[name]
    one = centered(config, [8 * late], iterations=1, eta=0, start_last=False, v_start=(0, 0))
    full, elsewhere = one.events * config.buffer_events, [(8 - 8 * late, 0, 0)]
    batch = Batch(events=elsewhere + full if late else full + elsewhere, settings=one.settings)
    _, (outcome, _) = run(config, [batch, spread(config, rng)], rng)
    largest = config.widths.image_max * config.widths.derivative_image_max
    assert outcome.trace[0]["sums"]["sx"] == (largest if late else -largest)


#: Cycles of an iteration beside its events, of a batch beside its events and iterations, and of a verdict.
LATENCIES = {
    "small": (70, 70, 0), "power": (51, 70, 0), "narrow": (70, 70, 0), "tiny": (20, 70, 0), "short": (70, 38, 0),
    "still": (70, 70, 0), "two": (70, 62, 0), "two tiny": (20, 62, 0), "one pass": (23, 70, 0),
    "two, one pass": (23, 62, 0), "fast": (51, 60, 3), "four evaluators": (54, 60, 4), "one evaluator": (53, 68, 1),
    "three bits of v": (51, 68, 7), "rounds, no confidence": (55, 60, 0), "similarity": (21, 60, 15),
    "rotation": (21, 76, 15), "binned": (51, 60, 3), "binned rotation": (21, 76, 15), "thin": (70, 70, 0),
    "two, thin": (70, 62, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", CONFIGS)
def test_cycle_formula_is_exact(name, rng):
    """:meth:`Core.cycles` in free flow, for one event and for many, and its latencies."""
    config = CONFIGS[name]
    center = config.sensor_width // 2, config.sensor_height // 2
    roi = (center[0] >> config.binning) - config.roi_width // 2, (center[1] >> config.binning) - config.roi_height // 2
    # The first and the last event at the ROI's centre, so that no batch is degenerate.
    batches = [
        Batch(
            events=[(5, *center), *((6, x, y) for _, x, y in moving_points(config, rng, count)), (15, *center)],
            settings=settings(config, roi=roi, iterations=iterations, eta=0),
        )
        for iterations in (1, 4)
        for count in (1, 2, 30)
    ]
    core = Core(config)
    results, outcomes = run(config, batches, rng, eager=config.buffers == 1)
    for result, outcome in zip(results, outcomes, strict=True):
        assert Flag.DEGENERATE not in result.flags
        counts = {name: getattr(result, name) for name in ("events", "roi_events", "iterations")}
        wanted = core.cycles(**counts)
        assert outcome.result["cycles"] == outcome.done - outcome.opened == wanted
    latencies = core.iteration_latency + core.sweep_cycles, core.batch_latency
    assert (*latencies, core.judge_latency if config.confidence else 0) == LATENCIES[name]
    assert core.shortest_batch == (10 if config.buffers == 2 else 0)


@pytest.mark.parametrize("max_level", [0, 2])
@pytest.mark.parametrize("roi_height", [16, 15])
@pytest.mark.parametrize("ascent", ASCENTS)
@pytest.mark.parametrize("dither_frac", [0, 4])
def test_the_configuration_knows_the_latency_of_one_pass(dither_frac, max_level, roi_height, ascent):
    """The rule on ``tag_bits`` relies on it."""
    changes = {"gradient": "one_pass", "roi_width": 16, "roi_height": roi_height}
    changes |= {name: values[0] for name, values in ASCENTS[ascent].needs}
    changes |= {"border": "whole", "schedule_entries": 64} if ascent == "sign" else {}
    config = Config(**changes, dither_frac=dither_frac, max_level=max_level, ascent=ascent)
    assert Core(config).iteration_latency == config.one_pass.latency


def test_a_replay_cannot_start_before_the_last_event_is_counted():
    with pytest.raises(ValueError, match="2 cycles before the last event is counted"):
        IterationControl(CONFIGS["small"], replay_delay=-2, move=3, settle=6)


DEGENERATE = {
    "n = 0": (range(5), {"roi": (0, 0)}), "n < minimum": (range(5), {"min_roi_events": 6}), "t1 = tN": ([7] * 5, {}),
    "one event": ([7], {}), "T = 0": (range(5), {"iterations": 0}),
}  # fmt: skip


@pytest.mark.parametrize("what", DEGENERATE)
def test_degenerate_batches_change_nothing(what, rng):
    """v and the ROI stay, whatever start velocity was asked for; a batch after it, long or short, is right."""
    config, (times, changes) = CONFIGS["small"], DEGENERATE[what]
    good = spread(config, rng, start_last=False, v_start=(1 << config.v_frac, 0))
    bad = centered(config, times, **{"roi": None, "start_last": False, "v_start": (123, 456)} | changes)
    # The batches after it are so short that a division that the degenerate batch began would still be running.
    batches = [good, bad, centered(config, [3, 9, 30]), bad, bad, spread(config, rng), bad, spread(config, rng, 2)]
    results, outcomes = run(config, batches, rng)
    assert [Flag.DEGENERATE in result.flags for result in results] == [batch is bad for batch in batches]
    assert outcomes[1].result["v"] == outcomes[0].result["v"]
    if bad.settings.roi is None:
        assert outcomes[1].result["roi_next"] == outcomes[0].result["roi_next"]


@pytest.mark.parametrize("flow", ["free", "both"])
def test_cold_and_warm_schedules(flow, rng):
    """Warm only from a last v, of an object that is followed: not after a new ROI, a degenerate batch, or a given v."""
    config = CONFIGS["fast"]
    still = {"roi": None, "cold_after_doubtful": 0}
    cold, warm = (dict(zip(("cold", "warm", "roi_gain"), (*pair, 0), strict=True)) for pair in (PLANS[3:5], PLANS[1:3]))
    chosen = [
        (cold, 4), (cold | still, 2), (warm | still, 3), (cold | still | {"start_last": False}, 4), (warm | still, 3),
        (cold | still | {"min_roi_events": 30}, 0), (warm | still, 2), (cold | still, 2), (warm, 2), (warm | still, 3),
    ]  # fmt: skip
    batches = [spread(config, rng, **changes) for changes, _ in chosen]
    results, _ = run(config, batches, rng, **FLOWS[flow])
    assert [result.iterations for result in results] == [wanted for _, wanted in chosen]


@pytest.mark.parametrize("flow", ["free", "both"])
def test_after_a_doubtful_batch_the_next_one_starts_cold(flow, rng):
    """Two buffers: it is already stored then. Not if the setting is off, nor after what is not judged or trusted."""
    config = CONFIGS["fast"]
    doubtful, trusted = {"confidence_limit": 1023}, {"confidence_limit": 1}
    plans, follow = {"cold": PLANS[0], "warm": PLANS[4]}, {"roi": None, "roi_gain": 0}
    chosen = [
        (doubtful, 1), (doubtful | follow, 1), (doubtful | follow | {"cold_after_doubtful": 0}, 2),
        (trusted | follow, 1), (doubtful | follow, 2), ({"judge": 0} | follow, 1), (doubtful | follow, 2),
    ]  # fmt: skip
    batches = [centered(config, range(100, 300, 10), **plans | changes) for changes, _ in chosen]
    results, _ = run(config, batches, rng, **FLOWS[flow])
    assert [result.iterations for result in results] == [wanted for _, wanted in chosen]
    assert [result.restarted for result in results] == [0, 1, 0, 1, 0, 1, 0]
    assert [Flag.DOUBTFUL in result.flags for result in results] == [1, 1, 1, 0, 1, 0, 1]


def test_minimum_is_met_exactly(rng):
    config = CONFIGS["small"]
    results, _ = run(config, [centered(config, range(5), min_roi_events=least) for least in (5, 6, 4, 0, 1)], rng)
    assert [Flag.DEGENERATE in result.flags for result in results] == [False, True, False, False, False]


def test_length_by_count_and_cut(rng):
    """``batch_events`` ends a batch without ``last``; at max_batch_events it is cut, which only then is flagged."""
    config = CONFIGS["small"]
    points = moving_points(config, rng, config.max_batch_events, span=2000)
    chosen = settings(config, iterations=1)
    # As long as can be, but ended as the source wanted: no flag.
    ends = (20, "count"), (None, "cut"), (1, "count"), (None, "last"), (None, "count"), (30, "last")
    batches = [Batch(events=points[:count], settings=chosen, end=end) for count, end in ends]
    results, _ = run(config, batches, rng)
    assert [Flag.CUT in result.flags for result in results] == [False, True, False, False, False, False]


def test_overflow_is_counted(rng):
    """A buffer that is exactly full is no overflow; one event more is."""
    config = CONFIGS["small"]
    full = config.buffer_events
    counts = full, full + 1, full - 1, config.max_batch_events
    results, _ = run(config, [spread(config, rng, count, iterations=1) for count in counts], rng)
    assert [result.overflow for result in results] == [0, 1, 0, config.max_batch_events - full]


@pytest.mark.parametrize("buffers", [1, 2])
def test_strides_and_thinning(buffers, rng):
    """As many events as a stride needs, one less, one more; and twice to four times the buffer."""
    config = CONFIGS["similarity"].replace(buffer_events=520, max_batch_events=2100, buffers=buffers)
    (plan,) = core_batches.plans("similarity", "2:1/4 0:-1/2 1:0/4*2")
    same = {"cold": plan, "warm": plan[:2], "roi_gain": 0, "judge": 0}
    batches = [
        spread(config, rng, count, **same, **({"roi": None} if number % 2 else {}))
        for number, count in enumerate((511, 513, 256, 2079, 255, 1041, 700))
    ]
    results, _ = run(config, batches, rng, eager=buffers == 1)
    assert [result.roi_events for result in results] == [511, 513, 256, 520, 255, 261, 350]
    assert [result.thinning_used for result in results] == [1, 1, 1, 4, 1, 4, 2]


@pytest.mark.parametrize("name", ["small", "two"])
@pytest.mark.parametrize("flow", ["free", "both"])
def test_a_batch_ends_with_its_roi_events(name, flow, rng):
    """With exactly as many as wanted, and no event more; whether a marked end or the count comes before it."""
    config = CONFIGS[name]
    corner, batches, counts = (12, 9), [], []
    for wanted, thinning in ((1, 1), (7, 1), (2, 3), (config.buffer_events, 1), (12, 1), (1, 1), (5, 2)):
        points = moving_points(config, rng, 85, span=5000)
        inside = [0 <= x - 12 < config.roi_width and 0 <= y - 9 < config.roi_height for _, x, y in points]
        end = np.flatnonzero(inside)[::thinning][wanted - 1] + 1
        chosen = settings(config, iterations=2, roi=corner, thinning=thinning)
        batches.append(Batch(events=points[:end], settings=chosen, end="roi", batch_roi_events=wanted))
        counts.append(wanted)
    events, chosen = batches[1].events, batches[1].settings
    for how in ("last", "count"):
        # Ended otherwise one event before the limit would be met, and exactly with it.
        batches += [Batch(events=e, settings=chosen, end=how, batch_roi_events=7) for e in (events[:-1], events)]
        counts += [6, 7]
    results, _ = run(config, batches, rng, **FLOWS[flow], free=False)
    assert [result.roi_events for result in results] == counts


def test_thinning_follows_its_target(rng):
    """The factor of a batch is the one that its predecessor would have needed; without a target, the one given."""
    config = CONFIGS["small"].replace(buffer_events=20)
    batches = [
        spread(config, rng, count, thin_target=target, thinning=3, iterations=1)
        for count, target in ((40, 20), (40, 20), (80, 20), (10, 20), (30, 0), (30, 20), (30, 20))
    ]
    results, _ = run(config, batches, rng)
    # 40 in 3; 2 for 40 events; still 2 for the 80, which overflow; 4 for those; by hand twice; 2 for 30.
    assert [result.roi_events for result in results] == [14, 20, 20, 3, 10, 10, 15]
    assert [result.overflow for result in results] == [0, 0, 20, 0, 0, 0, 0]


def test_result_waits(rng):
    """A result that waits for long holds (``drive_core`` compares each cycle), and the next batch is not taken up."""
    config = CONFIGS["small"]
    run(config, [spread(config, rng, 10, iterations=1) for _ in range(3)], rng, stall=0.97)


def test_settings_are_taken_with_the_first_event(rng):
    config = CONFIGS["small"]
    eta = config.formats.eta.raw(4.0)
    changes = [
        {"iterations": 4, "eta": eta},
        {"iterations": 1, "eta": 0, "start_last": False, "v_start": (-4096, 8192)},
        {"iterations": 2, "eta": eta, "roi": (3, 4), "roi_gain": 63},
        {"iterations": 3, "roi": None, "roi_gain": 0, "min_roi_events": 9},
        {"iterations": 3, "roi": (24, 18), "start_last": False, "v_start": (99, -99)},
    ]
    batches = [spread(config, rng, 20, **change) for change in changes]
    for eager in (True, False):
        results, _ = run(config, batches, rng, eager=eager)
        assert len({result.v for result in results}) > 3


@functools.cache
def resettable(config):
    core, reset, top = Core(config), Signal(), Module()
    top.submodules.core = ResetInserter(reset)(core)
    return core, reset, Repeated(top)


@pytest.mark.parametrize("name", ["small", "two", "fast"])
@pytest.mark.parametrize("moment", ["ingest", "division", "votes", "sweep", "evaluation", "result"])
def test_reset_in_the_middle(name, moment, rng):
    """A reset forgets v, the ROI and the batch, and the images that it leaves in the RAMs are swept away."""
    config = CONFIGS[name]
    core, reset, top = resettable(config)
    moved = [spread(config, rng, 20, iterations=2, eta=config.formats.eta.raw(8.0)) for _ in range(2)]
    come, came = at_moment(core, moment), []

    def before_tick(ctx, cycle):
        came.append(come(ctx))
        return came[-1]

    first, _ = drive_core(core, moved, rng=rng, eager=config.buffers == 1, before_tick=before_tick)
    again = [
        # Where v and the ROI must be those of a reset; sees the whole image.
        Batch(events=[(t, x - 12, y - 9) for t, x, y in moved[0].events], settings=settings(config, iterations=3)),
        spread(config, rng, 30),
    ]
    second, outcomes = drive_core(core, again, rng=rng, eager=config.buffers == 1)

    async def bench(ctx):
        await first(ctx)
        assert came[-1], "the moment never came"
        ctx.set(core.o.ready, 0)
        ctx.set(reset, 1)
        await ctx.tick()
        ctx.set(reset, 0)
        ctx.set(core.i.valid, 0)
        await second(ctx)

    top.simulate(bench)
    check_core(config, again, outcomes, free=True)


def at_moment(core, moment):
    """For ``drive_core``, every cycle: has the second batch, of 20 events like the first, come to this moment?"""
    votes, idle, each = core.image.votes, core.iteration_latency, core.config.ascent_rule.evaluations
    # Not the sweep after the reset; in one pass, the cycles in which no event is added to the sums.
    sweeps = core.image.accumulator.sweep.valid if core.sweep_cycles else ~votes.valid
    counted = {
        "events": core.i.valid & core.i.ready, "votes": votes.valid, "traced": core.trace.valid,
        "swept": sweeps & core.iteration_control.iterating,
    }  # fmt: skip
    seen = dict.fromkeys((*counted, "cycles since the last event"), 0)

    def come(ctx):
        for name, signal in counted.items():
            seen[name] += ctx.get(signal)
        seen["cycles since the last event"] += seen["events"] == 40
        # Two iterations a batch.
        return {
            "ingest": seen["events"] == 30,
            "division": seen["cycles since the last event"] == 20,
            "votes": seen["votes"] == (3 * 20 + 15) * each,
            "sweep": seen["swept"] == 7 * (core.sweep_cycles or idle) // 2,
            "evaluation": seen["traced"] == 4 * each,
            "result": seen["traced"] == 4 * each and ctx.get(core.o.valid),
        }[moment]

    return come


def test_power_up_state(rng):
    """Before any batch: no result, and the first batch starts from v = 0 and the ROI at the sensor's origin."""
    config = CONFIGS["small"]
    points = moving_points(config, rng, 40, span=900, around=(8, 6))
    results, outcomes = run(config, [Batch(events=points, settings=settings(config))], rng, eager=False, gap=0.9)
    assert outcomes[0].trace[0]["v"] == {"x": 0, "y": 0} and results[0].roi == (0, 0)


def test_only_our_own_blocks_may_be_asked_for_numbers_without_a_warning():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        importlib.reload(rtl)
        for path in (core.__file__, __file__):
            warnings.warn_explicit("created but never used", UnusedElaboratable, path, 1)
    assert [one.filename for one in caught] == [__file__]
