"""What the parameters of a motion mean: signs and frames, against the camera's own rotation and a global search."""

import dataclasses
import math

import numpy as np
import pytest

import cmfpga
from cmfpga.config import preset
from cmfpga.errors import ConfigError
from cmfpga.events import generate
from cmfpga.imaging.camera import RATES, Camera, extent, flow, parameters, rates
from cmfpga.reference.global_search import rotation, search

SPAN = 40_000  # µs
OMEGA = (0.7, -1.1, 0.4)
CAMERA = Camera(200.0, 200.0, 118.0, 91.0)
PINHOLE = preset("rotation").replace(camera=CAMERA.text)
SIMILAR = preset("similarity")


def test_the_flow_of_a_rotation_is_that_of_the_camera():
    y, x = (axis.ravel().astype(float) for axis in np.mgrid[0 : PINHOLE.roi_height : 9, 0 : PINHOLE.roi_width : 9])
    moved = flow(PINHOLE, parameters(PINHOLE, OMEGA, SPAN), x, y, (0, 0))
    assert np.allclose(moved, CAMERA.speeds(OMEGA, x, y) * SPAN / 2e6, atol=1e-6)


def test_a_roi_beside_the_corner_has_the_same_flow_at_the_same_place():
    config = PINHOLE.replace(roi_width=64, roi_height=48)
    v = parameters(config, OMEGA, SPAN)
    moved = flow(config, v, np.array([3.0]), np.array([5.0]), (40, 30))
    assert np.allclose(np.ravel(moved), CAMERA.speeds(OMEGA, [43.0], [35.0])[:, 0] * SPAN / 2e6, atol=1e-6)


def test_a_similarity_grows_and_turns_clockwise():
    x, y = np.array([63.5, 103.5]), np.array([63.5, 63.5])
    u, v = flow(SIMILAR, parameters(SIMILAR, (100.0, -50.0, 2.0, 0.5), SPAN), x, y, (7, 9))
    assert np.allclose(u, [2.0, 2.0 + 40 * 2.0 * 0.02]) and np.allclose(v, [-1.0, -1.0 + 40 * 0.5 * 0.02])


@pytest.mark.parametrize("config, motion", [(PINHOLE, OMEGA), (SIMILAR, (100.0, -50.0, 2.0, 0.5))])
def test_there_and_back(config, motion):
    found = rates(config, parameters(config, motion, SPAN), SPAN)
    assert tuple(found) == RATES[config.motion]
    assert [*found.values()] == pytest.approx([*motion] if config is PINHOLE else [2.0, 0.5, 0.5])
    assert set(rates(config, (0.0,) * len(config.motion_model.names), 0).values()) == {None}


def test_no_zoom_has_no_time_to_contact():
    assert rates(SIMILAR, (1.0, 0.0, 0.0, 0.0), SPAN)["time_to_contact_s"] is None
    assert rates(SIMILAR, (1.0, 0.0, -1.0, 0.0), SPAN)["time_to_contact_s"] < 0


def test_a_translation_stays_what_it_was():
    config, v = preset("fast"), (3.0, -4.0)
    assert flow(config, v, None, None, (0, 0)) is v and rates(config, v, SPAN) == {} and extent(config, v, (0, 0)) == 5


def test_the_extent_is_that_of_the_edge_where_the_centre_stands_still():
    assert extent(SIMILAR, (0.0, 0.0, 0.0, 4.0), (0, 0)) == pytest.approx(4.0 * 63.5 / 64)
    assert extent(SIMILAR, (3.0, 4.0, 0.0, 0.0), (0, 0)) == pytest.approx(5.0)


@pytest.fixture(scope="module")
def turned():
    """A scene in front of a camera with a lens, which turns."""
    camera = Camera(200.0, 200.0, 118.0, 91.0, -0.35, 0.12)
    how = {"seed": 3, "size": (360, 270), "bars": 20, "duration_us": 40_000, "contrast": 2.0}
    return camera, generate(**how, camera=camera, rotation=OMEGA)


def test_the_synthetic_rotation_is_what_a_global_search_finds(turned):
    camera, scene = turned
    events = scene.events
    found = search(rotation(camera, events.x, events.y), events.t)
    assert np.abs(found.at_middle - OMEGA).max() < math.radians(2)


def test_a_rotation_needs_a_camera(turned):
    with pytest.raises(ConfigError, match="it holds no calibration, which motion = rotation needs: camera="):
        cmfpga.track(turned[1], preset="rotation", engine="model")


def test_a_rotation_adds_no_velocity(turned):
    """Unless one is given, too."""
    scene = turned[1].scene
    assert (turned[1].motion.velocities == 0).all()
    still = generate(dataclasses.replace(scene, velocity=(0.0, 0.0)))
    moved = generate(dataclasses.replace(scene, velocity=(100.0, 0.0)))
    assert len(still.events) == len(turned[1].events) and (still.events.x == turned[1].events.x).all()
    assert len(moved.events) != len(still.events)
