"""Motion models: their formats, and what their hardware builds on."""

import re

import pytest

from cmfpga.config import Config, preset
from cmfpga.config.motion import MOTIONS, needs
from cmfpga.errors import ConfigError
from cmfpga.protocol.settings import BatchSettings


def test_translation_has_no_basis():
    motion = Config().motion_model
    assert (motion.names, motion.basis, motion.terms) == (("x", "y"), {}, {"x": (), "y": ()})
    assert Config().formats.flow == Config().formats.v


@pytest.mark.parametrize("name, names, members", [
    ("similarity", ("x", "y", "zoom", "roll"), {"p", "q"}),
    ("rotation", ("x", "y", "roll"), {"p", "q", "xx", "xy", "yy"}),
])  # fmt: skip
def test_parameters_and_basis(name, names, members):
    config = preset(name)
    motion = config.motion_model
    assert motion.names == names and set(motion.basis) == members and config.motion == name
    # A quarter of the lever arm at most, in the format of v.
    assert [p.fmt.real(p.fmt.max + 1) for p in motion.parameters[2:]] == [16] * len(names[2:])
    assert motion.lever == 6 and motion.frac == 8
    assert {p.moves_roi for p in motion.parameters} == ({None} if name == "rotation" else {"x", "y", None})
    # The largest p and q of the ROI, or of the sensor, fit.
    for member, size in zip("pq", (config.roi_width, config.roi_height), strict=True):
        q = motion.basis[member]
        assert q.real(q.max) * 64 >= (size if name == "rotation" else size / 2)


@pytest.mark.parametrize("motion", [name for name in MOTIONS if name != "translation"])
def test_what_a_motion_needs(motion):
    good = preset(motion)
    others = {"gradient": "sweep", "border": "corners", "undistortion": "off", "confidence": 1}
    for name in needs(motion):
        if name in others:
            with pytest.raises(ConfigError, match=f"^motion = {motion}: {name} = {needs(motion)[name]} is needed$"):
                good.replace(**{name: others[name]})
    with pytest.raises(ConfigError, match=f"motion = {motion}: ascent = sign is needed"):
        Config(motion=motion, gradient="one_pass", border="whole", undistortion=good.undistortion)
    with pytest.raises(ConfigError, match=f"motion = {motion}: an ROI of at least 16 px along one side is needed"):
        good.replace(roi_width=14, roi_height=15)
    assert good.replace(roi_width=16, roi_height=2).motion_model.lever == 3


def test_the_exact_model_holds_a_whole_sensor():
    """With quadratic terms and 32,768 events on 240×180 px; a sensor and a buffer that are too large are refused."""
    assert max(preset("rotation").widths.exact.values()) <= 63
    with pytest.raises(ConfigError, match=r"needs 6[4-9] bits, more than the 63"):
        preset("rotation").replace(
            sensor_width=1280, sensor_height=720, roi_width=1280, roi_height=720, buffer_events=1 << 17,
            weight_frac=8, derivative_frac=8, tag_bits=16,
        )  # fmt: skip


@pytest.mark.parametrize("camera, message", [
    ("", "a calibration is needed: camera = fx,fy,cx,cy,k1,k2,p1,p2,k3, in px"),
    ("200,230,120,90", "fx = 200, fy = 230 px: they may differ by 5 %"),
    ("200,200,240,90", "cx = 240 px: 0 to 239 is needed, on the sensor"),
    ("200,200,100,-1", "cy = -1 px: 0 to 179 is needed, on the sensor"),
    ("30,31,100,90", "f = 30.4959 px: at least 32 px is needed"),
])  # fmt: skip
def test_a_rotation_without_a_camera_that_fits(camera, message):
    """The hardware can be built without; a batch cannot be run."""
    config = preset("rotation").replace(camera=camera)
    with pytest.raises(ConfigError, match=f"^motion = rotation: {re.escape(message)}$"):
        BatchSettings.from_config(config)


def test_a_camera_as_the_hardware_has_it():
    motion = preset("rotation").motion_model
    assert motion.centre((200, 200, 100.3, 90.9)) == (401, 364)
    assert motion.curve((200, 210, 0, 0)) == round(2**27 / 42000)
    assert motion.curve((32, 32, 0, 0)) == 2**17 - 1
