"""Event buffer: stores a batch's ROI events and replays them in every iteration."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from ...config.schedule import FEWEST
from ...fixed import bits_for
from ...protocol.results import thins
from .. import Block, payloads
from ..arithmetic import delay, select


def stored(config):
    """Signature of what the buffer says of a batch: events stored and events dropped since ``clear``.

    One that thins out drops none, but has ``thinned`` some, by ``halved``: high in a cycle after which the buffer
    stores half as many of those that come.
    """
    counter = Out(bits_for(config.max_batch_events))
    more = {"thinned": counter, "halved": Out(1)} if thins(config) else {"overflow": counter}
    return wiring.Signature({"count": Out(bits_for(config.buffer_events)), **more})


class EventBuffer(Block):
    """Stores events, then replays them, one per cycle, whenever asked.

    What a full buffer does with the surplus: it drops and counts it. Or, with ``when_full="thin"``, it thins out what
    it holds, evenly, without a pause or a copy: events are stored where the i-th one belongs after all halvings so
    far, at the address i with its bits rotated by one place for each. Then sample 2i of before is sample i of after,
    rotl(2i, e) = rotl(i, e + 1), so a halving moves nothing: it only forgets every second event, the same from then
    on.

    A replay may be of a subset: of every second or fourth event, from another one in each iteration
    (:func:`cmfpga.config.schedule.used`). With two buffers, one is filled while the other is replayed.
    One event per cycle in and out, as long as there is ``room`` for what comes out; the first event appears
    :attr:`latency` cycles after ``replay``, and each one :attr:`latency` − 1 after the cycle in which there was room.
    Where evaluations of an event take turns, an event comes out in the first cycle of each turn.

    Parameters
    ----------
    config : Config
        ``buffer_events`` is the depth of each of ``buffers``.

    Members
    -------
    i : ``In``, flow of :func:`payloads.roi_event`
        Events to store.
    o : ``Out``, flow of :func:`payloads.replayed_event`
        The stored events in order, or a subset; ``last`` marks the last one.
    clear : ``In(1)``
        Begin to fill: the other buffer, if there are two. No event in this cycle.
    take : ``In(1)``
        What has been filled is what will be replayed. No replay is under way.
    replay : ``In(1)``
        Begin a replay. Not while one is under way; at least one event must be stored.
    stride : ``In``
        With ``replay``: of one event in 2^stride. Only with a schedule.
    started, subset : ``Out(1)``, ``Out``, :func:`payloads.subset`
        A replay has begun, one cycle; what it replays, from then on until the next. Only with a schedule.
    room : ``In(1)``
        Where it is low, the replay pauses: here alone, because nothing behind can be stalled.
    stored : ``Out``, :func:`stored`
    """

    latency = 4

    def __init__(self, config):
        subset = {"stride": In(payloads.STRIDE_BITS), "started": Out(1), "subset": Out(payloads.subset(config))}
        super().__init__(
            config,
            i=In(payloads.flow(payloads.roi_event(config))),
            o=Out(payloads.flow(payloads.replayed_event(config))),
            clear=In(1),
            take=In(1),
            replay=In(1),
            room=In(1, init=1),
            stored=Out(stored(config)),
            **(subset if config.ascent_rule.strides else {}),
        )

    def elaborate(self, platform):
        depth = self.config.buffer_events
        count = self.stored.count
        m = Module()
        two = self.config.buffers == 2
        # Rotated addresses are of all those bits.
        words = 1 << bits_for(depth - 1) if thins(self.config) else depth
        ports = []
        # With several stores there are so many units that block RAM is short.
        several = self.config.regions and self.config.store.readers > 1
        style = {"ram_style": "ultra"} if several and self.config.store_style == "ultra" else {}
        for number in range(self.config.buffers):
            events = memory.Memory(shape=payloads.roi_event(self.config), depth=words, init=[], attrs=style)
            ports.append((events.write_port(), events.read_port()))
            m.submodules[f"events_{number}"] = events

        filling, replaying = Signal(), Signal()  # which of two buffers
        replayed = Signal.like(count)  # events of the one that is replayed
        if two:
            with m.If(self.clear):
                m.d.sync += filling.eq(~filling)
        with m.If(self.take):
            m.d.sync += [replaying.eq(filling), replayed.eq(count)]

        full = Signal()  # ``count`` is ``depth``
        stays, place, placed = (self._thin if thins(self.config) else self._drop)(m, full)
        for number, (write, _) in enumerate(ports):  # a cycle later
            mine = stays & (filling == number)
            m.d.sync += [write.addr.eq(place), write.data.eq(self.i.payload), write.en.eq(mine)]

        # Stage 1: address.
        reading_s1 = Signal()
        address_s1 = Signal(range(max(2, depth)))
        last_s1 = Signal()
        first, step, next_step = self._subset(m, replayed) if self.config.ascent_rule.strides else (0, 1, 1)
        # From there on an event is the last one: in a register, so that only a comparison is left. A step is never
        # larger than the number of events.
        final = Signal.like(replayed)
        with m.If(self.replay):
            m.d.sync += final.eq(replayed - next_step)
        m.d.comb += last_s1.eq(address_s1 >= final)
        goes = reading_s1 & self.room
        if self.config.geometry.turn_bits:
            turn = Signal(self.config.geometry.turn_bits)
            goes &= turn == 0
            m.d.sync += turn.eq(Mux(self.replay, 0, turn + 1))
        with m.If(self.replay):
            m.d.sync += [reading_s1.eq(1), address_s1.eq(first)]
        with m.Elif(goes):
            m.d.sync += [reading_s1.eq(~last_s1), address_s1.eq(address_s1 + step)]

        # Stage 2: where that is. Stage 3: the memory's own register. Stage 4: its output register, then which memory.
        place_s2 = Signal(range(max(2, words)), reset_less=True)
        m.d.sync += place_s2.eq(placed(address_s1))
        outputs = []
        for number, (_, read) in enumerate(ports):
            m.d.comb += read.addr.eq(place_s2)
            outputs.append(delay(m, read.data, 1, name=f"output_{number}"))
        output = outputs[0]
        if two:
            output = Mux(delay(m, replaying, 3, name="which"), outputs[1].as_value(), output.as_value())
        m.d.comb += [self.o.payload.eq(output), self.o.payload.last.eq(delay(m, last_s1, 3, name="last"))]
        m.d.sync += self.o.valid.eq(delay(m, goes, 2, name="reading", valid=True))
        return m

    def _drop(self, m, full):
        """What comes when it is full is dropped.

        Returns whether the event on ``i`` is stored, where, and a function of the number of an event that is replayed:
        where that is.
        """
        count, overflow = self.stored.count, self.stored.overflow
        with m.If(self.clear):
            m.d.sync += [count.eq(0), overflow.eq(0), full.eq(0)]
        with m.Elif(self.i.valid):
            with m.If(full):
                m.d.sync += overflow.eq(overflow + 1)
            with m.Else():
                m.d.sync += [count.eq(count + 1), full.eq(count == self.config.buffer_events - 1)]
        return self.i.valid & ~full, count, lambda number: number

    def _thin(self, m, full):
        """What comes when it is full halves what is stored. Returns the same."""
        depth, most = self.config.buffer_events, self.config.max_batch_events
        count, halved = self.stored.count, self.stored.halved
        bits = bits_for(depth - 1)
        seen = Signal(range(most + 1))
        skipped = Signal(bits_for(-(-most // depth)))  # 2^e − 1 after e halvings: these bits of seen are not looked at
        turn, replayed_turn = Signal(range(max(2, bits))), Signal(range(max(2, bits)))  # e modulo bits
        looked = Signal()
        # The event that comes when it is full has the number ``depth`` of those that are looked at.
        half, even = (depth + 1) // 2, depth % 2 == 0
        m.d.comb += [
            looked.eq(self.i.valid & ((seen & skipped) == 0)),
            halved.eq(looked & full),
            self.stored.thinned.eq(seen - count),
        ]
        with m.If(self.clear):
            m.d.sync += [count.eq(0), full.eq(0), seen.eq(0), skipped.eq(0), turn.eq(0)]
        with m.Elif(self.i.valid):
            m.d.sync += seen.eq(seen + 1)
            with m.If(halved):
                m.d.sync += [
                    count.eq(half + even),
                    skipped.eq(skipped << 1 | 1),
                    turn.eq(Mux(turn == bits - 1, 0, turn + 1)),
                ]
            with m.Elif(looked):
                m.d.sync += count.eq(count + 1)
            with m.If(looked):  # not behind ``halved``, for its time
                m.d.sync += full.eq(Mux(full, half + even == depth, count == depth - 1))
        with m.If(self.take):
            m.d.sync += replayed_turn.eq(turn)

        def rotated(number, by):
            number = Cat(number, Const(0, bits))[:bits]
            for k, bit in enumerate(by):
                number = Mux(bit, number.rotate_left(1 << k), number)
            return number

        # After the halving it is number ``half``, which has to be turned once more than ``turn`` says.
        number = Mux(full, Const(half % (1 << bits), bits).rotate_left(1), count[:bits]) if even else count
        stays = looked if even else looked & ~full
        return stays, rotated(number, turn), lambda number: rotated(number, replayed_turn)

    def _subset(self, m, replayed):
        """First event and step of a replay, as :func:`cmfpga.config.schedule.used` has them.

        The first with ``replay``, the step from the next cycle on; and with ``replay`` what it will be.
        """
        iteration = Signal(2)  # of the batch, modulo 4
        subset = self.subset
        stride = Signal.like(self.stride, name="enough_for")
        m.d.comb += stride.eq(
            Mux(replayed >= 4 * FEWEST, self.stride, Mux(replayed >= 2 * FEWEST, self.stride != 0, 0))
        )
        first = select(stride, [0, iteration[0], Cat(iteration[1], iteration[0])])
        m.d.sync += self.started.eq(self.replay)
        with m.If(self.take):
            m.d.sync += iteration.eq(0)
        with m.Elif(self.replay):
            m.d.sync += [iteration.eq(iteration + 1), subset.stride.eq(stride), subset.first.eq(first)]
        return first, 1 << subset.stride, 1 << stride
