"""The C++ compiler of this machine: which it is, and what it says."""

import os
import shlex
import shutil
import subprocess

from ..errors import ConfigError

COMPILERS = ("c++", "g++", "clang++")


def find_compiler():
    """The command of a C++ compiler, as a shell takes it: ``$CXX``, or the first of :data:`COMPILERS`; None without.

    Whether it works is found out by using it.
    """
    given = os.environ.get("CXX", "").strip()
    return given or next((shlex.quote(path) for path in map(shutil.which, COMPILERS) if path), None)


class CompilerError(ConfigError):
    """There is no C++ compiler, or it fails, or what it makes cannot be loaded."""


def require_compiler():
    """``(command, version)``: the C++ compiler's first words, and what it says to ``--version``.

    Raises
    ------
    CompilerError
        There is none, or it does not even say its version.
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


def compiler_output(command):
    """What a compiler prints; its failure is one line, for it is the user's to mend."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    except OSError as error:
        raise CompilerError(f"the C++ compiler {command[0]} cannot be run: {error.strerror}") from None
    if done.returncode:
        why = first_line(done.stderr + done.stdout) or "it does not say why"
        raise CompilerError(f"the C++ compiler {command[0]} fails with status {done.returncode}: {why}")
    return done.stdout


def first_line(text):
    """The first line that names an error, or else the first one."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line.lower()), lines[0] if lines else "")
