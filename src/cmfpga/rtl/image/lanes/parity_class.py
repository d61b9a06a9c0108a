"""Parity class: the pixels whose columns are even or odd, and whose rows are, in one bank for each lane."""

from amaranth.hdl import Cat, Module
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ... import payloads
from .lane_bank import LaneBank
from .router import Router
from .vote_queue import VoteQueue


class ParityClass(wiring.Component):
    """Queues, router and banks.

    A pixel lies in bank (column + row) modulo K, both counted in the class, so that neighbours, and the pixels of an
    edge whatever its direction, lie in different ones. Each lane has two queues, for the even and the odd banks.

    A vote is in its bank's first stage :attr:`latency` cycles after it came, if it has not to wait.

    Parameters
    ----------
    config : Config
        Of more than one lane.

    Members
    -------
    i : ``In``, array of K members of ``banks`` of :func:`payloads.votes`
        A vote of each lane, or none.
    turn : ``In``, array of two
        The lane that is preferred; for each half of the banks the same, of its own.
    tag : ``In``
        Of what enters the banks: the number of the iteration, or 0 :attr:`Router.latency` cycles after ``sweep``.
    sweep : ``In``, flow of an address
        Where all banks take on ``tag``; not before the cycle after the first in which all were ``empty``.
    full, empty : ``Out(1)``
        A queue had room for few votes more, a cycle ago; none has a vote.
    o : ``Out``, array of K :func:`payloads.tagged_step`
        What each bank did, :attr:`LaneBank.latency` cycles after its operation; where that was no vote's, it added 0.
    """

    #: Cycles after which a vote that had not to wait has left its queue.
    queued = 3
    latency = queued - 1 + Router.latency

    def __init__(self, config):
        self.config = config
        lanes = config.lanes
        vote = payloads.votes(config)["banks"].shape.elem_shape
        super().__init__(
            {
                "i": In(data.ArrayLayout(vote, lanes)),
                "turn": In(data.ArrayLayout(range(lanes), 2)),
                "tag": In(config.tag_bits),
                "sweep": In(payloads.flow(config.geometry.word_bits)),
                "full": Out(1),
                "empty": Out(1),
                "o": Out(data.ArrayLayout(payloads.tagged_step(config), lanes)),
            }
        )

    def elaborate(self, platform):
        geometry, lanes = self.config.geometry, range(self.config.lanes)
        m = Module()
        m.submodules.router = router = Router(self.config)
        connect(m, flipped(self.sweep), router.sweep)
        m.d.comb += router.turn.eq(self.turn)
        queues = []
        for lane in lanes:
            vote = self.i[lane]
            column, row = vote.address[: geometry.bank_column_bits], vote.address[geometry.bank_column_bits :]
            bank = (column + row)[: geometry.lane_bits]
            for half in range(2):
                m.submodules[f"queue_{lane}_{half}"] = queue = VoteQueue(self.config)
                queues.append(queue)
                queued = queue.i.payload
                m.d.comb += [
                    queue.i.valid.eq(vote.valid & (bank[0] == half)),
                    queued.bank.eq(bank[1:]),
                    queued.operation.address.eq(Cat(column[geometry.lane_bits :], row)),
                    *(queued.operation.add[name].eq(vote[name]) for name in payloads.pixel(self.config).members),
                    router.wants[lane][half].eq(queue.wants),
                    router.heads[lane][half].eq(queue.head),
                    queue.taken.eq(router.taken[lane][half]),
                ]
        for number, o in enumerate(router.o):
            m.submodules[f"bank_{number}"] = bank = LaneBank(self.config, always=True)
            m.d.comb += [
                bank.i.valid.eq(1),  # who adds nothing does no harm
                bank.i.payload.address.eq(o.address),
                bank.i.payload.add.eq(o.add),
                bank.i.payload.tag.eq(self.tag),
                self.o[number].eq(bank.o.payload),
                self.o[number].valid.eq(bank.o.valid),
            ]
        m.d.sync += self.full.eq(Cat(queue.full for queue in queues).any())
        m.d.comb += [
            self.empty.eq(Cat(queue.empty for queue in queues).all()),
        ]
        return m
