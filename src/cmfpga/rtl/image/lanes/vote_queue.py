"""Vote queue: what one lane has for one half of a parity class's banks."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from ... import payloads


class VoteQueue(wiring.Component):
    """A queue of votes, its head in a register that says which bank it wants.

    A vote stands at the head two cycles after it came, at the earliest; one vote a cycle in and out.

    Parameters
    ----------
    config : Config
        Of more than one lane.

    Members
    -------
    i : ``In``, flow of :func:`payloads.lane_vote`
        Whether there is room, ``full`` says one vote early: the one that comes with it still fits.
    wants : ``Out``
        A bit for each bank of the half: the head's. None where there is no head.
    head : ``Out``, :func:`payloads.lane_operation`
    taken : ``In(1)``
        The head goes to its bank.
    full, empty : ``Out(1)``
    """

    depth = 16  # what a LUT RAM of ECP5 holds; more win less than 1 % of the cycles

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(payloads.flow(payloads.lane_vote(config))),
                "wants": Out(config.lanes // 2),
                "head": Out(payloads.lane_operation(config)),
                "taken": In(1),
                "full": Out(1),
                "empty": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.operations = operations = memory.Memory(
            shape=payloads.lane_operation(self.config), depth=self.depth, init=[], attrs={"ram_style": "distributed"}
        )
        write, head = operations.write_port(), operations.read_port(domain="comb")
        waiting = Signal.like(head.addr)
        # Which bank of the half each is for: read of the one that comes next, where all else is read of the head.
        m.submodules.banks = banks = memory.Memory(
            shape=max(1, self.config.geometry.lane_bits - 1), depth=self.depth, init=[], attrs={"ram_style": "distributed"}
        )
        bank_write, bank = banks.write_port(), banks.read_port(domain="comb")
        # Without the head: is there a vote, and how many behind it? Of none, as many as there are of the most.
        waits, load, behind = Signal(), Signal(), Signal(range(self.depth), init=self.depth - 1)
        m.d.comb += [
            load.eq(waits & (self.taken | ~self.wants.any())),
            self.full.eq(waits & behind[2:].all() & behind[:2].any()),  # the depth less three, or more
            self.empty.eq(~waits & ~self.wants.any()),
            self.head.eq(head.data),
        ]
        m.d.comb += [
            *(port.en.eq(self.i.valid) for port in (write, bank_write)),
            write.data.eq(self.i.payload.operation),
            bank_write.data.eq(self.i.payload.bank),
            bank_write.addr.eq(write.addr),
            bank.addr.eq(waiting),
        ]
        with m.If(self.i.valid):
            m.d.sync += write.addr.eq(self._next(write.addr))
        with m.If(self.i.valid ^ load):
            m.d.sync += [behind.eq(behind + Mux(load, -1, 1)), waits.eq(~load | (behind != 0))]
        with m.If(load):
            m.d.sync += [
                waiting.eq(self._next(waiting)),
                head.addr.eq(waiting),
                self.wants.eq(1 << bank.data if self.config.lanes > 2 else 1),
            ]
        with m.Elif(self.taken):
            m.d.sync += self.wants.eq(0)
        return m

    @staticmethod
    def _next(address):
        """The address after ``address``, of up to four bits: all of them in turn, by a LUT in place of an adder."""
        return Cat(address[-1:-3:-1].xor() ^ ~address[:-1].any(), address[:-1])
