"""Test benches: what is played into a block, cycle by cycle, and what is recorded of it.

In each cycle the inputs are set, the outputs of this cycle are read, then the clock ticks. So an output is
recorded in the cycle in which it is visible, and a latency is the difference of two cycle numbers.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np
import torch
from amaranth.hdl import Fragment, MemoryData, MemoryInstance, Shape, Value
from amaranth.lib import data
from amaranth.sim import Simulator
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from cmfpga.config import Config, preset
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import COUNTS, SUMS, not_judged
from cmfpga.protocol.settings import BatchSettings, settings_values
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.rtl import payloads

NARROW = {
    "dt_frac": 8, "v_frac": 6, "position_frac": 4, "weight_frac": 4, "derivative_frac": 4,
    "sensor_width": 100, "sensor_height": 50, "roi_width": 32, "roi_height": 16, "buffer_events": 100,
}  # fmt: skip
ODD = {"sensor_width": 40, "sensor_height": 30, "roi_width": 24, "roi_height": 10, "buffer_events": 96}
TINY = {"sensor_width": 9, "sensor_height": 7, "roi_width": 2, "roi_height": 2, "buffer_events": 33}
SENSOR = {"roi_width": 240, "roi_height": 180}

CONFIGS = {
    "default": Config(),
    "narrow": Config(**NARROW),
    "odd": Config(**ODD),
    "tiny": Config(**TINY),
    # Weights and derivatives finer than the products they are rounded from: nothing to round.
    "fine": Config(**ODD, dt_frac=2, v_frac=1, position_frac=4, weight_frac=10, derivative_frac=9),
    "sensor": Config(**SENSOR),
}

#: With coarse levels and dither, sizes that are odd or no power of two among them.
LEVELS = {
    "fast": preset("fast"),
    "fast odd": preset("fast").replace(
        sensor_width=40, sensor_height=30, roi_width=23, roi_height=13, buffer_events=96, max_level=3
    ),
    "fast tiny": preset("fast").replace(
        sensor_width=9, sensor_height=7, roi_width=3, roi_height=2, buffer_events=33, dither_frac=1
    ),
    # As the article's formats, with one coarse level, and a dither finer than a warped position.
    "fast wide": Config(
        **ODD | {"roi_width": 21, "roi_height": 10}, gradient="one_pass", ascent="sign", max_level=1, dither_frac=8,
        position_frac=5, cold="1:0 0:-1", warm="0:-1",
    ),
}  # fmt: skip

#: Probability of idle cycles before an item.
GAPS = {"free": 0.0, "gaps": 0.4}

#: Corner cases: the same few in every run, and however long they take.
corners = hypothesis_settings(derandomize=True, deadline=None, max_examples=12, database=None)


# ---------------------------------------------------------------- values


class Codec:
    """Bits of a shape to plain integers, lists and dictionaries, and back.

    The simulator does the same through layouts, which takes longer than the simulation itself.
    """

    def __init__(self, shape):
        self.keys = None
        if isinstance(shape, data.Layout):
            self.keys = [(key, field.offset, Codec(field.shape)) for key, field in shape]
            self.is_array = isinstance(shape, data.ArrayLayout)
        shape = Shape.cast(shape)
        self.width, self.signed = shape.width, shape.signed
        self.mask = (1 << self.width) - 1

    def pack(self, value):
        if self.keys is None:
            low, high = shape_range(Shape(self.width, self.signed))
            assert low <= value <= high, f"{value} does not fit {self.width} bits"
            return value & self.mask
        assert len(value) == len(self.keys)
        bits = 0
        for key, offset, codec in self.keys:
            bits |= codec.pack(value[key]) << offset
        return bits

    def unpack(self, bits):
        if self.keys is None:
            bits &= self.mask
            return bits - self.mask - 1 if self.signed and bits >> (self.width - 1) else bits
        if self.is_array:
            return [codec.unpack(bits >> offset) for _, offset, codec in self.keys]
        return {key: codec.unpack(bits >> offset) for key, offset, codec in self.keys}


class Port:
    """A signal, or a view of one, that is set to and read as plain values."""

    def __init__(self, signal):
        self.codec = Codec(signal.shape())
        self.bits = Value.cast(signal)
        if self.bits.shape().signed:
            self.bits = self.bits.as_unsigned()

    def set(self, ctx, value):
        ctx.set(self.bits, self.codec.pack(value))

    def get(self, ctx):
        return self.codec.unpack(ctx.get(self.bits))


def random_value(shape, rng):
    """Anything of this shape: what stands on wires when it must not matter."""
    if isinstance(shape, data.StructLayout):
        return {name: random_value(member, rng) for name, member in shape.members.items()}
    if isinstance(shape, data.ArrayLayout):
        return [random_value(shape.elem_shape, rng) for _ in range(shape.length)]
    low, high = shape_range(shape)
    return int(rng.integers(low, high, endpoint=True)) if high < 1 << 63 else int(rng.integers(1 << 62))


def random_values(shape, rng, count=16):
    """Endless :func:`random_value`, of which a few are computed and repeated."""
    return itertools.cycle([random_value(shape, rng) for _ in range(count)])


def shape_range(shape):
    """Smallest and largest integer of a shape."""
    shape = Shape.cast(shape)
    if shape.signed:
        return -(1 << (shape.width - 1)), (1 << (shape.width - 1)) - 1
    return 0, (1 << shape.width) - 1


def integers_at_edges(low, high):
    """Hypothesis strategy: integers, the ends of the range and the neighbourhood of zero above all."""
    edges = sorted({value for value in (low, low + 1, -1, 0, 1, high - 1, high) if low <= value <= high})
    return st.one_of(st.sampled_from(edges), st.integers(low, high))


def edge_integers(rng, low, high, count):
    """Random integers, half of them at the ends of the range or around zero."""
    edges = np.array([value for value in (low, low + 1, -1, 0, 1, high - 1, high) if low <= value <= high])
    anywhere = rng.integers(low, high, count, endpoint=True)
    return np.where(rng.random(count) < 0.5, rng.choice(edges, count), anywhere)


def random_gaps(rng, count, probability):
    """Idle cycles before each of ``count`` items."""
    return np.where(rng.random(count) < probability, rng.integers(1, 5, count), 0).tolist()


def tensor(values):
    """int64 tensor."""
    return torch.tensor(np.asarray(values, np.int64))


# ---------------------------------------------------------------- playing


@dataclass
class Recording:
    """What a block did."""

    #: name of a flow -> (cycle, payload) of each of its items
    flows: dict = field(default_factory=dict)
    #: name of an output -> its value in every cycle
    watch: dict = field(default_factory=dict)

    def values(self, name="o"):
        return [value for _, value in self.flows[name]]

    def cycles(self, name="o"):
        return [cycle for cycle, _ in self.flows[name]]


class AnyContent:
    """A platform whose memories start with random words: what a reset, which clears no RAM, may leave there."""

    def __init__(self, rng):
        self.rng = rng

    def get_memory(self, memory):
        """Hook of :class:`amaranth.lib.memory.Memory`: what is elaborated in its place."""
        width = Shape.cast(memory.shape).width
        bits = self.rng.integers(0, 2, (memory.depth, width)).tolist()
        words = [sum(bit << n for n, bit in enumerate(word)) for word in bits]
        # The memory itself is frozen by now: the same ports on one that is not.
        content = MemoryData(shape=width, depth=memory.depth, init=words)
        instance = MemoryInstance(data=content)
        for port in memory.write_ports:
            instance.write_port(domain=port.domain, addr=port.addr, data=Value.cast(port.data), en=port.en)
        for port in memory.read_ports:
            assert not port.transparent_for
            word = Value.cast(port.data)
            instance.read_port(domain=port.domain, addr=port.addr, data=word, en=port.en, transparent_for=())
        return instance


def simulate(top, *benches, platform=None):
    """Run until every bench has finished."""
    simulator = Simulator(Fragment.get(top, platform))
    simulator.add_clock(1e-6)
    for bench in benches:
        simulator.add_testbench(bench)
    simulator.run()


def member(block, path):
    """The signal that ``path`` ("i.payload") names."""
    for name in path.split("."):
        block = getattr(block, name)
    return block


def play(block, script, *, flows=("o",), watch=(), platform=None):
    """Play a script and record.

    ``script`` has one dictionary ``{path: value}`` per cycle. Inputs of one bit go back to 0 in a cycle that does not
    name them; all others keep their values.
    """
    script = list(script)
    paths = sorted({path for cycle in script for path in cycle})
    inputs = {path: Port(member(block, path)) for path in paths}
    pulses = [path for path, port in inputs.items() if port.codec.keys is None and port.codec.width == 1]
    ports = {name: (Port(member(block, name).valid), Port(member(block, name).payload)) for name in flows}
    watched = {name: Port(member(block, name)) for name in watch}
    recording = Recording({name: [] for name in flows}, {name: [] for name in watch})

    async def bench(ctx):
        driven = dict.fromkeys(pulses, 0)
        for number, cycle in enumerate(script):
            for path in pulses:
                if cycle.get(path, 0) != driven[path]:
                    driven[path] = cycle.get(path, 0)
                    inputs[path].set(ctx, driven[path])
            for path, value in cycle.items():
                if path not in driven:
                    inputs[path].set(ctx, value)
            for name, (valid, payload) in ports.items():
                if valid.get(ctx):
                    recording.flows[name].append((number, payload.get(ctx)))
            for name, port in watched.items():
                recording.watch[name].append(port.get(ctx))
            await ctx.tick()

    simulate(block, bench, platform=platform)
    return recording


def flow_script(block, items, gaps, rng, *, flow="i", drain=None):
    """(script, pushed): offer ``items``, each after its gap; ``pushed`` are their cycles.

    An item is a payload, or (payload, {path: value} of other inputs in its cycle). In the gaps, random values stand
    on the payload, so that a block that ignores ``valid`` is found. The idle end is long enough for every item to
    come out, and for surplus ones to be seen.
    """
    noise = random_values(member(block, flow).payload.shape(), rng)
    script, pushed = [], []

    def idle(cycles):
        script.extend({f"{flow}.payload": next(noise)} for _ in range(cycles))

    for item, gap in zip(items, gaps, strict=True):
        payload, others = item if isinstance(item, tuple) else (item, {})
        idle(gap)
        pushed.append(len(script))
        script.append({f"{flow}.valid": 1, f"{flow}.payload": payload, **others})
    idle(block.latency + 5 if drain is None else drain)
    return script, pushed


def check_flow(block, items, expected, *, gaps, rng, before=()):
    """One item out per item in: the expected payloads, in order, each :attr:`latency` cycles later."""
    script, pushed = flow_script(block, items, gaps, rng)
    recording = play(block, [*before, *script])
    came = recording.values()
    for number, (value, wanted) in enumerate(zip(came, expected, strict=False)):
        assert value == wanted, f"item {number} of {len(expected)} ({items[number]})"
    assert len(came) == len(expected), f"{len(came)} of {len(expected)} items came out"
    pushed = [cycle + len(before) for cycle in pushed]
    assert [out - into for out, into in zip(recording.cycles(), pushed, strict=True)] == [block.latency] * len(pushed)
    return pushed, recording.cycles()


def check_throughput(pushed, popped):
    """One item per cycle, in and out."""
    assert pushed == list(range(pushed[0], pushed[0] + len(pushed)))
    assert popped == list(range(popped[0], popped[0] + len(popped)))


def held(timeline, length):
    """A value for each of ``length`` cycles: the newest that ``timeline``, ``{cycle: value}``, has at that time."""
    value = timeline[0]
    for cycle in range(length):
        value = timeline.get(cycle, value)
        yield value


# ---------------------------------------------------------------- the core


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
        if config.ascent == "sign":
            values |= {f"{name}_first": place(table, getattr(self.settings, name)) for name in ("cold", "warm")}
        if self.end == "count":
            values["batch_events"] = len(self.events)
        return nested(payloads.settings(config), values)


def nested(layout, values, prefix=""):
    """Values by their Verilog ports' names, in the shape of a layout."""
    return {
        name: nested(shape, values, f"{prefix}{name}_") if isinstance(shape, data.Layout) else values[prefix + name]
        for name, shape in layout.members.items()
    }


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
    """What the core gave for a batch."""

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
        busy = iterations * (len(batch.events) + config.geometry.bank_words + core.iteration_latency)
        limit += 2 * (len(batch.events) + busy + core.batch_latency) + 20
    limit = int(limit / (1 - min(0.9, max(gap, stall))))

    async def bench(ctx):
        queue = [
            (number, k, {"t": t, "x": x, "y": y, "last": int(batch.end == "last" and k == len(batch.events) - 1)})
            for number, batch in enumerate(batches)
            for k, (t, x, y) in enumerate(batch.events)
        ]
        position, offering, held, finished = 0, False, None, 0
        for address, (level, log2_step) in enumerate(table):
            entry = {"level": level, "shift": log2_step + config.formats.v.f}
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
            settings.set(
                ctx, batches[number].raw_settings(config, table) if offering and k == 0 else next(settings_noise)
            )
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
    model = model or IntegerCore(config)
    results = []
    for number, (batch, outcome) in enumerate(zip(batches, outcomes, strict=True)):
        t, x, y = (np.array(column, np.int64) for column in zip(*batch.events, strict=True))
        wanted = model.run(t, x, y, batch.settings, cut=batch.end == "cut", keep=True)
        results.append(wanted)
        degenerate = Flag.DEGENERATE in wanted.flags
        result = dict(outcome.result)
        sums, cycles = result.pop("sums"), result.pop("cycles")
        assert result == {
            "v": {"x": model.v[0], "y": model.v[1]},
            "t_first": int(t[0]),
            **{name: getattr(wanted, name) for name in ("span", "events", *COUNTS)},
            "roi": dict(zip("xy", wanted.roi, strict=True)),
            "roi_next": dict(zip("xy", wanted.roi_next, strict=True)),
            "iterations": wanted.iterations,
            "flags": int(wanted.flags),
            **{name: _named(getattr(wanted, name)) for name in not_judged(config)},
        }, f"batch {number}"
        assert wanted.events == sum(result[name] for name in COUNTS)
        steps = [{"v": dict(zip("xy", i.v, strict=True)), "sums": i.sums._asdict()} for i in model.iterations]
        assert outcome.trace == steps, f"batch {number}"
        if config.gradient == "sweep":
            images = [words for iteration in model.iterations for words in bank_pixels(config, iteration.images)]
            assert outcome.pixels == images, f"batch {number}: images"
        if not degenerate:
            assert sums == steps[-1]["sums"]
        elif config.confidence:
            assert not any(sums.values())
        assert cycles == outcome.done - outcome.opened
        if free and not degenerate:
            assert cycles == cycles_of(config, wanted), f"batch {number}"
    return results


def _named(value):
    """Sums by their names."""
    return dict(zip(SUMS, value, strict=True)) if isinstance(value, tuple) else value


def cycles_of(config, result):
    """:meth:`Core.cycles` without a core: N + T·(n + P/4 + L) + constant, its latencies as numbers."""
    events = result.events if config.buffers == 1 else max(result.events, SHORTEST)
    judged = bool(result.confidence_limit)
    iterations = result.iterations + 2 * judged
    more = judge_cycles(config) if judged else 0
    return events + iterations * (result.roi_events + per_iteration(config)) + constant_cycles(config) + more


#: What a batch of fewer events takes with two buffers: the next ROI must be known.
SHORTEST = 3


def per_iteration(config):
    """P/4 + L as a number, L in one pass."""
    division = 0 if config.geometry.pixels & (config.geometry.pixels - 1) == 0 else 3
    ascent = (3 if config.ascent == "constant" else 0) + (1 if config.max_level else 0)
    return division + ascent + (16 + config.geometry.bank_words if config.gradient == "sweep" else 15)


def judge_cycles(config):
    """Cycles of a batch whose v is probed, beside those of two iterations: a bit of the comparison takes one."""
    more = config.weight_frac - config.derivative_frac
    factors = max((8 << max(0, more)) * config.buffer_events, 1023 << max(0, -more))
    return 3 + config.widths.curvature_bits - 17 + factors.bit_length() + config.widths.judge_bits


def constant_cycles(config):
    """Cycles of a batch that depend on neither N, n nor T, as a number."""
    dither = 1 if config.dither_frac else 0
    return config.span_bits + config.reciprocal_bits + dither + (18 if config.buffers == 1 else 16)


# ---------------------------------------------------------------- votes and images


def vote_payloads(config, votes):
    """Model votes as payloads of :func:`cmfpga.rtl.payloads.votes`: sorted by bank, None where there is no vote."""
    names = ("inside", "column", "row", "w", "dx", "dy")
    payloads = []
    for event in zip(*(getattr(votes, name).tolist() for name in names), strict=True):
        banks = [None] * 4
        for inside, column, row, w, dx, dy in zip(*event, strict=True):
            number = 2 * (row & 1) + (column & 1)
            address = ((row >> 1) << config.geometry.bank_column_bits) | (column >> 1)
            if inside:
                banks[number] = {"valid": 1, "address": address, "i": w, "dx": dx, "dy": dy}
        payloads.append(banks)
    return payloads


def sweep_addresses(config):
    """Addresses of a bank in the order of a sweep, as (address, row, column) of the bank."""
    return [
        ((row << config.geometry.bank_column_bits) | column, row, column)
        for row in range(config.geometry.bank_rows)
        for column in range(config.geometry.bank_columns)
    ]


def bank_pixels(config, images):
    """The images as a sweep reads them: for each address the four banks' words."""
    i, dx, dy = (image.tolist() for image in images)
    pixels = []
    for _, bank_row, bank_column in sweep_addresses(config):
        words = []
        for number in range(4):
            row, column = 2 * bank_row + (number >> 1), 2 * bank_column + (number & 1)
            words.append({"i": i[row][column], "dx": dx[row][column], "dy": dy[row][column]})
        pixels.append(words)
    return pixels
