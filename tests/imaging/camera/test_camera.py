"""Pixels, rays, and what a turning camera sees."""

import numpy as np
import pytest

from cmfpga.imaging.camera import Camera

LENSES = {
    "pinhole": Camera(199.0, 201.0, 120.0, 90.0),
    "distorted": Camera(199.1, 198.8, 132.2, 110.7, -0.368, 0.151, -0.0003, -0.0009, 0.01),
}


def turned(omega, seconds, rays):
    """Rays of still points after a camera has turned, by Rodrigues' formula: nothing of the module under test."""
    angle = -np.linalg.norm(omega) * seconds  # the scene turns the other way
    x, y, z = np.divide(omega, np.linalg.norm(omega))
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    moved = matrix @ np.stack([*rays, np.ones(rays.shape[1])])
    return moved[:2] / moved[2]


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES)
def test_there_and_back(camera, rng):
    at = rng.uniform([[0], [0]], [[239], [179]], (2, 200))
    assert np.abs(camera.pixels(*camera.rays(*at)) - at).max() < 1e-6


@pytest.mark.parametrize("omega", [(0.5, 0.0, 0.0), (0.0, -0.7, 0.0), (0.0, 0.0, 2.0), (0.3, -0.4, 1.0)])
@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES)
def test_speeds_are_those_of_a_scene_that_stands_still(camera, omega, rng):
    at = rng.uniform([[20], [20]], [[219], [159]], (2, 50))
    seconds, rays = 1e-4, camera.rays(*at)
    after, before = (camera.pixels(*turned(omega, step, rays)) for step in (seconds, -seconds))
    assert np.allclose(camera.speeds(omega, *at), (after - before) / (2 * seconds), rtol=1e-4, atol=1e-3)
