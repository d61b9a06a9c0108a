"""Other images behind the seam: registers in place of RAMs, complete early or late, and one that is short of room.

The whole core with each of them equals the integer model, and its cycles are those of the formula where they can be
known.
"""

import pytest
from amaranth.hdl import Module, Signal
from amaranth.lib import data
from amaranth.lib.fifo import SyncFIFO

from cmfpga.config import Config, preset
from cmfpga.protocol.flags import Flag
from cmfpga.rtl import payloads
from cmfpga.rtl.arithmetic import delay
from cmfpga.rtl.ascent.gradient import Gradient
from cmfpga.rtl.core import Core
from cmfpga.rtl.image import IMAGES
from cmfpga.rtl.image.image_sums import ImageSums
from support.bench import simulate
from support.core import Batch, check_core, drive_core
from support.core_batches import moving_points, settings
from support.votes import sweep_addresses

#: The ascent is the article's, and its batches have no schedule.
CONFIG = Config(
    sensor_width=40, sensor_height=30, roi_width=8, roi_height=8, buffer_events=48, max_batch_events=90,
    max_iterations=7, iterations=3, gradient="one_pass",
)  # fmt: skip


class RegisterImage(ImageSums):
    """A register for each pixel; the sums are made of all of them at once."""

    latency, sweep_cycles = 1 + Gradient.lead, 1

    def elaborate(self, platform):
        config = self.config
        m = Module()
        valid, votes = self.votes_to_add(m)
        pixels = [
            [Signal(payloads.pixel(config), name=f"pixel_{row}_{column}") for column in range(config.roi_width)]
            for row in range(config.roi_height)
        ]
        for number in range(4):
            vote = votes.banks[number]
            for address, row, column in sweep_addresses(config):
                pixel = pixels[2 * row + (number >> 1)][2 * column + (number & 1)]
                with m.If(valid & vote.valid & (vote.address == address)):
                    m.d.sync += [pixel[name].eq(pixel[name] + vote[name]) for name in pixel.shape().members]
        flat = [pixel for row in pixels for pixel in row]
        with m.If(self.next):
            m.d.sync += [pixel.eq(0) for pixel in flat]
        done = delay(m, valid & votes.last, 1, name="done", valid=True)
        with m.If(done):
            sums = self.sums.payload
            m.d.sync += [sums[name].eq(sum(pixel[name] for pixel in flat)) for name in ("i", "dx", "dy")]
            m.d.sync += [
                sums[f"s{p}"].eq(sum(pixel.i * pixel[f"d{p}"] for pixel in flat)) for p in config.motion_model.names
            ]
        m.d.comb += [
            self.complete.eq(delay(m, done, self.sweep_cycles - 1, name="complete", valid=True)),
            self.sums.valid.eq(delay(m, done, Gradient.lead + 1, name="valid", valid=True)),
            self.cleared.eq(self.clear),  # a reset has cleared all registers
        ]
        return m

    def votes_to_add(self, m):
        m.d.comb += self.room.eq(1)
        return self.votes.valid, self.votes.payload


class LateImage(RegisterImage):
    """Complete when the sums are valid: so late that the next replay cannot come early enough to hide its latency."""

    latency, sweep_cycles = 0, 2 + Gradient.lead


class SlowImage(RegisterImage):
    """One event in three cycles, out of a queue that holds hardly more than what is in flight."""

    def votes_to_add(self, m):
        shape = payloads.votes(self.config)
        m.submodules.queue = queue = SyncFIFO(width=data.Layout.cast(shape).size, depth=self.in_flight + 2)
        turn = Signal(range(3))
        valid = queue.r_rdy & (turn == 0)
        m.d.sync += turn.eq((turn + 1) % 3)
        m.d.comb += [
            queue.w_en.eq(self.votes.valid),
            queue.w_data.eq(self.votes.payload),
            queue.r_en.eq(valid),
            self.room.eq(self.has_room(queue)),
        ]
        return valid, data.View(shape, queue.r_data)

    def has_room(self, queue):
        return queue.depth - queue.level > self.in_flight


class CarelessImage(SlowImage):
    def has_room(self, queue):
        return 1


def run(image, config, rng, monkeypatch, **flow):
    monkeypatch.setitem(IMAGES, config.gradient, image)
    core = Core(config)
    corner = {"x": 16, "y": 11}
    batches = [
        Batch(
            events=moving_points(config, rng, count, span=900, around=(20, 15)),
            settings=settings(config, roi=tuple(corner.values()), iterations=iterations, start_last=bool(count % 2)),
        )
        for count, iterations in ((40, 3), (1, 2), (85, 1), (20, 0), (63, 4), (7, 2))
    ]
    bench, outcomes = drive_core(core, batches, rng=rng, **flow)
    simulate(core, bench)
    results = check_core(config, batches, outcomes)
    assert sum(result.iterations for result in results) >= 10
    return core, results, outcomes


@pytest.mark.parametrize("buffers", [1, 2])
@pytest.mark.parametrize("image", [RegisterImage, LateImage])
def test_another_image_equals_the_model(image, buffers, rng, monkeypatch):
    core, results, outcomes = run(image, CONFIG.replace(buffers=buffers), rng, monkeypatch, eager=buffers == 1)
    assert set(core.blocks) >= {"image"} and core.latencies["image"] == image.latency
    for result, outcome in zip(results, outcomes, strict=True):
        if Flag.DEGENERATE not in result.flags:
            counts = {name: getattr(result, name) for name in ("events", "roi_events", "iterations")}
            assert outcome.result["cycles"] == core.cycles(**counts)


@pytest.mark.parametrize("buffers", [1, 2])
def test_an_image_that_is_short_of_room_equals_the_model(buffers, rng, monkeypatch):
    _, results, outcomes = run(SlowImage, CONFIG.replace(buffers=buffers), rng, monkeypatch, gap=0.2, stall=0.5)
    longest = max(results, key=lambda result: result.roi_events)
    assert outcomes[results.index(longest)].result["cycles"] > 2 * longest.roi_events * longest.iterations


def test_votes_that_are_lost_are_found(rng, monkeypatch):
    with pytest.raises(AssertionError):
        run(CarelessImage, CONFIG, rng, monkeypatch)


@pytest.mark.parametrize("name", ["paper", "fast"])
def test_images_of_the_presets_always_have_room(name):
    """So that the formula of cycles holds: nothing but a constant drives it. Their members are those of the seam."""
    assert list(IMAGES[preset(name).gradient](preset(name), in_flight=9).blocks) != ["image"]
