"""Errors that are the user's to mend.

Everything that a person can get wrong (a file, an option, a value) raises one of these. The message is one
line: what is wrong, where, and what is allowed. The command lines print it and exit with status 2.
"""

import contextlib
import difflib
import sys
from pathlib import Path


class UserError(ValueError):
    """Base of all errors that a command line reports in one line, without a traceback."""


class ConfigError(UserError):
    """A configuration field, or a combination of fields, has a value that is not allowed."""


class RecordingError(UserError):
    """A recording is missing, unreadable, or holds events that cannot be used."""


class MissingPackage(ConfigError):
    """What was asked for needs a package that is not installed."""


class DeviceError(UserError):
    """The hardware, or what leads to it, does not do what it should. One line: what, and what to look at."""


class WrongHardware(DeviceError):
    """What answers is not the accelerator, of another version, or of another configuration."""


class DeviceTimeout(DeviceError, TimeoutError):
    """Something did not come in time."""


def meant(name, names):
    """A guess, as ``"did you mean 'fast'?"``, where ``name`` nearly is one of ``names``; else empty."""
    near = difflib.get_close_matches(str(name).lower(), names, n=1, cutoff=0.75)  # two letters of four, swapped
    return f"did you mean {near[0]!r}?" if near else ""


def one_of(name, names, printed=None):
    """That one of ``names`` is needed, or where they are ``printed``; first a guess as of :func:`meant`."""
    every = f"{printed} prints all" if printed else f"one of {', '.join(names)} is needed"
    guess = meant(name, names)
    return f"{guess} {every[0].upper()}{every[1:]}" if guess else every


@contextlib.contextmanager
def needs(package, extra, what):
    """Where ``package`` is missing, :exc:`MissingPackage` says that ``what`` needs it and which extra installs it.

    An empty ``extra`` is what the package itself depends on; an empty ``package`` is any but our own and Python's.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        own = missing in ("", "cmfpga") or missing in sys.stdlib_module_names
        if own if not package else missing != package:
            raise
        install = f"'cmfpga[{extra}]'" if extra else "cmfpga (--no-deps leaves it out)"
        raise MissingPackage(f"{what}: {missing} is not installed; pip install {install}") from None


@contextlib.contextmanager
def naming(path):
    """An :exc:`OSError` from inside names ``path``, where the system does not say which file it is: a full disk."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(path)
        raise


def write_text(path, text):
    """Write a file in UTF-8; an :exc:`OSError` names it."""
    with naming(path):
        Path(path).write_text(text, encoding="utf-8")
