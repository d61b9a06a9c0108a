"""Store: takes a batch's events in, bin by bin, and reads the bins of the one before."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out

from ...config.regions import PAGE_EVENTS
from ...fixed import bits_for
from .. import Block
from ..arithmetic import delay
from ..image.sliced_memory import memory_of
from ..payloads import flow
from ..read_modify_write import ReadModifyWrite
from .payloads import bin_entry, stored_event

#: Bits of an event's place on its page.
SLOT_BITS = bits_for(PAGE_EVENTS - 1)


class BinTable(ReadModifyWrite):
    """How many events each bin has, and the page that its next one lies on, unless that page is full.

    An operation with ``one`` counts an event; one without only reads. See :class:`ReadModifyWrite` for throughput,
    latency and the other members.

    Members
    -------
    page : ``In``
        The next page that is free.
    allocates : ``Out(1)``
        It is taken, :attr:`latency` − 1 cycles after the operation that needs it.
    """

    def __init__(self, config):
        super().__init__(
            data.StructLayout({"entry": bin_entry(config)}), data.StructLayout({"one": 1}), config.store.bins
        )
        self.page, self.allocates = Signal(bits_for(config.store.pages)), Signal()
        self._fresh = Signal()

    def changed(self, name, before, operand):
        after = Signal(before.shape(), name="after")
        return after, [
            self._fresh.eq(before.count[:SLOT_BITS] == 0),
            after.count.eq(before.count + operand.one),
            after.page.eq(Mux(self._fresh & operand.one, self.page, before.page)),
        ]

    def elaborate(self, platform):
        m = super().elaborate(platform)
        one = delay(m, self.i.valid & self.i.payload.add.one & ~self.i.payload.clear, 2, name="one", valid=True)
        m.d.comb += self.allocates.eq(one & self._fresh)
        return m


class Half(Block):
    """One batch: pages of :data:`~cmfpga.config.regions.PAGE_EVENTS` events, linked bin by bin.

    Filling takes an event per cycle, which lies in its page :attr:`latency` cycles later. Reading takes a bin's address
    when it has looked the one before up, and gives an event per cycle, those of a bin in the order in which they came;
    between bins there is a cycle's pause, and an empty one costs four.

    Members
    -------
    i : ``In``, flow of :func:`payloads.stored_event`
        Only after a :attr:`clear`, and while nothing is read.
    clear : ``In(1)``
        Forget all events, which takes as many cycles as there are bins; none may come, or be read.
    cleared : ``Out(1)``
        Nothing is stored, and nothing is being cleared; right from the cycle after ``clear`` on.
    read : ``In``, stream of a bin's address
    o : ``Out``, flow of :func:`payloads.stored_event`
    busy : ``Out(1)``
        Events of what was asked for may still come.
    """

    latency = ReadModifyWrite.latency + 2

    def __init__(self, config):
        self._address = bits_for(config.store.bins - 1)
        super().__init__(
            config,
            i=In(flow(stored_event(config))),
            clear=In(1),
            cleared=Out(1),
            read=In(stream.Signature(self._address)),
            o=Out(flow(stored_event(config))),
            busy=Out(1),
        )

    def elaborate(self, platform):
        config, store = self.config, self.config.store
        m = Module()
        m.submodules.bins = bins = BinTable(config)
        pages = bits_for(store.pages - 1)
        memories = {
            "events": (stored_event(config), store.pages * PAGE_EVENTS),
            "link": (pages, store.pages),  # of a full page: the one behind it
            "head": (pages, store.bins),
        }
        write, read = {}, {}
        for name, (shape, depth) in memories.items():
            style = {"ram_style": config.store_style} if (name, config.store_style) == ("events", "ultra") else {}
            m.submodules[name] = ram = memory_of(shape, max(2, depth), style)
            write[name], read[name] = ram.write_port(), ram.read_port()

        # Clear: a word a cycle.
        clearing, at = Signal(), Signal(range(max(2, store.bins)))
        with m.If(self.clear):
            m.d.sync += [clearing.eq(1), at.eq(0), bins.page.eq(0)]
        with m.Elif(clearing):
            m.d.sync += [at.eq(at + 1), clearing.eq(at != store.bins - 1)]
        m.d.comb += self.cleared.eq(~clearing)

        # Fill. The table tells where an event goes.
        frac, bits = config.formats.event_frac, config.bin_bits
        event = self.i.payload
        address = Cat((event.x >> (frac + bits))[: store.column_bits], event.y >> (frac + bits))
        operation = bins.i.payload
        m.d.comb += [
            bins.i.valid.eq(clearing | self.i.valid | self.read.valid),
            operation.address.eq(Mux(clearing, at, Mux(self.i.valid, address, self.read.payload))),
            operation.clear.eq(clearing),
            operation.add.one.eq(self.i.valid),
        ]
        with m.If(bins.allocates):
            m.d.sync += bins.page.eq(bins.page + 1)
        stored = delay(m, self.i.valid, bins.latency, name="stored", valid=True)
        event = delay(m, event, bins.latency, name="event")
        address = delay(m, address, bins.latency, name="address")
        allocated = delay(m, bins.page, 1, name="allocated")
        before = bins.o.payload.entry
        fresh = before.count[:SLOT_BITS] == 0
        page = Mux(fresh, allocated, before.page)[:pages]
        m.d.sync += [
            write["events"].en.eq(stored),
            write["events"].addr.eq(Cat(before.count[:SLOT_BITS], page)),
            write["events"].data.eq(event),
            write["link"].en.eq(stored & fresh & (before.count != 0)),
            write["link"].addr.eq(before.page),
            write["link"].data.eq(allocated),
            write["head"].en.eq(stored & (before.count == 0)),
            write["head"].addr.eq(address),
            write["head"].data.eq(allocated),
        ]
        self._read(m, bins, read)
        return m

    def _read(self, m, bins, read):
        """Look a bin up while the one before is read."""
        looking, known = Signal(), Signal()
        asked = self.read.valid & self.read.ready
        # Less two, so that the sign says that only one event is left.
        of_bin = bins.o.payload.entry.count
        count, left = Signal(signed(len(of_bin) + 1)), Signal(signed(len(of_bin) + 1))
        page = Signal(len(read["link"].data))
        slot = Signal(SLOT_BITS)
        walking, begins = Signal(), Signal()
        m.d.comb += [
            self.read.ready.eq(~(looking | known)),
            read["head"].addr.eq(self.read.payload),
            begins.eq(known & (~walking | left[-1])),
        ]
        head = Signal.like(page)
        with m.If(delay(m, asked, 1, name="asked", valid=True)):
            m.d.sync += head.eq(read["head"].data)
        found = delay(m, asked, bins.latency, name="found", valid=True)
        with m.If(asked):
            m.d.sync += looking.eq(1)
        with m.If(found):
            m.d.sync += [looking.eq(0), known.eq(of_bin != 0), count.eq(of_bin - 2)]
        with m.Elif(begins):
            m.d.sync += known.eq(0)
        with m.If(begins):
            m.d.sync += [walking.eq(1), left.eq(count), page.eq(head), slot.eq(0)]
        with m.Elif(walking):
            m.d.sync += [walking.eq(~left[-1]), left.eq(left - 1), slot.eq(slot + 1)]
            with m.If(slot == PAGE_EVENTS - 1):
                m.d.sync += page.eq(read["link"].data)
        m.d.comb += [
            read["events"].addr.eq(Cat(slot, page)),
            read["link"].addr.eq(page),
            self.o.valid.eq(delay(m, walking, 2, name="walking", valid=True)),
            self.o.payload.eq(delay(m, read["events"].data, 1, name="output")),
        ]
        flying = Signal()
        m.d.sync += flying.eq(walking)
        m.d.comb += self.busy.eq(looking | known | walking | flying | self.o.valid)


class Store(Block):
    """Two batches: one is filled while the other is read.

    Throughput and latencies are those of :class:`Half`.

    Members
    -------
    i, o, read, busy
        As those of the half that is filled, and of the one that is read; ``o`` and ``busy`` a cycle later.
    open : ``In(1)``
        Begin to fill the other half, which is clear. No event in this cycle.
    take : ``In(1)``
        What was filled is what will be read.
    clear : ``In(1)``
        Forget what is read; ``reset`` : both.
    cleared : ``Out(1)``
        Nothing is being cleared; right from the cycle after ``clear`` or ``reset`` on.
    """

    latency = Half.latency

    def __init__(self, config):
        self._halves = [Half(config) for _ in range(2)]
        half = self._halves[0].signature.members
        super().__init__(
            config,
            **{name: half[name] for name in ("i", "o", "read", "busy", "cleared")},
            **dict.fromkeys(("open", "take", "clear", "reset"), In(1)),
        )

    def elaborate(self, platform):
        m = Module()
        filling, reading = Signal(), Signal()
        with m.If(self.open):
            m.d.sync += filling.eq(~filling)
        with m.If(self.take):
            m.d.sync += reading.eq(filling)
        for number, half in enumerate(self._halves):
            m.submodules[f"half_{number}"] = half
            fills, reads = filling == number, reading == number
            m.d.comb += [
                half.i.payload.eq(self.i.payload),
                half.i.valid.eq(self.i.valid & fills),
                half.clear.eq(self.reset | (self.clear & reads)),
                half.read.payload.eq(self.read.payload),
                half.read.valid.eq(self.read.valid & reads),
            ]
        first, second = self._halves
        m.d.comb += [
            self.cleared.eq(first.cleared & second.cleared),
            self.read.ready.eq(Mux(reading, second.read.ready, first.read.ready)),
        ]
        # Registers, for the wires from memories that lie far apart.
        m.d.sync += [
            self.o.valid.eq(Mux(reading, second.o.valid, first.o.valid)),
            self.o.payload.eq(Mux(reading, second.o.payload.as_value(), first.o.payload.as_value())),
            self.busy.eq(Mux(reading, second.busy, first.busy)),
        ]
        return m
