"""Time scaler against its model: dt is −1 … 1, x, y and last pass through."""

import numpy as np
import pytest
from amaranth.hdl import signed

from cmfpga.config import Config, preset
from cmfpga.fixed import Q
from cmfpga.reference.integer.event_path import reciprocal, time_scaler
from cmfpga.rtl import payloads
from cmfpga.rtl.image.time_scaler import TimeScaler
from support.bench import GAPS, check_latency, flow_script, play
from support.configs import CONFIGS
from support.values import edge_integers, random_gaps, random_value, tensor

SHAPES = {
    "default": CONFIGS["default"],
    "narrow": CONFIGS["narrow"],
    "short": Config(span_bits=4, reciprocal_bits=4, dt_frac=4),
    "long": Config(time_bits=48, span_bits=32, reciprocal_bits=17, dt_frac=16),
    # dt has more fraction bits than the product: shifted left, not rounded.
    "coarse": Config(span_bits=4, reciprocal_bits=4, dt_frac=12),
}


def check(config, times, span, gaps, block=None):
    rng = np.random.default_rng(0)
    block = block or TimeScaler(config)
    dt = time_scaler(config, tensor(times), span=span).tolist()
    items = [{**random_value(block.i.payload.shape(), rng), "t": t} for t in times]
    expected = [
        {"dt": value, **{key: item[key] for key in ("x", "y", "last")}} for item, value in zip(items, dt, strict=True)
    ]
    shift, mantissa = reciprocal(config, span)
    script, pushed = flow_script(block, items, gaps, rng)
    recording = play(block, [{"span": span, "shift": shift, "mantissa": mantissa}, *script])
    assert recording.values() == expected
    check_latency(block, [1 + cycle for cycle in pushed], recording)
    return dt


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, gap, rng):
    config = SHAPES[name]
    largest = (1 << config.span_bits) - 1
    for span in {1, 2, largest, largest // 2 + 1, int(rng.integers(1, largest))}:
        times = edge_integers(rng, 0, span, 40).tolist()
        dt = check(config, [0, *times, span], span, [0, *random_gaps(rng, 41, GAPS[gap])])
        # The first event is at −1, the last at +1, up to the reciprocal's precision.
        error = 1 + (1 << config.dt_frac >> config.reciprocal_bits - 1)
        assert abs(dt[0] + (1 << config.dt_frac)) <= error
        assert abs(dt[-1] - (1 << config.dt_frac)) <= error


def test_every_time_of_every_short_span():
    config = SHAPES["short"]
    for span in range(1, 16):
        check(config, list(range(span + 1)), span, [0] * (span + 1))


@pytest.mark.parametrize("name", ["quad", "short", "wide", "coarse"])
def test_in_a_window_that_slides_times_are_limited(name, rng):
    """To its end; and to −2, for the last reference time, which comes as one more event."""
    config = {
        "quad": preset("quad"),
        "short": Config(span_bits=5, time_bits=8, reciprocal_bits=8, dt_frac=4),
        "wide": Config(span_bits=20, reciprocal_bits=17, dt_frac=12),
        "coarse": Config(span_bits=16, reciprocal_bits=7, dt_frac=12),  # -2 times its reciprocal is less than 2
    }[name]
    place = payloads.Fixed(Q(9, config.formats.dithered_frac))
    block = TimeScaler(config, payloads.layout(t=signed(config.span_bits + 1), x=place, y=place, last=1))
    most = 1 << config.span_bits
    for span in (1, 2, 3, most // 2, int(rng.integers(1, most)), most - 1):
        turn = [edge + more for edge in (-span // 2, span, 3 * span // 2) for more in (-2, -1, 0, 1, 2)]
        times = [*edge_integers(rng, -most, most - 1, 40).tolist(), *turn]
        times = [t for t in times if -most <= t < most]
        dt = check(config, times, span, [0] * len(times), block)
        assert span > most // 3 or {-2 << config.dt_frac, 1 << config.dt_frac} <= {*dt}
