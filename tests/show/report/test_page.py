"""The page by itself: complete, self-contained, small; and the commands that write it."""

import html
import json
import re

import numpy as np

import cmfpga
from cmfpga.events import generate
from cmfpga.protocol.flags import Flag
from cmfpga.show import report
from cmfpga.show.story import Story
from cmfpga.tracking.kept import BUDGET, Detail, Kept


def own(text):
    """The page without plotly.js."""
    return text.replace(report.plotly_script(), "")


def test_nothing_is_loaded_from_elsewhere(turning):
    text = own(report.render(turning, 210.0))
    assert len(text) < 400_000
    assert "http" not in text.replace("http-equiv", "").replace("HTTP", "")
    assert not re.search(r"(src|href)=[\"'](?!data:)", text) and "default-src 'none'" in text
    assert "{{" not in text and "}}" not in text.replace("}}}", "")


def test_what_it_says_and_holds(flagged):
    text = report.render(flagged, 99.5)
    story = Story(flagged, 99.5)
    assert html.escape(story.lead) in text and all(html.escape(note) in text for note in story.notes)
    assert "<script><b>" not in text and "&lt;script&gt;&lt;b&gt;" in text  # the recording's name
    assert "/me/" not in text  # but not where it lies
    head = json.loads(re.search(r'id="head">(.*?)</script>', text)[1])
    assert head["columns"]["contrast"] == flagged.column("contrast")
    for name, value in flagged.config.to_dict().items():
        assert re.search(rf"<code>{name}</code></th><td>{re.escape(str(value))}[ <]", text), name
    assert "<dd>99.5 MHz</dd>" in text and "<dt>amaranth</dt>" in text


def test_every_flag_is_explained():
    assert list(report.FLAGS) == [flag.text for flag in Flag]


def test_captions_are_of_what_is_drawn(turning, flagged):
    """The turning scene's ascent has three levels, the other one has one."""
    texts = [own(report.render(kept, 210.0)) for kept in (turning, flagged)]
    for caption, drawn in (
        ("Dashed: the true velocity.", [True, True]), ("Dashed: what the hardware's buffer holds.", [True, True]),
        ("large diamonds", [True, False]), ("small circles, 1 px.", [True, True]),
    ):  # fmt: skip
        assert [caption in text for text in texts] == drawn
    unknown = Kept(turning.config, "model", "x")
    config, truths = turning.config.replace(buffer_events=16383), [(np.nan, np.nan)] * len(turning.rows)
    unknown.__dict__ |= {**vars(turning), "config": config, "truths": truths}
    assert "Dashed: " not in own(report.render(unknown, 210.0))


def test_two_hundred_batches_are_below_ten_megabytes(turning):
    """As dense as the star recording, and without a pattern that could be compressed."""
    rng = np.random.default_rng(7)
    kept = Kept(turning.config, "model", "noise")
    kept.roi_next = turning.roi_next
    for k in range(200):
        frame = np.zeros((180, 240), np.uint8)
        np.add.at(frame, (rng.integers(180, size=5000), rng.integers(240, size=5000)), 1)
        x, y = rng.integers(64, size=(2, 900), dtype=np.uint16)
        since = np.sort(rng.integers(20_000, size=900, dtype=np.uint32))
        v = rng.integers(-200, 200, (9, 2)) / 64
        kept.details.append(Detail(k, frame, x, y, since, v, np.zeros(8, np.uint8)))
        kept.rows.append(turning.rows[k % len(turning.rows)])
        kept.spans.append(20_000)
        kept.truths.append((1.0, 2.0))
    assert sum(detail.size for detail in kept.details) < BUDGET
    assert 5_000_000 < len(report.render(kept, 210.0).encode()) < 10_000_000


def test_from_python(tmp_path):
    scene = generate(seed=1, velocity=(150.0, 100.0), duration_us=100_000)
    tracking = cmfpga.track(scene, preset="fast", engine="model", batch_events=1500, batches=2)
    tracking.report(tmp_path / "a.html", clock_mhz=77)
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "77 MHz" in text and tracking._kept.column("vx")[1] in text
