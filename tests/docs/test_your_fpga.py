"""The page about the core in an FPGA: its commands work; its drawing is that of the simulation."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cmfpga.config import preset
from support.board_files import load
from support.verilog_tools import require_icarus

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def waveform():
    return load("waveform", DOCS)


def test_it_is_that_of_the_simulation(waveform, monkeypatch, tmp_path, long_tools):
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


def test_it_shows_every_row_and_fetches_nothing(waveform):
    text = waveform.PATH.read_text(encoding="utf-8")
    ElementTree.fromstring(text)
    assert re.findall(r'class="name"[^>]*>(\w+)<', text) == list(waveform.ROWS)
    assert set(re.findall(r"https?://[^\"' ]+", text)) == {"http://www.w3.org/2000/svg"} and "@import" not in text


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
