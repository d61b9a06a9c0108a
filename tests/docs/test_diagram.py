"""The drawing of the blocks: up to date, complete, and drawn without anything from elsewhere."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import cmfpga
from cmfpga.config import PRESETS, preset
from cmfpga.rtl.top import verilog_top
from support.board_files import load

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def diagram():
    return load("diagram", DOCS)


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
    filtered = preset().replace(hot_pixels=1, background=1)
    for config in (*(preset(name) for name in PRESETS), filtered):
        for block in verilog_top(config).blocks.values():
            assert type(block).__module__.rpartition(".")[2] + ".py" in shown


def test_it_fetches_nothing(diagram):
    text = diagram.svg()
    ElementTree.fromstring(text)
    assert set(re.findall(r"https?://[^\"' ]+", text)) == {"http://www.w3.org/2000/svg"} and "@import" not in text
    pages = [*DOCS.rglob("*.md"), DOCS.parent / "README.md", DOCS.parent / "mkdocs.yml"]
    assert not [page.name for page in pages if "mermaid" in page.read_text(encoding="utf-8")]
