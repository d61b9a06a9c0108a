"""Vote queue: what one lane has for one half of a parity class's banks."""

from amaranth.hdl import Cat, Module, Signal
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
        Whether there is room, ``full`` says early: a vote that comes with it still fits, and those of two more cycles.
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
        following = Signal.like(head.addr)
        # Without the head: is there a vote, and how many behind it? Of none, as many as there are of the most.
        waits, load, behind = Signal(), Signal(), Signal(range(self.depth), init=self.depth - 1)
        m.d.comb += [
            load.eq(waits & (self.taken | ~self.wants.any())),
            self.full.eq(waits & behind[2:].all()),  # the depth less four, or more
            self.empty.eq(~waits & ~self.wants.any()),
            write.data.eq(self.i.payload.operation),
            write.en.eq(self.i.valid),
            self.head.eq(head.data),
        ]
        # Which bank each is for, the youngest first. Of the oldest, the number of those behind it tells the place: as
        # cases, which tools make a shift register of that can be read anywhere.
        banks = [Signal.like(self.i.payload.bank, name=f"bank_{place}", reset_less=True) for place in range(self.depth)]
        bank = Signal.like(self.i.payload.bank)
        with m.Switch(behind):
            for place, one in enumerate(banks):
                with m.Case(place):
                    m.d.comb += bank.eq(one)
        with m.If(self.i.valid):
            m.d.sync += write.addr.eq(self._next(write.addr))
            m.d.sync += [one.eq(before) for one, before in zip(banks, [self.i.payload.bank, *banks], strict=False)]
        with m.If(self.i.valid ^ load):
            m.d.sync += [behind.eq(self._counted(behind, load)), waits.eq(~load | (behind != 0))]
        with m.If(load):
            m.d.sync += [
                following.eq(self._next(following)),
                head.addr.eq(following),
                self.wants.eq(1 << bank if self.config.lanes > 2 else 1),
            ]
        with m.Elif(self.taken):
            m.d.sync += self.wants.eq(0)
        return m

    @staticmethod
    def _next(address):
        """The address after ``address``, of up to four bits: all of them in turn, by a LUT in place of an adder."""
        return Cat(address[-1:-3:-1].xor() ^ ~address[:-1].any(), address[:-1])

    @staticmethod
    def _counted(number, down):
        """``number`` + 1, or − 1 where ``down``: a LUT for each bit, where an adder would wait for ``down`` longer."""
        return Cat(bit ^ (number[:k] ^ down.replicate(k)).all() if k else ~bit for k, bit in enumerate(number))
