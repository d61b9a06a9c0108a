"""Whole real recordings through the emitted Verilog and the integer model."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cmfpga.config import Config
from cmfpga.engines import make_engine
from cmfpga.events import BatchCutter, open_recording
from cmfpga.protocol.settings import BatchSettings

RECORDINGS = {  # file: ROI of the first batch, events of a batch
    "davis240c_shapes_rotation_0.0s.h5": ((100, 30), 5000),
    "davis240c_shapes_rotation_2.1s_gtflow.h5": ((90, 60), 2000),
    "davis240c_shapes_translation_52.0s.h5": ((90, 60), 3000),
    "davis240c_slider_depth_0.0s.h5": ((90, 60), 5000),
    "davis240c_translboxes_imu.h5": ((90, 60), 6000),
    "davis240b_evbench_seq0002.h5": ((92, 66), 5000),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_whole_recording(data_dir, name):
    torch.set_num_threads(1)
    roi, size = RECORDINGS[name]
    # 20 iterations: every event of every recording passes through, in a time that CI can spare.
    config = Config(iterations=20)
    rtl, model = make_engine("rtl", config), make_engine("model", config)
    formula = rtl._core.core.cycles
    batches = 0
    with open_recording(data_dir / name) as recording:
        cutter = BatchCutter(recording, events=size, max_events=config.max_batch_events)
        while (batch := cutter.next()) is not None:
            settings = BatchSettings.from_config(config, None if batches else roi)
            a, b = rtl.run(batch, settings)[0], model.run(batch, settings)[0]
            assert replace(a, cycles=None) == b
            assert a.cycles == formula(events=a.events, roi_events=a.roi_events, iterations=a.iterations)
            assert a.events == a.roi_events + a.outside + a.overflow
            batches += 1
        assert batches == recording.num_events // size
    rtl.close()
    assert batches >= 10


def test_every_iteration_of_one_real_batch(data_dir):
    """All 100 iterations of the article's workload, from a start far off, on the densest recording."""
    torch.set_num_threads(1)
    config = Config(start="given", v_start_x=9.0, v_start_y=-7.0)
    rtl, model = make_engine("rtl", config), make_engine("model", config)
    with open_recording(data_dir / "davis240b_evbench_seq0002.h5") as recording:
        batch = BatchCutter(recording, events=5000, max_events=config.max_batch_events).next()
    settings = BatchSettings.from_config(config, (92, 66))
    a, b = rtl.run(batch, settings)[0], model.run(batch, settings)[0]
    assert a.iterations == 100 and len(np.unique(a.trace.v, axis=0)) > 20
    assert a.trace == b.trace
    rtl.close()
