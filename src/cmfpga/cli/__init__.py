"""What the command lines share: the configuration's options, and errors in one line."""

import argparse
import contextlib
import dataclasses
import functools
import re
import signal
import sys
import threading
import warnings
from pathlib import Path

from .. import __version__
from ..config import DEFAULT_PRESET, PRESETS, Config, preset
from ..config.presets import CLOCK_MHZ
from ..errors import ConfigError, UserError, meant, needs

#: Options that say how a recording is read, by their names in Python.
READING = {
    "sensor": "--sensor", "time_unit": "--time-unit", "columns": "--columns", "dataset": "--dataset",
    "form": "--format",
}  # fmt: skip


def parser(command, description, examples):
    """An argument parser of ``command``, such as ``cmfpga track``, with examples at the end of its help."""
    made = _Parser(
        prog=command,
        description=description,
        epilog="examples:\n" + "".join(f"  {line}\n" for line in examples),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("--version", action="version", version=f"cmfpga {__version__}")
    return made


class _Parser(argparse.ArgumentParser):
    """Raises :exc:`UserError` for a mistake, and takes ``--roi -1,5`` for an option with its value."""

    def parse_known_args(self, args=None, namespace=None):
        args = [*(sys.argv[1:] if args is None else args)]
        for argument in args:
            if argument == "--":
                break
            if argument.startswith("--") and argument.endswith("=--"):
                # argparse of Python 3.11 loses the value, and fails.
                raise UserError(f"argument {argument[:-3]}: '--' is no value (--help lists the options)")
        return super().parse_known_args(_join_negative(args), namespace)

    def parse_args(self, args=None, namespace=None):
        options, unknown = self.parse_known_args(args, namespace)
        if unknown:
            guess = meant(unknown[0].partition("=")[0], self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(unknown)}{guess and '; '}{guess}")
        return options

    def error(self, message):
        raise UserError(f"{message} (--help lists the options)")


def _join_negative(arguments):
    """``--roi -1,5`` as ``--roi=-1,5``: argparse would take the value for an option."""
    joined = []
    for argument in arguments:
        last = joined[-1] if joined else ""
        if re.match(r"-[\d.]", argument) and re.fullmatch(r"--[a-z][a-z-]*", last):
            joined[-1] = f"{last}={argument}"
        else:
            joined.append(argument)
    return joined


def add_config_options(made, usual=DEFAULT_PRESET, told=None):
    """``--preset``, ``usual`` if none is told (``told``: how help says which), ``--set`` and ``--list-fields``."""
    group = made.add_argument_group("configuration")
    names = f"one of: {', '.join(PRESETS)} (default: {told or usual})"
    group.add_argument("--preset", default=usual, metavar="P", help=names)
    text = "set a field; repeatable"
    group.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", dest="assignments", help=text)
    text = "list all fields with their defaults and units"
    group.add_argument("--list-fields", nargs=0, action=_ListFields, help=text)


def config_changes(options):
    """The fields that ``--set`` names, as a dictionary."""
    return Config.parse(options.assignments)


def make_config(options, **defaults):
    """The configuration that the options ask for; ``defaults`` go before the preset's values, ``--set`` before all."""
    return preset(options.preset).replace(**{**defaults, **config_changes(options)})


class _ListFields(argparse.Action):
    def __call__(self, parser, *_):
        for field in dataclasses.fields(Config):
            meta = field.metadata
            unit = f" [{meta['unit']}]" if meta["unit"] else ""
            when = "; run-time" if meta["runtime"] else ""
            print(f"{field.name} = {field.default}{unit}: {meta['doc']}{when}")
        parser.exit()


def add_batch_options(made, default):
    """How a recording is cut into batches, and where the first one begins; ``default`` says how, without an option."""
    size = made.add_argument_group(f"batches (one of; default: {default})").add_mutually_exclusive_group()
    size.add_argument("--batch-events", type=positive, metavar="N", help="events of the whole sensor")
    size.add_argument("--batch-us", type=positive, metavar="D", help="duration, µs")
    size.add_argument("--batch-roi-events", type=positive, metavar="M", help="events in the ROI")
    made.add_argument("--start-event", type=natural, default=0, metavar="K", help="first event (default: 0)")


#: Options of windows that slide, by the fields of the configuration that they set.
WINDOWS = {
    "window_events": ("N", "most events of a window, in the ROI (default: as suits the motion)"),
    "window_us": ("D", "oldest event of a window, µs"),
    "hop_events": ("N", "evaluate again after so many new events in the ROI (default: a 16th of a window's)"),
    "hop_us": ("D", "or after so long, µs"),
}


def add_window_options(made):
    """How long windows and hops are, and how many results are kept; for :func:`window_fields`."""
    group = made.add_argument_group("windows that slide (unless a batch option, or something else, asks for batches)")
    for name, (metavar, text) in WINDOWS.items():
        group.add_argument(f"--{name.replace('_', '-')}", type=natural, metavar=metavar, help=text)
    group.add_argument("--every", type=positive, default=1, metavar="K", help="keep every K-th result (default: 1)")


def window_fields(options):
    """The fields that :data:`WINDOWS` were given for."""
    return {name: getattr(options, name) for name in WINDOWS if getattr(options, name) is not None}


def batch_size(options):
    """What makes a batch complete, as :class:`~cmfpga.events.BatchCutter` takes it; empty without such an option."""
    sizes = {"events": options.batch_events, "duration_us": options.batch_us, "roi_events": options.batch_roi_events}
    return {name: value for name, value in sizes.items() if value}


def add_clock_option(made):
    """``--clock``."""
    text = f"clock that you assume the hardware to reach, MHz (default: {CLOCK_MHZ:g})"
    made.add_argument("--clock", type=clock, default=CLOCK_MHZ, metavar="MHZ", help=text)


def add_tile_options(made):
    """``--tile`` and ``--step``, of tiles of flow."""
    made.add_argument("--tile", type=positive, metavar="PX", help="size of a tile (default: 32; 48 for HD)")
    made.add_argument("--step", type=positive, metavar="PX", help="from tile to tile (default: half a tile)")


def add_recording_options(made):
    """``--sensor`` and ``--time-unit``."""
    made.add_argument("--sensor", type=pair("W,H"), metavar="W,H", help="sensor size, px, if the file doesn't say")
    made.add_argument("--time-unit", choices=("s", "ms", "us", "ns"), help="unit of the time stamps, if ambiguous")


def add_reading_options(made):
    """:func:`add_recording_options`, ``--columns``, ``--dataset`` and ``--format``, for :func:`reading`."""
    from ..events import forms

    add_recording_options(made)
    text = "columns in their order, of text without names and of N×4; others: any name"
    made.add_argument("--columns", metavar="x,y,t,p", help=text)
    made.add_argument("--dataset", metavar="PATH", help="data set or group inside of an HDF5 file; topic of a ROS bag")
    text = f"format of a file or stream that doesn't say it: {', '.join(forms())}"
    made.add_argument("--format", dest="form", choices=forms(), metavar="F", help=text)


def reading(options):
    """How the recording is read, as :func:`cmfpga.events.open_recording` takes it."""
    return {name: getattr(options, name) for name in READING}


def require_recording(options, *names):
    """Without a RECORDING, :exc:`ConfigError` for an option of reading it, or for one of ``names``."""
    for name in (*READING, *names):
        if getattr(options, name):
            option = READING.get(name, f"--{name}")
            raise ConfigError(f"{option}: a RECORDING is needed; the synthetic scene has its own")


def note(*sentences):
    """Print each of them that is not empty to standard error."""
    for sentence in filter(None, sentences):
        print(f"note: {sentence}", file=sys.stderr, flush=True)


def noted(recording):
    """The recording; what is odd about it is noted."""
    note(*recording.notes())
    return recording


def wrote(files):
    """Print which files were written."""
    for path in files:
        print(f"wrote {path}")


def files(action):
    """Marks an argument of argparse as a file, for the completion of shells."""
    action.complete = {"bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f"}
    return action


def checked(parse):
    """A parser for argparse, made of one that raises :exc:`ConfigError`."""

    def parsed(text):
        try:
            return parse(text)
        except ConfigError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parsed


def numbers(kind, count, needed, allowed=lambda value: True):
    """A parser for argparse of ``count`` numbers with commas between them, a tuple, each of which is ``allowed``.

    ``needed`` says so to who gives others.
    """

    def parse(text):
        try:
            found = tuple(kind(part) for part in text.split(","))
        except ValueError:
            found = ()
        if len(found) != count or not all(map(allowed, found)):
            raise argparse.ArgumentTypeError(f"{text!r}: {needed} needed")
        return found

    return parse


def number(kind, needed, allowed=lambda value: True):
    """The same of one number."""
    parse = numbers(kind, 1, needed, allowed)
    return lambda text: parse(text)[0]


def pair(what):
    """A parser of ``A,B`` (two integers) for argparse."""
    return numbers(int, 2, f"{what}, two whole numbers, is")


positive = number(int, "a whole number of 1 or more is", lambda value: value >= 1)
natural = number(int, "a whole number of 0 or more is", lambda value: value >= 0)
clock = number(float, "a number of MHz, more than 0, at most 10000, is", lambda value: 0 < value <= 10_000)


def few(text):
    """A parser of a number of objects, 1 to 4, for argparse."""
    if positive(text) > 4:
        raise argparse.ArgumentTypeError(f"{text!r}: 1 to 4 is needed")
    return int(text)


def shows_bar():
    """Whether there is a terminal for a progress bar, as tqdm decides."""
    return sys.stderr.isatty()


def expected(recording, cutter, start_event, most, slices=1):
    """Number of windows that will come, for a progress bar, as far as it can be known soon."""
    if not shows_bar() or cutter.mode == "roi_events" or hasattr(cutter, "survey"):
        return most
    if (extent := recording.extent()) is None:
        return most
    events, last = extent
    if cutter.mode == "events":
        rest = events - start_event
    else:
        first = next(recording.chunks(start_event, 1), None)
        rest = last - int(first.t[0]) if first else 0
    whole = max(0, rest // cutter.size - slices + 1)
    return min(whole, most or whole)


def output_folder(path):
    """``path`` as an existing folder in which files can be made."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".cmfpga-write-test"
        probe.touch()
        probe.unlink(missing_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise ConfigError(f"--out {path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    return folder


@contextlib.contextmanager
def locked(path):
    """``path`` as :func:`output_folder`, in which no other command that locks it writes meanwhile."""
    from filelock import FileLock, Timeout

    folder = output_folder(path)
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ConfigError(f"--out {path}: another command is writing there; another folder is needed") from None
    try:
        yield folder
    finally:
        (folder / ".lock").unlink(missing_ok=True)
        lock.release()


class Proposals(tuple):
    """``choices`` of an option that a shell proposes; its ``type`` says what is allowed."""

    def __contains__(self, value):
        return True


def run(main, arguments=None):
    """Call ``main(arguments)``; a user's mistake, or the system's refusal, becomes one line and exit status 2."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal or a pipe may not have every sign of a path or a unit
            stream.reconfigure(errors="backslashreplace")
    hook, sys.unraisablehook = sys.unraisablehook, functools.partial(_unraisable, sys.unraisablehook)
    try:
        with needs("", "", "this command"):
            return main(arguments)
    except UserError as error:
        return _fail(str(error))
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    except OSError as error:  # such as a full disk, or a folder where a file is to be written
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        warnings.simplefilter("ignore")  # Amaranth's, of each block whose elaboration was not finished
        print("interrupted", file=sys.stderr)
        return 130
    finally:
        sys.unraisablehook = hook


def _unraisable(hook, unraisable):
    """Python drops what a destructor raises; an interrupt that came there comes again, when this has returned."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        again = threading.Timer(0.2, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        again.daemon = True
        again.start()
    else:
        hook(unraisable)


def _fail(message):
    print("error:", " ".join(message.splitlines()), file=sys.stderr)
    return 2
