"""What a report says of clock cycles: with lanes, where they go."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.config.schedule import used_events
from cmfpga.engines import make_engine
from cmfpga.events import BatchCutter, generate
from cmfpga.show.report.cycles import PARTS
from cmfpga.show.report.page import render
from cmfpga.show.report.story import Story
from cmfpga.tracking.loop import track
from support.reporting import keep

CONFIG = preset("fast").replace(
    sensor_width=64, sensor_height=48, roi_width=24, roi_height=20, buffer_events=150, tag_bits=5, lanes=2
)


@pytest.fixture(scope="module")
def scene():
    return generate(seed=3, width=64, height=48, size=(12, 12), position=(30.0, 24.0), velocity=(200.0, 0.0))


def test_where_the_cycles_of_lanes_go(compiler, scene):
    recording, size, roi = scene.recording("lanes"), 220, (20, 14)
    story = Story(keep(CONFIG, recording, roi=roi, size=size, batches=4, engine="rtl"), 210.0)
    model, waited = make_engine("model", CONFIG), []
    model.core.count_waits = True
    for _ in track(model, BatchCutter(recording, events=size, max_events=CONFIG.max_batch_events), roi=roi, batches=4):
        waited.append(model.core.waited)
    votes, waits, probes, ways = (story.parts[name] for name in PARTS)
    assert waits.tolist() == waited and max(waited) > 0
    assert (story.cycles == size + votes + waits + probes + ways).all() and not story.by_formula
    inside = story.kept.numbers("roi_events")
    # Every iteration's way is as long, that of a probe too, which votes with all events and judges in the end.
    warm, cold = CONFIG.schedules.warm, CONFIG.schedules.cold
    for k, count in enumerate(story.kept.numbers("iterations")):
        plan = warm if count == len(warm) else cold
        assert votes[k] == sum(-(-n // 2) for n in used_events(plan, int(inside[k])))
    assert (probes > 4 * inside / 2).all() and len(set(ways[1:].tolist())) <= 2
    note = next(note for note in story.notes if "2 lanes" in note)
    shares = [int(word.rstrip("%")) for word in note.split() if word.endswith("%")]
    assert len(shares) == 4 and abs(sum(shares) - 100) <= 2
    assert f"{np.nansum(waits) / (story.cycles - size).sum():.0%} waits of votes for one bank" in note
    page = render(story.kept, 210.0)
    assert all(f'"{name}":[' in page for name in PARTS) and "Dashed: what they go to" in page


@pytest.mark.parametrize("changes", [{"lanes": 1}, {}], ids=["one lane", "no clock"])
def test_nothing_is_said_where_nothing_is_known(changes, scene):
    kept = keep(CONFIG.replace(**changes), scene.recording("lanes"), roi=(20, 14), size=220, batches=2)
    story = Story(kept, 210.0)
    assert story.parts == {} and story.by_formula and not any("lanes" in note for note in story.notes)
    assert "Dashed: what they go to" not in render(kept, 210.0)
