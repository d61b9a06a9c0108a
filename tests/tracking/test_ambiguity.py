"""What a window's events leave open: told, not trusted, and not told of single motions."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import cmfpga
from cmfpga.config import preset
from cmfpga.engines import make_engine
from cmfpga.events import Events, generate
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.tracking import ambiguity as rules
from cmfpga.tracking import sliding
from cmfpga.tracking.ambiguity import UNTRUSTED, Ambiguity, ambiguity
from cmfpga.tracking.columns import columns
from cmfpga.tracking.verdict import Verdict
from studies.accuracy import ambiguous

COUNT = 36


CONFIG = preset("fast").replace(buffer_events=8191)


@pytest.fixture(scope="module")
def engine():
    with closing(make_engine("model", CONFIG)) as engine:
        yield engine


@pytest.fixture(scope="module")
def found(engine):
    scenes = ambiguous.SCENES.items()
    return {name: ambiguous.counts(ambiguous.judged(engine, scene, COUNT)) for name, scene in scenes}


def singles(engine, count=1):
    """Events of single motions, and what the engine finds in each."""
    settings = replace(BatchSettings.from_config(CONFIG, ambiguous.PLACE), start_last=False, v_start=(0, 0))
    rng = np.random.default_rng(5)
    for k in range(count):
        events, _ = ambiguous.single(rng, k)
        yield events, engine.run(events, settings)[0]


def total(found, words, what):
    return sum(one[what] for name, one in found.items() if words in name)


@pytest.mark.parametrize(
    "words, least, most", [("gratings", 0.05, 0.02), ("two", 0.1, 0.05), ("stops", 0.1, 0.02), ("turns", 0.2, 0.17)]
)
def test_what_is_wrong_is_not_trusted(found, words, least, most):
    whole = total(found, words, "batches")
    assert total(found, words, "wrong_before") > least * whole
    assert total(found, words, "wrong") <= most * whole


def test_what_is_open_has_its_name_and_single_motions_stay_trusted(found):
    named = {"gratings": ("stripes", "one_direction"), "two": ("two_motions",), "stops": ("changes",)}
    for words, name in ((words, name) for words, names in named.items() for name in names):
        assert total(found, words, name) > 0.3 * total(found, words, "trusted_before")
    assert found["straight edges"]["wrong"] == 0
    one = found["single motion"]
    assert one["wrong_before"] == 0 and one["trusted"] > 0.9 * one["trusted_before"] > 0.8 * COUNT
    # One motion never looks like halves of the ROI that move apart, though dense texture looks like two motions.
    two = found["two motions, beside"]
    assert one["apart"] == 0 < two["wrong_before"] and two["apart"] > 0.8 * two["wrong_before"]


def test_what_the_border_cuts_does_not_change(engine):
    """Objects half of which are in the ROI, and move in or out by 8 px."""
    settings = replace(BatchSettings.from_config(CONFIG, ambiguous.PLACE), start_last=False, v_start=(0, 0))
    rng, told = np.random.default_rng(2), []
    for v in np.array([(4.0, 1.0), (-4.0, -1.0)] * 8):
        events = ambiguous._object(rng, v, "lines", (40, 40), 2.0, off=np.array([28.0, 4.0]))
        (result,) = engine.run(events, settings)
        told.append(ambiguity(CONFIG, events, result, thinned=bool(result.thinned)))
    assert not any(one & Ambiguity.CHANGES for one in told) and sum(one & UNTRUSTED == 0 for one in told) > 12


def test_the_ends_of_the_time_are_compared(rng):
    """Points that others replace: the middle third has both, and is like either end."""
    size, pixels = (64, 64), rng.integers(20, 44, (2, 2, 60)).repeat(60, 2)
    dt = rng.uniform(-1, 1 / 3, 3600)
    x, y, dt = (np.concatenate(each) for each in ((*pixels[:, 0],), (*pixels[:, 1],), (dt, -dt)))
    halves = [rules._spectra(x[part], y[part], dt[part], size) for part in np.split(rng.permutation(len(dt)), 2)]
    images = np.fft.irfft2(np.stack([rules._moved(half, (0, 0), size) for half in halves]).sum(1), (32, 32))
    assert rules._lasting(sum(halves), images[:, 4], (0, 0), size) < 0.3 < rules.LASTS


@pytest.mark.parametrize("step, told", [(1000, 0), (15_000, Ambiguity.FEW_STAMPS)])
def test_few_time_stamps(step, told):
    scene = generate(seed=3, velocity=(120.0, -40.0), duration_us=150_000)
    at = scene.events
    events = Events(at.t // step * step, at.x, at.y, at.p)
    where = {"roi": scene.roi_start(64, 64), "sensor": (240, 180)}
    tracking = cmfpga.track(events, preset="fast", engine="model", batch_us=45_000, **where)
    assert tracking.ambiguity.tolist() == [told] * len(tracking) and len(tracking) >= 2
    assert tracking.trusted.any() == (not told) and len(tracking.verdict.speeds) == tracking.trusted.sum()


@pytest.mark.parametrize("pixels, told", [(1, Ambiguity.FEW_PIXELS), (3, Ambiguity.FEW_PIXELS), (200, 0)])
def test_hot_pixels_that_stand_still(pixels, told, rng):
    """The peak is sharp, for they do not move; as many pixels as an edge has may be a thing at rest."""
    many = 600
    at = rng.choice(40 * 40, pixels, replace=False)[np.arange(many) % pixels]
    x, y = np.where(np.arange(many) % 10, (at % 40 + 100, at // 40 + 70), rng.integers(88, 152, (2, many)))
    events = Events(np.sort(rng.integers(0, 40_000, many)), x, y, np.zeros(many, np.uint8))
    options = {"roi": (88, 58), "sensor": (240, 180), "preset": "fast", "engine": "model", "hot_pixels": 0}
    tracking = cmfpga.track(events, batch_events=many, **options)
    assert np.hypot(tracking.vx, tracking.vy) < 0.5 and tracking.confidence > 100
    assert tracking.ambiguity.tolist() == [told] and tracking.trusted.tolist() == [not told]


@pytest.mark.parametrize("off, told", [(0.0, 0), (0.3, 0), (1.8, Ambiguity.ELSEWHERE)])
def test_a_contrast_that_is_sharper_elsewhere(engine, off, told):
    """As where the buffer held too small a part of the events, or the ascent stopped early."""
    for events, result in singles(engine, 4):
        for x, y in ((off, 0.0), (0.0, -off)):
            moved = replace(result, v=(result.v[0] + x, result.v[1] + y))
            assert ambiguity(CONFIG, events, moved, thinned=bool(result.thinned)) & ~Ambiguity.TWO_MOTIONS == told


def test_two_depths_of_a_sharp_image_are_not_trusted(data_dir, monkeypatch):
    """Everything moves along x on the rail; both halves of this ROI hold both depths, and agree on neither's v."""
    monkeypatch.setattr(sliding, "WAY_PX", 5.0)  # in longer windows the image changes besides
    where = {"roi": (66, 58), "preset": "sliding", "engine": "model"}
    tracking = cmfpga.track(data_dir / "davis240c_slider_depth_0.0s.h5", **where)
    off = np.abs(tracking.vy) > 0.6
    sharp = np.array([not one & (Flag.DOUBTFUL | Flag.DEGENERATE) for one in map(Flag.parse, tracking.flags)])
    assert (off & sharp).sum() >= 5 and not (off & tracking.trusted).any()
    assert (tracking.ambiguity[off & sharp] & Ambiguity.APART).mean() > 0.7


@pytest.mark.filterwarnings("ignore:hot pixels")
def test_windows_that_few_around_them_bear_out_are_not_trusted(data_dir, monkeypatch):
    """A camera pans over boxes: vy = 0. One window in twenty is sharp, by chance, and some of these are wrong."""
    monkeypatch.setattr(sliding, "WAY_PX", 5.0)  # longer windows are sharp, and right
    tracking = cmfpga.track(data_dir / "davis240c_translboxes_imu.h5", roi="auto", engine="model")
    off, alone = np.abs(tracking.vy) > 0.6, tracking.ambiguity & Ambiguity.ALONE > 0
    assert (off & alone).sum() >= 5 and not (off & tracking.trusted).any()


@pytest.mark.parametrize("thinned, share, told", [(True, 1.0, 0), (True, 0.2, Ambiguity.THINNED), (False, 0.2, 0)])
def test_a_blurred_image_of_which_few_events_are_kept_is_not_trusted(engine, thinned, share, told):
    """A fifth of the curvature: noise has blurred the image."""
    ((events, result),) = singles(engine)
    blurred = replace(result, curvature=tuple(round(share * one) for one in result.curvature))
    assert ambiguity(CONFIG, events, blurred, thinned=thinned) & ~Ambiguity.TWO_MOTIONS == told


def test_the_verdict_says_it():
    left = np.array([0, 8, 8, 8, 2, 8]).astype(float)
    values = {name: np.ones(6) for name in columns("translation")}
    values |= {"confidence": np.full(6, 99.0), "trusted": (left != 2).astype(float), "ambiguity": left}
    verdict = Verdict(values.get, [Flag(0)] * 6)
    assert verdict.share == "5 of 6 batches are to be trusted (in 1, stripes: may repeat)"
    assert str(verdict).startswith("5 of 6 batches are to be trusted (in 1, stripes: may repeat). Velocity ")
    assert any(text.startswith("4 of 6 batches look as if two motions") for text in verdict.notes(fitted=True))
    told, none = verdict.summary(), dict.fromkeys((one.name.lower() for one in Ambiguity), 0)
    assert told["trusted_batches"] == 5
    assert told["ambiguous_batches"] == none | {"stripes": 1, "two_motions": 4}
    few = Verdict((values | {"ambiguity": np.array([0, 8, 8, 8, 2, 0.0])}).get, [Flag(0)] * 6)
    assert not any("two motions" in text for text in few.notes(fitted=True)), "half of them may be by chance"
    values |= {"trusted": np.zeros(6), "ambiguity": np.full(6, 2.0)}
    assert Verdict(values.get, [Flag(0)] * 6).lost == [], "sure of a sharp peak: no batch started cold"
    assert Verdict(values.get, [Flag.DOUBTFUL] * 6).lost
