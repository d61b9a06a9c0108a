"""Router: the heads of a parity class's queues to its banks."""

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ... import payloads
from ...arithmetic import delay, select


class Router(wiring.Component):
    """Gives every bank one of the heads that want it, in every cycle: that of the lane whose turn it is, or the next.

    The turn goes round, so a head waits for as many cycles as there are lanes at most. What a bank gets stands in a
    register, :attr:`latency` cycles later: in between, the lane that was chosen stands in one, and the heads in others.

    Members
    -------
    turn : ``In``, array of two
        The lane that is preferred; for each half of the banks the same, of its own.
    wants : ``In``, array of K arrays of two
        Of the queues of each lane, by the lowest bit of the banks that they are for: a bit for each of these banks.
    heads : ``In``, array of K arrays of two :func:`payloads.lane_operation`
    sweep : ``In``, flow of an address
        For all banks, :attr:`latency` cycles later, while nothing is wanted: in place of the first lane's heads.
    taken : ``Out``, array of K
        A bit for each queue of a lane: its head is given.
    o : ``Out``, array of K :func:`payloads.lane_operation`
        For each bank. Where nothing is given, nothing is added: where ``sweep`` says, or else anywhere.
    """

    latency = 1

    def __init__(self, config):
        self.config = config
        lanes, operation = config.lanes, payloads.lane_operation(config)
        super().__init__(
            {
                "turn": In(data.ArrayLayout(range(lanes), 2)),
                "wants": In(data.ArrayLayout(data.ArrayLayout(lanes // 2, 2), lanes)),
                "heads": In(data.ArrayLayout(data.ArrayLayout(operation, 2), lanes)),
                "sweep": In(payloads.flow(config.geometry.word_bits)),
                "taken": Out(data.ArrayLayout(2, lanes)),
                "o": Out(data.ArrayLayout(operation, lanes)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        lanes = range(self.config.lanes)
        given = [[] for _ in lanes]  # by lane: by each bank
        heads = [
            [delay(m, self.heads[lane][half], 1, name=f"head_{lane}_{half}") for half in range(2)] for lane in lanes
        ]
        with m.If(self.sweep.valid):  # where nothing is wanted, these are chosen
            m.d.sync += [head.address.eq(self.sweep.payload) for head in heads[0]]
        for bank, o in enumerate(self.o):
            half, number = bank & 1, bank >> 1
            wanted = Cat(self.wants[lane][half][number] for lane in lanes)
            grant = Signal(len(lanes), name=f"grant_{bank}")
            for lane in lanes:
                before = [[(turn + k) % len(lanes) for k in range((lane - turn) % len(lanes))] for turn in lanes]
                taken = select(self.turn[half], [Cat(wanted[other] for other in others).any() for others in before])
                m.d.comb += grant[lane].eq(wanted[lane] & ~taken)
                given[lane].append(grant[lane])
            # By number, so that a bit of four lanes is a LUT.
            bits = range(self.config.geometry.lane_bits)
            chosen = Cat(Cat(grant[lane] for lane in lanes if lane >> bit & 1).any() for bit in bits)
            chosen = delay(m, chosen, 1, name=f"chosen_{bank}")
            found = delay(m, wanted.any(), 1, name=f"found_{bank}", valid=True)
            m.d.comb += o.eq(select(chosen, [heads[lane][half] for lane in lanes]))
            with m.If(~found):
                m.d.comb += o.add.eq(0)
        for lane in lanes:
            m.d.comb += self.taken[lane].eq(Cat(Cat(given[lane][half::2]).any() for half in range(2)))
        return m
