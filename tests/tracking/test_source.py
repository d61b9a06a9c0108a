"""The size of a sensor that nobody says: one rule for all commands."""

import numpy as np
import pytest

from cmfpga.api.flow import configure
from cmfpga.config import preset
from cmfpga.errors import ConfigError
from cmfpga.events import Events, MemoryRecording, open_recording
from cmfpga.tracking.source import likely_sensor, rotation_fields, sensor_fields


@pytest.mark.parametrize("covered, size", [
    ((0, 0), (240, 180)), ((240, 180), (240, 180)), ((241, 10), (304, 240)), ((319, 319), (320, 320)),
    ((346, 200), (346, 260)), ((600, 470), (640, 480)), ((641, 3), (1280, 720)), ((1280, 721), (1280, 800)),
    ((1400, 900), (1400, 900)),
])  # fmt: skip
def test_the_smallest_sensor_that_holds_the_events(covered, size):
    assert likely_sensor(covered, (240, 180)) == size


def test_track_and_flow_take_the_same(tmp_path):
    many = np.arange(300)
    np.savez(tmp_path / "a.npz", t=many, x=many * 2, y=many, p=many % 2)
    with open_recording(tmp_path / "a.npz", time_unit="us") as recording:
        fields, note = sensor_fields(recording, {}, preset, "--sensor W,H")
        assert fields == {"sensor_width": 640, "sensor_height": 480}
        assert note.endswith("does not say how large its sensor is: taking 640×480 px; say it with --sensor W,H")
        config, *_ = configure(recording, "flow", {}, None, None, str)
        assert (config.sensor_width, config.sensor_height) == (640, 480)
        assert sensor_fields(recording, {"sensor_width": 700}, preset, "") == ({}, None)


@pytest.mark.parametrize("size, binning, bits", [
    ((240, 180), 0, None), ((346, 260), 0, 11), ((320, 320), 0, 11), ((640, 480), 1, 11), ((1280, 720), 2, 11),
    ((1280, 800), 2, 11),
])  # fmt: skip
def test_a_rotation_has_the_binning_and_the_tags_that_its_image_needs(size, binning, bits):
    """No more of them, and none where the preset's are enough, or a smaller ROI is told."""
    source = MemoryRecording(Events([0], [0], [0], [0]), *size)
    sensor = dict(zip(("sensor_width", "sensor_height"), size, strict=True))
    camera = {"camera": "250,250,119,89,0,0,0,0,0"}
    found = rotation_fields(source, "rotation", camera, "")
    most = {1: (1 << 20) - 1, 2: (1 << 22) - 1}  # as many events a pixel of the image as without
    assert found == {
        "roi_width": size[0] >> binning, "roi_height": size[1] >> binning, **({"tag_bits": bits} if bits else {}),
        **({"binning": binning, "max_batch_events": most[binning]} if binning else {}),
    }  # fmt: skip
    config = preset("rotation").replace(**sensor, **camera, **found)
    assert config.geometry.bank_depth <= 16 << 12, "an image that fills more than the UltraRAMs of a KV260"
    if binning:  # and a finer one would
        finer = rotation_fields(source, "rotation", {**camera, "binning": binning - 1}, "")
        assert preset("rotation").replace(**sensor, binning=binning - 1, **finer).geometry.bank_depth > 16 << 12
    if bits:
        with pytest.raises(ConfigError, match=rf"^tag_bits = {bits - 1}: .*: tag_bits = {bits} or more$"):
            config.replace(tag_bits=bits - 1)
    assert rotation_fields(source, "rotation", {**camera, "roi_width": 200, "roi_height": 150}, "") == {}
