"""The report in headless Chromium: the slider moves everything, numbers are the CSV's, nothing goes wrong."""

import base64

import matplotlib.image
import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.config.dither import DITHER_BITS, FACTORS
from cmfpga.events import open_recording
from cmfpga.imaging.iwe import image_of_warped_events
from cmfpga.protocol.flags import Flag
from cmfpga.show.story import Story
from cmfpga.tracking.columns import COLUMNS
from support.reporting import keep


@pytest.fixture(scope="module")
def star(compiler, data_dir):
    """The star of `shapes_rotation` that moves to the right and turns, by the Verilog with preset ``fast``."""
    with open_recording(data_dir / "davis240c_shapes_rotation_0.0s.h5") as recording:
        return keep(preset("fast"), recording, roi=(100, 30), size=5000, start_event=15000, batches=20, engine="rtl")


@pytest.fixture(params=["turning", "flagged", "star"])
def kept(request):
    return request.getfixturevalue(request.param)


def shown(report):
    """The numbers on the page, by column; ``""`` where there is none."""
    script = "return [...document.querySelectorAll('[data-column]')].map(n => [n.dataset.column, n.textContent])"
    return {name: "" if text == "—" else text for name, text in report.do(script)}


def traces(report, plot):
    """x and y of each line of a plot, and z of its picture."""
    return report.do(f"return $('{plot}').data.map(d => [d.x, d.y, d.z && d.z.map(r => Array.from(r))])")


def test_every_batch_by_keyboard(opened, kept):
    from selenium.webdriver.common.keys import Keys

    report = opened(kept).show()
    report.do("$('slider').focus()")
    seen = []
    for _ in kept.details:
        numbers = shown(report)
        assert numbers == dict(zip(COLUMNS, kept.rows[int(numbers["batch"])], strict=True))
        flags = report.do("return $('flags').textContent")
        assert all(name in flags for name in filter(None, numbers["flags"].split("|")))
        assert flags.startswith("⚠") == bool(Flag.parse(numbers["flags"]).warnings) and "undefined" not in flags
        seen.append((numbers["batch"], report.do("return $('slider').value")))
        report.press(Keys.ARROW_RIGHT)
    assert seen == [(str(k), str(k)) for k in range(len(kept.rows))]
    for key, batch in ((Keys.HOME, 0), (Keys.END, len(kept.rows) - 1), (Keys.ARROW_LEFT, len(kept.rows) - 2)):
        report.press(key)
        assert shown(report)["batch"] == str(batch)
    assert report.errors() == []


def test_the_slider_moves_everything_together(opened, kept):
    report = opened(kept).show()
    pictures = {}
    for batch in (1, 6):
        report.do(f"go({batch})")
        report.settle()
        detail, config = kept.details[batch], kept.config
        pictures[batch] = {plot: traces(report, plot) for plot in ("frame", "still", "moved", "landscape")}
        assert pictures[batch]["frame"][0][2] == detail.frame.tolist()
        box = report.do("const s = $('frame').layout.shapes[0]; return [s.x0, s.y0, s.x1, s.y1]")
        x, y = (int(kept.column(name)[batch]) for name in ("roi_x", "roi_y"))
        assert box == [x - 0.5, y - 0.5, x + config.roi_width - 0.5, y + config.roi_height - 0.5]
        trail = pictures[batch]["frame"][2][0]
        assert trail == [int(text) + (config.roi_width - 1) / 2 for text in kept.column("roi_x")[: batch + 1]]
        # The images and their contrasts are computed in the browser.
        span = kept.spans[batch]
        dt = (2 * detail.since.astype(float) - span) / span
        size = {"width": config.roi_width, "height": config.roi_height}
        for plot, v in (("still", (0.0, 0.0)), ("moved", detail.v[-1] if len(detail.levels) else (0.0, 0.0))):
            expected = image_of_warped_events(detail.x, detail.y, dt, v, **size)
            np.testing.assert_allclose(pictures[batch][plot][0][2], expected, atol=1e-9)
            found = float(report.do(f"return $('{plot}').dataset.contrast"))
            assert found == pytest.approx(expected.var(), abs=1e-9)
        if len(detail.levels):
            assert found == pytest.approx(float(kept.column("contrast")[batch]), abs=6e-7)
        same = "return [...new Set(['still', 'moved'].map(id => document.getElementById(id).data[0].zmax))].length"
        assert report.do(same) == 1
        for chart in ("velocity", "margin", "inside", "cycles"):
            at = report.do(f"return $('{chart}').layout.shapes[0].x0")
            times = kept.numbers("t_ref_us")
            assert at == pytest.approx((times[batch] - times[0]) / 1e6)
    assert all(pictures[1][plot] != pictures[6][plot] for plot in pictures[1])
    assert report.errors() == []


def test_the_landscape_and_the_path_on_it(opened, turning):
    """The contrast that the ascent climbs, with its dither, at each level; and every velocity that it went through."""
    report = opened(turning).show()
    report.do("go(0)")
    report.settle()
    detail = turning.details[0]
    span = turning.spans[0]
    dt = (2 * detail.since.astype(float) - span) / span
    steps = np.arange(len(dt))
    positions = [
        axis + (((factor // 2 + steps * factor) % 2**DITHER_BITS) >> (DITHER_BITS - 4)) / 16 - 0.5
        for axis, factor in zip((detail.x, detail.y), FACTORS, strict=True)
    ]
    for level in (2, 1, 0):
        report.do(f"document.querySelector('input[name=level][value=\"{level}\"]').click()")
        (vx, vy, z), *paths = traces(report, "landscape")
        z = np.array(z)
        last = len(vx) - 1
        assert z.shape == (last + 1, last + 1) and vx[0] == -vx[last] and vx[last // 2] == 0
        for row, column in ((0, 0), (last // 2, last // 2), (3 * last // 4, 7 * last // 8), (last, 3)):
            speeds = zip(positions, (vx[column], vy[row]), strict=True)
            x, y = ((axis - dt * v + 0.5) / 2**level - 0.5 for axis, v in speeds)
            image, side = np.zeros((64, 64)), 64 >> level
            image[:side, :side] = image_of_warped_events(x, y, dt, (0, 0), width=side, height=side)
            assert z[row, column] == pytest.approx(image.var(), abs=1e-9)
        # Lines and markers of each level in the order of its use, the star of the result, the ring of the start.
        lines, markers = paths[0:-2:2], paths[1:-2:2]
        assert len(lines) == 3
        drawn = [(x, y) for marker in markers for x, y in zip(marker[0], marker[1], strict=True)]
        assert drawn == [tuple(v) for v in detail.v[1:].tolist()]
        assert [len(marker[0]) for marker in markers] == [(detail.levels == each).sum() for each in (2, 1, 0)]
        assert paths[-2][:2] == [[detail.v[-1][0]], [detail.v[-1][1]]]
        assert paths[-1][:2] == [[detail.v[0][0]], [detail.v[0][1]]]
    assert np.abs(np.array(detail.v)).max() <= max(vx)


def test_a_logarithmic_axis_has_more_than_one_tick(opened, turning):
    """Though all is within one power of ten."""
    clock = np.nanmedian(Story(turning, 1.0).cycles) / np.median(turning.spans) / 1.5
    assert opened(turning, clock).show().do("return document.querySelectorAll('#margin .ytick').length") > 1


def test_the_charts_show_the_columns(opened, kept):
    report = opened(kept, 100.0).show()
    for plot, line, name in (
        ("velocity", 0, "vx_px_per_s"), ("velocity", 1, "vy_px_per_s"), ("inside", 0, "roi_events"),
    ):  # fmt: skip
        got = [np.nan if value is None else value for value in traces(report, plot)[line][1]]
        np.testing.assert_array_equal(got, kept.numbers(name))
    lasts, takes = (traces(report, "margin")[line][1] for line in (0, 1))
    np.testing.assert_allclose(lasts, np.array(kept.spans) / 1000)
    cycles = np.array([np.nan if value is None else value for value in traces(report, "cycles")[0][1]])
    np.testing.assert_allclose([np.nan if value is None else value for value in takes], cycles / 100 / 1000)
    if kept.engine == "rtl":
        np.testing.assert_array_equal(cycles, kept.numbers("cycles"))
    marked = traces(report, "velocity")[-1][0]
    assert len(marked) == sum(bool(Flag.parse(text).warnings) for text in kept.column("flags"))
    assert report.do("return document.querySelectorAll('#strip i').length") == len(marked)
    rows = report.do("return document.querySelectorAll('#table tr[data-batch]').length")
    assert rows == len(kept.rows)


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_two_widths_dark_and_light(opened, turning, tmp_path, width, theme):
    report = opened(turning).show(width=width, theme=theme)
    assert report.do("return document.documentElement.scrollWidth") <= width
    background = report.do("return getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") == (theme == "light")
    ink = report.do("return $('velocity').layout.font.color")
    assert (ink == "#16181d") == (theme == "light")
    sizes = report.do(
        "return [...document.querySelectorAll('.plot')]"
        ".map(p => [p.getBoundingClientRect().width, p.querySelector('svg') !== null])"
    )
    assert len(sizes) == 8 and all(wide > 250 and drawn for wide, drawn in sizes)
    shot = {"format": "png", "captureBeyondViewport": True}
    picture = base64.b64decode(report.browser.execute_cdp_cmd("Page.captureScreenshot", shot)["data"])
    (tmp_path / "page.png").write_bytes(picture)
    pixels = matplotlib.image.imread(tmp_path / "page.png")[..., :3]
    assert pixels.shape[1] == width and pixels.std() > 0.1
    assert (pixels.mean() > 0.6) == (theme == "light")
    report.do("$('theme').click()")
    assert report.do("return getComputedStyle(document.body).backgroundColor") != background
    assert report.errors() == []


def test_a_click_on_a_chart_goes_to_its_batch(opened, turning):
    report = opened(turning).show()
    for script, batch in (
        ("$('velocity').emit('plotly_click', {points: [{customdata: '7'}]})", "7"),
        ("document.querySelector('tr[data-batch=\"3\"]').click()", "3"),
    ):
        report.do(script)
        report.settle()
        assert shown(report)["batch"] == batch


def test_it_plays(opened, turning):
    report = opened(turning).show()
    report.do("$('play').click()")
    report.wait("shown >= 2")
    report.do("$('play').click()")
    assert report.do("return $('play').textContent") == "▶ play"
    at = report.do("return shown")
    for button, place in (("next", at + 1), ("previous", at)):
        report.do(f"$('{button}').click()")
        report.settle()
        assert report.do("return shown") == place


def test_it_prints_on_white(opened, turning):
    report = opened(turning).show(theme="dark")
    printed = base64.b64decode(report.browser.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})["data"])
    assert printed.startswith(b"%PDF") and len(printed) > 50_000
    report.do("window.dispatchEvent(new Event('beforeprint'))")
    assert report.do("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert report.do("return $('velocity').layout.font.color") == "#16181d"
    report.do("window.dispatchEvent(new Event('afterprint'))")
    assert report.do("return getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    assert report.errors() == []


def test_a_page_that_is_damaged_says_so(opened, turning):
    report = opened(turning)
    text = report.path.read_text(encoding="utf-8")
    start = text.index('id="blob">') + len('id="blob">')
    report.path.write_text(text[:start] + text[start + 40 :], encoding="utf-8")
    report.browser.get(report.path.as_uri())
    report.wait("!$('problem').hidden")
    assert "cannot draw the page" in report.do("return $('problem').textContent")
