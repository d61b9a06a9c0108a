"""Event path: the blocks from event buffer to image."""

from amaranth.lib.wiring import connect

from ..sliding.placer import Placer, placed_event
from .basis import Basis
from .dither import Dither
from .evaluators import Evaluators
from .time_scaler import TimeScaler
from .voter import BilinearVoter
from .warp import Warp


class EventPath:
    """Dither, where there is one, or placer, scaler, warp and voter, or in place of these evaluators; an event a cycle.

    Attributes
    ----------
    blocks : dict
        By name, in the order of data flow.
    latency : int
    evaluating : int
        Cycles of it in which an event has a velocity.
    """

    def __init__(self, config):
        self.config = config
        self.blocks = {"dither": Dither(config)} if config.dither_frac else {}
        rounds = config.ascent_rule.evaluations > 1
        if config.slides:
            self.blocks = {"placer": Placer(config)}
            scaler = TimeScaler(config, placed_event(config))
            last = {"evaluators": Evaluators(config, scaler.o.payload.shape())}
        else:
            scaler = TimeScaler(config)
            last = (
                {"evaluators": Evaluators(config)} if rounds else {"warp": Warp(config), "voter": BilinearVoter(config)}
            )
        self.blocks |= {"time_scaler": scaler, **last}
        self.latency = sum(block.latency for block in self.blocks.values())
        self.evaluating = sum(block.latency for block in last.values())
        self.basis = Basis(config) if config.motion_model.basis else None

    @property
    def boxes(self):
        """The blocks by their names in the core."""
        return ({"basis": self.basis} if self.basis else {}) | self.blocks

    def connect(self, m, buffer, image):
        """Into the path and out of it."""
        replayed = buffer.o
        for name, block in self.blocks.items():
            if name == "time_scaler" and self.basis:
                m.d.comb += [getattr(self.basis, axis).eq(replayed.payload[axis]) for axis in ("x", "y")]
                m.d.comb += block.basis.eq(self.basis.o)
            connect(m, replayed, block.i)
            replayed = block.o
        votes = [replayed] if "voter" in self.blocks else list(replayed)
        for each, taken in zip(votes, [image.votes] if len(votes) == 1 else image.votes, strict=True):
            connect(m, each, taken)

    def scale_and_warp(self, m, batch, reciprocal, v, ascent):
        """What is the same for all events of an iteration."""
        scaler, level = self.blocks["time_scaler"], ascent.level
        m.d.comb += [
            scaler.span.eq(batch.span),
            scaler.shift.eq(reciprocal.shift),
            scaler.mantissa.eq(reciprocal.mantissa),
        ]
        if evaluators := self.blocks.get("evaluators"):
            m.d.comb += [evaluators.centre.eq(v), evaluators.distance.eq(ascent.distance), evaluators.level.eq(level)]
        else:
            warp, voter = self.blocks["warp"], self.blocks["voter"]
            m.d.comb += [warp.v.eq(v), warp.level.eq(level), voter.level.eq(level)]
        if hasattr(self.basis, "centre"):
            m.d.comb += [
                self.basis.centre.eq(batch.settings.centre),
                self.basis.curve.eq(batch.settings.curve),
                self.basis.corner.eq(batch.roi),
            ]

    def look_from(self, m, job):
        """Where a region has the middle that its motion is about."""
        for block in (self.basis, self.blocks.get("voter")):
            if hasattr(block, "middle"):
                m.d.comb += block.middle.eq(job.middle)

    def replay_subsets(self, m, buffer):
        """Which events a replay has, the dither knows from the buffer; only with a schedule."""
        if self.config.dither_frac:
            dither = self.blocks["dither"]
            m.d.comb += [dither.started.eq(buffer.started), dither.subset.eq(buffer.subset)]
