"""Figures of the tables, from outcomes made by hand."""

import math
from pathlib import Path
from types import SimpleNamespace

import pandas
import pytest

from cmfpga.config import Config, preset
from cmfpga.fpga import resources
from cmfpga.sweep import tables
from cmfpga.sweep.plan import Choice, Row, Subject
from cmfpga.sweep.task import Run, Store
from cmfpga.tracking.columns import COLUMNS
from cmfpga.truth import Truth

TRUTH = Truth("recording", (0,), ((1.0, 0.0),), (0.0, 0.0))

#: Columns whose empty text a CSV cannot tell from a missing number.
TEXTS = ("config.hot_mask", "config.camera")


def batch(index, **changes):
    """One batch as a task returns it."""
    values = {
        "batch": index, "t_ref_us": 10.5, "events": 100, "roi_events": 40, "roi_x": 3, "roi_y": 4, "vx": 1.0, "vy": 0.5,
        "vx_px_per_s": 10.0, "vy_px_per_s": 5.0, "vx_px_per_s_sd": None, "vy_px_per_s_sd": None,
        "iterations": 8, "cycles": 1000, "contrast": 2.0, "confidence": None,
        "flags": "", "ambiguity": 0, "gain": 2.0, "true_vx": 1.0, "true_vy": 0.0, "error_px": 0.5,
    }  # fmt: skip
    values |= changes
    trusted = values["confidence"] is not None and not {"doubtful", "degenerate"} & {*values["flags"].split("|")}
    return {"trusted": int(trusted), **values}


def ok(*batches):
    return {"status": "ok", "batches": list(batches), "events_left_over": 7, "note": ""}


def row(number=0, *, name="rec.h5", truth=TRUTH, **fields):
    subject = Subject(name=name, path=Path(name), roi=(3, 4), truth=truth, digest="d", sensor=(240, 180))
    choice = Choice(number=number, varied=fields or {"eta": 1.0}, preset="paper", changes=fields)
    task = SimpleNamespace(config=preset("paper").replace(**fields))
    return Row(subject=subject, choice=choice, roi=(3, 4), task=task)


NOTHING = dict.fromkeys(("vx_px_per_s", "vy_px_per_s", "error_px", "gain"))
DEGENERATE = {**NOTHING, "flags": "degenerate", "contrast": 0.0}


def test_summary():
    found = tables.summary(row(), ok(
        batch(0, cycles=900, contrast=1.0, confidence=40.0, error_px=0.2, roi_events=10),
        batch(1, flags="overflow|doubtful|roi_clamped", confidence=-3.0, gain=1.2, error_px=0.7, vx_px_per_s=-2.0),
        batch(2, **DEGENERATE, cycles=20),
        batch(3, flags="overflow", error_px=0.59, cycles=1100),
    ))  # fmt: skip
    assert (found["status"], found["reason"]) == ("ok", None)
    assert (found["batches"], found["degenerate_batches"], found["batches_with_warnings"]) == (4, 1, 3)
    assert found["flags"] == "overflow|doubtful|roi_clamped|degenerate"
    assert (found["gain_median"], found["trusted_batches"]) == (pytest.approx(1.6), 1)
    assert (found["events"], found["events_left_over"], found["roi_events_mean"]) == (400, 7, 32.5)
    assert found["vx_px_per_s_median"] == 10.0 and found["contrast_mean"] == 1.25
    assert found["error_px_median"] == pytest.approx(0.645) and found["error_px_max"] == math.inf
    assert found["error_below_0.6_px"] == 0.5
    assert (found["cycles_mean"], found["cycles_max"]) == (1000.0, 1100)


def test_summary_without_truth_clock_or_measurement():
    found = tables.summary(row(truth=None), ok(batch(0, cycles=None, error_px=None, true_vx=None)))
    assert "error_px_median" not in found and found["cycles_mean"] is None and found["cycles_max"] is None
    found = tables.summary(row(), ok(batch(0, **DEGENERATE)))
    assert found["status"] == "empty" and found["reason"] == "no batch measured anything: at most 40 events in the ROI"
    assert found["error_px_median"] == math.inf
    found = tables.summary(row(), ok(batch(0, **{**DEGENERATE, "roi_events": 0})))
    assert found["reason"] == "no event ever entered the ROI at 3,4"
    assert tables.summary(row(), {"status": "failed", "reason": "why"}) == {"status": "failed", "reason": "why"}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_tables_hold_the_whole_configuration_and_read_back(tmp_path, suffix):
    planned = [row(0, eta=0.5), row(1, eta=2.0)]
    outcomes = [ok(batch(0), batch(1, **DEGENERATE)), {"status": "failed", "reason": "a, b"}]
    estimates = {planned[0].task.config.hardware_hash: {"status": "ok", "total": dict.fromkeys(resources.KINDS, 3)}}
    frame = tables.results(planned, outcomes, Run(engine="model", size={"events": 100}), estimates)
    assert list(frame.columns) == [
        *tables.RESULTS, *(f"resources.{kind}" for kind in resources.KINDS),
        *(f"config.{name}" for name in Config().to_dict()),
    ]  # fmt: skip
    tables.write(frame, tmp_path / f"x{suffix}")
    if suffix == ".csv":  # an empty text is no missing number
        read = pandas.read_csv(tmp_path / "x.csv", dtype=dict.fromkeys(TEXTS, object)).fillna(dict.fromkeys(TEXTS, ""))
    else:
        read = pandas.read_parquet(tmp_path / f"x{suffix}")
    first, second = read.to_dict("records")
    for values, eta in ((first, 0.5), (second, 2.0)):
        config = {name.removeprefix("config."): v for name, v in values.items() if name.startswith("config.")}
        assert Config(**config) == preset("paper").replace(eta=eta)
    assert (first["status"], first["batches"], first["batch_events"], first["engine"]) == ("ok", 2, 100, "model")
    assert first["error_px_max"] == math.inf and first["resources.lut"] == 3
    assert (second["status"], second["reason"]) == ("failed", "a, b") and pandas.isna(second["batches"])

    by_batch = tables.batches(planned, outcomes)
    assert list(by_batch.columns) == [
        "recording", "first_roi", "configuration", "config.eta", *COLUMNS, "gain", "true_vx", "true_vy", "error_px",
    ]  # fmt: skip
    assert by_batch["config.eta"].tolist() == [0.5, 0.5] and by_batch["first_roi"].tolist() == ["3,4", "3,4"]
    assert by_batch["error_px"].isna().tolist() == [False, True] and by_batch["cycles"].dtype == "Int64"


def ranked_example():
    """Four configurations on two recordings: the errors of one, the cycles of another, are best; one is incomplete."""
    good, other = {"error_px": 0.1, "cycles": 2000, "gain": 3.0}, {"error_px": 0.3, "cycles": 500, "gain": 3.3}
    worse = {"error_px": 0.4, "cycles": 2500, "gain": 1.5, "contrast": 9.0}
    planned, outcomes = [], []
    for number, (eta, values) in enumerate([(1.0, worse), (2.0, other), (3.0, good), (4.0, good)]):
        for name, truth in (("a.h5", TRUTH), ("<b>.h5", None)):
            planned.append(row(number, name=name, truth=truth, eta=eta))
            failed = eta == 4.0 and truth is None
            outcomes.append({"status": "failed", "reason": "R&D"} if failed else ok(batch(0, **values)))
    return planned, outcomes


def test_a_recording_that_nothing_has_a_result_for_takes_no_rank():
    planned, outcomes = ranked_example()
    expected = [entry["ranks"] for entry in tables.ranking(planned, outcomes, {})]
    for number in range(4):
        planned.append(row(number, name="broken.h5", eta=number + 1.0))
        outcomes.append({"status": "failed", "reason": "no such file"})
    assert [entry["ranks"] for entry in tables.ranking(planned, outcomes, {})] == expected
    assert not any(entry["ranks"] for entry in tables.ranking(planned[-4:], outcomes[-4:], {}))


def test_ranking():
    planned, outcomes = ranked_example()
    ranked = tables.ranking(planned, outcomes, {})
    assert [entry["configuration"] for entry in ranked] == [2, 1, 0, 3]
    assert [entry["best"] for entry in ranked] == [True, True, False, False]
    assert [entry["ranks"] for entry in ranked] == [
        {"error_px": 1, "gain": 2, "cycles": 2}, {"error_px": 2, "gain": 1, "cycles": 1},
        {"error_px": 3, "gain": 3, "cycles": 3}, {},
    ]  # fmt: skip
    assert [entry["error_px"] for entry in ranked] == [0.1, 0.3, 0.4, 0.1]
    assert [entry["gain"] for entry in ranked] == pytest.approx([3 / 3.3, 1, 1.5 / 3.3, 3 / 3.3])
    assert [entry["below"] for entry in ranked] == [1.0] * 4
    assert [(entry["rows_ok"], entry["rows"], entry["complete"]) for entry in ranked][3] == (1, 2, False)


def test_ranking_without_truth_and_with_resources():
    planned = [row(k, truth=None, weight_frac=bits) for k, bits in enumerate((8, 4))]
    outcomes = [ok(batch(0))] * 2
    estimates = {
        r.task.config.hardware_hash: {"status": "ok", "total": dict.fromkeys(resources.KINDS, lut)}
        for r, lut in zip(planned, (900, 700), strict=True)
    }
    ranked = tables.ranking(planned, outcomes, estimates)
    assert [entry["configuration"] for entry in ranked] == [1, 0]
    assert ranked[0]["ranks"] == {"gain": 1, "cycles": 1, "lut": 1} and ranked[1]["ranks"]["lut"] == 2
    assert ranked[0]["error_px"] is None and [entry["best"] for entry in ranked] == [True, False]
    assert "700" in tables.text(ranked)
    estimates[planned[1].task.config.hardware_hash] = {"status": "failed", "reason": "x"}
    ranked = tables.ranking(planned, outcomes, estimates)
    assert [entry["configuration"] for entry in ranked] == [0, 1] and ranked[1]["resources"] is None


def test_the_trusted_share_goes_before_the_contrast():
    """Where no truth is known, an answer that is sharper and not to be trusted is not ranked first."""
    sure, doubtful = {"confidence": 50.0, "gain": 1.5}, {"confidence": 3.0, "flags": "doubtful", "gain": 3.0}
    planned = [row(k, truth=None, eta=eta) for k, eta in enumerate((1.0, 2.0))]
    outcomes = [ok(batch(0, **doubtful), batch(1, **sure)), ok(batch(0, **sure), batch(1, **sure))]
    ranked = tables.ranking(planned, outcomes, {})
    assert [(entry["configuration"], entry["trusted"]) for entry in ranked] == [(1, 1.0), (0, 0.5)]
    found = tables.summary(planned[0], outcomes[0])
    assert found["verdict"].startswith("1 of 2 batches are to be trusted; velocity 11 px/s in the median")


@pytest.mark.parametrize("change", [
    {"batches": []}, {"batches": [1]}, {"batches": [{}]}, {"batches": {"a": 1}}, {"note": []},
    {"events_left_over": "7"},
    *({"batches": [batch(0, **wrong)]} for wrong in (
        {"vx": "1"}, {"vx": [[1.0]]}, {"vx": math.nan}, {"events": True}, {"cycles": 1 << 70}, {"more": 1},
        {"flags": "nonsense"}, {"flags": 3}, {"events": 1.5}, {"roi_events": {}},
    )),
])  # fmt: skip
def test_what_was_kept_and_changed_is_not_taken_for_a_result(tmp_path, change):
    kept = Store(tmp_path)
    good = ok(batch(0), batch(1, **DEGENERATE))
    right = tables.outcome_form("translation")
    kept.put("a", good)
    assert kept.get("a", right) == good and kept.get("a", tables.outcome_form("rotation")) is None
    kept.put("a", {**good, **change})
    assert kept.get("a", right) is None
    (tmp_path / "a.json").write_text("[" * 100_000)
    assert kept.get("a", right) is None


@pytest.mark.parametrize("value, shown", [
    (None, "–"), (pandas.NA, "–"), (math.inf, "∞"), (0.12345, "0.123"), (1234.5, "1,234"), (-2.0, "-2"),
    (999.6, "1,000"),
])  # fmt: skip
def test_numbers_for_people(value, shown):
    assert tables.number(value) == shown
