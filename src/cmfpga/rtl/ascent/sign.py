"""The fast ascent: a step of the schedule up the gradient, by its sign alone."""

from amaranth.hdl import Mux, Signal, signed
from amaranth.lib.wiring import In, Out, connect, flipped

from .. import payloads
from ..arithmetic import delay
from .ascent import Ascent
from .schedule import Schedule


class SignAscent(Ascent):
    """v ← v + 2^shift · sign(G), each parameter by itself; v saturates. No multiplier, no normalisation.

    The schedule says level, shift and stride of each iteration; it has a part for batches that begin with the last v,
    and one for all others. A gradient a cycle. See :class:`Ascent` for the other members and attributes.

    Members
    -------
    schedule_write : ``In``, flow of :func:`payloads.schedule_write`
        Fills the table. Only while no batch is under way.
    stride : ``Out``
        The next replay uses one event in 2^stride; from the third cycle after ``run.take`` or ``run.updated`` on.
    """

    latency = 2

    def __init__(self, config):
        self.schedule = Schedule(config)
        members = {
            "schedule_write": In(payloads.flow(payloads.schedule_write(config))),
            "stride": Out(payloads.STRIDE_BITS),
        }
        super().__init__(config, target_bits=config.formats.v.width + 1, members=members)

    @property
    def blocks(self):
        return {"schedule": self.schedule, "ascent": self}

    def elaborate(self, platform):
        run, settings, schedule = self.run, self.run.settings, self.schedule
        # Warm only while an object is followed: a new ROI, or a batch that found nothing, begins cold.
        tracking = Signal()
        warm = Signal()
        m = self.begin(warm)
        m.submodules.schedule = schedule
        connect(m, flipped(self.schedule_write), schedule.write)
        with m.If(run.done):
            m.d.sync += tracking.eq(~run.degenerate)
        m.d.comb += warm.eq(self._unless_in_doubt(m, settings.start_last & tracking & ~settings.roi_load))
        plan = {name: Mux(warm, settings.warm[name], settings.cold[name]) for name in ("first", "count")}
        m.d.comb += [
            run.planned.eq(plan["count"]),
            schedule.new_batch.eq(run.take),
            schedule.start.eq(run.start),
            schedule.first.eq(plan["first"]),
            schedule.advance.eq(self.velocity.move),
            self.level.eq(schedule.level),
            self.limited.eq(schedule.limited),
            self.stride.eq(schedule.stride),
            self.velocity.move.eq(delay(m, self.i.valid, 1, name="valid", valid=True)),
        ]
        for name in self.config.motion.names:
            # Stage 1: sign. Stage 2: step; limited in the velocity.
            g = self.i.payload[name]
            sign_s1 = Signal(signed(2), name=f"sign_{name}_s1", reset_less=True)
            m.d.sync += sign_s1.eq(Mux(g == 0, 0, Mux(g < 0, -1, 1)))
            step = 1 << schedule.shift
            m.d.comb += self.velocity.target[name].eq(
                self.v[name] + Mux(sign_s1 == 0, 0, Mux(sign_s1 < 0, -step, step))
            )
        return m

    def _unless_in_doubt(self, m, warm):
        """``warm``, but not after a doubtful batch, if the settings say so."""
        run = self.run
        if not self.config.confidence:
            return warm
        m.d.comb += self.schedule.hold.eq(run.final)
        doubtful, restart = Signal(), Signal()
        m.d.comb += restart.eq(warm & doubtful & run.settings.cold_after_doubtful)
        with m.If(run.done):
            m.d.sync += doubtful.eq(run.doubtful)
        with m.If(run.take):
            m.d.sync += self.restarted.eq(0)
        with m.Elif(run.start):
            m.d.sync += self.restarted.eq(restart)
        return warm & ~restart
