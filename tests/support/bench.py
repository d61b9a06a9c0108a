"""Test benches: what is played into a block, cycle by cycle, and what is recorded of it.

In each cycle the inputs are set, the outputs of this cycle are read, then the clock ticks. So an output is
recorded in the cycle in which it is visible, and a latency is the difference of two cycle numbers.
"""

import functools
import inspect
from dataclasses import dataclass, field

from amaranth.sim import Simulator

from support.values import Port, random_values

#: Probability of idle cycles before an item.
GAPS = {"free": 0.0, "gaps": 0.4}


@dataclass
class Recording:
    #: name of a flow -> (cycle, payload) of each of its items
    flows: dict = field(default_factory=dict)
    #: name of an output -> its value in every cycle
    watch: dict = field(default_factory=dict)

    def values(self, name="o"):
        return [value for _, value in self.flows[name]]

    def cycles(self, name="o"):
        return [cycle for cycle, _ in self.flows[name]]


def simulate(top, *benches):
    simulator = Simulator(top)
    simulator.add_clock(1e-6)
    for bench in benches:
        simulator.add_testbench(bench)
    simulator.run()


def played_by(play):
    """Makes a test of ``async def test(driver, …)``: ``play(script)`` simulates it, and gives the script the driver."""

    def made(script):
        signature = inspect.signature(script)
        _, *fixtures = signature.parameters.values()

        @functools.wraps(script)
        def test(**given):
            play(functools.partial(script, **given))

        test.__signature__ = signature.replace(parameters=fixtures)
        return test

    return made


class Repeated:
    """A design that is elaborated once, and then simulated from its first state as often as is wanted."""

    def __init__(self, top):
        self.top = top
        self._simulator = Simulator(top)
        self._simulator.add_clock(1e-6)
        self._bench = None

    def simulate(self, bench):
        begun, self._bench = self._bench, bench
        if begun:
            self._simulator.reset()
        else:
            self._simulator.add_testbench(self._run)
        self._simulator.run()

    async def _run(self, ctx):
        await self._bench(ctx)


def member(block, path):
    """The signal that ``path`` ("i.payload") names."""
    for name in path.split("."):
        block = block[int(name)] if name.isdecimal() else getattr(block, name)
    return block


def play(block, script, *, flows=("o",), watch=()):
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

    simulate(block, bench)
    return recording


def flow_script(block, items, gaps, rng, *, drain=None):
    """(script, pushed): offer ``items``, each after its gap; ``pushed`` are their cycles.

    An item is a payload, or (payload, {path: value} of other inputs in its cycle). In the gaps, random values stand
    on the payload, so that a block that ignores ``valid`` is found. The idle end is long enough for every item to
    come out, and for surplus ones to be seen.
    """
    noise = random_values(block.i.payload.shape(), rng)
    script, pushed = [], []

    def idle(cycles):
        script.extend({"i.payload": next(noise)} for _ in range(cycles))

    for item, gap in zip(items, gaps, strict=True):
        payload, others = item if isinstance(item, tuple) else (item, {})
        idle(gap)
        pushed.append(len(script))
        script.append({"i.valid": 1, "i.payload": payload, **others})
    idle(block.latency + 5 if drain is None else drain)
    return script, pushed


def check_latency(block, pushed, recording):
    assert recording.cycles() == [cycle + block.latency for cycle in pushed]


def held(timeline, length):
    """A value for each of ``length`` cycles: the newest that ``timeline``, ``{cycle: value}``, has at that time."""
    value = timeline[0]
    for cycle in range(length):
        value = timeline.get(cycle, value)
        yield value
