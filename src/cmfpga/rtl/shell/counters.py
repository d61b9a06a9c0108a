"""Counters: 32 bits each, of losses, stalls and work, in a memory with one adder."""

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal
from amaranth.lib import data, memory
from amaranth.lib.wiring import In, Out

from ...protocol.registers.contract import COUNTERS
from ...protocol.results import RESULTS
from .. import Block
from . import payloads

OF_FLAGS = ("degenerate", "cut", "doubtful")
#: Counters of what a result packet has, and where: numbers, and bits of its first word.
PLACES = {f.name: f.places[0] for f in RESULTS if f.total}
PLACES |= {name: place for f in RESULTS for place in f.places if (name := place.field.lower()) in OF_FLAGS}
BITS = {name: place.lsb for name, place in PLACES.items() if place.width == 1}
LONGEST = "longest_batch"
#: What one result adds to, one a cycle; :data:`LONGEST` takes two, to compare and to store.
BY_RESULT = (*PLACES, "batches", "results_held_back")
BY_PULSE = tuple(name.lower() for name in COUNTERS if name.lower() not in (*BY_RESULT, LONGEST))
PULSES = tuple(name for name in BY_PULSE if name != "cycles")
#: Counters of a half of the memory, and cycles in which each of its turns comes again, less those for a result.
TURNS = 16
#: Cycles that a word's upper half waits, while lower ones are added.
DELAY = 3


def _steps():
    """The step behind ``begun`` in which each counter of results is added to; behind those of :data:`LONGEST`."""
    steps = {name: place.word // 2 - 1 + DELAY * (place.word % 2) for name, place in PLACES.items() if name not in BITS}
    free = iter(sorted(set(range(2, TURNS)) - set(steps.values())))
    return steps | {name: next(free) for name in BY_RESULT if name not in steps}


#: Those that count once a batch, with its last result, where there is a table of regions.
OF_BATCH = (*(f.name for f in RESULTS if f.total and f.scope == "batch"), "cut", "batches")
STEPS = _steps()
assert len(set(STEPS.values())) == len(STEPS) and min(STEPS.values()) == 2


def pulses(config):
    """A bit for each of :data:`PULSES`; more for those of events, where vectors come."""
    many = payloads.counted(config).members
    return data.StructLayout({**dict.fromkeys(PULSES, 1), **many, "events_taken": many["events_in"]})


class Counters(Block):
    """Wrap after 2^32; cleared all at once.

    Nothing is lost: pulses are counted in five bits, and added in turn. So a counter of pulses shows what was counted
    up to 17 cycles ago, or 31 where a result came; those of results are complete :attr:`walk` cycles after ``begun``.

    Members
    -------
    clear : ``In(1)``
        A result that began less than :attr:`walk` cycles ago is cleared too.
    pulses : ``In``, :func:`pulses`
        Adds one; or so many, where vectors of events come.
    begun : ``In(1)``
        A result counts. At most every 32 cycles.
    held : ``In(1)``
        It is not shown in the registers. Stays for :attr:`walk` cycles.
    last : ``In(1)``
        It is its batch's last. Stays for :attr:`walk` cycles. Only with a table of regions.
    packet : ``In(64)``
        From ``begun`` on, the words of its packet, one a cycle.
    address, word : ``In(5)``, ``Out(32)``
        The counter of that number in :data:`cmfpga.protocol.registers.contract.COUNTERS`.
    """

    #: Cycles of adding a result.
    walk = max(STEPS.values()) + 1

    def __init__(self, config):
        if len(BY_PULSE) >= TURNS or self.walk >= TURNS:
            raise NotImplementedError(f"a total of a late word: a result is added up in {TURNS} cycles")
        super().__init__(
            config,
            **dict.fromkeys(("clear", "begun", "held", *(("last",) if config.regions else ())), In(1)),
            pulses=In(pulses(config)),
            packet=In(64),
            address=In(5),
            word=Out(32),
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.store = store = memory.Memory(shape=32, depth=2 * TURNS, init=[])
        put = store.write_port()
        get, show = (store.read_port(domain="comb") for _ in range(2))
        turn, step, walking = Signal(range(TURNS)), Signal(range(TURNS)), Signal()
        with m.If(walking):
            m.d.sync += [step.eq(step + 1), walking.eq(step != self.walk - 1)]
        with m.Else():
            m.d.sync += turn.eq(turn + 1)
        with m.If(self.begun):
            m.d.sync += [walking.eq(1), step.eq(0)]
        compare, keep = walking & (step == 0), walking & (step == 1)

        # A half that was cleared counts as 0 until each of its words was written.
        old_pulses, old_results, renewing = Signal(init=1), Signal(init=1), Signal()
        walking_s1 = Signal()
        with m.If(~walking & (turn == TURNS - 1)):
            m.d.sync += old_pulses.eq(0)
        with m.If(self.begun):
            m.d.sync += [renewing.eq(old_results), old_results.eq(0)]
        with m.Elif(walking_s1 & ~walking):
            m.d.sync += renewing.eq(0)
        with m.If(self.clear):
            m.d.sync += [old_pulses.eq(1), old_results.eq(1), turn.eq(0)]

        # One word a cycle: what is added to it, then the sum.
        added_s1, more_s1, place_s1 = Signal(32), Signal(), Signal(range(2 * TURNS))
        nothing_s1, compare_s1, keep_s1, longer = Signal(), Signal(), Signal(), Signal()
        total = Signal(34)
        counts, pulses = self._pulses(m, turn, walking)
        of_result, one = self._of_result(m, step, added_s1)
        with m.If(walking):
            m.d.sync += [added_s1.eq(of_result), more_s1.eq(one)]
        with m.Else():
            m.d.sync += [added_s1.eq(counts[turn]), more_s1.eq(pulses[turn])]
        m.d.sync += [
            walking_s1.eq(walking),
            place_s1.eq(Cat(Mux(walking, Mux(keep, 0, step), turn)[:4], walking)),
            nothing_s1.eq(Mux(walking, renewing | keep, old_pulses)),
            compare_s1.eq(compare),
            keep_s1.eq(keep),
            longer.eq(total[33]),  # of compare: what was there + ~cycles < 2^32
        ]
        m.d.comb += [
            get.addr.eq(place_s1),
            # a + b + more = a - ~b - ~more, so that registers alone go straight into the carry chain.
            total.eq(Cat(more_s1, added_s1) - Cat(~more_s1, ~Mux(nothing_s1, 0, get.data))),
            put.addr.eq(place_s1),
            put.data.eq(total[1:]),
            put.en.eq(~compare_s1 & (~keep_s1 | longer)),
        ]
        places = {name: k for k, name in enumerate(BY_PULSE)} | {name: TURNS + k for name, k in STEPS.items()}
        places[LONGEST] = TURNS
        numbers = [places[name.lower()] for name in COUNTERS]
        m.d.comb += [
            show.addr.eq(Array(numbers + [TURNS - 1] * (32 - len(numbers)))[self.address]),
            self.word.eq(Mux(Mux(show.addr[-1], old_results | renewing, old_pulses), 0, show.data)),
        ]
        return m

    def _pulses(self, m, turn, walking):
        """By turn: the pulses since the counter's last one, and that of this cycle."""
        counts, pulses = [Const(0)] * TURNS, [Const(0)] * TURNS
        for k, name in enumerate(BY_PULSE):
            pulses[k] = Const(1) if name == "cycles" else self.pulses[name]
            counts[k] = count = Signal(4 + len(pulses[k]), name=f"since_{name}")
            m.d.sync += count.eq(count + pulses[k])
            if len(pulses[k]) > 1:
                counts[k], pulses[k] = count + pulses[k], Const(0)
            with m.If(self.clear | (~walking & (turn == k))):
                m.d.sync += count.eq(0)
        return Array(counts), Array(pulses)

    def _of_result(self, m, step, before):
        """What a result adds, and one if it does; ``before``: the last one."""
        lower, upper = self.packet[:32], self.packet[32:]
        bits = Signal(data.StructLayout(dict.fromkeys(BITS, 1)))
        with m.If(self.begun):
            m.d.sync += [bits[name].eq(upper[lsb]) for name, lsb in BITS.items()]
        width = max(f.shape(self.config).width for f in RESULTS if f.total)
        delayed = upper[:width]
        for _ in range(DELAY):
            following = Signal(width)
            m.d.sync += following.eq(delayed)
            delayed = following
        # Which: a register, of the step before it. The cycles, which are to be compared with the longest, come first.
        choices = [~upper, ~before, lower[:width], delayed]
        numbers = {STEPS[name]: (2 + place.word % 2, name) for name, place in PLACES.items() if name not in BITS}
        last = {name: self.last for name in OF_BATCH} if self.config.regions else {}
        which, some = Signal(2), Signal()
        m.d.sync += [some.eq(self.begun), which.eq(0)]
        with m.If(~self.begun):
            with m.Switch(step + 1):
                for k, (number, name) in {1: (1, LONGEST), **numbers}.items():
                    with m.Case(k):
                        m.d.sync += [which.eq(number), some.eq(last.get(name, 1))]
        one = {name: bits[name] for name in BITS} | {"batches": 1, "results_held_back": self.held}
        added = ((step == STEPS[name]) & (value & last[name] if name in last else value) for name, value in one.items())
        return Mux(some, Array(choices)[which], 0), Cat(added).any()


def filtered(m, counts, result, *, clear, once):
    """``{name: total}`` of what filters of noise dropped, of all results: of each ``once``, until ``clear``."""
    totals = {name: Signal(32, name=f"count_{name}") for name in ("hot", "noise") if name in counts}
    for name, count in totals.items():
        with m.If(clear):
            m.d.sync += count.eq(0)
        with m.Elif(once):
            m.d.sync += count.eq(count + result[name])
    return {name.upper(): count for name, count in totals.items()}
