"""The page of a run in headless Chromium: the slider moves everything, what is drawn is what was found."""

import base64
import io
import itertools

import matplotlib.image
import numpy as np
import pytest

from cmfpga.api.flow import Flow
from cmfpga.show import flow as pages
from cmfpga.show.flow import colours, field, figure, top_speed
from support.browser import Opened
from support.flowing import measured


@pytest.fixture(scope="module")
def found(sliding):
    """Three windows."""
    return measured(sliding.recording(), window_events=7000)[0]


@pytest.fixture
def shown(browser, no_network, found, tmp_path):
    flow, page = Flow(found[0].config, found[0].tiles, "<a & b>.h5", "model", "translation"), pages.Page()
    for window in found:
        flow.add(window)
        page.add(window, flow.fitted(window.index))
    (tmp_path / "flow.html").write_text(page.render(flow), encoding="utf-8")
    settled = "document.body.dataset.shown === String(windows[shown].window)"
    return Opened(browser, tmp_path / "flow.html", settled).show()


def picture(page, name):
    """A canvas as an array [rows, columns, 4]."""
    text = page.do(f"return $('{name}').toDataURL('image/png')")
    return matplotlib.image.imread(io.BytesIO(base64.b64decode(text.partition(",")[2])), format="png")


def test_every_window_by_keyboard(shown, found):
    from selenium.webdriver.common.keys import Keys

    assert shown.do("return document.querySelector('h1').textContent") == "Flow of <a & b>.h5"
    for window in found:
        assert f"window {window.index}:" in shown.do("return $('where').textContent")
        still, moved = (picture(shown, name)[..., 0] for name in ("still", "moved"))
        top = max(float(np.percentile(window.images()[1], 99.7)), 1.0)
        for image, wanted in zip((still, moved), window.images(), strict=True):
            assert np.abs(image - np.floor(np.minimum(wanted / top, 1) * 255) / 255).max() < 0.6 / 255
        count = shown.do("return $('share').textContent")
        assert count.startswith(f"{window.trusted.sum()} of {len(window.tiles)} tiles")
        assert "vx_px_per_s" in shown.do("return $('fit').textContent")
        shown.press(Keys.ARROW_RIGHT)
    assert shown.errors() == []


def test_colours_are_those_of_the_picture(shown, found):
    """In one of the corners of each cell: an arrow cannot be in all."""
    window, drawn = found[0], picture(shown, "flow")
    wanted = field(window, top_speed(window))
    cells, _ = window.tiles.of_pixels(128, 96)
    checked = 0
    for k in range(len(window.tiles)):
        rows, columns = np.nonzero(cells == k)
        if rows.max() > 45 and columns.max() > 80:
            continue  # the wheel
        checked += 1
        corners = itertools.product((rows.min() + 1, rows.max()), (columns.min() + 1, columns.max()))
        away = [np.abs(drawn[4 * row, 4 * column, :3] - wanted[row, column]).max() for row, column in corners]
        assert min(away) < 0.02
    assert checked >= 20


def test_a_tile_that_is_pointed_at(shown, found):
    shown.do(
        "const box = $('flow').getBoundingClientRect(); $('flow').dispatchEvent(new PointerEvent('pointermove',"
        "{clientX: box.left + box.width * 40 / 128, clientY: box.top + box.height * 40 / 96}))"
    )
    told = shown.do("return $('pointed').textContent")
    k = found[0].tiles.of_pixels(128, 96)[0][40, 40]
    x, y = found[0].tiles.corners[k]
    assert told.startswith(f"x {x}, y {y}, events {found[0].counts[k]}")


def test_too_many_windows_for_a_page(found, monkeypatch):
    monkeypatch.setattr(pages, "BUDGET", 1)
    page, flow = pages.Page(), Flow(found[0].config, found[0].tiles, "x.h5", "model")
    for window in found:
        flow.add(window)
        page.add(window)
    text = page.render(flow)
    assert "The page shows one window of 4; 3 are in flow.csv." in text and '"window":0' in text
    assert '"window":1' not in text and '"window":2' not in text


def test_the_wheel():
    right, down, left, up = colours(np.array([(1.0, 0.0), (0, 1), (-1, 0), (0, -1)]), 1.0)
    assert right == pytest.approx((1, 0, 0)) and left == pytest.approx((0, 1, 1))
    assert down == pytest.approx((0.5, 1, 0)) and up == pytest.approx((0.5, 0, 1))
    assert colours(np.zeros(2), 1.0) == pytest.approx((1, 1, 1))
    assert colours(np.array([9.0, 0.0]), 1.0) == pytest.approx(right)


def test_what_the_picture_shows(slid):
    made = figure(slid, r"price $5 and ☂")
    texts = [axis.get_title() for axis in made.axes]
    assert any(f"{slid.images()[1].var():.3f}" in text for text in texts)
    shown = [image.get_array() for axis in made.axes for image in axis.get_images()]
    assert any(image.shape == (96, 128, 3) and np.allclose(image, field(slid, top_speed(slid))) for image in shown)
    (arrows,) = (one for axis in made.axes for one in axis.collections if hasattr(one, "U") and hasattr(one, "V"))
    assert len(arrows.U) == slid.trusted.sum()
    assert np.allclose(np.arctan2(arrows.V, arrows.U), np.arctan2(*slid.px_per_s[slid.trusted].T[::-1]))
