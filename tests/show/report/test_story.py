"""What a report says in words."""

import dataclasses
import re

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.rtl.core import Core
from cmfpga.show.story import Story, corners, direction, number
from cmfpga.tracking.columns import COLUMNS, columns
from cmfpga.tracking.kept import Kept


def made_up(config, *, roi, speed, cycles=100_000, span=20_000, flags=""):
    """A :class:`Kept` of rows only: ROI corners, and everything else the same in all batches."""
    kept = Kept(config, "rtl", "made up")
    for k, (x, y) in enumerate(roi[:-1]):
        row = dict.fromkeys(columns(config.motion, config.slides), "0") | {
            "batch": str(k), "t_ref_us": f"{20_000.0 * k + 10_000}", "events": "5000", "roi_events": "800",
            "roi_x": str(x), "roi_y": str(y), "iterations": "8", "cycles": str(cycles), "flags": flags,
            "trusted": str(int("d" not in flags)),  # neither degenerate nor doubtful
            "vx_px_per_s": speed and str(speed[0]), "vy_px_per_s": speed and str(speed[1]),
        }  # fmt: skip
        kept.rows.append(tuple(row.values()))
        kept.spans.append(span)
        kept.truths.append((np.nan, np.nan))
    kept.roi_next = roi[-1]
    return kept


@pytest.fixture(scope="module")
def config(turning):
    return turning.config


@pytest.mark.parametrize("step, words", [
    ((5, 0), "to the right"), ((5, 5), "down and to the right"), ((0, 3), "down"),
    ((-2, 2), "down and to the left"),
    ((-9, 1), "to the left"), ((-3, -3), "up and to the left"), ((1, -9), "up"), ((4, -3), "up and to the right"),
])  # fmt: skip
def test_directions(step, words):
    assert direction(*step) == words


def test_corners_of_a_path():
    path = np.array([(k, 0) for k in range(10)] + [(9, k) for k in range(1, 10)], float)
    assert corners(path, 1.0) == [0, 9, 18]
    assert corners(path + np.random.default_rng(1).uniform(-0.3, 0.3, path.shape), 1.0) == [0, 9, 18]
    assert corners(path, 20.0) == [0, 18]
    there_and_back = np.array([(k, 0) for k in (0, 5, 10, 5, 0)], float)
    assert corners(there_and_back, 1.0) == [0, 2, 4]


def test_a_straight_way(config):
    lead = Story(made_up(config, roi=[(10 * k, 30) for k in range(6)], speed=(500, 0)), 210.0).lead
    assert lead == (
        "The object in the orange frame moved 50 px to the right within 0.10 s, at about 500 px/s; the hardware would "
        "keep up: at an assumed clock of 210 MHz even the tightest batch, number 0, is computed in 0.476 ms, and it "
        "lasts 20.0 ms, 42.0 times as long."
    )


@pytest.mark.parametrize("fields, says", [
    ({}, "tightest window, number 0, is computed in 0.476 ms, and its hop lasts 1.25 ms, 2.62 times as long."),
    ({"hop_events": 200}, "and its hop lasts 4.00 ms, 8.40 times as long."),  # by hop_us; 200 of 800 events: 5 ms
    ({"hop_events": 8}, "1 of 1 windows take longer to compute than their hops last, window 0 0.476 ms for 0.200 ms."),
])  # fmt: skip
def test_a_result_of_windows_is_due_with_the_next_hop(fields, says):
    story = Story(made_up(preset("sliding").replace(**fields), roi=[(10, 30), (20, 30)], speed=(500, 0)), 210.0)
    assert story.lead.endswith(says)
    assert story.notes[-1] == "None of the 1 windows has a warning: nothing unusual happened."


CIRCLE = [(round(60 + 30 * np.cos(a)), round(60 + 30 * np.sin(a))) for a in np.linspace(0, 4 * np.pi, 60)]


@pytest.mark.parametrize("roi, speed, says", [
    ([(x, 30) for x in (100, 110, 120, 130, 140, 130, 120)], (-30, 40),
     r"moved 40 px to the right, then 20 px to the left within 0\.12 s, at about 50 px/s;"),
    (CIRCLE, (1, 0), "moved along a path of about .*px that ends at where it began,"),
    ([(5, 5)] * 4, (0, 1), "stayed where it was within"),
], ids=["there and back", "a long way round", "no way"])  # fmt: skip
def test_ways(config, roi, speed, says):
    assert re.search(says, Story(made_up(config, roi=roi, speed=speed), 210.0).lead)


def test_a_hardware_that_does_not_keep_up(config):
    kept = made_up(config, roi=[(0, 0), (9, 0), (18, 0)], speed=(9, 0), cycles=10_000_000)
    kept.spans[1] = 60_000
    assert Story(kept, 210.0).lead.endswith(
        "the hardware would not keep up at an assumed clock of 210 MHz: 1 of 2 batches take longer to compute than "
        "they last, batch 0 47.6 ms for 20.0 ms."
    )
    assert "would keep up: at an assumed clock of 1000 MHz" in Story(kept, 1000.0).lead


def test_nothing_measured(config):
    kept = made_up(config, roi=[(5, 5)] * 4, speed="", flags="degenerate", cycles="")
    at = list(COLUMNS).index("iterations")
    kept.rows = [(*row[:at], "0", *row[at + 1 :]) for row in kept.rows]
    story = Story(kept, 210.0)
    assert story.lead.startswith("Nothing could be measured") and story.lead.endswith("the hardware's speed.")
    assert story.notes[0] == "0 of 3 batches are to be trusted."
    assert story.notes[-1] == "3 of 3 batches have warnings: degenerate in 3."


def test_of_a_synthetic_track(turning):
    story = Story(turning, 210.0)
    found = re.search(r"moved (\d+) px down and to the right, then (\d+) px up and to the right", story.lead)
    # 45 and 39 px in truth; with two buffers the ROI goes on for a batch after each turn.
    assert 40 < int(found[1]) < 56 and 28 < int(found[2]) < 45
    assert " px up and to the right within 0.48 s, at about 1" in story.lead
    assert "keep up" in story.lead and "not keep up" not in story.lead
    count = len(turning.rows)
    # One holds both sides of a turn.
    assert story.notes[0] == f"{count - 1} of {count} batches are to be trusted (in 1, parts of the ROI move apart)."
    assert story.notes[1].startswith("Velocity 1") and " px/s in the median, " in story.notes[1]
    assert story.notes[2].endswith("the velocities fit.") and "px/s off in the median" in story.notes[3]
    assert story.notes[4] == f"None of the {count} batches has a warning: nothing unusual happened."


def test_cycles_by_the_formula(turning):
    """The model has no clock."""
    story = Story(turning, 100.0)
    config, core = turning.config, Core(turning.config)
    assert story.by_formula
    for k, cycles in enumerate(story.cycles):
        n, inside, iterations = (int(turning.numbers(name)[k]) for name in ("events", "roi_events", "iterations"))
        restarted = not k or "doubtful" in turning.column("flags")[k - 1]
        plan = config.schedules.cold if restarted else config.schedules.warm
        assert cycles == core.cycles(events=n, roi_events=inside, iterations=plan) and iterations == len(plan)
        assert story.margin[k] == pytest.approx(turning.spans[k] / (cycles / 100))


def test_velocities_that_do_not_fit(turning):
    """What the first note is for: with velocities turned round the image gets no sharper."""
    wrong = Kept(turning.config, "model", "wrong")
    wrong.__dict__.update(turning.__dict__)
    wrong.details = [dataclasses.replace(detail, v=-detail.v) for detail in turning.details]
    story = Story(wrong, 210.0)
    assert "do not trust the velocities" in story.notes[2]
    assert story.lead.startswith("Doubtful, see the remarks: the object in the orange frame moved")


def test_an_object_that_is_lost(config):
    kept = made_up(config, roi=[(10 * k, 30) for k in range(6)], speed=(500, 0))
    nothing = {"vx_px_per_s": "", "vy_px_per_s": "", "trusted": "0"}
    for k in (3, 4):
        kept.rows[k] = tuple((dict(zip(COLUMNS, kept.rows[k], strict=True)) | nothing).values())
    assert "within 0.06 s, at about 500 px/s, until it was lost after batch 2; the hardware" in Story(kept, 210.0).lead


def test_what_the_command_was_told_is_not_known(config):
    """So nothing is said of its batch options, not of slow batches either."""
    story = Story(made_up(config, roi=[(10 * k, 30) for k in range(6)], speed=(100, 0), flags="short"), 210.0)
    assert any(note.startswith("Short: 5 of 5 batches move by less than 1.5 px") for note in story.notes)
    assert not any("batch option" in note for note in story.notes)


def test_numbers():
    shown = {0: "0", 0.05091: "0.0509", 1.234: "1.23", 21.25: "21.2", 416.4: "416", 12345.6: "12,346"}
    assert {value: number(value) for value in shown} == shown
