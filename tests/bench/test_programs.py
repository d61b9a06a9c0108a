"""The opponents do what the float64 reference does: gradient by gradient, and to the same v."""

import sys
from pathlib import Path

import numpy as np
import pytest

from cmfpga.bench import opponents, programs
from cmfpga.bench.opponents import Job, Unavailable, c_program, make_programs, torch_program
from cmfpga.bench.opponents.c_program import CProgram
from cmfpga.bench.opponents.numba_program import NumbaProgram
from cmfpga.bench.opponents.torch_program import TorchProgram
from cmfpga.bench.workloads import MOTION_PX, make_workload
from cmfpga.config import preset
from cmfpga.config.schedule import ScheduleEntry
from cmfpga.events import Events

#: Of a gradient, relative to the largest: float32 sums of some thousand terms.
TOLERANCE = 2e-5
#: An event that lies this near to a pixel's border, px, may be on its other side in float32: its derivatives jump.
NEAR = 1e-4

MAKERS = {
    "C gather": lambda: CProgram("gather"),
    "C literal": lambda: CProgram("literal"),
    "numba gather": lambda: NumbaProgram("gather"),
    "numba literal": lambda: NumbaProgram("literal"),
}


@pytest.fixture(scope="module")
def reference():
    return TorchProgram()


@pytest.fixture(scope="module", params=MAKERS)
def program(request):
    try:
        return MAKERS[request.param]()
    except Unavailable as reason:
        pytest.skip(str(reason))


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


def assert_equal_gradients(program, reference, job, places):
    """Equal but for rounding, and for what events near a pixel's border may change."""
    want, got = (gradients(each, job, places) for each in (reference, program))
    loaded = reference.load(job)
    loaded.batch()
    *positions, dt = (np.asarray(part, np.float64) for part in loaded._scaled())
    size = np.abs(want).max()
    assert size > 0.1
    for (v, level), g, g_right in zip(places, got, want, strict=True):
        moved = [(x - dt * axis + 0.5) / 2**level - 0.5 for x, axis in zip(positions, v, strict=True)]
        gaps = [np.abs(x - np.round(x)) for x in moved]  # none: exact in float32 too
        doubtful = sum(np.count_nonzero((gap > 0) & (gap < NEAR)) for gap in gaps)
        assert np.abs(g - g_right).max() <= TOLERANCE * size + 2 * doubtful, (v, level)
        assert doubtful < 0.01 * len(dt) + 1  # or the comparison would be worth little


SHAPES = {"64×64": (64, 64, 900), "odd at level 1": (30, 18, 401), "flat": (50, 6, 302), "large": (240, 180, 5003)}
VELOCITIES = {"none": (0.0, 0.0), "small": (0.31, -0.17), "usual": (2.83, -4.21), "out of the ROI": (-97.3, 211.9)}


@pytest.mark.parametrize("dither", [False, True], ids=["plain", "dithered"])
@pytest.mark.parametrize("shape", SHAPES)
def test_gradients(program, reference, shape, dither, rng):
    width, height, events = SHAPES[shape]
    job = make_job(rng, width=width, height=height, events=events, dither=dither)
    places = [(v, level) for v in VELOCITIES.values() for level in (0, 1, 2)]
    assert_equal_gradients(program, reference, job, places)


@pytest.mark.parametrize("events", [2, 3, 4, 5, 6, 7, 8, 9])
def test_few_events(program, reference, events, rng):
    """Any number: the vectorised program takes four at a time."""
    inside = make_job(rng, width=8, height=8, events=events)
    job = Job(**{**vars(inside), "events": Events(np.arange(events) * 7, rng.integers(10, 18, events),
                                                  rng.integers(7, 15, events), np.zeros(events))})  # fmt: skip
    assert_equal_gradients(program, reference, job, [((0.31, -0.73), level) for level in (0, 1, 2)])


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
def test_the_articles_ascent_step_by_step(program, reference, batch, start):
    """From the same v, always: with a constant step, a difference grows from iteration to iteration."""
    v, path = start, 0.0
    for _ in range(15):
        job = of(batch, iterations=1, eta=2.0, v_start=v)
        want, got = run(reference, job), run(program, job)
        assert got == pytest.approx(want, abs=1e-3)
        path += np.abs(np.subtract(want, v)).max()
        v = want
    assert path > 0.3


def test_the_articles_ascent_in_one_go(program, reference, batch):
    job = of(batch, iterations=4, eta=0.5, v_start=(2.5, -1.5))
    assert run(program, job) == pytest.approx(run(reference, job), abs=5e-3)


@pytest.mark.parametrize("schedule", ["cold", "warm"])
def test_the_sign_ascent_ends_at_the_same_v(program, reference, batch, schedule):
    entries = getattr(preset("fast").schedules, schedule)
    start = (0.0, 0.0) if schedule == "cold" else (3.5, -2.5)
    job = of(batch, iterations=len(entries), schedule=entries, dither=True, v_start=start)
    want = run(reference, job)
    assert run(program, job) == want  # steps are powers of two: equal signs, equal v
    assert np.abs(np.subtract(want, MOTION_PX)).max() < 0.3


def test_once_more_is_the_same(program, batch):
    entries = preset("fast").schedules.cold
    loaded = program.load(of(batch, iterations=len(entries), schedule=entries, dither=True))
    once = loaded.batch()
    assert loaded.batch(3) == loaded.ascent() == loaded.ascent(2) == once
    loaded.close()
    loaded.close()  # safe


@pytest.mark.parametrize("kind", ["no events", "none in the ROI", "one moment"])
def test_nothing_to_do(program, reference, kind):
    count = 0 if kind == "no events" else 20
    t = np.full(count, 5) if kind == "one moment" else np.arange(count)
    place = np.full(count, 3 if kind == "none in the ROI" else 12)
    job = Job(events=Events(t, place, place, np.zeros(count)), roi=(8, 8), width=16, height=16, iterations=2,
              v_start=(1.5, -0.5))  # fmt: skip
    for each in (program, reference):
        assert run(each, job) == (1.5, -0.5)


# ---------------------------------------------------------------- these tests can fail

MUTANTS = {
    "a derivative's sign": ("literal", "VOTE(column + 1, row, fx * ey, -dt", "VOTE(column + 1, row, fx * ey, dt"),
    "no zeroing": ("literal", "memset(by_x, 0, bytes);", ""),
    "mean of too many": ("literal", "(double)job->width * job->height);\n    g[0]", "1e9);\n    g[0]"),
    "no mean outside": ("gather", "const float mean = (float)", "const float mean = 0 * (float)"),
    "a swapped corner": ("gather", "Four w[4] = {1 - a - (b - ab), a - ab, b - ab, ab};",
                         "Four w[4] = {1 - a - (b - ab), b - ab, a - ab, ab};"),
    "another dither": ("gather", "1621087444u", "0u"),
    "no level": ("gather", "offset = 0.5f * scale - 0.5f", "offset = 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_program_is_noticed(name, reference, tmp_path, rng):
    form, old, new = MUTANTS[name]
    changed = 0
    for file in ("program.h", f"{form}.c"):
        text = (Path(opponents.__file__).parent / file).read_text(encoding="utf-8")
        changed += text.count(old)
        (tmp_path / file).write_text(text.replace(old, new), encoding="utf-8")
    assert changed == 1
    try:
        mutant = CProgram(form, tmp_path)
    except Unavailable as reason:
        pytest.skip(str(reason))
    job = make_job(rng, width=64, height=64, events=900, dither=True)
    with pytest.raises(AssertionError):
        assert_equal_gradients(mutant, reference, job, [(v, level) for v in VELOCITIES.values() for level in (0, 1, 2)])


# ---------------------------------------------------------------- what is missing


def test_without_any_tool_there_are_lines_instead(monkeypatch):
    monkeypatch.setattr(c_program.shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.setitem(sys.modules, "torch", None)
    programs, missing = make_programs()
    assert programs == []
    assert [line.partition(":")[0] for line in missing] == [
        "no C compiler (cc, gcc, clang) was found",
        "numba is not installed (pip install 'cmfpga[bench]')",
        "PyTorch is not installed (pip install 'cmfpga[reference]')",
    ]


def test_a_compiler_that_refuses_is_a_line(tmp_path):
    if not any(map(c_program.shutil.which, c_program.COMPILERS)):
        pytest.skip("no C compiler")
    for name in ("program.h", "gather.c"):
        (tmp_path / name).write_text("this is no C\n")
    with pytest.raises(Unavailable, match=r"does not compile gather\.c \(.*error.*\): no program 'C, gather'$"):
        CProgram("gather", tmp_path)


def test_a_missing_gpu_is_a_line(monkeypatch):
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(Unavailable, match=r"^no CUDA device: "):
        TorchProgram("cuda")


def test_on_a_gpu_it_is_the_same(batch, reference):
    import torch

    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    entries = preset("fast").schedules.cold
    job = of(batch, iterations=len(entries), schedule=entries, dither=True)
    assert run(TorchProgram("cuda"), job) == run(reference, job)


def test_torch_keeps_its_threads(batch):
    import torch

    before = torch.get_num_threads()
    run(TorchProgram(), of(batch, iterations=1))
    assert torch.get_num_threads() == before
    assert len(torch_program.MAKERS) == 2


def test_a_schedule_of_another_length_is_refused(batch):
    with pytest.raises(ValueError, match="1 entries of a schedule for 2 iterations"):
        of(batch, iterations=2, schedule=(ScheduleEntry(0, 0),))


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("cpu family\t: 26\nmodel\t\t: 2\nmodel name\t: AMD EPYC\n", "AMD EPYC, family 26, model 2"),
        ("processor\t: 0\n\nModel\t\t: Raspberry Pi 4\n", "Raspberry Pi 4"),
    ],
)
def test_the_processor_says_which_it_is(text, name, monkeypatch):
    """Virtual machines on different processors have the same name."""
    monkeypatch.setattr(programs.Path, "read_text", lambda *_, **__: text)
    assert programs.processor() == name
