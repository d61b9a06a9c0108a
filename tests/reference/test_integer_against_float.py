"""The integer model's gradient against the float reference's, iteration by iteration from the same v."""

import numpy as np
import pytest
import torch

from cmfpga.config import Config
from cmfpga.events import BatchCutter, generate, open_recording
from cmfpga.imaging.iwe import scaled_roi_events
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.floating import evaluate
from cmfpga.reference.integer.core import IntegerCore
from support.bounds import gradient_bound

CONFIG = Config(iterations=12)


def compare(events, roi, config=CONFIG):
    """Run a batch in integers and check every iteration's gradient; the largest share of its bound."""
    torch.set_num_threads(1)
    core = IntegerCore(config)
    core.run(events.t, events.x, events.y, BatchSettings.from_config(config, roi), keep=True)
    x, y, dt = scaled_roi_events(config, events, roi)
    assert len(core.iterations) == config.iterations and len(x) > 100
    # 2·G/P² in events² per px, from raw sums.
    unit = 2.0 / config.geometry.pixels**2 / (config.widths.weight_max * config.widths.derivative_max)
    shares = []
    for step in core.iterations:
        v = np.array([config.formats.v.real(axis) for axis in step.v])
        there = evaluate(x, y, dt, v, width=config.roi_width, height=config.roi_height).gradient.numpy()
        error = np.abs(np.array(step.g) * unit - there)
        bound = np.asarray(gradient_bound(config, x.astype(np.int64), y.astype(np.int64), dt, v))
        assert (error <= bound).all()
        shares.append((error / bound).max())
    return max(shares)


@pytest.mark.parametrize("texture", ["lines", "dense"])
@pytest.mark.parametrize("speed", [(60.0, 20.0), (-150.0, 120.0)])
def test_synthetic_batches(texture, speed):
    scene = generate(seed=5, texture=texture, size=(24, 24), velocity=speed, duration_us=25_000, noise=0.1)
    assert 0 < compare(scene.events[:1500], scene.roi_start(64, 64)) < 1


def test_a_start_far_off_and_a_size_that_is_no_power_of_two():
    config = Config(roi_width=50, roi_height=36, iterations=6, start="given", v_start_x=5.3, v_start_y=-7.1)
    scene = generate(seed=6, texture="lines", size=(24, 20), velocity=(100.0, 0.0), duration_us=25_000)
    assert 0 < compare(scene.events[:1200], scene.roi_start(50, 36), config) < 1


@pytest.mark.parametrize("start", [15_000, 60_000])
def test_real_batches(data_dir, start):
    with open_recording(data_dir / "davis240c_shapes_rotation_0.0s.h5") as recording:
        batch = BatchCutter(recording, start_event=start, events=3000, max_events=65_535).next()
    assert 0 < compare(batch, (100, 30)) < 1
