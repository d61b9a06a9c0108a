"""The opponents do what the float64 reference does: gradient by gradient, and to the same v."""

import platform

import numpy as np
import pytest
from studies.bench.cases import COLD, MOTION_PX, STEPS, WARM, make_workload, parse_steps
from studies.bench.opponents import CProgram, Job, Unavailable, c_program, make_programs

from cmfpga.config import preset
from cmfpga.config.schedule import ScheduleEntry
from cmfpga.events import Events
from cmfpga.reference import float_core, floating
from studies.bench import programs
from support import steps
from support.opponents import broken, made

#: Of a gradient, relative to the largest: float32 sums of some thousand terms; positions in 1/256 px.
TOLERANCE = {"gather": 2e-5, "int16": 0.06}
#: Of a step, px.
STEP = {"gather": 1e-3, "int16": 1e-2}
#: An event that lies this near to a pixel's border, px, may be on its other side in float32: its derivatives jump.
NEAR = 1e-4


@pytest.fixture(scope="module", params=["gather", "int16"])
def program(request):
    return made(CProgram, request.param)


def scaled(job):
    """x, y and dt of the events in the ROI, as the float64 reference wants them."""
    t, x, y = (np.asarray(axis, np.int64) for axis in (job.events.t, job.events.x, job.events.y))
    x, y = x - job.roi[0], y - job.roi[1]
    inside = (x >= 0) & (x < job.width) & (y >= 0) & (y < job.height)
    first, last = t[[0, -1]].tolist()
    t, x, y = (floating.torch.from_numpy(axis[inside]) for axis in (t, x, y))
    if job.dither:
        x, y = (axis + offset for axis, offset in zip((x, y), floating.dither(len(x)), strict=True))
    return x, y, floating.scaled_times(t, first, last)


def right_v(job):
    options = {"width": job.width, "height": job.height, "v_start": job.v_start}
    if job.schedule is None:
        found = float_core.ascend(*scaled(job), **options, eta=job.eta, iterations=job.iterations)
    else:
        return tuple(steps.ascend(*scaled(job), **options, schedule=job.schedule)[-1].tolist())
    return tuple(found.v[-1].tolist())


def right_gradients(job, places):
    found, pixels = [], job.width * job.height
    for v, level in places:
        at = floating.torch.tensor(v, dtype=floating.torch.float64)
        now = floating.evaluate(*scaled(job), at, width=job.width, height=job.height, level=level)
        found.append((now.g / pixels).tolist())
    return np.array(found)


def make_job(rng, *, width, height, events, iterations=1, **options):
    """Events all over a sensor that is larger than the ROI, at random."""
    t = np.sort(rng.integers(0, 30_000, events))
    x, y = rng.integers(0, width + 20, events), rng.integers(0, height + 14, events)
    batch = Events(t, x, y, np.zeros(events))
    return Job(events=batch, roi=(10, 7), width=width, height=height, iterations=iterations, **options)


def gradients(program, job, places):
    loaded = program.load(job)
    loaded.batch()
    got = np.array([loaded.gradient(*place) for place in places])
    loaded.close()
    return got


def assert_equal_gradients(program, job, places):
    """Equal but for rounding, and for what events near a pixel's border may change."""
    want, got = right_gradients(job, places), gradients(program, job, places)
    *positions, dt = map(np.asarray, scaled(job))
    size = np.abs(want).max()
    assert size > 0.1
    for (v, level), g, g_right in zip(places, got, want, strict=True):
        moved = [(x - dt * axis + 0.5) / 2**level - 0.5 for x, axis in zip(positions, v, strict=True)]
        gaps = [np.abs(x - np.round(x)) for x in moved]  # none: exact in float32 too
        doubtful = sum(np.count_nonzero((gap > 0) & (gap < NEAR)) for gap in gaps)
        assert np.abs(g - g_right).max() <= TOLERANCE[program.form] * size + 2 * doubtful, (v, level)
        assert doubtful < 0.01 * len(dt) + 1  # or the comparison would be worth little


SHAPES = {"64×64": (64, 64, 900), "odd at level 1": (30, 18, 401), "flat": (50, 6, 302), "large": (240, 180, 5003),
          "dense": (64, 45, 9000)}  # fmt: skip
VELOCITIES = {"none": (0.0, 0.0), "small": (0.31, -0.17), "usual": (2.83, -4.21), "out of the ROI": (-97.3, 111.9)}


@pytest.mark.parametrize("dither", [False, True], ids=["plain", "dithered"])
@pytest.mark.parametrize("shape", SHAPES)
def test_gradients(program, shape, dither, rng):
    width, height, events = SHAPES[shape]
    job = make_job(rng, width=width, height=height, events=events, dither=dither)
    places = [(v, level) for v in VELOCITIES.values() for level in (0, 1, 2)]
    assert_equal_gradients(program, job, places)


@pytest.mark.parametrize("events", [2, 3, 4, 5, 6, 7, 8, 9])
def test_few_events(program, events, rng):
    """Any number: the vectorised program takes four at a time."""
    inside = make_job(rng, width=8, height=8, events=events)
    job = Job(**{**vars(inside), "events": Events(np.arange(events) * 7, rng.integers(10, 18, events),
                                                  rng.integers(7, 15, events), np.zeros(events))})  # fmt: skip
    assert_equal_gradients(program, job, [((0.31, -0.73), level) for level in (0, 1, 2)])


@pytest.fixture(scope="module")
def batch():
    return make_workload("batch", events=3000, roi_events=800)


def of(batch, **options):
    size = {"width": batch.width, "height": batch.height}
    return Job(events=batch.events, roi=batch.roi, **size, **options)


def run(program, job):
    loaded = program.load(job)
    v = loaded.batch()
    loaded.close()
    return v


@pytest.mark.parametrize("start", [(0.0, 0.0), (2.5, -1.5)], ids=["from zero", "near the motion"])
def test_the_articles_ascent_step_by_step(program, batch, start):
    """From the same v, always: with a constant step, a difference grows from iteration to iteration."""
    if program.form == "int16" and start == (0.0, 0.0):
        pytest.skip("without dither, 1/256 px decide there on which side of a pixel's border events lie")
    v, path = start, 0.0
    for _ in range(15):
        job = of(batch, iterations=1, eta=2.0, v_start=v)
        want, got = right_v(job), run(program, job)
        assert got == pytest.approx(want, abs=STEP[program.form])
        path += np.abs(np.subtract(want, v)).max()
        v = want
    assert path > 0.3


def test_the_articles_ascent_in_one_go(program, batch):
    job = of(batch, iterations=4, eta=0.5, v_start=(2.5, -1.5))
    assert run(program, job) == pytest.approx(right_v(job), abs=5 * STEP[program.form])


@pytest.mark.parametrize("schedule", ["cold", "warm"])
def test_the_sign_ascent_ends_at_the_same_v(program, schedule):
    """In 16 bits in nine of ten batches: where a slope is as good as 0, a rounding decides its sign."""
    entries, apart, wrong = parse_steps(preset("fast"), STEPS[schedule]), [], []
    start = (0.0, 0.0) if schedule == "cold" else (3.5, -2.5)
    for seed in range(1, 3 if program.form == "gather" else 21):
        batch = make_workload("batch", events=3000, roi_events=800, seed=seed)
        job = of(batch, iterations=len(entries), schedule=entries, dither=True, v_start=start)
        want, got = right_v(job), run(program, job)
        apart.append(np.abs(np.subtract(want, got)).max())
        wrong.append([np.linalg.norm(np.subtract(v, MOTION_PX)) for v in (want, got)])
    if program.form == "gather":
        assert max(apart) == 0  # steps are powers of two: equal signs, equal v
    assert np.mean(np.array(apart) <= 1 / 16) >= 0.8 and max(apart) < 0.5
    right, found = np.median(wrong, axis=0)
    assert found <= right + 1 / 32 < 0.3


def test_probes_are_gradients_beside_v(program, batch):
    entries = parse_steps(preset("fast"), STEPS[WARM])
    loaded = program.load(
        of(batch, iterations=len(entries), schedule=entries, dither=True, probes=True, v_start=(3.0, -2.0))
    )
    x, y = loaded.batch()
    beside = [(x - 0.75, y), (x + 0.75, y), (x, y - 0.75), (x, y + 0.75)]
    assert (loaded.probes == [loaded.gradient(v) for v in beside]).all() and np.abs(loaded.probes).min() > 1
    loaded.close()


def test_16_bits_are_the_same_without_vector_instructions(batch, rng):
    """What has no sign in C is written twice."""
    options = ("-mno-avx2",) if platform.machine() == "x86_64" else ()
    plain, fast = made(CProgram, "int16", options=options), made(CProgram, "int16")
    for shape in SHAPES.values():
        job = make_job(rng, width=shape[0], height=shape[1], events=shape[2], dither=True)
        places = [(v, level) for v in VELOCITIES.values() for level in (0, 1, 2)]
        assert (gradients(plain, job, places) == gradients(fast, job, places)).all()


@pytest.mark.parametrize("events, width, fits", [(127, 64, True), (128, 64, False), (5000, 64, False), (9, 251, False)])
def test_16_bits_have_limits(events, width, fits):
    """All events in one pixel, in the middle of the ROI."""
    at = np.full(events, 30)
    job = Job(
        events=Events(np.arange(events), at, at, np.zeros(events)), roi=(0, 0), width=width, height=64, iterations=1
    )
    if fits:
        assert run(made(CProgram, "int16"), job) == right_v(job)
    else:
        with pytest.raises(OverflowError, match="127 events a pixel at most, and images of 250 px"):
            run(made(CProgram, "int16"), job)


def test_once_more_is_the_same(program, batch):
    entries = parse_steps(preset("fast"), STEPS[COLD])
    loaded = program.load(of(batch, iterations=len(entries), schedule=entries, dither=True))
    once = loaded.batch()
    assert loaded.batch(3) == loaded.ascent() == loaded.ascent(2) == once
    loaded.close()
    loaded.close()  # safe


@pytest.mark.parametrize("kind", ["no events", "none in the ROI", "one moment"])
def test_nothing_to_do(program, kind):
    count = 0 if kind == "no events" else 20
    t = np.full(count, 5) if kind == "one moment" else np.arange(count)
    place = np.full(count, 3 if kind == "none in the ROI" else 12)
    job = Job(events=Events(t, place, place, np.zeros(count)), roi=(8, 8), width=16, height=16, iterations=2,
              v_start=(1.5, -0.5))  # fmt: skip
    assert run(program, job) == (1.5, -0.5)


MUTANTS = {
    "votes that vanish": ("int16", "even[k] += odd[k] << 16 | odd[k - stride] >> 16", "even[k] += odd[k] << 16"),
    "a derivative's sign": ("int16", "k % 2 ? -part_x[k] : part_x[k]", "part_x[k]"),
    "no mean": ("int16", "(256.0 * votes - outside)", "(0.0 * votes)"),
    "no mean outside": ("gather", "const float mean = (float)", "const float mean = 0 * (float)"),
    "a swapped corner": ("gather", "Four w[4] = {1 - a - (b - ab), a - ab, b - ab, ab};",
                         "Four w[4] = {1 - a - (b - ab), b - ab, a - ab, ab};"),
    "another dither": ("gather", "1621087444u", "0u"),
    "no level": ("gather", "offset = 0.5f * scale - 0.5f", "offset = 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_program_is_noticed(name, tmp_path, rng):
    form, old, new = MUTANTS[name]
    mutant = made(CProgram, form, broken(tmp_path, ("program.h", f"{form}.c"), old, new))
    width, height, events = SHAPES["dense"]
    job = make_job(rng, width=width, height=height, events=events, dither=True)
    with pytest.raises(AssertionError):
        assert_equal_gradients(mutant, job, [(v, level) for v in VELOCITIES.values() for level in (0, 1, 2)])


def test_without_a_compiler_there_is_a_line_instead(monkeypatch):
    monkeypatch.setattr(c_program.shutil, "which", lambda name: None)
    assert make_programs() == ([], ["no C compiler (cc, gcc, clang) was found: no C programs"])


def test_a_compiler_that_refuses_is_a_line(tmp_path):
    if not any(map(c_program.shutil.which, c_program.COMPILERS)):
        pytest.skip("no C compiler")
    for name in ("program.h", "gather.c"):
        (tmp_path / name).write_text("this is no C\n")
    with pytest.raises(Unavailable, match=r"does not compile gather\.c \(.*error.*\): no program 'C, gather'$"):
        CProgram("gather", tmp_path)


def test_a_schedule_of_another_length_is_refused(batch):
    with pytest.raises(ValueError, match="1 entries of a schedule for 2 iterations"):
        of(batch, iterations=2, schedule=(ScheduleEntry(0, 0),))


@pytest.mark.parametrize("text, name", [
    ("cpu family\t: 26\nmodel\t\t: 2\nmodel name\t: AMD EPYC\n", "AMD EPYC, family 26, model 2"),
    ("processor\t: 0\n\nModel\t\t: Raspberry Pi 4\n", "Raspberry Pi 4"),
])  # fmt: skip
def test_the_processor_says_which_it_is(text, name, monkeypatch):
    """Virtual machines on different processors have the same name."""
    monkeypatch.setattr(programs.Path, "read_text", lambda *_, **__: text)
    assert programs.processor() == name
