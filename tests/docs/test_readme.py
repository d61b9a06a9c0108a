"""The code in README.md, docs/ and boards/ works as printed.

Every ``python`` block is a whole program; a ``text`` block right behind it is its output. A ``py`` block is an excerpt,
which is only parsed. Of ``console`` blocks, lines that begin with ``$ python -m studies.`` or ``$ cmfpga`` are run, in
a folder that holds recordings, and so are ``$ head -n`` and ``$ echo $?``. Lines below a command are its output, where
there are any; ``…`` stands for anything in a line, and alone for any lines.
"""

import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from cmfpga.cli import command as tool
from cmfpga.events import generate, write_hdf5
from cmfpga.verilog.compiler import find_compiler

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "boards").rglob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?", re.MULTILINE | re.DOTALL)
TIME_OUT = 600


def blocks(language):
    """One parameter per block: (its text, what is printed behind it)."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for match in FENCE.finditer(text):
            if match[1] == language:
                line = text.count("\n", 0, match.start()) + 1
                yield pytest.param(match[2], match[3], id=f"{page.relative_to(ROOT)}:{line}")


@pytest.fixture(scope="session")
def recordings(tmp_path_factory):
    """A synthetic recording under the names that the pages use."""
    folder = tmp_path_factory.mktemp("recordings")
    scene = generate(seed=2, position=(132.0, 62.0), velocity=(90.0, 20.0), duration_us=600_000, noise=0.6)
    events = scene.events
    write_hdf5(folder / "rec.h5", events, width=scene.scene.width, height=scene.scene.height)
    np.savez(folder / "rec.npz", t=events.t, x=events.x, y=events.y, p=events.p)
    columns = zip(events.t.tolist(), events.x.tolist(), events.y.tolist(), events.p.tolist(), strict=True)
    (folder / "truth.csv").write_text("t_us,vx_px_per_s,vy_px_per_s\n0,90,20\n")
    (folder / "events.txt").write_text("".join(f"{t / 1e6:.6f} {x} {y} {p}\n" for t, x, y, p in columns))
    return folder


@pytest.fixture
def workplace(recordings, tmp_path):
    for file in recordings.iterdir():
        (tmp_path / file.name).symlink_to(file)
    return tmp_path


def run(command, folder):
    # The suites of `studies` are not installed: they are found from the checkout, as where a reader runs them.
    done = subprocess.run(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=TIME_OUT,
        encoding="utf-8", env={**os.environ, "PYTHONIOENCODING": "utf-8", "COLUMNS": "100", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    return done.returncode, done.stdout


def assert_output(expected, got):
    """``…`` alone in a line matches any lines, elsewhere anything within the line."""
    parts = [".*" if line == "…\n" else re.escape(line).replace("…", "[^\n]*") for line in expected.splitlines(True)]
    assert re.fullmatch("".join(parts), got, re.DOTALL), f"expected:\n{expected}\ngot:\n{got}"


@pytest.mark.parametrize("code, output", list(blocks("python")))
def test_python(code, output, workplace):
    status, got = run([sys.executable, "-W", "error", "-c", code], workplace)
    assert status == 0, got
    if output is not None:
        assert_output(output, got)


@pytest.mark.parametrize("code, output", list(blocks("py")))
def test_excerpt(code, output):
    compile(code, "excerpt", "exec")


def commands(text):
    """``[(command, expected output)]`` of a console block."""
    found = []
    for line in text.splitlines(keepends=True):
        if line.startswith("$ "):
            found.append([line[2:].strip(), ""])
        elif found:
            found[-1][1] += line
    return found


RUN = ("python -m studies.", "cmfpga ", "head -n ", "echo $?")


def runnable(text):
    return [item for item in commands(text) if item[0].startswith(RUN)]


#: In processes of their own: they start others, or take the time.
APART = ("sweep", "studies.bench")


@pytest.mark.parametrize("text, output", [block for block in blocks("console") if runnable(block.values[0])])
def test_console(text, output, workplace, request, command, monkeypatch):
    """In this process, which has all imported; what is written to stderr stands first, as in a pipe."""
    monkeypatch.chdir(workplace)
    monkeypatch.setenv("COLUMNS", "100")
    status = None
    for line, expected in runnable(text):
        if "$CMFPGA_DATA" in line:
            line = line.replace("$CMFPGA_DATA", str(request.getfixturevalue("data_dir")))
        if line == "echo $?":
            assert expected == f"{status}\n"
            continue
        words = shlex.split(line, comments=True)
        if words[0] == "head":
            got = "".join((workplace / words[3]).read_text().splitlines(keepends=True)[: int(words[2])])
            assert_output(expected, got)
            continue
        suite = words[0] == "python"
        name, *words = words[2:] if suite else words[1:]
        if name == "track" and not {"model", "float", "--help", "--list-fields"} & set(words):
            if find_compiler() is None:
                pytest.skip("no C++ compiler: the simulation would take hours")
        if words[-1].endswith(".rrd"):
            pytest.importorskip("rerun", reason="needs rerun-sdk")
        if name in APART:
            module = [name] if suite else ["cmfpga", name]
            status, got = run([sys.executable, "-m", *module, *words], workplace)
        else:
            done = command(import_module(name), *words) if suite else command(tool, name, *words)
            status, got = done.status, done.err + done.out
        if expected:
            assert_output(expected, got)
        # A mistake is only made on purpose where its status or its message is shown.
        assert status == 0 or "echo $?" in text or expected.startswith("error: "), got


def test_there_is_something_to_test():
    assert len(list(blocks("python"))) >= 3
    assert sum(len(runnable(block.values[0])) for block in blocks("console")) >= 10


def test_output_is_compared():
    assert_output("a … c\n…\nz\n", "a bb c\nd\ne\nz\n")
    for expected, got in (("a\n", "b\n"), ("a …\n", "a\nb\n"), ("a\n…\nz\n", "a\nb\ny\n"), ("1.0\n", "1x0\n")):
        with pytest.raises(AssertionError):
            assert_output(expected, got)
