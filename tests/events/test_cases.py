"""Files as people bring them, where they lie beside the checkout; each with its right events."""

from pathlib import Path

import numpy as np
import pytest

from cmfpga.events import open_recording
from support.recordings import read_all

CASES = Path(__file__).parents[3] / "shared" / "cases"
_SCENE = "01_evt21"  # whose events most of the others hold, too


def scene(count, **changes):
    """The first ``count`` events of the scene as columns; ``changes`` are functions of a column."""
    with np.load(CASES / _SCENE / "expected.npz") as file:
        columns = {name: file[name][:count] for name in "txyp"}
    return columns | {name: change(columns[name]) for name, change in changes.items()}


def same(path, expected, **options):
    with open_recording(CASES / path, **options) as recording:
        found = read_all(recording)
        recording.notes()
    for name, column in expected.items():
        np.testing.assert_array_equal(getattr(found, name), column, err_msg=name)
    return recording


@pytest.mark.parametrize("path, count, options, size", [
    ("01_evt21/genx320.raw", 6000, {}, (320, 320)),
    ("01_evt21/legacy.raw", 6000, {}, (320, 320)),
    ("05_metavision_csv/events.csv", 3000, {}, (None, None)),
    ("05_metavision_csv/edvs.txt", 3000, {}, (None, None)),
    ("12_polarity_codes/p12.npz", 1500, {}, (None, None)),
    ("12_polarity_codes/p255.npz", 1500, {}, (None, None)),
])  # fmt: skip
def test_scene(path, count, options, size):
    if not (CASES / path).exists():
        pytest.skip("no such case here")
    recording = same(path, scene(count), **options)
    assert (recording.width, recording.height) == size
