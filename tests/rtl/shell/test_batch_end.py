"""Batch end against its model: batches end by count, duration, TLAST and command, and no event is lost."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.wire import BatchEnds, Token, split_batches
from cmfpga.rtl.shell import batch_end
from support.axi_streams import FLOWS, pass_through
from support.mutation import break_blocks
from support.values import Port

CONFIG = Config(max_batch_events=50)
ENDS = {
    "tlast": BatchEnds(),
    "count": BatchEnds(events=7, by_tlast=False),
    "one": BatchEnds(events=1, by_tlast=False),
    "one and tlast": BatchEnds(events=1),
    "count and tlast": BatchEnds(events=5),
    "duration": BatchEnds(duration=100, by_tlast=False),
    "all": BatchEnds(events=9, duration=60),
    "longest": BatchEnds(duration=(1 << 24) - 1),
    "none": BatchEnds(by_tlast=False),
}


class Consumer:
    """What the core does: opens a batch with an offered event, takes events, says when it has them all.

    ``busy``: cycles between a batch's last event and ``taken``; as many more until the next may be opened.
    """

    def __init__(self, block, ends, rng, *, busy, start_p=1.0, commands=()):
        self.block, self.ends, self.rng, self.busy, self.start_p = block, ends, rng, busy, start_p
        self.commands = set(commands)
        self.state, self.timer, self.count, self.go = "idle", 0, 0, False
        self.batches, self.batch = [], []

    def __call__(self, ctx, cycle, accepting):
        """Set the inputs of this cycle; whether an event would be taken in it."""
        block = self.block
        Port(block.end_batch).set(ctx, int(cycle in self.commands))
        Port(block.idle).set(ctx, 1)
        self.go = self.go or self.rng.random() < self.start_p
        Port(block.go).set(ctx, int(self.go))
        # Right only in the cycle in which a batch is opened.
        opens = self.state == "idle" and self.timer == 0 and ctx.get(block.o.valid)
        ends = {"batch_events": self.ends.events, "duration": self.ends.duration, "by_tlast": int(self.ends.by_tlast)}
        # By TLAST in any cycle: it also says what an end without an event is.
        most = {"batch_events": CONFIG.max_batch_events, "duration": 99}
        noise = {name: int(self.rng.integers(below)) for name, below in most.items()}
        Port(block.settings).set(ctx, ends if opens else ends | noise)
        Port(block.opened).set(ctx, int(opens))
        Port(block.taken).set(ctx, int(self.state == "full" and self.timer == 0))
        ready = self.state == "open" and accepting
        if opens:
            self.state, self.count, self.go = "open", 0, False
        elif self.state == "full" and self.timer == 0:
            self.state, self.timer = "idle", self.busy
        elif self.timer:
            self.timer -= 1
        return ready

    def took(self, event):
        self.batch.append((event["t"], event["x"], event["y"]))
        self.count += 1
        if event["last"] or self.count in (self.ends.events, CONFIG.max_batch_events):
            self.batches.append((self.batch, not event["last"] and self.count != self.ends.events))
            self.batch, self.state, self.timer = [], "full", self.busy


def run(tokens, ends, flow, rng, *, busy=2, start_p=1.0, commands=(), open_end=False):
    block = batch_end.BatchEnd(CONFIG)
    consumer = Consumer(block, ends, rng, busy=busy, start_p=start_p, commands=commands)
    items = [{name: int(value) for name, value in k._asdict().items() if name != "known"} for k in tokens]
    events = sum(token.event for token in tokens)
    passage = pass_through(
        block, items, flow, rng, expect=events - open_end, pulses=("empty_end",), consumer=consumer, tail=60
    )
    return consumer.batches, consumer.batch, passage


def some_tokens(rng, count, *, end_p=0.1, event_p=0.9, grid=1, jumps=0.0):
    time, tokens = int(rng.integers(1 << 32)), []
    for _ in range(count):
        time += grid * (int(rng.integers(12)) - 2)
        if rng.random() < jumps:
            time += int(rng.integers(-(1 << 31), 1 << 31))
        event = rng.random() < event_p
        end = rng.random() < end_p if event else True
        x, y = int(rng.integers(240)), int(rng.integers(180))
        tokens.append(Token(time % (1 << 32), x, y, True, bool(event), bool(end)))
    return tokens


def check(tokens, name, flow, rng, **options):
    batches, rest, empty = split_batches(CONFIG, tokens, ENDS[name])
    got, got_rest, passage = run(tokens, ENDS[name], flow, rng, open_end=bool(rest), **options)
    wanted = [(list(zip(*(axis.tolist() for axis in batch[:3]), strict=True)), batch[3]) for batch in batches]
    assert got == wanted
    assert got_rest == rest[:-1]  # the newest one waits
    assert passage.count("empty_end") == empty
    return got, passage


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("name", ENDS)
def test_batches(name, flow, rng):
    """The settings are right only in the cycle in which a batch is opened, and noise in all others."""
    got, _ = check(some_tokens(rng, 200), name, flow, rng, busy=int(rng.integers(4)), start_p=0.3)
    assert len(got) > 2 or name == "longest"


@pytest.mark.parametrize("name", ["tlast", "duration", "longest"])
@pytest.mark.parametrize("most", [1, 2, 3])
def test_what_comes_behind_the_longest_batch_does_not_end_it(most, name, rng, monkeypatch):
    """Whether it was cut does not depend on how long its last event waits."""
    monkeypatch.setitem(globals(), "CONFIG", CONFIG.replace(max_batch_events=most))
    got, _ = check(some_tokens(rng, 200, **OFTEN, jumps=0.1), name, "both", rng, busy=2)
    assert any(cut for _, cut in got)


@pytest.mark.parametrize("flow", ["free", "both"])
def test_jumps_of_the_clock(flow, rng):
    """Each costs the batch under way, none blocks the batches behind it."""
    got, _ = check(some_tokens(rng, 300, jumps=0.05, end_p=0), "duration", flow, rng)
    assert all(max(t) - min(t) < 200 for t in ([e[0] for e in batch] for batch, _ in got))


def test_ends_without_events_are_counted(rng):
    end = Token(0, 0, 0, True, False, True)
    event = Token(5, 1, 2, True, True, False)
    got, passage = check([end, end, event, end, end, event, event._replace(end=True), end], "tlast", "free", rng)
    assert [len(batch) for batch, _ in got] == [1, 2] and passage.count("empty_end") == 4


def test_command_ends_the_batch_under_way(rng):
    """A source that stops in mid-batch: the command marks the event that waits; another one has nothing to end."""
    events = [Token(5 + k, k, 2, True, True, False) for k in range(20)]
    batches, rest, passage = run(events, ENDS["none"], "free", rng, commands={40, 55})
    assert [(len(batch), cut) for batch, cut in batches] == [(20, False)] and not rest
    assert passage.count("empty_end") == 1


def test_one_event_per_cycle(rng):
    tokens = [Token(k, 1, 2, True, True, False) for k in range(40)]
    _, passage = check(tokens, "count", "free", rng, busy=0)
    cycles = [cycle for cycle, _ in passage.out]
    assert cycles[:7] == list(range(cycles[0], cycles[0] + 7))
    # The last one of a batch does not wait for another.
    _, passage = check(tokens[:7], "count", "free", rng, busy=0)
    assert passage.out[-1][0] == passage.taken[-1] + batch_end.BatchEnd.latency


JUMPS, OFTEN, GRID = {"jumps": 0.05}, {"event_p": 0.6, "end_p": 0.3}, {"grid": 10}
MUTANTS = {  # old, new, ends, how many tokens of which kind show it
    "ends are forgotten": ("held.end.eq(1)", "held.end.eq(0)", "tlast", 200, {}),
    "a wrong number": ("completes(number + events,", "completes(number + 2,", "count", 7, {"event_p": 1.0}),
    "a TLAST behind the number": ("& ~(leaves_whole & by_number & ~ended)", "", "one and tlast", 600, OFTEN),
    "a TLAST behind the next event": ("by_time) & ~arrives)", "by_time))", "one and tlast", 200, OFTEN),
    "one microsecond": ("Cat(Const(1, 1), apart", "Cat(Const(0, 1), apart", "duration", 200, GRID),
    "no step back": ("(later ^ later[-1].replicate(", "(later & ~later[-1].replicate(", "duration", 200, JUMPS),
    "settings at any time": ("with m.If(self.opened):", "with m.If(self.opened | self.taking_in):", "count", 200, {}),
    "does not wait": ("ended | followed | by_number", "1", "tlast", 200, {}),
    "empty ends": ("self.empty_end.eq(self.settings.by_tlast)", "self.empty_end.eq(0)", "tlast", 200, {}),
}  # fmt: skip


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutants(mutant, monkeypatch, rng):
    old, new, name, count, kind = MUTANTS[mutant]
    break_blocks(monkeypatch, batch_end, old, new)
    tokens = some_tokens(rng, count, **kind)
    with pytest.raises(AssertionError):
        check(tokens, name, "both", rng, busy=0)


def test_the_tokens_are_worth_it(rng):
    tokens = some_tokens(rng, 300, jumps=0.05)
    batches, _, empty = split_batches(CONFIG, tokens, ENDS["all"])
    assert empty > 1 and len({len(t) for t, *_ in batches}) > 3
    assert np.sum([len(t) for t, *_ in batches]) > 200
