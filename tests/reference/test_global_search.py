"""The global search finds the motion that made the events, whichever kind it is."""

import numpy as np
import pytest

from cmfpga.imaging.camera import Camera
from cmfpga.reference.global_search import affine, rotation, rotation_as_seen, search, translation

CAMERA = Camera(199.1, 198.8, 120.2, 90.7, -0.3, 0.1)
CENTRE, SCALE = (120.0, 90.0), 80.0
US = 100_000


def moved_by(parameters):
    def path(place, dt):
        across, down = (place - np.reshape(CENTRE, (2, 1))) / SCALE
        vx, vy, vx_x, vx_y, vy_x, vy_y = parameters
        return place + dt * np.stack([vx + vx_x * across + vx_y * down, vy + vy_x * across + vy_y * down])

    return path


def turned_by(omega):
    def path(place, dt):
        rays = CAMERA.rays(*place)
        return CAMERA.pixels(*(rays + dt * np.einsum("akn,k->an", CAMERA.rotation(*rays), omega)))

    return path


def events_of(rng, path, points=400, each=8):
    """Points that stand at random places in the middle of the time range, and emit at random times."""
    place = np.repeat(rng.uniform([[10], [10]], [[230], [170]], (2, points)), each, axis=1)
    t = rng.integers(0, US, points * each)
    x, y = np.round(path(place, (t - US / 2) * 1e-6))
    order = np.argsort(t, kind="stable")
    return t[order], x[order], y[order]


@pytest.mark.parametrize("v", [(0.0, 0.0), (130.0, -60.0), (-220.0, 10.0)])
@pytest.mark.parametrize("window", [None, (20, 220, 20, 160)], ids=["all", "window"])
def test_translation(v, window, rng):
    t, x, y = events_of(rng, moved_by((*v, 0, 0, 0, 0)))
    found = search(translation(x, y), t, window=window)
    assert np.allclose(found.at_middle, v, atol=4)  # 0.2 px per half of the time range
    assert not found.rate.any() and np.array_equal(found.at(0.01), found.at_middle)


def test_affine(rng):
    truth = (40.0, -90.0, 30.0, 0.0, 0.0, -20.0)
    t, x, y = events_of(rng, moved_by(truth))
    assert np.allclose(search(affine(x, y, CENTRE, SCALE), t).at_middle, truth, atol=6)


@pytest.mark.parametrize("omega", [(0.1, 0.6, -0.3), (-0.5, 0.0, 1.0)])
def test_rotation(omega, rng):
    t, x, y = events_of(rng, turned_by(omega))
    assert np.allclose(search(rotation(CAMERA, x, y), t).at_middle, omega, atol=0.03)


def test_a_rotation_as_the_lens_shows_it(rng):
    """Where nothing is distorted both are the same; else events move as a turning camera moves them."""
    x, y = rng.uniform(0, 239, 50), rng.uniform(0, 179, 50)
    plain = Camera(245.0, 240.0, 119.5, 89.5)
    for one, other in zip(
        vars(rotation(plain, x, y)).values(), vars(rotation_as_seen(plain, x, y)).values(), strict=True
    ):
        assert one == pytest.approx(other, abs=1e-4)
    bent = Camera(245.0, 240.0, 119.5, 89.5, -0.3)
    seen = rotation_as_seen(bent, x, y)
    assert np.einsum("akn,k->an", seen.basis, (0.1, -0.2, 0.3)) == pytest.approx(
        bent.speeds((0.1, -0.2, 0.3), *seen.position), abs=1e-4
    )
    assert np.abs(seen.basis - rotation(bent, x, y).basis).max() > 20  # px/s per rad/s


def test_a_rate_that_changes(rng):
    """At a constant acceleration, the parameters' slope is found as well; without it, the image stays blurred."""
    rate = np.array([[900.0], [-500.0]])
    t, x, y = events_of(rng, lambda place, dt: place + dt * np.array([[50.0], [80.0]]) + rate * dt**2 / 2)
    found, constant = (search(translation(x, y), t, linear=linear) for linear in (True, False))
    assert np.allclose(found.at_middle, (50, 80), atol=4) and np.allclose(found.rate, rate.ravel(), atol=200)
    assert found.contrast > 1.05 * constant.contrast
    assert np.allclose(found.at(0.02), found.at_middle + 0.02 * found.rate)
