"""The table of result fields, and outcomes by batch and by region."""

import dataclasses
import pickle

import numpy as np
import pytest

from cmfpga.config import PRESETS, preset
from cmfpga.protocol import results as protocol
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.layout import BASE
from cmfpga.protocol.results import COUNTS, RESULTS, BatchResult, RegionOutcome, WireResult, fields_of
from cmfpga.protocol.settings import SETTINGS, BatchSettings, settings_of, settings_values
from cmfpga.protocol.shapes import leaves
from cmfpga.protocol.trace import Trace, columns
from cmfpga.rtl import payloads
from cmfpga.rtl.top import flatten, verilog_top
from support.configs import WRAPPED
from support.values import required

REGION = required(
    "region", v=(1.5, -0.25), roi_events=3, outside=1, roi=(4, 5), roi_next=(6, 6), iterations=5, flags=Flag.OVERFLOW
)
BATCH = required("batch", span=100, events=4)


def some_trace(**changes):
    fields = {"v": np.zeros((2, 2)), "sum_i": np.zeros(1), "sum_d": np.zeros((1, 2)), "s": np.zeros((1, 2))}
    return Trace(**{**fields, **changes})


@pytest.mark.parametrize("name", WRAPPED)
def test_every_bit_of_a_result_has_its_place(name):
    """No leaf is wider than the registers that show it, and none is left out."""
    config = preset(name)
    linked = register_map(config).linked("Result")
    wanted = {leaf: q.width for f in RESULTS for leaf, q in leaves(f.name, f.shape(config)).items() if f.when(config)}
    assert set(linked) == set(wanted)
    for leaf, width in wanted.items():
        ends = [f.link_lsb + f.width for _, f in linked[leaf]]
        assert [0, *ends[:-1]] == [f.link_lsb for _, f in linked[leaf]] and ends[-1] >= width, leaf


def test_words_of_a_packet_have_no_gaps():
    words = {place.word for f in RESULTS for place in f.places}
    assert words == set(range(len(words)))
    # Presets of one motion, in batches or not, have packets of one length, up to the last register of one of them.
    lengths, last = {}, {}
    for config in map(preset, WRAPPED):
        basis = bool(config.motion_model.basis), config.slides
        lengths.setdefault(basis, set()).add(protocol.packet_beats(config))
        used = {r.offset for places in register_map(config).linked("Result").values() for r, _ in places}
        last[basis] = max(last.get(basis, 0), *((offset - BASE["Result"]) // 4 for offset in used))
    assert lengths == {basis: {1 + word // 2} for basis, word in last.items()} and len(last) == 3


def test_names_are_used_once():
    assert len({f.name for f in RESULTS}) == len(RESULTS) and len({s.name for s in SETTINGS}) == len(SETTINGS)
    totals = [f.total.word for f in RESULTS if f.total]
    assert len(set(totals)) == len(totals)


@pytest.mark.parametrize("name", PRESETS)
def test_the_hardware_has_what_the_tables_say(name):
    config = preset(name)
    if config.motion == "rotation":
        config = config.replace(camera="200,200,120,90")
    core = verilog_top(config)
    own, trace = (["region", "last"], "trace_0_") if config.regions else ([], "trace_")
    results = [leaf for f in fields_of("batch", "region", config=config) for leaf in leaves(f.name, f.shape(config))]
    given = [port.removeprefix("result_") for port in core.outputs if port.startswith("result_")]
    assert given == ["valid", *own, *results]
    settings = settings_values(config, BatchSettings.from_config(config))
    assert [port.removeprefix("settings_") for port in core.inputs if port.startswith("settings_")] == list(settings)
    traced = [port for port in core.outputs if port.startswith(trace) and "pixels" not in port]
    assert traced == [trace + name for name in ("valid", *own[:1], *columns(config))]
    assert set(payloads.batch(config).members) < {"settings", "cut", "clamped", *(f.name for f in RESULTS)}


def test_payloads_know_their_formats():
    config = preset("fast")
    shapes = {leaf: shape for leaf, (_, shape) in flatten(payloads.settings(config), "settings").items()}
    assert shapes["settings_eta"].q == config.formats.eta and shapes["settings_v_start_x"].q == config.formats.v
    assert [setting.name for setting in settings_of(config, "shell")] == ["batch_events", "duration", "by_tlast"]


def test_a_raw_result_is_read():
    config = preset("paper")
    values = {leaf: 3 for f in fields_of("batch", "region", config=config) for leaf in leaves(f.name, f.shape(config))}
    found = protocol.decode(config, values | {"v_x": -(3 << 11), "flags": int(Flag.CUT)})
    assert found["v"] == (-1.5, 3 / 4096) and found["roi"] == (3, 3) and found["flags"] is Flag.CUT
    assert found["sums"] == (3,) * 5
    assert protocol.decode(config, values | {"flags": 1})["sums"] == (0,) * 5  # in a degenerate batch they mean nothing


def test_fields_of_the_only_region_are_the_outcomes_too():
    outcome = BatchResult(**BATCH, **REGION)
    assert outcome == BatchResult(**BATCH, regions=(RegionOutcome(**REGION),))
    assert outcome.v == outcome.regions[0].v == (1.5, -0.25) and outcome.cycles is None and outcome.t_first is None
    assert outcome.events == sum(getattr(outcome, name) for name in COUNTS)
    moved = dataclasses.replace(outcome, roi=(7, 7), span=9)
    assert (moved.regions[0].roi, moved.span, moved.v) == ((7, 7), 9, outcome.v) and moved != outcome
    assert pickle.loads(pickle.dumps(outcome)) == outcome
    with pytest.raises(AttributeError, match="no attribute 'speed'"):
        outcome.speed  # noqa: B018


def test_of_several_regions_each_has_its_own():
    region = RegionOutcome(**REGION)
    outcome = BatchResult(**BATCH, regions=(region, dataclasses.replace(region, v=(0.0, 0.0))))
    assert outcome.span == 100 and outcome.regions[1].v == (0.0, 0.0)
    with pytest.raises(AttributeError, match="v: the batch has 2 regions"):
        outcome.v  # noqa: B018


def test_a_field_that_is_missing_is_named():
    all_of_it = BATCH | REGION
    for name, message in (("span", "span is missing"), ("roi_next", "roi_next")):
        with pytest.raises(TypeError, match=message):
            BatchResult(**{field: value for field, value in all_of_it.items() if field != name})
    with pytest.raises(TypeError, match="speed"):
        BatchResult(**all_of_it, speed=1)


def test_a_batch_without_events():
    known = {"roi": (1, 2), "roi_next": (1, 2), "v": (0.5, 0.0)}
    for kind in (BatchResult, WireResult):
        nothing = kind.nothing(known)
        assert nothing.flags is Flag.DEGENERATE and nothing.roi == (1, 2) and nothing.sums == (0,) * 5
        assert not any(getattr(nothing, name) for name in (*COUNTS, "events", "iterations", "span"))
        assert nothing.t_first is nothing.cycles is None
    assert nothing.batch == 0 and nothing.t_ref is None and nothing.wire is nothing.config_range is False


def test_sums_are_those_of_the_last_iteration():
    trace = some_trace(sum_i=np.array([5, 7]), sum_d=np.array([[1, 2], [3, 4]]), s=np.array([[0, 0], [-5, 6]]))
    assert BatchResult(**BATCH, **REGION, trace=trace).sums == (7, 3, 4, -5, 6)
    assert BatchResult(**BATCH, **REGION, trace=some_trace(sum_i=np.zeros(0))).sums == (0,) * 5


def test_traces_are_compared_by_all_their_values():
    assert some_trace() == some_trace()
    assert some_trace() != "trace"
    for field in dataclasses.fields(Trace):
        values = getattr(some_trace(), field.name)
        assert some_trace(**{field.name: values + 1}) != some_trace()
        assert some_trace(**{field.name: values[:0]}) != some_trace()


#: From bit 0 on.
NAMES = "degenerate overflow time_back time_span cut saturated roi_clamped schedule thinned doubtful short".split()


@pytest.mark.parametrize("flags, text", [
    (Flag(0), ""), (Flag.ROI_CLAMPED | Flag.DEGENERATE, "degenerate|roi_clamped"), (sum(Flag), "|".join(NAMES)),
    *((Flag(1 << bit), name) for bit, name in enumerate(NAMES)),
])  # fmt: skip
def test_flags_have_the_bits_of_the_hardware_and_a_text(flags, text):
    assert Flag(flags).text == text and Flag.parse(text) == flags
