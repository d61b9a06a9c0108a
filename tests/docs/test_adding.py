"""The examples of docs/adding.md: applied to a copy of the package, they work in hardware and model."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cmfpga

ROOT = Path(__file__).parents[2]
EDIT = re.compile(r'^```diff title="([^"]+)"\n(.*?)^```\n', re.MULTILINE | re.DOTALL)

#: Some batches through the emitted Verilog, of the core or of the AXI top with its driver, and the integer model.
RUN = """
import dataclasses, json
import numpy as np
from cmfpga.config import preset
from cmfpga.engines import make_engine
from cmfpga.events import Events
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.results import fields_of, packet_beats
from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.top import VerilogCore

config = preset({preset!r}).replace(
    sensor_width=24, sensor_height=16, roi_width=8, roi_height=8, buffer_events=64, max_batch_events=200,
    start="given", v_start_x=3.0)
rng = np.random.default_rng(5)
found = {{"map": {{r.name: r.offset for r in register_map(config)}}, "beats": packet_beats(config), "outcomes": []}}
found["ports"] = VerilogCore(config).port_order
settings = BatchSettings.from_config(config, (8, 4))
engines = [make_engine(name, config) for name in ({engine!r}, "model")]
for change in ({{}}, *[{change}] * 3):
    now = dataclasses.replace(settings, **change)
    events = Events(np.arange(40, 240) * 7, rng.integers(0, 24, 200), rng.integers(0, 16, 200), np.zeros(200))
    events.x[:3] = 0  # the first events are outside the ROI
    one, other = [engine.run(events, now)[0] for engine in engines]
    for field in fields_of("batch", "region"):
        if field.name != "cycles":
            assert getattr(one, field.name) == getattr(other, field.name), field.name
    x, y = events.x - one.roi[0], events.y - one.roi[1]
    inside = (x >= 0) & (x < 8) & (y >= 0) & (y < 8)
    first = int(events.t[inside][0] - events.t[0])
    found["outcomes"].append({{"roi": one.roi, "roi_next": one.roi_next, "first": first,
                               "roi_first": getattr(one, "roi_first", None)}})
print(json.dumps(found))
"""


def edits(heading):
    """``{path: [(old text, new text)]}`` of a section; lines begin with a blank (context), - (old) or + (new)."""
    text = (ROOT / "docs" / "adding.md").read_text(encoding="utf-8")
    section = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    found = {}
    for path, diff in EDIT.findall(section):
        lines = diff.splitlines(keepends=True)
        old, new = ("".join(line[1:] for line in lines if line[0] in kinds) for kinds in (" -", " +"))
        found.setdefault(path, []).append((old, new))
    return found


def applied(changes, folder):
    """A copy of the package with the edits."""
    shutil.copytree(
        Path(cmfpga.__file__).parent, folder / "src" / "cmfpga", ignore=shutil.ignore_patterns("__pycache__")
    )
    for path, pairs in changes.items():
        text = (folder / path).read_text(encoding="utf-8")
        for old, new in pairs:
            assert text.count(old) == 1, f"docs/adding.md: {path} has this {text.count(old)} times:\n{old}"
            text = text.replace(old, new)
        (folder / path).write_text(text, encoding="utf-8")
    return folder / "src"


def run(source, preset, engine, change="{}"):
    """What :data:`RUN` found, or the last line of what it complained of."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", RUN.format(preset=preset, engine=engine, change=change)],
        env={**os.environ, "PYTHONPATH": str(source)}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    return json.loads(done.stdout) if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("preset, engine", [("paper", "rtl"), ("fast", "axi")])
def test_examples(preset, engine, tmp_path):
    """Both at once: a setting and a result field, each at most three files, nothing else edited."""
    setting, result = edits("a setting"), edits("a result field")
    assert 0 < len(setting) <= 3 and 0 < len(result) <= 3
    both = {path: [*setting.get(path, []), *result.get(path, [])] for path in {*setting, *result}}
    found = run(applied(both, tmp_path), preset, engine, '{"roi_hold": 1, "roi": None}')
    assert isinstance(found, dict), found
    assert {"settings_roi_hold", "result_roi_first"} <= set(found["ports"])
    assert found["map"]["ROI_HOLD"] == 0x80 + 4 * 27 and found["map"]["RESULT_ROI_FIRST"] == 0x100 + 4 * 49
    assert found["beats"] == 25
    outcomes = found["outcomes"]
    moved, held = outcomes[0 if preset == "paper" else 1], outcomes[-1]  # with two buffers a move shows a batch later
    assert moved["roi_next"] != moved["roi"] and held["roi_next"] == held["roi"]
    assert all(batch["roi_first"] == batch["first"] > 0 for batch in outcomes)


#: Tests of what follows from the tables, and of what is made of results. They must not list what the tables list.
FOLLOWING = (
    "protocol", "tracking/test_loop.py", "tracking/test_rows.py", "tracking/test_fit.py", "engines",
    "reference/test_sliding.py", "api/test_track_result.py",
    *(f"driver/test_{name}.py" for name in ("failures", "uio", "recipe")),
)  # fmt: skip


@pytest.mark.parametrize("heading", ["a setting", "a result field"])
def test_the_tests_that_exist_pass_with_the_example(heading, tmp_path):
    """In a copy; the long ones among them are left out."""
    source = applied(edits(heading), tmp_path)
    for name in ("tests", "docs", "boards", "sim", "studies", "pyproject.toml", "README.md"):
        (tmp_path / name).symlink_to(ROOT / name)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", "-m", "not long", "--tb=line",
         *(f"tests/{name}" for name in FOLLOWING)],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(source)}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-3000:]


def test_an_example_that_leaves_the_model_out_is_noticed(tmp_path):
    changes = edits("a result field")
    del changes["src/cmfpga/reference/ingest.py"]
    assert "roi_first" in run(applied(changes, tmp_path), "paper", "rtl")
