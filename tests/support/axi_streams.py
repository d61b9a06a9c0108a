"""Test bench for blocks with ready/valid streams: offers items, takes items, checks the rules of a stream."""

from dataclasses import dataclass, field

from amaranth.hdl import ClockDomain, Module, Signal, Value

from support.bench import member, simulate
from support.values import Port, random_values

#: Probabilities of (an idle cycle at the input, an unready one at the output).
FLOWS = {"free": (0.0, 0.0), "gaps": (0.5, 0.0), "stalls": (0.0, 0.5), "both": (0.4, 0.4)}


@dataclass
class Passage:
    #: (cycle, value) of everything taken from the output
    out: list = field(default_factory=list)
    #: cycle in which each item was taken by the input
    taken: list = field(default_factory=list)
    #: name of a pulse -> cycles in which it was high
    pulses: dict = field(default_factory=dict)

    @property
    def values(self):
        return [value for _, value in self.out]

    def count(self, name):
        return len(self.pulses[name])


def pass_through(block, items, flow, rng, *, expect, pulses=(), inputs=None, consumer=None, tail=12):
    """Offer ``items`` at ``block.i``, take what comes from ``block.o`` until ``expect`` items came; a :class:`Passage`.

    What is offered stays until it is taken, and so must what the block offers; random values stand on the input while
    nothing is offered. ``inputs`` are constant. ``tail`` cycles more show that nothing else comes. With a ``consumer``,
    which says in each cycle whether it is ready, and is told what it took, the block may take back an offer.
    """
    gap, stall = FLOWS[flow]
    passage = Passage(pulses={name: [] for name in pulses})
    payload, valid, ready = Port(block.i.payload), Port(block.i.valid), Port(block.i.ready)
    out, out_valid, out_ready = Port(block.o.payload), Port(block.o.valid), Port(block.o.ready)
    watched = {name: Value.cast(member(block, name)) for name in pulses}
    noise = random_values(block.i.payload.shape(), rng)
    limit = int((40 * len(items) + 40 * expect + 200) / (1 - max(gap, stall)))

    async def bench(ctx):
        for name, value in (inputs or {}).items():
            Port(member(block, name)).set(ctx, value)
        position, offering, held, left = 0, False, None, tail
        for cycle in range(limit):
            if not offering:
                offering = position < len(items) and rng.random() >= gap
            valid.set(ctx, int(offering))
            payload.set(ctx, items[position] if offering else next(noise))
            accepting = rng.random() >= stall
            if consumer:
                accepting = consumer(ctx, cycle, accepting)
            out_ready.set(ctx, int(accepting))
            for name, signal in watched.items():
                if ctx.get(signal):
                    passage.pulses[name].append(cycle)
            if out_valid.get(ctx):
                value = out.get(ctx)
                assert held is None or consumer or value == held, (
                    f"cycle {cycle}: {held} became {value} while it waited"
                )
                held = None if accepting else value
                if accepting:
                    passage.out.append((cycle, value))
                    if consumer:
                        consumer.took(value)
            else:
                assert held is None or consumer, f"cycle {cycle}: {held} went away before it was taken"
            if offering and ready.get(ctx):
                passage.taken.append(cycle)
                position, offering = position + 1, False
            await ctx.tick()
            if position == len(items) and len(passage.out) >= expect:
                left -= 1
                if not left:
                    return
        raise AssertionError(
            f"{len(passage.out)} of {expect} items came, {position} of {len(items)} were taken, after {limit} cycles"
        )

    top = Module()
    top.domains += getattr(block, "sync", ClockDomain("sync"))  # a block that needs the clock itself brings the domain
    top.submodules.block = block
    top.d.sync += Signal().eq(1)  # a block without a register has no clock
    simulate(top, bench)
    return passage
