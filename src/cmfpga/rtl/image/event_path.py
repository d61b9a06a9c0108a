"""Event path: the blocks from event buffer to image."""

from amaranth.lib.wiring import connect

from .basis import Basis
from .dither import Dither
from .time_scaler import TimeScaler
from .voter import BilinearVoter
from .warp import Warp


class EventPath:
    """Dither, where there is one, scaler, warp and voter; one event a cycle.

    Parameters
    ----------
    config : Config

    Attributes
    ----------
    blocks : dict
        By name, in the order of data flow.
    latency : int
    """

    def __init__(self, config):
        self.config = config
        self.blocks = {"dither": Dither(config)} if config.dither_frac else {}
        self.blocks |= {"time_scaler": TimeScaler(config), "warp": Warp(config), "voter": BilinearVoter(config)}
        self.latency = sum(block.latency for block in self.blocks.values())
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
        connect(m, replayed, image.votes)

    def scale_and_warp(self, m, batch, reciprocal, v, level):
        """What is the same for all events of an iteration."""
        scaler, warp, voter = (self.blocks[name] for name in ("time_scaler", "warp", "voter"))
        m.d.comb += [
            scaler.span.eq(batch.span),
            scaler.shift.eq(reciprocal.shift),
            scaler.mantissa.eq(reciprocal.mantissa),
            warp.v.eq(v),
            warp.level.eq(level),
            voter.level.eq(level),
        ]
        if hasattr(self.basis, "centre"):
            m.d.comb += [
                self.basis.centre.eq(batch.settings.centre),
                self.basis.curve.eq(batch.settings.curve),
                self.basis.corner.eq(batch.roi),
            ]

    def look_from(self, m, job):
        """Where a region has the middle that its motion is about."""
        for block in (self.basis, self.blocks["voter"]):
            if hasattr(block, "middle"):
                m.d.comb += block.middle.eq(job.middle)

    def replay_subsets(self, m, buffer):
        """Which events a replay has, the dither knows from the buffer; only with a schedule."""
        if self.config.dither_frac:
            dither = self.blocks["dither"]
            m.d.comb += [dither.started.eq(buffer.started), dither.subset.eq(buffer.subset)]
