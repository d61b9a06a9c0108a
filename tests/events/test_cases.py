"""Files as people bring them, where they lie beside the checkout; each with its right events."""

from pathlib import Path

import numpy as np
import pytest

from cmfpga.events import open_recording
from support.recordings import read_all

CASES = Path(__file__).parents[3] / "shared" / "cases"
BAGS = ("ros1.bag", "ros2", "ros2/ros2.mcap")
# What is added to the scene's columns: the time of ROS, the offset that a file of DSEC has apart, a sensor of 128×128.
ROS, DSEC, SMALL = {"t": 1_700_000_000 * 10**6}, {"t": 49_585_231_313}, {"x": -60, "y": -50}


# The events are the first ``count`` of one scene, but for those that a folder of its own has.
@pytest.mark.parametrize("path, count, options, size, shift", [
    *((f"01_evt21/{name}.raw", 6000, {}, (320, 320), {}) for name in ("genx320", "legacy")),
    *((f"04_rosbag/{name}", 3000, {"dataset": "/event_camera/events"}, (640, 480), {}) for name in BAGS),
    *((f"04_rosbag/{name}", 3000, {"dataset": "/dvs/events"}, (640, 480), ROS) for name in BAGS),
    ("02_hdf5_filters/dsec_like.h5", 2000, {}, (640, 480), DSEC),
    ("06_v2e_aedat2/v2e.aedat", 3000, {"sensor": (346, 260)}, (346, 260), {}),
    ("08_nmnist_bin/digit.bin", 2000, {}, (None, None), SMALL),
    ("09_aedat31/gesture.aedat", 2000, {}, (128, 128), SMALL),
    ("10_dvs128_aedat2/dvs128.aedat", 2000, {}, (128, 128), SMALL),
    ("18_raw_without_header/dump.raw", 2000, {"form": "evt2", "sensor": (320, 320)}, (320, 320), {}),
    *((path, count, {}, (None, None), {}) for path, count in (
        ("02_hdf5_filters/zstd_like.h5", 2000), ("05_metavision_csv/events.csv", 3000),
        ("05_metavision_csv/edvs.txt", 3000), ("12_polarity_codes/p12.npz", 1500), ("12_polarity_codes/p255.npz", 1500),
        ("17_evimo2_npy", 2000), ("17_evimo2_npy/dataset_events_t.npy", 2000), ("19_fractions/ms.csv", 6000),
        ("19_fractions/us.csv", 6000),
    )),
])  # fmt: skip
def test_right_events(path, count, options, size, shift):
    folder = CASES / path.split("/")[0]
    if not folder.exists():
        pytest.skip("no such case here")
    for part, package in (("rosbag", "rosbags"), ("hdf5_filters", "hdf5plugin")):
        if part in path:
            pytest.importorskip(package)
    own = folder / "expected.npz"
    with np.load(own if own.exists() else CASES / "01_evt21" / "expected.npz") as file:
        columns = {name: file[name][:count] for name in "txyp"}
    with open_recording(CASES / path, **options) as recording:
        found = read_all(recording)
        assert (recording.width, recording.height) == size
    for name, column in columns.items():
        np.testing.assert_array_equal(getattr(found, name), column.astype(int) + shift.get(name, 0), err_msg=name)
