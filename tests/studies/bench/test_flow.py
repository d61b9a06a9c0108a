"""Dense flow in C against the float reference, and ``bench --flow``."""

import json

import numpy as np
import pytest
from studies.bench.opponents.c_program import FlowProgram

from cmfpga.config import preset
from cmfpga.dense.fields import scene
from cmfpga.dense.tiles import grid
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.regions import RegionSequence
from studies.bench import flow, main
from support.opponents import made
from support.steps import StepCore

CONFIG = preset("flow").replace(undistortion="off")
EVENTS = 9000


@pytest.fixture(scope="module")
def program():
    return made(FlowProgram)


@pytest.fixture(scope="module")
def window():
    return grid(CONFIG), scene().events[:EVENTS], flow.with_steps(CONFIG, BatchSettings.from_config(CONFIG))


def test_each_tile_ends_where_that_of_the_float_reference_does(program, window):
    """Whose border is that of the C program; float32 and float64 differ where a gradient is as good as 0."""
    tiles, events, settings = window
    found = program.load_window(CONFIG, tiles.regions, events, settings, 1)()
    reference = RegionSequence(StepCore(CONFIG))
    reference.write(tiles.regions)
    wanted = reference.run(events.t, events.x, events.y, settings)
    enough = [k for k, region in enumerate(wanted.regions) if region.roi_events >= CONFIG.min_roi_events]
    apart = np.abs(found - [region.v for region in wanted.regions])[enough].max(axis=1)
    assert len(enough) > 60 and np.mean(apart < 0.1) > 0.9 and np.median(apart) < 1e-9


def test_threads_change_nothing(program, window):
    tiles, events, settings = window
    first = program.load_window(CONFIG, tiles.regions, events, settings, 1)().copy()
    for threads in (2, 5):
        assert (program.load_window(CONFIG, tiles.regions, events, settings, threads)(2) == first).all()


@pytest.mark.parametrize("threads", [0, 65])
def test_threads_have_limits(program, window, threads):
    tiles, events, settings = window
    with pytest.raises(MemoryError, match=f"on {threads} threads"):
        program.load_window(CONFIG, tiles.regions, events, settings, threads)()


@pytest.mark.usefixtures("compiler")
def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("CMFPGA_DATA", raising=False)
    monkeypatch.setattr(flow, "EVENTS", 6000)
    path = tmp_path / "flow.json"
    assert main(["--flow", "--quick", "--runs", "1", "--clock", "100", "--json", str(path)]) == 0
    told, report = capsys.readouterr().out, json.loads(path.read_text(encoding="utf-8"))
    (row,) = report["hardware"]
    assert row["units"] == 5 and 0.3 < row["busy"] <= 1 and row["cycles"] > 6000
    assert row["events_per_s"] == pytest.approx(6000 * row["fields_per_s"])
    assert row["fields_per_s"] == pytest.approx(100e6 / row["cycles"])
    assert f"{row['cycles']:,.0f}" in told and "assumed 100 MHz" in told
    for one in report["programs"][:2]:
        assert f"5 units are {one['seconds']['median'] * row['fields_per_s']:.1f} × as fast as {one['name']}" in told
