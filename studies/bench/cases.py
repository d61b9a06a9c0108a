"""What is measured: batches with exactly N events, n of them in the ROI; ascents; and the cores that do them."""

from dataclasses import dataclass

import numpy as np

from cmfpga.config import preset
from cmfpga.config.schedule import parse_schedule
from cmfpga.events import Events, generate
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.verilog import description

MOTION_PX = (3.0, -2.0)  # how far the object moves in half a batch, px; the middle of where batches are measured best
DURATION_US = 50_000
NOISE = 0.05  # share of the ROI's events that are noise


@dataclass(frozen=True, kw_only=True)
class Workload:
    """A batch, and its name for the table."""

    name: str
    events: Events  # N of them
    roi: tuple[int, int]  # left column and top row, px
    width: int  # of the ROI, px
    height: int
    roi_events: int  # n
    v: tuple[float, float]  # true motion, px per half batch


def make_workload(name, *, events, roi_events, width=64, height=64, sensor=(240, 180), seed=1):
    """An object that fills 60 % of the ROI's width and height and moves by :data:`MOTION_PX` in half a batch.

    A longer and denser recording than is needed is thinned evenly to ``roi_events``; events outside the ROI are noise,
    uniform over the rest of the sensor and over time.
    """
    size, roi = (width, height), ((sensor[0] - width) // 2, (sensor[1] - height) // 2)
    rng = np.random.default_rng(seed)
    half = DURATION_US / 2e6
    scene = generate(
        seed=seed, width=sensor[0], height=sensor[1], size=(round(0.6 * width), round(0.6 * height)),
        velocity=tuple(axis / half for axis in MOTION_PX),
        position=tuple(corner + (side - 1) / 2 - move for corner, side, move in zip(roi, size, MOTION_PX, strict=True)),
        duration_us=DURATION_US, noise=NOISE,
    )  # fmt: skip
    while len(index := events_in_roi(scene.events, roi, *size)[0]) < roi_events:  # the same with more events a pixel
        scene = generate(**{**vars(scene.scene), "contrast": 2 * scene.scene.contrast})
    inside = scene.events[index]
    inside = inside[np.sort(rng.choice(len(inside), roi_events, replace=False))]
    outside = _outside(events - roi_events, roi, width, height, sensor, rng)
    batch = Events.merge([inside, outside])
    return Workload(name=name, events=batch, roi=roi, width=width, height=height, roi_events=roi_events, v=MOTION_PX)


def _outside(count, roi, width, height, sensor, rng):
    parts = []
    while (missing := count - sum(map(len, parts))) > 0:
        t = rng.integers(DURATION_US, size=2 * missing)
        x, y = (rng.integers(size, size=2 * missing) for size in sensor)
        made = Events(t, x, y, np.zeros(len(t)))
        parts.append(made[np.delete(np.arange(len(t)), events_in_roi(made, roi, width, height)[0])][:missing])
    return Events.concatenate(parts)


CONSTANT, COLD, WARM = "constant", "cold", "warm"  # ascents: the article's, and rounds without and with a last v

#: What the programs do in place of rounds: steps by signs, which cost a program less, and find v as well.
STEPS = {
    COLD: "2:2/4 2:1/4*2 2:0/4*2 2:-1/4 1:0/2 1:-1/2*2 1:-2/2 1:-2 1:-3*3 0:-4",
    WARM: "1:-1/2 1:-2/2 1:-2 1:-3*2 0:-4",
}

ARTICLE, KIM = "the article's batch", "Kim and Kim's case"  # names of the batches that the limits are for


@dataclass(frozen=True, kw_only=True)
class Case:
    """One batch, one ascent: the cores that do it, ``{name: configuration}``, and the settings.

    The first core is what programs are compared with; ``steps`` are theirs, where the core has a ``schedule``.
    """

    workload: object
    ascent: str
    designs: dict
    iterations: int
    schedule: tuple | None = None
    steps: tuple | None = None

    def plan(self, iterations):
        """The first so many iterations, as ``Core.cycles`` wants them."""
        return iterations if self.schedule is None else self.schedule[:iterations]


def make_cases(quick=False):
    """The cases, in the order of the table; ``quick`` leaves out all but the article's batch with the presets."""
    paper, quad = preset("paper"), preset("quad")
    batch = make_workload(ARTICLE, **description.ARTICLE_BATCH)
    designs = {"core, preset paper": paper}
    if not quick:
        designs["core, paper in one pass"] = paper.replace(gradient="one_pass")
    cases = [constant_case(batch, designs, 100), *round_cases(batch, "quad", quad, fast=preset("fast"))]
    if quick:
        return cases

    full = preset("full-frame")
    batch = make_workload(KIM, events=5000, roi_events=5000, width=240, height=180)
    size = {key: getattr(full, key) for key in ("roi_width", "roi_height", "buffer_events", "ram_style")}
    large = paper.replace(**size)
    one_pass = large.replace(gradient="one_pass", tag_bits=full.tag_bits)
    designs = {"core, paper at 240×180": large, "core, the same in one pass": one_pass}
    cases += [constant_case(batch, designs, 90), *round_cases(batch, "full-frame", full)]
    batch = make_workload("the article's density on 128×128", events=20000, roi_events=3200, width=128, height=128)
    return [*cases, *round_cases(batch, "fast-128", preset("fast-128"))]


def constant_case(batch, designs, iterations):
    """The article's ascent on a batch."""
    # From v = 0, as a program is; the ROI stays, so that batches can be repeated.
    fields = {"iterations": iterations, "start": "zero", "roi_gain": 0.0}
    designs = {name: config.replace(**fields) for name, config in designs.items()}
    return Case(workload=batch, ascent=CONSTANT, designs=designs, iterations=iterations)


def parse_steps(config, text):
    """Steps by signs, of their text."""
    limits = {"max_level": config.max_level, "v": config.formats.v, "entries": config.schedule_entries}
    return parse_schedule(text, name="steps", motion="similarity", **limits)


def round_cases(batch, name, config, **others):
    """Rounds on a batch, cold and then warm; first without the verdict. ``others`` are cores that take other times."""
    shipped = config.replace(roi_gain=0.0)
    designs = {f"core, preset {name}, judge=0": shipped.replace(judge=0), f"core, preset {name}": shipped}
    designs |= {f"core, preset {other}": each.replace(roi_gain=0.0) for other, each in others.items()}
    for ascent, schedule in ((COLD, config.schedules.cold), (WARM, config.schedules.warm)):
        size = {"iterations": len(schedule), "schedule": schedule, "steps": parse_steps(config, STEPS[ascent])}
        yield Case(workload=batch, ascent=ascent, designs=designs, **size)
