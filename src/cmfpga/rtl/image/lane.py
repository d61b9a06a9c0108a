"""Lane: the blocks from event buffer to image, of which there may be several side by side."""

from amaranth.hdl import EnableInserter, Signal
from amaranth.lib.wiring import connect

from ...protocol.settings import by_signs
from .. import payloads
from .basis import Basis
from .dither import Dither
from .time_scaler import TimeScaler
from .voter import BilinearVoter
from .warp import Warp


class Lane:
    """Dither, where there is one, scaler, warp and voter; one event a cycle.

    Parameters
    ----------
    config : Config
    number : int
        Of ``config.lanes``: that of the first event of a replay that it has.

    Attributes
    ----------
    blocks : dict
        By name, in the order of data flow.
    latency : int
    """

    def __init__(self, config, number):
        self.config, self.number = config, number
        self.blocks = {"dither": Dither(config, number)} if config.dither_frac else {}
        self.blocks |= {"time_scaler": TimeScaler(config), "warp": Warp(config), "voter": BilinearVoter(config)}
        self.latency = sum(block.latency for block in self.blocks.values())
        self.basis = Basis(config) if config.motion_model.basis else None

    @property
    def boxes(self):
        """The blocks by their names in the core."""
        basis = {"basis": self.basis} if self.basis else {}
        return {
            f"{name}_{self.number}" if self.number else name: block for name, block in (basis | self.blocks).items()
        }

    def pausing(self, block, image):
        """What is to be elaborated of a block: with other lanes, all stand still where the image has no room."""
        return EnableInserter(image.room[self.number])(block) if self.config.lanes > 1 else block

    def connect(self, m, buffer, image):
        """Into the lane and out of it."""
        replayed, votes = (payloads.by_lane(self.config, ends)[self.number] for ends in (buffer.o, image.votes))
        for name, block in self.blocks.items():
            if name == "time_scaler" and self.basis:
                m.d.comb += [getattr(self.basis, axis).eq(replayed.payload[axis]) for axis in ("x", "y")]
                m.d.comb += block.basis.eq(self.basis.o)
            connect(m, replayed, block.i)
            replayed = block.o
        connect(m, replayed, votes)

    def scale_and_warp(self, m, batch, reciprocal, v, level):
        """What is the same for all events of an iteration."""
        scaler, warp, voter = (self.blocks[name] for name in ("time_scaler", "warp", "voter"))
        if self.config.lanes > 1:
            # A register for each lane, for its wires; they begin at other values, so that no tool makes one of them.
            here = Signal.like(level, name=f"level_{self.number}", init=self.number % (1 << len(level)))
            m.d.sync += here.eq(level)
            level = here
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

    def dither_as(self, m, first):
        """The sequence of the dither is that of the ``first`` lane."""
        if self.config.dither_frac:
            m.d.comb += self.blocks["dither"].phases.eq(first.blocks["dither"].phases)

    def replay_subsets(self, m, buffer):
        """Which events a replay has, the dither knows from the buffer; only with a schedule."""
        if self.config.dither_frac and by_signs(self.config):
            dither = self.blocks["dither"]
            m.d.comb += [dither.started.eq(buffer.started), dither.subset.eq(buffer.subset)]
