"""Values that follow from a configuration."""

import pytest

from cmfpga.config import Config, preset
from cmfpga.config.regions import PAGE_EVENTS


def test_derived_values_of_the_paper_preset():
    """Widths worked out by hand, so that a bound that changes is noticed."""
    formats, sizes, widths = Config().formats, Config().geometry, Config().widths
    for part, wanted in (
        (formats, {"dt": "Q1.12", "v": "Q5.12", "eta": "UQ6.10", "roi_gain": "UQ2.4", "gradient": "Q11.24",
                   "roi_x": "UQ8.16", "roi_y": "UQ7.16"}),
        (sizes, {"pixels": 4096, "bank_columns": 32, "bank_rows": 32, "bank_words": 1024, "bank_depth": 1024,
                 "roi_x_max": 176, "roi_y_max": 116, "x_bits": 8, "y_bits": 8}),
        # 2048 votes of 256: 2^19 needs 20 bits, 21 with a sign; ΣI up to 2048·258; S up to 2048·258 · 2048·256.
        (widths, {"image_bits": 20, "derivative_image_bits": 21, "sum_i_bits": 20, "sum_d_bits": 21, "s_bits": 40,
                  "g_bits": 52}),
    ):  # fmt: skip
        found = {name: getattr(part, name) for name in wanted}
        assert {name: str(q) if part is formats else q for name, q in found.items()} == wanted
    # P² = 2^24 exactly, so ρ = 1.
    assert widths.gradient_scale == (8 + 8 + 24 - 1, 1 << 16)


def test_banks_whose_rows_are_no_power_of_two():
    config = Config(roi_width=10, roi_height=6)
    assert (config.geometry.bank_columns, config.geometry.bank_rows, config.geometry.bank_words) == (5, 3, 15)
    assert config.geometry.bank_column_bits == 3 and config.geometry.bank_depth == 24
    shift, mantissa = config.widths.gradient_scale
    exact = 2 / (60**2 * 2.0 ** (config.weight_frac + config.derivative_frac))
    assert mantissa / 2**16 * 2.0**-shift == pytest.approx(exact, rel=2**-16)
    assert 1 << 15 < mantissa <= 1 << 16


def test_an_roi_as_large_as_the_sensor_has_one_position():
    config = Config(roi_width=240, roi_height=180)
    assert (config.geometry.roi_x_max, config.geometry.roi_y_max) == (0, 0)
    assert config.formats.roi_x.i == 1  # no format of no bits


def test_the_pages_of_the_store_suffice_for_any_batch():
    """The worst: in every bin but one a page with one event, all other events in that one."""
    regions = preset("fast").replace(buffers=2, regions=2)
    sizes = [{"max_batch_events": events} for events in (1, 65535, 1 << 18)]
    for config in (regions.replace(**fields) for fields in ({}, {"bin_bits": 2}, {"bin_bits": 12}, *sizes)):
        store, events = config.store, config.max_batch_events
        bins = store.columns * store.rows
        single = min(bins - 1, events - 1)
        assert single + -(-(events - single) // PAGE_EVENTS) <= store.pages
        assert store.bins == store.rows << store.column_bits >= bins
