"""``python -m studies.bench``: cycles are those of the Verilog, the table and its JSON say what was measured."""

import contextlib
import io
import json
import re
import sys
import time

import numpy as np
import pytest
from studies.bench.cases import make_workload
from studies.bench.opponents import c_program
from studies.bench.programs import side_by_side, times_of
from studies.bench.table import table

from cmfpga import cli
from cmfpga.config import preset
from cmfpga.rtl.core import Core
from cmfpga.verilog import description
from cmfpga.verilog.compiler import find_compiler
from studies import bench
from studies.bench import cases, cycles


def command(*arguments):
    return cli.run(bench.main, [*arguments])


def test_the_articles_formula():
    assert description.article_cycles(**description.ARTICLE_BATCH, pixels=64 * 64, iterations=100) == 194_100
    assert description.article_cycles(events=5000, roi_events=5000, pixels=240 * 180, iterations=90) == 1_433_030


@pytest.mark.parametrize("name, ascent", [("paper", cases.CONSTANT), ("fast", cases.COLD), ("fast", cases.WARM)])
def test_measured_cycles_equal_the_cores_formula(compiler, name, ascent):
    events, n = 1000, 800
    batch = make_workload("w", events=events, roi_events=n)
    config = preset(name)
    if name == "paper":
        case = cases.constant_case(batch, {name: config}, 7)
    else:
        case = next(each for each in cases.round_cases(batch, name, config) if each.ascent == ascent)
    for design in case.designs:
        check_cycles(cycles.measure(case, design), case, case.designs[design], {"events": events, "roi_events": n})


def check_cycles(row, case, config, size):
    core, events = Core(config), size["events"]
    assert row["measured"] and row["iterations"] == case.iterations
    assert row["cycles"] == row["formula"] == core.cycles(**size, iterations=case.plan(case.iterations))
    assert row["per_iteration"] == row["cycles"] - core.cycles(**size, iterations=case.plan(case.iterations - 1))
    assert row["after_last"] == row["cycles"] - events
    if config.buffers == 1:
        assert row["cycles"] <= row["back_to_back"] <= row["cycles"] + 10 + config.geometry.bank_words
    else:  # a batch is taken in while the one before is optimised, which takes longer here
        assert row["after_last"] <= row["back_to_back"] <= row["after_last"] + 10 < row["cycles"]
    if case.ascent != cases.CONSTANT:
        assert row["v"] == pytest.approx(case.workload.v, abs=0.6)


def test_another_number_of_iterations_is_noticed(compiler):
    batch = make_workload("w", events=500, roi_events=100)
    case = cases.constant_case(batch, {"paper": preset("paper")}, 5)
    wrong = cases.Case(**{**vars(case), "iterations": 6})
    with pytest.raises(AssertionError, match="5 and 4 iterations on 100 events"):
        cycles.measure(wrong, "paper")


@pytest.fixture(scope="module")
def quick(tmp_path_factory, long_tools):
    """One quick run: its JSON, its text, and the seconds that this process worked for it."""
    file = tmp_path_factory.mktemp("bench") / "bench.json"
    printed = io.StringIO()
    if find_compiler():
        for case in cases.make_cases(quick=True):  # compiled simulators are kept: what is compiled once is not counted
            cycles.simulated(next(iter(case.designs.values())))
    start = time.process_time()
    with contextlib.redirect_stdout(printed):
        assert command("--quick", "--runs", "1", "--json", str(file)) == 0
    seconds = time.process_time() - start
    return json.loads(file.read_text(encoding="utf-8")), printed.getvalue(), seconds


def test_quick_is_quick(quick):
    """Of the processor's time, which other work on the machine does not lengthen."""
    assert quick[2] < 30


def test_json_has_the_keys(quick):
    numbers, _, _ = quick
    assert set(numbers) == {
        "version", "clock_mhz_assumed", "processor", "runs", "quick", "seconds", "missing", "programs", "cases",
        "limits", "speed_ups", "accuracy", "foreign",
    }  # fmt: skip
    assert numbers["clock_mhz_assumed"] == 210 and numbers["quick"] and numbers["runs"] == 1
    assert [case["ascent"] for case in numbers["cases"]] == ["constant", "cold", "warm"]
    for case in numbers["cases"]:
        assert set(case) == {
            "workload", "ascent", "events", "roi_events", "width", "height", "iterations", "steps", "true_v",
            "article_cycles", "cores", "programs",
        }  # fmt: skip
        assert (case["events"], case["roi_events"], case["width"], case["height"]) == (5000, 800, 64, 64)
        for core in case["cores"]:
            assert set(core) == {
                "name", "measured", "iterations", "cycles", "formula", "per_iteration", "after_last", "back_to_back",
                "v",
            }  # fmt: skip
            assert core["cycles"] == core["formula"]
        plain = [program["name"] for program in case["programs"] if not program["confidence"]]
        judged = [program["name"] for program in case["programs"] if program["confidence"]]
        assert plain == list(numbers["programs"])
        assert judged == ([] if case["ascent"] == "constant" else [f"{name}, confidence" for name in plain])
        for program in case["programs"]:
            assert set(program) == {"name", "how", "batch", "ascent", "confidence", "v"}
            for what in ("batch", "ascent"):
                assert 0 < program[what]["low"] <= program[what]["median"] <= program[what]["high"]
    assert numbers["cases"][0]["article_cycles"] == 194_100
    for row in numbers["foreign"]:  # none where it is not installed
        assert np.allclose(row["v"], numbers["cases"][0]["true_v"], atol=0.6) and row["batch"]["median"] > 0


def test_programs_agree_in_the_run_itself(quick):
    for case in quick[0]["cases"]:
        found = [program["v"] for program in case["programs"]]
        if case["ascent"] != "constant":  # which ends where rounding takes it
            assert np.ptp(found, axis=0).max(initial=0) <= 1 / 16


def test_the_confidence_is_on_both_sides(quick):
    numbers, text, _ = quick
    without, judged = numbers["cases"][2]["cores"][:2]
    for program in numbers["cases"][2]["programs"]:
        core = judged if program["confidence"] else without
        ratios = [program[what]["median"] * 210e6 / core[cycles]
                  for what, cycles in (("batch", "cycles"), ("ascent", "after_last"))]  # fmt: skip
        assert re.search(rf"  {program['name']} +6 .* {ratios[0]:.2f} {ratios[1]:.2f} ", text)


def test_limits_hold(quick):
    limits = quick[0]["limits"]
    assert [limit["limit"] for limit in limits] == [856, 2650, 9400, 5010]
    assert all(limit["holds"] for limit in limits)
    config = preset("quad")
    core, schedules = Core(config), config.schedules
    whole, warm = (
        core.cycles(**description.ARTICLE_BATCH, iterations=plan, judge=0) for plan in (schedules.cold, schedules.warm)
    )
    # Back to back, the next 5000 events take longer than the iterations.
    assert [limit["value"] for limit in limits] == [856, warm - 5000, whole, 2 + 5000 + core.drain]
    assert warm - 5000 == 2628


def test_the_accuracy_is_told(quick):
    numbers, text, _ = quick
    scores = numbers["accuracy"]["scores"]
    assert set(scores) == {"synthetic, cold", "synthetic, warm"}
    assert all(score["batches"] == 30 and score["below_0.6_px"] > 0.9 for score in scores.values())
    assert text.count("30 synthetic batches, ") == 2


def test_ratios_name_opponent_and_clock(quick):
    numbers, text, _ = quick
    assert "at an assumed 210 MHz" in text and numbers["processor"] in text
    opponents = [each["opponent"] for each in numbers["speed_ups"]]
    assert all("on this CPU (" in each or "formula" in each for each in opponents)
    cycles = numbers["cases"][1]["cores"][0]["cycles"]
    assert f"{194_100 / cycles:.2f} × as fast as the article's formula, T = 100, at 210 MHz too" in text
    for program in numbers["cases"][1]["programs"][:2]:
        ratio = program["batch"]["median"] / (cycles / 210e6)
        assert any(abs(each["times"] / ratio - 1) < 1e-9 for each in numbers["speed_ups"])


def test_what_is_missing_is_a_line(monkeypatch, capsys):
    """No tool at all: the cycles are computed, and the lines say what is not there."""
    monkeypatch.setattr(c_program.shutil, "which", lambda name: None)  # the C++ compiler is found the same way
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setitem(sys.modules, "eventcv", None)
    assert command("--quick", "--clock", "100") == 0
    text = capsys.readouterr().out
    for line in ("no C compiler", "the comparison with eventcv: eventcv is not", "no C++ compiler found"):
        assert len(re.findall(f"^  {re.escape(line)}", text, re.MULTILINE)) == 1
    for what, last in ((", judge=0", 40), ("", 46)):
        row = rf"core, preset quad{what} +5 +9,3{last} computed +856 +4,3{last} cycles .* µs .* µs$"
        assert re.search(row, text, re.M)
    assert "on this CPU" not in text


def test_a_limit_that_is_broken_is_said(quick):
    numbers = json.loads(json.dumps(quick[0]))
    numbers["cases"][1]["cores"][0]["per_iteration"] = 857
    lines, limits, _ = table(numbers)
    assert not limits[0]["holds"] and any("857; at most 856: FAILS" in line for line in lines)


@pytest.mark.parametrize("arguments, message", [
    (["--json", "no/such/folder/x.json"], "its folder does not exist"),
    (["--clock", "0"], "a number of MHz, more than 0, at most 10000, is needed"),
    (["--clock", "nan"], "a number of MHz, more than 0, at most 10000, is needed"),
    (["--runs", "0"], "a whole number of 1 or more is needed"),
])  # fmt: skip
def test_a_mistake_is_one_line(arguments, message, capsys):
    assert command("--quick", *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error and error.count("\n") == 1


def test_all_cases_are_made():
    """Those that a quick run leaves out too: the right sizes, and configurations that are allowed."""
    made = cases.make_cases()
    assert [(case.workload.width, case.ascent, case.iterations) for case in made] == [
        (64, "constant", 100), (64, "cold", 5), (64, "warm", 3),
        (240, "constant", 90), (240, "cold", 5), (240, "warm", 3),
        (128, "cold", 5), (128, "warm", 3),
    ]  # fmt: skip
    for case in made:
        for config in case.designs.values():
            cycles = Core(config).cycles(
                events=len(case.workload.events), roi_events=case.workload.roi_events, iterations=case.iterations
            )
            assert cycles > 0 and case.workload.roi_events <= config.buffer_events
    full = Core(made[4].designs["core, preset full-frame"])
    one, none = (full.cycles(events=0, roi_events=5000, iterations=count) for count in (1, 0))
    assert one - none == 5063


SIZES = {
    "the article's": {"events": 5000, "roi_events": 800},
    "the whole sensor": {"events": 5000, "roi_events": 5000, "width": 240, "height": 180},
    "128×128": {"events": 20000, "roi_events": 3200, "width": 128, "height": 128},
    "small": {"events": 120, "roi_events": 100, "width": 16, "height": 12, "sensor": (40, 30)},
}


@pytest.mark.parametrize("name", SIZES)
def test_size(name):
    size = SIZES[name]
    batch = make_workload(name, **size)
    events = batch.events
    x, y = events.x.astype(int) - batch.roi[0], events.y.astype(int) - batch.roi[1]
    inside = (x >= 0) & (x < batch.width) & (y >= 0) & (y < batch.height)
    assert len(events) == size["events"] and inside.sum() == size["roi_events"] == batch.roi_events
    assert (np.diff(events.t) >= 0).all() and events.t[-1] > events.t[0]
    width, height = size.get("sensor", (240, 180))
    assert events.x.max() < width and events.y.max() < height


def test_the_same_seed_gives_the_same_events():
    first, again, other = (make_workload("w", events=300, roi_events=200, seed=seed) for seed in (5, 5, 6))
    for name in "txyp":
        np.testing.assert_array_equal(getattr(first.events, name), getattr(again.events, name))
    assert not np.array_equal(first.events.x, other.events.x)


class Machine:
    """Actions on a machine whose clock is turned by hand, by what they take."""

    def __init__(self):
        self.now = 0.0
        self.calls = []

    def clock(self):
        return self.now

    def action(self, name, seconds):
        def act(count):
            self.calls.append((name, count))
            self.now += count * seconds

        return act


def test_median_and_range():
    assert times_of([5.0, 1.0, 2.0]) == {"median": 2.0, "low": 1.0, "high": 5.0}


def test_side_by_side():
    machine = Machine()
    steps = []
    actions = [machine.action("short", 1e-5), machine.action("long", 0.5)]
    options = {"runs": 3, "seconds": 0.02, "clock": machine.clock, "step": lambda: steps.append(1)}
    short, long = side_by_side(actions, **options)
    for times, seconds in ((short, 1e-5), (long, 0.5)):
        assert [times[name] for name in ("low", "median", "high")] == pytest.approx([seconds] * 3)
    # In turn, the short one repeated until it can be timed, the long one not at all.
    assert [name for name, _ in machine.calls[-6:]] == ["short", "long"] * 3 and len(steps) == 6
    assert machine.calls[-2:] == [("short", 2000), ("long", 1)]


def test_a_clock_that_stands_still_ends_too():
    machine = Machine()
    (times,) = side_by_side([machine.action("nothing", 0.0)], runs=1, seconds=0.01, clock=machine.clock)
    assert times["median"] == 0.0
