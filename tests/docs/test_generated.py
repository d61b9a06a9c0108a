"""Tables in the documentation equal what the code says."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from cmfpga.cli import command as tool
from cmfpga.config import preset
from cmfpga.rtl.sliding.core import SlidingCore
from support.baselines import BASELINES
from support.board_files import load

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.fixture(scope="module")
def maker():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs")  # where its parts are
        return load("tables", ROOT / "docs")


@pytest.fixture(scope="module")
def tables(maker):
    return {name: make() for name, make in maker.TABLES.items()}


def test_running_it_changes_nothing(maker, tables):
    for page in maker.PAGES:
        text = page.read_text(encoding="utf-8")
        assert maker.rewritten(text, tables) == text, f"{page.name}: run python docs/tables.py"


def test_every_table_is_used_once_and_every_marker_has_its_end(maker):
    text = "".join(page.read_text(encoding="utf-8") for page in maker.PAGES)
    names = re.findall(r"<!-- generated: (\w+) -->", text)
    assert sorted(names) == sorted(maker.TABLES)
    assert len(names) == text.count("<!-- end -->") == len(maker.BLOCK.findall(text))


def test_a_change_is_noticed(maker, tables):
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    row = re.search(r"^\| v \| Q\d+\.\d+ \| \d+ \|", text, re.MULTILINE)
    assert row
    changed = text[: row.start()] + "| v | Q9.9 | 19 |" + text[row.end() :]
    assert changed != text == maker.rewritten(changed, tables)


def test_resources_in_the_prose_are_the_measured_ones():
    def row(total):
        return " / ".join(f"{total[kind]:,.0f}" for kind in ("lut", "ff", "bram36", "dsp"))

    plain, readme = BASELINES["plain"], (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"(Yosys estimates, KV260) | {row(plain['sliding'])} | {row(plain['quad'])} |" in readme
    assert f"`fast`, the default of `build`: {row(BASELINES['presets']['fast']['total'])}; " in readme
    assert f"it reaches {BASELINES['placed']['fast']['fmax_mhz']:.0f} MHz" in readme
    sliding = "{} LUT, {} FF, {} BRAM36 and {} DSP".format(*row(plain["sliding"]).split(" / "))
    assert sliding in (ROOT / "docs" / "sliding.md").read_text(encoding="utf-8")


def test_times_in_the_prose_are_the_measured_ones():
    readme, build, sliding = (
        (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/build.md", "docs/sliding.md")
    )
    fast, quad = (re.search(rf"^\| `{name}` .* ([\d.]+) \(T = 3\)", build, re.M)[1] for name in ("fast", "quad"))
    assert f"placed on an ECP5; C on a busy server core | {quad} µs; {fast} µs; " in readme
    assert f"\n{fast} µs, " in readme
    core = SlidingCore(preset("sliding"))
    late = core.cycles(roi_events=800, iterations=1) + 3  # from the event that ends a hop
    assert f"{core.tail + 3} cycles; {late} if the round starts late" in readme
    assert f"so {late} at T = 1, n = 800" in sliding


OPTION = re.compile(r"--[a-z][a-z-]*")


def documented(section):
    """Options in the table of a section of docs/command.md."""
    text = (ROOT / "docs" / "command.md").read_text(encoding="utf-8")
    lines = text.partition(f"\n## {section}\n")[2].partition("\n## ")[0].splitlines()
    return {found for line in lines if line.startswith("| `--") for found in OPTION.findall(line.split("|")[1])}


SHARED = documented("Options of several commands")


@pytest.mark.parametrize("name", sorted({*tool.COMMANDS, "studies.accuracy", "studies.bench", "studies.crosscheck"}))
def test_options_are_documented(name, command):
    """The section of a command has all options of ``--help`` that no table shares, and no others; help has examples."""
    suite = name.startswith("studies.")
    module = import_module(name) if suite else tool.load(name)
    shown, _, examples = command(module, "--help").out.partition("examples:")
    assert examples.count(f"python -m {name}" if suite else f"cmfpga {name}") >= 2
    shown, own = set(OPTION.findall(shown)), documented(name if suite else f"cmfpga {name}")
    if name == "accuracy":
        own |= documented("cmfpga track") & shown
    assert own <= shown <= own | SHARED
