"""Tables in the documentation equal what the code says."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.fixture(scope="module")
def maker():
    spec = importlib.util.spec_from_file_location("docs_tables", ROOT / "docs" / "tables.py")
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs")  # where its parts are
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def tables(maker):
    return {name: make() for name, make in maker.TABLES.items()}


def test_running_it_changes_nothing(maker, tables):
    for page in maker.PAGES:
        text = page.read_text(encoding="utf-8")
        assert maker.rewritten(text, tables) == text, f"{page.name}: run python docs/tables.py"


def test_every_table_is_used_and_every_marker_has_its_end(maker):
    text = "".join(page.read_text(encoding="utf-8") for page in maker.PAGES)
    names = re.findall(r"<!-- generated: (\w+) -->", text)
    assert set(names) == set(maker.TABLES)
    assert len(names) == text.count("<!-- end -->") == len(maker.BLOCK.findall(text))


def test_a_change_is_noticed(maker, tables):
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    row = re.search(r"^\| v \| Q\d+\.\d+ \| \d+ \|", text, re.MULTILINE)
    assert row
    changed = text[: row.start()] + "| v | Q9.9 | 19 |" + text[row.end() :]
    assert changed != text == maker.rewritten(changed, tables)


def test_an_unknown_name_is_refused(maker):
    with pytest.raises(KeyError, match="nonsense"):
        maker.rewritten("<!-- generated: nonsense -->\n<!-- end -->\n", {})


@pytest.mark.parametrize(
    "command", ["build", "driver", "track", "info", "generate", "report", "sweep", "bench", "accuracy"]
)
def test_options_are_documented(command, tmp_path):
    """The table of options of a command's page has all that ``--help`` has, and no others; help ends with examples."""
    shown, _, examples = subprocess.run(
        [sys.executable, "-m", f"cmfpga.{command}", "--help"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout.partition("examples:")
    assert examples.count(f"python -m cmfpga.{command}") >= 2
    text = (ROOT / "docs" / f"{command}.md").read_text(encoding="utf-8")
    option = re.compile(r"--[a-z][a-z-]*")
    documented = {
        name for line in text.splitlines() if line.startswith("| `--") for name in option.findall(line.split("|")[1])
    }
    assert documented == set(option.findall(shown))
