"""Counters: 32 bits each, of losses, stalls and work."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ...protocol.flags import Flag
from ...protocol.registers.contract import COUNTERS
from ...protocol.results import RESULTS
from .. import payloads as core

#: Counters that add a result's count.
OF_RESULTS = tuple(f.name for f in RESULTS if f.total)
OF_FLAGS = {"degenerate": Flag.DEGENERATE, "cut": Flag.CUT, "doubtful": Flag.DOUBTFUL}
LONGEST = "longest_batch"
PULSES = tuple(
    name.lower() for name in COUNTERS if name.lower() not in (*OF_RESULTS, *OF_FLAGS, "batches", "cycles", LONGEST)
)


class Counters(wiring.Component):
    """Wrap after 2^32; cleared all at once.

    Members
    -------
    clear : ``In(1)``
    pulses : ``In``, one bit for each of :data:`PULSES`
        Adds one.
    taken : ``In(1)``
        A result is taken: ``result`` counts.
    result : ``In``, :func:`cmfpga.rtl.payloads.result`
    values : ``Out``, one word for each of :data:`cmfpga.protocol.registers.contract.COUNTERS`
    """

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "clear": In(1),
                "pulses": In(data.StructLayout(dict.fromkeys(PULSES, 1))),
                "taken": In(1),
                "result": In(core.result(config)),
                "values": Out(data.StructLayout({name.lower(): 32 for name in COUNTERS})),
            }
        )

    def elaborate(self, platform):
        m = Module()
        taken_s1 = Signal()  # a cycle later, so that the core's result does not reach into 32-bit adders
        result_s1 = Signal(core.result(self.config), reset_less=True)
        longer = Signal()
        m.d.sync += [taken_s1.eq(self.taken & ~self.clear), result_s1.eq(self.result)]
        m.d.comb += longer.eq(result_s1.cycles > self.values[LONGEST])
        # What this hardware never counts stays 0.
        counts = {name: result_s1[name] for name in OF_RESULTS if name in result_s1.shape().members}
        bits = {name: flag.bit_length() - 1 for name, flag in OF_FLAGS.items()}
        counts |= {name: result_s1.flags[bit] for name, bit in bits.items() if bit < len(result_s1.flags)}
        for name in self.values.shape().members:
            value = self.values[name]
            if name == LONGEST:
                following = Mux(taken_s1 & longer, result_s1.cycles, value)
            elif name in (*OF_RESULTS, *OF_FLAGS):
                following = value + Mux(taken_s1, counts.get(name, 0), 0)
            elif name == "batches":
                following = value + taken_s1
            elif name == "cycles":
                following = value + 1
            else:
                following = value + self.pulses[name]
            m.d.sync += value.eq(Mux(self.clear, 0, following))
        return m
