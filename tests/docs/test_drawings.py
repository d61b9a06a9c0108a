"""The drawings: up to date, complete, and drawn without anything from elsewhere; the page about the core in an FPGA."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

import cmfpga
from cmfpga.config import PRESETS, preset
from cmfpga.rtl.top import verilog_top
from support.board_files import load
from support.verilog_tools import require_icarus

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def diagram():
    return load("diagram", DOCS)


@pytest.fixture(scope="module")
def waveform():
    return load("waveform", DOCS)


def test_running_it_changes_nothing(diagram, monkeypatch):
    assert diagram.main(["--check"]) == 0, "run python docs/diagram.py"
    monkeypatch.setattr(diagram, "X", diagram.X + 1)
    assert diagram.main(["--check"]) == 1


def test_it_shows_every_block_of_the_presets_and_files_that_there_are(diagram):
    shown = {file for text, *_ in diagram.BOXES.values() for file in re.findall(r"\w+\.py", text)}
    there = {path.name for path in (Path(cmfpga.__file__).parent / "rtl").rglob("*.py")}
    for page in ("rounds", "sliding", "motion", "flow"):  # pages with drawings of their own
        shown |= set(re.findall(r"\w+\.py", (DOCS / f"{page}.md").read_text(encoding="utf-8"))) & there
    assert shown <= there
    for config in (*(preset(name) for name in PRESETS), preset().replace(hot_pixels=1, background=1)):
        for block in verilog_top(config).blocks.values():
            assert type(block).__module__.rpartition(".")[2] + ".py" in shown


def test_they_fetch_nothing(diagram, waveform):
    text = waveform.PATH.read_text(encoding="utf-8")
    for drawing in (diagram.svg(), text):
        ElementTree.fromstring(drawing)
        assert set(re.findall(r"https?://[^\"' ]+", drawing)) == {"http://www.w3.org/2000/svg"}
        assert "@import" not in drawing
    assert re.findall(r'class="name"[^>]*>(\w+)<', text) == list(waveform.ROWS)
    pages = [*DOCS.rglob("*.md"), DOCS.parent / "README.md", DOCS.parent / "mkdocs.yml"]
    assert not [page.name for page in pages if "mermaid" in page.read_text(encoding="utf-8")]


def test_the_waveform_is_that_of_the_simulation(waveform, monkeypatch, tmp_path, long_tools):
    require_icarus()
    config = preset("fast")
    found = waveform.course(config, waveform.sampled(waveform.simulate(config, tmp_path)))
    assert waveform.PATH.read_text(encoding="utf-8") == waveform.svg(found), "run python docs/waveform.py"
    # The handshakes, as docs/build.md tells them.
    taken = [
        t for t, *both in zip(*(found[n] for n in ("event_t", "event_valid", "event_ready")), strict=True) if all(both)
    ]
    assert len(taken) == 240 and taken == sorted(taken)
    assert found["event_valid"].index(1) < found["event_ready"].index(1)
    assert found["event_last"].count(1) == 1 == found["result_valid"].count(1)
    monkeypatch.setattr(waveform, "CELL", waveform.CELL + 1)
    assert waveform.PATH.read_text(encoding="utf-8") != waveform.svg(found)


def test_five_commands(tmp_path):
    """As printed, but for the first, which installs; the fourth and the fifth in the folder that the third enters."""
    require_icarus()
    page = (DOCS / "your-fpga.md").read_text(encoding="utf-8")
    assert len(page.split()) <= 850
    install, *commands = re.search(r"```sh\n(.*?)```", page, re.DOTALL)[1].splitlines()
    assert install == "pip install cmfpga" and len(commands) == 4
    folder, output = tmp_path, ""
    for command in commands:
        words = shlex.split(command)
        if words[0] == "cd":
            folder /= words[1]
            continue
        if words[0] == "cmfpga":
            words[:1] = [sys.executable, "-m", "cmfpga"]
        output = subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True).stdout
    shown = re.search(r"`(result_v_x = \d+)`.*?that is (\d+)/64 =", page, re.DOTALL)
    assert f"{shown[1]}\n" in output and shown[1].endswith(f" {shown[2]}")
