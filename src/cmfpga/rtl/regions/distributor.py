"""Distributor: goes through its rows of the table of regions, and gives each region's events to a unit."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for, round_half_up
from ...protocol.regions import STARTS
from .. import Block
from .. import payloads as common
from ..arithmetic import delay
from . import payloads


def place_of(position):
    """Left column and top row of a region, rounded to whole pixels."""
    return {axis: round_half_up(position[axis], shape.q.f) for axis, shape in position.shape().members.items()}


class Distributor(Block):
    """Row by row, in a state machine; one of several has every so manyth row.

    IDLE
        Wait for a batch.
    DIVIDE
        Wait for the reciprocal of its time range.
    ROW, START
        Read a row of the table and what is kept of its region, which must have been measured in the batch before; then
        that of the region whose v it starts with, which must have been measured in this one.
    UNIT
        Wait for a unit that can be loaded; one that is idle comes first.
    BINS
        Ask for the bins that the region overlaps, row by row.
    DRAIN
        Wait for their events, which are cropped; hand the region over.
    CLEAR
        All its rows are handed over: forget the events, while the last ones are iterated.
    REST
        Wait until the outcomes are those of this batch, so that no more than two are under way.

    A region of n events in b bins takes n' + b + 16 cycles or less, two more with a parent, n' being the events in all
    its bins and an empty bin counting as five, and more only while it waits for a unit, for its parent, or for its own
    outcome in the batch before.

    Parameters
    ----------
    config : Config
        With ``store.readers`` distributors.
    first : int
        Its first row; the next one is ``readers`` further.

    Members
    -------
    take : ``In(1)``
        A batch is complete; not while it is not ``free``.
    free : ``Out(1)``
    settings : ``In``, :func:`~cmfpga.rtl.payloads.settings`
        Of the batch, from the cycle after ``take``.
    divide : ``Out(1)``, divided : ``In(1)``
        Begin to divide; the units' times are right.
    number : ``Out``
        Whose row is looked up.
    row, state : ``In``, :func:`payloads.row`, :func:`payloads.state`
        Of that number, two cycles later.
    turn : ``Out(1)``
        Changes from batch to batch.
    read, events, busy
        As those of the store.
    clear : ``Out(1)``, cleared : ``In(1)``
        Of the store.
    o : ``Out``, flow of :func:`~cmfpga.rtl.payloads.roi_event`
        Events of a region; position in the unit's image.
    ready, idle : ``In``
        A bit for each unit.
    may : ``In(1)``
        A unit may be begun. With several distributors in turn, so that no two begin the same one.
    begin, commit : ``Out``
        A bit for each unit; one cycle.
    job : ``Out``, :func:`payloads.job`
        With ``commit``.
    begun : ``In(1)``
        All outcomes of the batch before have been taken.
    """

    def __init__(self, config, first=0):
        self._first = first
        units, bins = config.units, bits_for(config.store.bins - 1)
        super().__init__(
            config,
            **dict.fromkeys(("take", "divided", "busy", "cleared", "begun"), In(1)),
            **dict.fromkeys(("free", "divide", "turn", "clear"), Out(1)),
            may=In(1, init=1),
            settings=In(common.settings(config)),
            number=Out(config.store.number_bits),
            row=In(payloads.row(config)),
            state=In(payloads.state(config)),
            read=Out(stream.Signature(bins)),
            events=In(common.flow(payloads.stored_event(config))),
            o=Out(common.flow(common.roi_event(config))),
            **dict.fromkeys(("ready", "idle"), In(units)),
            **dict.fromkeys(("begin", "commit"), Out(units)),
            job=Out(payloads.job(config)),
        )

    def elaborate(self, platform):
        config, store = self.config, self.config.store
        m = Module()
        row, state, job = Signal(payloads.row(config)), Signal(payloads.state(config)), self.job
        settings = self.settings
        current = Signal(store.number_bits)  # the row that is being looked at
        timer = Signal(range(8))
        unit = Signal(config.units)  # one-hot: that which is loaded
        # One that is idle, else one that can be loaded: the lowest. Registers, for a unit stays so until it is loaded.
        ready, idle = Signal.like(self.ready), Signal.like(self.idle)
        m.d.sync += [ready.eq(self.ready), idle.eq(self.ready & self.idle)]
        free = Mux(idle.any(), idle, ready)
        chosen = free & (~free + 1)[: config.units]

        source = self.state
        warm, restarted = Signal(), Signal()
        of_parent, measured = Signal(), Signal()
        given = row.start == STARTS.index("given")
        wanted = source.followed & ~given
        doubtful = source.doubtful & settings.cold_after_doubtful if config.confidence else Const(0, 1)
        corner, last_bin, place, column, line = self._geometry(m, row, state)
        # Registers, for much hangs on them: the store looks a bin up for longer than they take.
        within, last_column, last_of_all, compared, last_row = Signal(), Signal(), Signal(), Signal(), Signal()
        # Of the row that is given out, while the next one is looked up: that it was the last, that it is past.
        was_last, given_out = Signal(), Signal()
        m.d.sync += [
            last_row.eq(current + store.readers >= settings.rows),
            within.eq((column <= last_bin["x"]) & (line <= last_bin["y"])),
            last_column.eq(column >= last_bin["x"]),
            last_of_all.eq((column >= last_bin["x"]) & (line >= last_bin["y"])),
            compared.eq(1),
        ]
        reading, steps = Signal(), Signal()  # in BINS
        m.d.comb += [
            self.read.valid.eq(reading & compared & within),
            steps.eq(reading & compared & (self.read.ready | ~within)),
        ]
        with m.If(steps):
            m.d.sync += [column.eq(column + 1), compared.eq(0)]
            with m.If(last_column):
                m.d.sync += [column.eq(place["x"][config.bin_bits :]), line.eq(line + 1)]
        m.d.comb += self.number.eq(Mux(of_parent, row.parent, current))
        m.d.sync += timer.eq(Mux(timer == 0, 0, timer - 1))
        # Of the number three cycles ago. It has to be seen twice: what a RAM returns while it is written is not said.
        there = Signal()
        m.d.sync += there.eq(source.turn != self.turn)

        def look():
            """While the number is the current one."""
            with m.If(measured & there):
                m.d.sync += [row.eq(self.row), state.eq(self.state), timer.eq(3)]
                m.d.sync += of_parent.eq(self.row.start == STARTS.index("parent"))
                m.next = "START"

        with m.FSM(name="distribute"):
            with m.State("IDLE"):
                m.d.comb += self.free.eq(1)
                m.d.sync += [current.eq(self._first), of_parent.eq(0)]
                with m.If(self.take):
                    m.d.sync += self.turn.eq(~self.turn)
                    m.next = "TAKEN"
            with m.State("TAKEN"):
                m.d.comb += self.divide.eq(1)
                m.next = "DIVIDE"
            with m.State("DIVIDE"):
                m.d.sync += [timer.eq(3), measured.eq(0)]
                with m.If(self.divided):
                    m.next = "ROW"
                    m.d.comb += self.clear.eq(settings.rows <= self._first)
                    with m.If(self.clear):  # no row is its own
                        m.next = "CLEAR"
            with m.State("ROW"):
                m.d.sync += measured.eq((timer == 0) & there)
                look()
            with m.State("START"):
                m.d.sync += measured.eq((timer == 0) & ~there)
                m.d.sync += [first.eq(place[axis][config.bin_bits :]) for axis, first in (("x", column), ("y", line))]
                with m.If(Mux(of_parent, measured & ~there, timer <= 1)):
                    m.d.sync += [warm.eq(wanted & ~doubtful), restarted.eq(wanted & doubtful)]
                    m.next = "UNIT"
            with m.State("UNIT"):
                v_start = Mux(warm, source.v.as_value(), settings.v_start.as_value())
                m.d.sync += [
                    job.settings.eq(settings),
                    job.settings.start_last.eq(0),  # v_start says it
                    job.settings.v_start.eq(v_start),
                    job.settings.cold.eq(Mux(warm, row.warm.as_value(), row.cold.as_value())),
                    job.number.eq(current),
                    job.turn.eq(self.turn),
                    job.stride.eq(row.stride),
                    job.restarted.eq(restarted),
                    measured.eq(0),
                ]
                for axis in ("x", "y") if "middle" in job.shape().members else ():
                    m.d.sync += job.middle[axis].eq(row.begin[axis] + row.end[axis] - 1)
                with m.If(free.any() & self.may):
                    m.d.comb += self.begin.eq(chosen)
                    m.d.sync += [unit.eq(chosen), reading.eq(1)]
                    m.next = "BINS"
            with m.State("BINS"):
                m.d.sync += [timer.eq(5), given_out.eq(0)]
                with m.If(steps & last_of_all):
                    m.d.sync += reading.eq(0)
                    m.next = "DRAIN"
            with m.State("DRAIN"):  # long enough for the next row to be looked up
                m.d.sync += [measured.eq(there), given_out.eq(1)]
                with m.If(~given_out):
                    m.d.sync += [was_last.eq(last_row), current.eq(current + store.readers), of_parent.eq(0)]
                with m.If(self.busy):
                    m.d.sync += timer.eq(4)
                with m.Elif(timer == 0):
                    m.d.comb += self.commit.eq(unit)
                    m.next = "ROW"
                    with m.If(was_last):
                        m.d.comb += self.clear.eq(1)
                        m.next = "CLEAR"
                    with m.Else():
                        look()
            with m.State("CLEAR"):
                with m.If(self.cleared):
                    m.next = "REST"
            with m.State("REST"):
                with m.If(self.begun):
                    m.next = "IDLE"
        m.d.comb += self.read.payload.eq(Cat(column[: store.column_bits], line))
        self._crop(m, row, corner)
        return m

    def _geometry(self, m, row, state):
        """Registers that follow from row and state: where the image lies, the last bins, the region's place."""
        config = self.config
        corner, last_bin, place = {}, {}, {}
        grid = {"x": config.store.columns, "y": config.store.rows}
        sizes = {"x": config.geometry.x_bits, "y": config.geometry.y_bits}
        for axis, at in place_of(state.position).items():
            bits = sizes[axis]
            place[axis] = Signal(bits, name=f"place_{axis}")
            corner[axis] = Signal(signed(bits + 1), name=f"corner_{axis}")
            last_bin[axis] = Signal(bits_for(grid[axis] - 1), name=f"last_bin_{axis}")
            last = Signal(bits + 1, name=f"last_{axis}")
            m.d.sync += [
                place[axis].eq(at),
                corner[axis].eq(at - row.begin[axis]),
                last.eq(at + (row.end[axis] - row.begin[axis]).as_unsigned()[: bits + 1] - 1),
            ]
            beyond = last[config.bin_bits :]
            m.d.sync += last_bin[axis].eq(Mux(beyond > grid[axis] - 1, grid[axis] - 1, beyond))
        column = Signal(len(last_bin["x"]) + 1, name="column")
        line = Signal(len(last_bin["y"]) + 1, name="line")
        return corner, last_bin, place, column, line

    def _crop(self, m, row, corner):
        """Events of the bins that lie in the region, by its stride: where it lies in the image, then whether inside."""
        frac = self.config.formats.event_frac
        event, inside = self.events.payload, Const(1, 1)
        stage_2 = Signal(self.o.payload.shape(), reset_less=True)
        for axis in ("x", "y"):
            moved = (event[axis] - Cat(Const(0, frac), corner[axis]).as_signed()).as_signed()
            moved_s1 = delay(m, moved, 1, name=f"moved_{axis}").as_signed()
            whole = moved_s1[frac:].as_signed()
            inside &= (whole >= row.begin[axis]) & (whole < row.end[axis])
            m.d.sync += stage_2[axis].eq(moved_s1[: len(stage_2[axis])])
        m.d.sync += stage_2.t.eq(delay(m, event.t, 1, name="time"))
        valid_s1 = delay(m, self.events.valid, 1, name="event", valid=True)
        valid_s2 = delay(m, valid_s1 & inside, 1, name="inside", valid=True)
        found = self.job.found
        skipped = Signal(1 << len(row.stride))
        m.d.sync += skipped.eq((1 << row.stride) - 1)
        with m.If(self.begin.any()):
            m.d.sync += found.eq(0)
        with m.Elif(valid_s2):
            m.d.sync += found.eq(found + 1)
        m.d.sync += [self.o.valid.eq(valid_s2 & ((found & skipped) == 0)), self.o.payload.eq(stage_2)]
