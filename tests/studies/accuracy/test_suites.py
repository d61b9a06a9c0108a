"""What the suites are made of."""

import math

import numpy as np
import pytest
from studies.accuracy.real import REAL_ROI_EVENTS, WINDOWS, real_cases
from studies.accuracy.synthetic import BATCHES, MARGIN, MAX_CONTRAST, WARM_RADIUS, synthetic_cases
from studies.accuracy.yardstick import ROI

from cmfpga.errors import RecordingError


def test_the_synthetic_suite_is_what_it_says(synthetic):
    assert len(synthetic) == BATCHES == 300
    facts = {name: np.array([case.facts[name] for case in synthetic]) for name in synthetic[0].facts}
    assert facts["roi_events"].min() >= 200 and facts["roi_events"].max() <= 2000
    assert (facts["texture"] == "lines").sum() == 150
    assert np.histogram(facts["speed"], 3, (0, 9))[0].min() > 75  # uniform
    assert facts["noise"].min() >= 0 and 0.28 < facts["noise"].max() <= 0.3
    assert facts["contrast"].min() == 1.0 and facts["contrast"].max() == MAX_CONTRAST
    for case in synthetic:
        assert math.hypot(*case.truth) == pytest.approx(case.facts["speed"], rel=0.02, abs=0.01)
        assert len(case.events) == case.facts["roi_events"] == case.scaled.shape[1]
        assert math.dist(case.start, case.truth) <= WARM_RADIUS
    directions = np.histogram([math.atan2(*case.truth) for case in synthetic], 4, (-math.pi, math.pi))[0]
    assert directions.min() > 50


def test_objects_stay_in_the_roi(synthetic):
    """Without its noise, a batch leaves the ROI's outermost pixels alone."""
    for case in synthetic[:40]:
        size, room = case.facts["size"], ROI - 2 * np.abs(case.truth)
        assert (size + 2 * MARGIN <= room + 0.5).all()


def test_a_part_is_the_beginning_of_the_whole(synthetic):
    for part, whole in zip(synthetic_cases(3), synthetic, strict=False):
        assert part.truth == whole.truth and np.array_equal(part.events.t, whole.events.t)
        assert np.array_equal(part.events.x, whole.events.x) and part.start == whole.start


def test_the_real_suite_is_what_it_says(real):
    assert len(real) == 76
    assert {case.facts["file"] for case in real} == {windows.file for windows in WINDOWS}
    low, high = REAL_ROI_EVENTS
    for case in real:
        assert low <= case.facts["roi_events"] <= high
        assert case.scaled.shape[1] == case.facts["roi_events"]
        hot = (case.roi[0] <= 27 < case.roi[0] + 64) and (case.roi[1] <= 70 < case.roi[1] + 64)
        assert not (hot and "evbench" in case.facts["file"])
    for a in real:
        for b in real:
            if a is not b and a.events is b.events:
                assert abs(a.roi[0] - b.roi[0]) >= 64 or abs(a.roi[1] - b.roi[1]) >= 64
    windows = {(case.facts["file"], case.facts["window"]) for case in real}
    assert len(windows) == sum(windows.count for windows in WINDOWS)


def test_a_missing_recording_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"shapes_rotation_0.0s.h5: no such file"):
        real_cases(tmp_path)
