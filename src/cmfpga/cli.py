"""What the command lines share: the configuration's options, and errors in one line."""

import argparse
import dataclasses
import sys
from pathlib import Path

from . import __version__
from .config import DEFAULT_PRESET, PRESETS, Config, preset
from .errors import ConfigError, UserError


def parser(name, description, examples):
    """An argument parser for ``python -m cmfpga.NAME``, with examples at the end of its help."""
    made = _Parser(
        prog=f"python -m cmfpga.{name}",
        description=description,
        epilog="examples:\n" + "".join(f"  {line}\n" for line in examples),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("--version", action="version", version=f"cmfpga {__version__}")
    return made


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise UserError(f"{message} (--help lists the options)")


def add_config_options(made):
    """``--preset``, ``--set`` and ``--list-fields``."""
    group = made.add_argument_group("configuration")
    group.add_argument(
        "--preset",
        default=DEFAULT_PRESET,
        metavar="P",
        help=f"one of: {', '.join(PRESETS)} (default: {DEFAULT_PRESET})",
    )
    group.add_argument(
        "--set", action="append", default=[], metavar="FIELD=VALUE", dest="assignments", help="set a field; repeatable"
    )
    group.add_argument("--list-fields", action=_ListFields, help="list all fields with their defaults and units")


def config_changes(options):
    """The fields that ``--set`` names, as a dictionary."""
    return Config.parse(options.assignments)


def make_config(options, **defaults):
    """The configuration that the options ask for; ``defaults`` go before the preset's values, ``--set`` before all."""
    return preset(options.preset).replace(**{**defaults, **config_changes(options)})


class _ListFields(argparse.Action):
    def __init__(self, *args, **options):
        super().__init__(*args, nargs=0, **options)

    def __call__(self, parser, *_):
        for field in dataclasses.fields(Config):
            meta = field.metadata
            unit = f" [{meta['unit']}]" if meta["unit"] else ""
            when = "; run-time" if meta["runtime"] else ""
            print(f"{field.name} = {field.default}{unit}: {meta['doc']}{when}")
        parser.exit()


def pair(what):
    """A parser of ``A,B`` (two integers) for argparse."""

    def parse(text):
        parts = text.split(",")
        try:
            first, second = (int(part) for part in parts)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r}: {what}, two whole numbers, is needed") from None
        return first, second

    return parse


def positive(text):
    """A parser of an integer of 1 or more for argparse."""
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number of 1 or more is needed")
    return number


def natural(text):
    """A parser of an integer of 0 or more for argparse."""
    try:
        number = int(text)
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number of 0 or more is needed")
    return number


def output_folder(path):
    """``path`` as an existing folder in which files can be made."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".cmfpga-write-test"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise ConfigError(f"--out {path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    return folder


def run(main, arguments=None):
    """Call ``main(arguments)``; a user's mistake, or the system's refusal, becomes one line and exit status 2."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal or a pipe may not have every sign of a path or a unit
            stream.reconfigure(errors="backslashreplace")
    try:
        return main(arguments)
    except UserError as error:
        return _fail(str(error))
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    except OSError as error:  # such as a full disk, or a folder where a file is to be written
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _fail(message):
    print("error:", " ".join(message.splitlines()), file=sys.stderr)
    return 2
