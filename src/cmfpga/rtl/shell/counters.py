"""Counters: 32 bits each, of losses, stalls and work, in a memory with one adder."""

from amaranth.hdl import Array, Cat, Module, Mux, Signal
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from ...protocol.flags import Flag
from ...protocol.registers.contract import COUNTERS
from ...protocol.results import RESULTS
from .. import payloads as core

#: Counters that add a result's count.
OF_RESULTS = tuple(f.name for f in RESULTS if f.total)
OF_FLAGS = {"degenerate": Flag.DEGENERATE, "cut": Flag.CUT, "doubtful": Flag.DOUBTFUL}
LONGEST = "longest_batch"
#: What one result adds to, one a cycle; :data:`LONGEST` takes two, to compare and to store.
BY_RESULT = (*OF_RESULTS, *OF_FLAGS, "batches", "results_held_back")
BY_PULSE = tuple(name.lower() for name in COUNTERS if name.lower() not in (*BY_RESULT, LONGEST))
PULSES = tuple(name for name in BY_PULSE if name != "cycles")
#: Counters of a half of the memory, and cycles in which each of its turns comes again, less those for a result.
TURNS = 16


class Counters(wiring.Component):
    """Wrap after 2^32; cleared all at once.

    Nothing is lost: pulses are counted in five bits, and added in turn. So a counter of pulses shows what was counted
    up to 17 cycles ago, or 31 where a result came; those of results are complete :attr:`walk` cycles after ``begun``.

    Members
    -------
    clear : ``In(1)``
        A result that began less than :attr:`walk` cycles ago is cleared too.
    pulses : ``In``, one bit for each of :data:`PULSES`
        Adds one.
    begun : ``In(1)``
        A result counts: ``result`` and ``held`` stay for :attr:`walk` cycles. At most every 32 cycles.
    held : ``In(1)``
        It is not shown in the registers.
    result : ``In``, :func:`cmfpga.rtl.payloads.result`
    address, word : ``In(5)``, ``Out(32)``
        The counter of that number in :data:`cmfpga.protocol.registers.contract.COUNTERS`.
    """

    #: Cycles of adding a result.
    walk = len(BY_RESULT) + 2

    def __init__(self, config):
        self.config = config
        assert len(BY_PULSE) < TURNS and self.walk < TURNS
        super().__init__(
            {
                **dict.fromkeys(("clear", "begun", "held"), In(1)),
                "pulses": In(data.StructLayout(dict.fromkeys(PULSES, 1))),
                "result": In(core.result(config)),
                "address": In(5),
                "word": Out(32),
            }
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
        compare, keep = walking & (step == self.walk - 2), walking & (step == self.walk - 1)

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
        added_s1, place_s1 = Signal(32), Signal(range(2 * TURNS))
        nothing_s1, compare_s1, keep_s1, longer = Signal(), Signal(), Signal(), Signal()
        total = Signal(33)
        m.d.sync += [
            walking_s1.eq(walking),
            added_s1.eq(Mux(walking, self._of_result(step), self._of_pulses(m, turn, walking))),
            place_s1.eq(Cat(Mux(walking, Mux(keep, self.walk - 2, step), turn)[:4], walking)),
            nothing_s1.eq(Mux(walking, renewing | keep, old_pulses)),
            compare_s1.eq(compare),
            keep_s1.eq(keep),
            longer.eq(~total[32]),  # of compare: what was there + ~cycles < 2^32
        ]
        m.d.comb += [
            get.addr.eq(place_s1),
            total.eq(Mux(nothing_s1, 0, get.data) + added_s1),
            put.addr.eq(place_s1),
            put.data.eq(total),
            put.en.eq(~compare_s1 & (~keep_s1 | longer)),
        ]
        places = {name: k for k, name in enumerate(BY_PULSE)} | {name: TURNS + k for k, name in enumerate(BY_RESULT)}
        places[LONGEST] = TURNS + self.walk - 2
        numbers = [places[name.lower()] for name in COUNTERS]
        m.d.comb += [
            show.addr.eq(Array(numbers + [TURNS - 1] * (32 - len(numbers)))[self.address]),
            self.word.eq(Mux(Mux(show.addr[-1], old_results | renewing, old_pulses), 0, show.data)),
        ]
        return m

    def _of_pulses(self, m, turn, walking):
        """The pulses that came since the last turn of a counter."""
        counts = Array(Signal(5, name=f"since_{name}") for name in BY_PULSE)
        for k, (name, count) in enumerate(zip(BY_PULSE, counts, strict=True)):
            pulse = 1 if name == "cycles" else self.pulses[name]
            with m.If(self.clear):
                m.d.sync += count.eq(0)
            with m.Else():
                m.d.sync += count.eq(Mux(~walking & (turn == k), 0, count) + pulse)
        return Array([*counts, *[0] * (TURNS - len(counts))])[turn]

    def _of_result(self, step):
        """What a result adds."""
        result = self.result
        bits = {name: flag.bit_length() - 1 for name, flag in OF_FLAGS.items()}
        # What this hardware never counts stays 0.
        counts = {name: result[name] for name in OF_RESULTS if name in result.shape().members}
        counts |= {name: result.flags[bit] for name, bit in bits.items() if bit < len(result.flags)}
        counts |= {"batches": 1, "results_held_back": self.held}
        added = [*(counts.get(name, 0) for name in BY_RESULT), ~result.cycles, result.cycles]
        return Array([*added, *[0] * (TURNS - len(added))])[step]
