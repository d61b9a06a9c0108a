"""The fast way to sum: the sums grow with every vote, and are complete with the last one."""

from amaranth.hdl import Module, Signal
from amaranth.lib.wiring import connect, flipped

from ...errors import ConfigError
from ..arithmetic import select
from .image_sums import ImageSums
from .one_pass_gradient import OnePassGradient
from .tagged_accumulator import TaggedAccumulator


class OnePassImage(ImageSums):
    """Tagged accumulator and one-pass gradient: no sweep, and another tag for the next iteration.

    For translation only: :class:`OnePassGradient` relies on the opposite derivatives of an event's votes.

    See :class:`ImageSums` for parameters, members and attributes.
    """

    def __init__(self, config, *, in_flight):
        self.tagged_accumulator = TaggedAccumulator(config)
        self.one_pass_gradient = OnePassGradient(config, accumulator_latency=self.tagged_accumulator.latency)
        self.latency, self.lead = self.one_pass_gradient.latency, self.one_pass_gradient.lead
        super().__init__(config, in_flight=in_flight)

    @property
    def blocks(self):
        return {"tagged_accumulator": self.tagged_accumulator, "one_pass_gradient": self.one_pass_gradient}

    def check(self, idle_cycles):
        if idle_cycles < self.config.one_pass.fewest_idle_cycles:
            raise ConfigError(
                f"tag_bits = {self.config.tag_bits}: {idle_cycles} idle cycles an iteration; "
                f"at least {self.config.one_pass.fewest_idle_cycles} are needed"
            )

    def elaborate(self, platform):
        m = Module()
        m.submodules.tagged_accumulator = accumulator = self.tagged_accumulator
        m.submodules.one_pass_gradient = gradient = self.one_pass_gradient
        connect(m, flipped(self.votes), accumulator.i)
        connect(m, gradient.o, flipped(self.sums))
        m.d.comb += [
            self.room.eq(1),
            gradient.votes.valid.eq(self.votes.valid),
            gradient.votes.payload.eq(self.votes.payload),
            gradient.steps.eq(accumulator.o),
            accumulator.next_tag.eq(self.next),
            self.complete.eq(self.votes.valid & self.votes.payload.last),
            self.cleared.eq(accumulator.swept),
        ]
        if self.config.confidence:
            m.d.comb += self.squares.eq(gradient.squares)
        return m


class FourImages(ImageSums):
    """A one-pass image for each of a round's four evaluations, side by side; their sums come one after the other.

    See :class:`ImageSums` for parameters, members and attributes.
    """

    def __init__(self, config, *, in_flight):
        self.images = [OnePassImage(config, in_flight=in_flight) for _ in range(config.geometry.images)]
        self.latency, self.lead = self.images[0].latency + len(self.images), self.images[0].lead
        super().__init__(config, in_flight=in_flight, images=len(self.images))

    @property
    def blocks(self):
        return {f"{name}_{k}": block for k, image in enumerate(self.images) for name, block in image.blocks.items()}

    def check(self, idle_cycles):
        self.images[0].check(idle_cycles)

    def elaborate(self, platform):
        m = Module()
        first = self.images[0]
        for number, (image, votes) in enumerate(zip(self.images, self.votes, strict=True)):
            m.submodules[f"image_{number}"] = image
            connect(m, flipped(votes), image.votes)
            m.d.comb += image.next.eq(self.next)
        turn = Signal(range(len(self.images)))
        valid = first.sums.valid | (turn != 0)
        m.d.sync += turn.eq(turn + valid)
        m.d.comb += [self.room.eq(1), self.complete.eq(first.complete), self.cleared.eq(first.cleared)]
        m.d.sync += [
            self.sums.valid.eq(valid),
            self.sums.payload.eq(select(turn, [image.sums.payload.as_value() for image in self.images])),
        ]
        if self.config.confidence:
            m.d.sync += self.squares.eq(select(turn, [image.squares for image in self.images]))
        return m
