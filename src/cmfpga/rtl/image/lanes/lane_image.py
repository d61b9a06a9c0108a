"""The fastest way to sum: several events a cycle, in one pass."""

from amaranth.hdl import Cat, Module, Mux, Signal

from ...arithmetic import delay
from ..image_sums import ImageSums
from ..one_pass_image import OnePassImage
from .lane_bank import LaneBank
from .lane_sums import LaneSums
from .parity_class import ParityClass
from .vote_queue import VoteQueue


class LaneImage(OnePassImage):
    """The votes of K lanes wait in queues for K banks of each parity class; the sums grow with every vote.

    Votes for one bank take turns, so an iteration takes longer than n/K cycles: how long depends on its image. Where a
    queue is nearly full, ``room`` goes away, and all that comes before the votes stands still at once.

    As :class:`~cmfpga.rtl.image.tagged_accumulator.TaggedAccumulator`, banks are swept between iterations.

    See :class:`ImageSums` for parameters, members and attributes; ``votes`` is an array of K flows, of which the first
    marks the last events of an iteration, and has one whenever another has.
    """

    exact_cycles = False
    squares_late = LaneSums.squares_late
    sweep_cycles = ParityClass.queued + 1

    def __init__(self, config, *, in_flight):
        self.lane_sums = LaneSums(config, ahead=ParityClass.latency + LaneBank.latency)
        self.classes = [ParityClass(config) for _ in range(4)]
        # From the last votes to the sums, less those to ``complete``.
        last = ParityClass.latency + LaneBank.latency + self.lane_sums.latency
        self.latency = last - self.sweep_cycles
        self.lead = last - self.lane_sums.plain_latency
        ImageSums.__init__(self, config, in_flight=in_flight)

    @property
    def blocks(self):
        return {**{f"parity_class_{k}": each for k, each in enumerate(self.classes)}, "lane_sums": self.lane_sums}

    def most_cycles(self, cycles):
        """Of a queue that is full three votes go in 3·K cycles, two cycles later there is room, and then for three.

        In the end, a queue is left.
        """
        lanes = self.config.lanes
        return -(-cycles // 3) * (3 * lanes + 5) + VoteQueue.depth * lanes

    def elaborate(self, platform):
        config = self.config
        m = Module()
        for name, block in self.blocks.items():
            m.submodules[name] = block
        lead = self.votes[0]
        # Votes are taken; an iteration's first; between two.
        came, first, idle = Signal(), Signal(), Signal(init=1, name="idle")
        m.d.comb += [came.eq(lead.valid & self.room[0]), first.eq(came & idle)]

        # What is marked last closes the iteration, as late as its votes may have left the queues.
        closes = delay(m, came & lead.payload.last, ParityClass.queued, name="closes", valid=True)
        closing, were_empty = Signal(name="closing"), Signal(4)
        m.d.sync += were_empty.eq(Cat(each.empty for each in self.classes))
        m.d.comb += self.complete.eq(closing & were_empty.all())
        with m.If(self.complete):
            m.d.sync += closing.eq(0)
        with m.Elif(closes):
            m.d.sync += closing.eq(1)
        with m.If(came):
            m.d.sync += idle.eq(0)
        with m.Elif(self.complete):
            m.d.sync += idle.eq(1)

        # Itself a register, and not the inverse of one: as it is, it enables those inside of multipliers and memories.
        # One for each lane, for its wires: with and without a reset, which begin with 0 or 1, up to four stay apart.
        room = ~Cat(each.full for each in self.classes).any()
        for lane, has_room in enumerate(self.room):
            here = Signal(name=f"room_{lane}", init=~lane & 1, reset_less=bool(lane & 2))
            m.d.sync += here.eq(room)
            m.d.comb += [has_room.eq(here), self.lane_sums.room[lane].eq(here)]

        address = Signal(range(max(2, config.geometry.words)))
        last = address == config.geometry.words - 1
        with m.If(idle):
            m.d.sync += address.eq(Mux(last, 0, address + 1))
        m.d.sync += self.cleared.eq(idle & last)

        # The number of an iteration is not 0, which all swept words have. Each class has its own register of it, and
        # each half of its banks its own turn; they begin at other values, or one has no reset, so that no tool makes
        # one of them, whose wires would be long.
        tags = (1 << config.tag_bits) - 1
        tag = Signal(config.tag_bits, init=1)
        with m.If(self.next):
            m.d.sync += tag.eq(Mux(tag == tags, 1, tag + 1))
        used = Mux(idle, 0, tag)
        sums = self.lane_sums
        for number, each in enumerate(self.classes):
            for half in range(2):
                turn = Signal(range(config.lanes), name=f"turn_{number}_{half}", reset_less=bool(half))
                m.d.sync += turn.eq(Mux(first, number % config.lanes, turn + 1))
                m.d.comb += each.turn[half].eq(turn)
            used_here = Signal.like(tag, name=f"used_{number}", init=number % (tags + 1))
            m.d.sync += used_here.eq(used)
            m.d.comb += [
                each.tag.eq(used_here),
                each.sweep.valid.eq(idle),
                each.sweep.payload.eq(address),
            ]
            for lane, votes in enumerate(self.votes):
                vote = votes.payload.banks[number]  # only in a valid item there are valid ones
                m.d.comb += [
                    sums.votes[lane][number].eq(vote),
                    each.i[lane].eq(vote),
                    each.i[lane].valid.eq(vote.valid & self.room[lane]),
                ]
            m.d.comb += [sums.steps[config.lanes * number + bank].eq(step) for bank, step in enumerate(each.o)]
        m.d.comb += [
            sums.begin.eq(first),
            self.sums.payload.eq(sums.sums),
            self.sums.valid.eq(delay(m, self.complete, self.latency, name="complete", valid=True)),
        ]
        if config.confidence:
            m.d.comb += self.squares.eq(sums.squares)
        return m
