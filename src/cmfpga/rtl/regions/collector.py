"""Collector: takes the units' outcomes, moves the regions that follow their v, and hands the results out."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out

from ...protocol.flags import Flag
from ...protocol.results import fields_of
from .. import Block
from .. import payloads as common
from ..arithmetic import is_short, select
from ..confidence.verdict import Verdict
from . import payloads
from .distributor import place_of

#: What happens to roi_gain·v in a cycle.
CLEAR, ADD = 1, 2


class Collector(Block):
    """One outcome after the other; the lowest unit that has one comes first. Those of a batch wait for the one before.

    Each takes :attr:`latency` cycles or less, in which v's confidence is judged, if that is asked.

    A region that moves goes by roi_gain·v, limited to the sensor, a bit of the gain a cycle, as in
    :class:`~cmfpga.rtl.ascent.roi_updater.RoiUpdater`.

    Members
    -------
    units : ``In``, array of streams of :func:`payloads.outcome`
    begins : ``In(1)``
        A batch begins: none of its regions has been measured. Only after ``begun``.
    batch : ``In``, :func:`~cmfpga.rtl.payloads.batch`
        With ``begins``, and until ``begun``.
    turn : ``In(1)``
        The batch's, as long.
    number : ``Out``
        Whose row is looked up.
    row, state : ``In``, :func:`payloads.row`, :func:`payloads.state`
        Of that number, two cycles later.
    write : ``Out``, flow of ``{number, state}``
        What is kept from now on.
    o : ``Out``, stream of :func:`payloads.region_result`
    begun : ``Out(1)``
        All results of the batches before have been taken.
    takes_over : ``Out(1)``
        That is so from now on: the results that come are those of the batch that began last. One cycle.
    """

    def __init__(self, config):
        # Units judge motions beyond a translation themselves, as the probes come.
        self._verdict = Verdict(config) if config.confidence and not config.motion_model.basis else None
        judging = self._verdict.latency + 1 if self._verdict else 0
        self.latency = 6 + max(config.formats.roi_gain.width + 3, judging)
        kept = data.StructLayout({"number": config.store.number_bits, "state": payloads.state(config)})
        super().__init__(
            config,
            units=In(stream.Signature(payloads.outcome(config))).array(config.units),
            begins=In(1),
            batch=In(common.batch(config)),
            turn=In(1),
            number=Out(config.store.number_bits),
            row=In(payloads.row(config)),
            state=In(payloads.state(config)),
            write=Out(common.flow(kept)),
            o=Out(stream.Signature(payloads.region_result(config))),
            **dict.fromkeys(("begun", "takes_over"), Out(1)),
        )

    def elaborate(self, platform):
        config, units = self.config, list(self.units)
        m = Module()
        # Of the outcomes that are taken now; those of the batch behind it wait in their units.
        batch, turn, waiting = Signal(self.batch.shape(), name="batch"), Signal(name="turn_now"), Signal()
        chosen = Signal(range(max(2, len(units))))
        outcome = Signal(payloads.outcome(config))
        m.d.sync += outcome.eq(select(chosen, [unit.payload.as_value() for unit in units]))
        row, state = Signal(payloads.row(config)), Signal(payloads.state(config))
        after = Signal(payloads.state(config))
        timer = Signal(range(max(4, len(self.batch.settings.roi_gain))))
        done, last = Signal(config.store.number_bits + 1), Signal()
        gain, steps, limits = Signal.like(batch.settings.roi_gain), Signal(2), {}
        moves, begin = row.moves & ~outcome.degenerate, Signal()
        offered = Cat(unit.valid & (unit.payload.turn == turn) for unit in units)
        decided, doubtful = self._judge(m, outcome, begin)
        with m.If(self.begins):
            m.d.sync += waiting.eq(1)
        with m.Elif(self.takes_over):
            m.d.sync += [waiting.eq(0), done.eq(0), batch.eq(self.batch), turn.eq(self.turn)]
        m.d.comb += [
            self.number.eq(outcome.number),
            self.begun.eq(~waiting),
            self.takes_over.eq(waiting & (done >= batch.settings.rows)),
            self.write.payload.number.eq(outcome.number),
            self.write.payload.state.eq(after),
        ]
        m.d.sync += timer.eq(timer - 1)
        with m.FSM(name="collect"):
            with m.State("IDLE"):
                for number in reversed(range(len(units))):
                    with m.If(offered[number]):
                        m.d.sync += chosen.eq(number)
                m.d.sync += timer.eq(3)
                with m.If(offered.any()):
                    m.next = "LOOK"
            with m.State("LOOK"):
                m.d.comb += [steps.eq(CLEAR), begin.eq(timer == 0)]
                m.d.sync += gain.eq(batch.settings.roi_gain)
                with m.If(timer == 0):
                    m.d.sync += [row.eq(self.row), state.eq(self.state), timer.eq(len(gain) - 1)]
                    m.next = "MOVE"
            with m.State("MOVE"):
                m.d.comb += steps.eq(ADD)
                m.d.sync += [gain.eq(gain << 1), last.eq(done + 1 >= batch.settings.rows)]
                with m.If(timer == 0):
                    m.d.sync += timer.eq(2)
                    m.next = "LIMIT"
            with m.State("LIMIT"):
                with m.If((timer == 0) & decided):
                    m.next = "KEEP"
            with m.State("KEEP"):
                m.d.comb += self.write.valid.eq(1)
                m.next = "OFFER"
            with m.State("OFFER"):
                m.d.comb += self.o.valid.eq(1)
                with m.If(self.o.ready):
                    m.d.comb += [unit.ready.eq(chosen == number) for number, unit in enumerate(units)]
                    m.d.sync += done.eq(done + 1)
                    m.next = "IDLE"
        m.d.comb += [
            after.v.eq(Mux(outcome.degenerate, state.v.as_value(), outcome.v.as_value())),
            after.followed.eq(~outcome.degenerate),
            after.turn.eq(turn),
        ]
        m.d.comb += after.doubtful.eq(doubtful)
        for axis, sensor in zip("xy", config.geometry.size, strict=True):
            size = (row.end[axis] - row.begin[axis]).as_unsigned()[: len(row.end[axis])]
            moved, limits[axis] = self._moved(
                m, axis, outcome.v[axis], state.position[axis], gain[-1], steps, sensor, size
            )
            m.d.comb += after.position[axis].eq(Mux(moves, moved, state.position[axis]))
        self._result(m, batch, outcome, state, after, last, moves & (limits["x"] | limits["y"]))
        return m

    def _judge(self, m, outcome, begin):
        """Whether v is in doubt: (it is known, it is)."""
        if not self._verdict:
            return Const(1, 1), outcome.flags[Flag.DOUBTFUL.bit_length() - 1] if self.config.confidence else Const(0, 1)
        m.submodules.verdict = verdict = self._verdict
        asked, decided = outcome.confidence_limit != 0, Signal()
        m.d.comb += [
            verdict.begin.eq(begin & asked),
            verdict.sum_i.eq(outcome.sums.i),
            verdict.squares.eq(outcome.sum_squares),
            verdict.curvature.eq(outcome.curvature),
            verdict.events.eq(outcome.roi_events),
            verdict.limit.eq(outcome.confidence_limit),
        ]
        with m.If(begin | verdict.done):
            m.d.sync += decided.eq(verdict.done | ~asked)
        return decided, verdict.doubtful & asked

    def _moved(self, m, axis, v, position, bit, steps, sensor, size):
        """Where the region goes along an axis, three cycles after the last bit of the gain; was that limited?"""
        frac = self.config.v_frac + self.config.roi_gain_frac
        step = Signal(signed(len(v) + len(self.batch.settings.roi_gain)), name=f"step_{axis}")
        target = Signal(signed(max(len(position), len(step)) + 2), name=f"target_{axis}", reset_less=True)
        room, moved = Signal(signed(len(size) + 14), name=f"room_{axis}"), Signal.like(position, name=f"moved_{axis}")
        largest, limited = Signal(len(position), name=f"largest_{axis}"), Signal(name=f"limited_{axis}")
        m.d.comb += room.eq(sensor - size)
        m.d.sync += [
            largest.eq(Mux(room < 0, 0, room) << frac),
            target.eq(position + step),
            moved.eq(Mux(target < 0, 0, Mux(target > largest, largest, target))),
            limited.eq((target < 0) | (target > largest)),
        ]
        with m.If(steps == CLEAR):
            m.d.sync += step.eq(0)
        with m.Elif(steps == ADD):
            m.d.sync += step.eq((step << 1) + Mux(bit, v, 0))
        return moved, limited

    def _result(self, m, batch, outcome, state, after, last, clamped):
        result = self.o.payload
        units = set(outcome.shape().members)
        fields = fields_of("batch", "region", config=self.config)
        dropped = [f.name for f in fields if f.counts and f.scope == "batch"]
        # Those that were stored, or lay off the sensor; less those in the region.
        outside, lost = Signal.like(result.outside), Signal.like(result.outside)
        m.d.sync += lost.eq(sum((batch[name] for name in dropped[1:]), batch[dropped[0]]))
        m.d.sync += outside.eq(batch.events - lost - outcome.outside)
        flags = {
            Flag.TIME_BACK: batch.time_back != 0,
            Flag.TIME_SPAN: batch.time_span != 0,
            Flag.CUT: batch.cut,
            Flag.ROI_CLAMPED: clamped,
        }
        if self.config.confidence:
            flags[Flag.DOUBTFUL] = after.doubtful
            flags[Flag.SHORT] = is_short(m, outcome.v) & ~outcome.degenerate
        more = {"roi": place_of(state.position), "roi_next": place_of(after.position)}
        m.d.comb += [result.region.eq(outcome.number), result.last.eq(last)]
        for field in fields:
            if field.name in more:
                m.d.comb += [result[field.name][axis].eq(value) for axis, value in more[field.name].items()]
            elif field.name == "v":
                m.d.comb += result.v.eq(after.v)
            elif field.name == "outside":
                m.d.comb += result.outside.eq(outside)
            elif field.name == "flags":
                m.d.comb += result.flags.eq(outcome.flags)
                m.d.comb += [result.flags[flag.bit_length() - 1].eq(value) for flag, value in flags.items()]
            else:
                m.d.comb += result[field.name].eq((outcome if field.name in units else batch)[field.name])
