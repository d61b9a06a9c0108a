"""The page of motions beyond translation: what it draws is the model's flow, and every axis has its unit."""

import html
import json
import re

import numpy as np
import pytest

from cmfpga.config import PRESETS
from cmfpga.imaging.camera import flow
from cmfpga.imaging.iwe import image_of_warped_events
from cmfpga.show.report import render, shown_motion
from cmfpga.show.story import Story


@pytest.fixture(params=["panning", "growing"])
def kept(request):
    return request.getfixturevalue(request.param)


def moved(config, v, x, y, roi):
    """As the page's script does it, by what the page holds."""
    shown = shown_motion(config)
    sizes = config.roi_width, config.roi_height
    middle = np.subtract(shown["middle"], roi) if shown["middle"] else np.subtract(sizes, 1) / 2
    p, q = x - middle[0], y - middle[1]
    basis = {"one": 1, "p": p / shown["lever"], "q": q / shown["lever"]}
    basis |= {"xx": p * p / shown["square"], "xy": p * q / shown["square"], "yy": q * q / shown["square"]}
    return [
        sum(
            value * sign * basis[member]
            for value, parameter in zip(v, shown["parameters"], strict=True)
            for member, sign in parameter["terms"][axis]
        )
        for axis in (0, 1)
    ]


@pytest.mark.parametrize("name", ["fast", "similarity", "rotation"])
def test_what_the_page_holds_is_the_flow(name, rng):
    config = PRESETS[name]
    if name == "rotation":
        config = config.replace(camera="200,210,118,91,-0.3,0.1,0,0")
    x, y = rng.uniform(0, config.roi_width, 50), rng.uniform(0, config.roi_height, 50)
    v, roi = rng.uniform(-3, 3, len(config.motion_model.names)), (3, 5)
    np.testing.assert_allclose(
        np.broadcast_arrays(*moved(config, v, x, y, roi), x)[:2],
        np.broadcast_arrays(*flow(config, v, x, y, roi), x)[:2],
    )
    assert all("px/half batch" in parameter["unit"] for parameter in shown_motion(config)["parameters"])


def test_what_it_says(panning, growing):
    turned, grown = Story(panning, 210.0), Story(growing, 210.0)
    speed = np.median(np.linalg.norm([panning.numbers(f"w{axis}_rad_per_s") for axis in "xyz"], axis=0))
    said = re.match(r"The camera turned for 0\.06 s, at about (\S+) rad/s; the hardware would keep up", turned.lead)
    assert float(said[1]) == pytest.approx(speed, rel=0.01)
    assert any(note.startswith("ωx ") and "rad/s in the median" in note for note in turned.notes)
    assert "px/s" in grown.lead and any(note.startswith("Zoom ") for note in grown.notes)
    for story in (turned, grown):  # moved back by all parameters, not by v alone
        assert story.fits and story.gain > 1.2
        assert html.escape(story.lead) in render(story.kept, 210.0)


def test_charts_and_choices(panning, growing, turning):
    for kept, chart, pairs in ((panning, "Angular velocity of the camera", 3), (growing, "Zoom and roll", 2)):
        text = render(kept, 210.0)
        assert f'<h2>{chart}</h2>\n<div id="rates"' in text and len(re.findall('name="pair"', text)) == pairs
        head = json.loads(re.search(r'id="head">(.*?)</script>', text)[1])
        for name in head["motion"]["charts"][0]["lines"]:
            assert head["columns"][name] == kept.column(name) and head["labels"][name][1] in ("rad/s", "1/s")
    plain = render(turning, 210.0)
    assert 'id="rates"' not in plain and 'name="pair"' not in plain and "Velocity of the object" in plain


def test_images_and_contrast_in_the_browser(opened, kept):
    """Before and after, over the whole ROI; the contrast over each pair of parameters, the others as found."""
    report = opened(kept).show()
    config, detail = kept.config, kept.details[1]
    report.do("go(1)")
    report.settle()
    span, roi = kept.spans[1], [int(kept.column(name)[1]) for name in ("roi_x", "roi_y")]
    x, y = kept.places(detail)
    dt = (2 * detail.since.astype(float) - span) / span
    size = {"width": config.roi_width, "height": config.roi_height}
    for plot, v in (("still", np.zeros_like(detail.v[-1])), ("moved", detail.v[-1])):
        expected = image_of_warped_events(x, y, dt, flow(config, v, x, y, roi), **size)
        found = float(report.do(f"return $('{plot}').dataset.contrast"))
        assert found == pytest.approx(expected.var(), abs=1e-9)
    assert found == pytest.approx(float(kept.column("contrast")[1]), rel=0.01)  # positions are rounded to 16 bits
    titles = [f"{parameter['title']} [{parameter['unit']}]" for parameter in shown_motion(config)["parameters"]]
    pairs = report.do("return [...document.querySelectorAll('input[name=pair]')].map(choice => choice.value)")
    for pair in pairs:
        report.do(f"document.querySelector('input[name=pair][value=\"{pair}\"]').click()")
        a, b = map(int, pair.split(","))
        axes = "const l = $('landscape').layout; return [l.xaxis.title.text, l.yaxis.title.text]"
        assert report.do(axes) == [titles[a], titles[b]]
        corner = "const d = $('landscape').data[0]; const k = d.x.length - 1;return [d.x[k], d.y[0], d.z[0][k]]"
        column, row, value = report.do(corner)
        there = detail.v[-1].copy()
        there[a], there[b] = column, row
        moves = flow(config, there, x, y, roi)
        u, w = map(np.array, report.do("return ['x', 'y'].map((axis, k) => Array.from(dithered(details[1][axis], k)))"))
        assert value == pytest.approx(image_of_warped_events(u, w, dt, moves, **size).var(), abs=1e-9)
        stars = "return $('landscape').data.filter(d => d.marker?.symbol === 'star').map(d => [d.x, d.y])"
        assert report.do(stars) == [[[detail.v[-1][a]], [detail.v[-1][b]]]]
    drawn = report.do("return $('rates').data.map(d => d.y)")
    rates = shown_motion(config)["charts"][0]["lines"]
    for line, name in zip(drawn, rates, strict=False):
        np.testing.assert_array_equal(line, kept.numbers(name))
    assert "/s]" in report.do("return $('rates').layout.yaxis.title.text")
    assert report.errors() == []
