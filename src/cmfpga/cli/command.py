"""The command ``cmfpga``, which is ``python -m cmfpga``: one name for all tools.

A subcommand is a module of this room, with ``parser()``, and with ``main(arguments)``, which returns the exit status.
It is imported when it is called, so that ``cmfpga --help`` takes no time.
"""

import importlib
import sys

from .. import cli
from ..errors import UserError, needs, one_of

#: Purpose of each subcommand, in the order of the help.
COMMANDS = {
    "info": "what a recording holds, and an ROI and batches that suit it",
    "track": "follow objects through a recording",
    "flow": "dense optical flow of a recording, and one motion fitted to it",
    "accuracy": "how right that is, beside a true motion that you have",
    "sweep": "many recordings with many configurations, and which did best",
    "build": "emit the accelerator as Verilog",
    "report": "one page of a track: what moved, where to, how fast",
    "driver": "self-test of the accelerator: simulated, or on a board",
    "generate": "write a synthetic recording with known motion",
}

EXAMPLES = (
    "cmfpga info rec.h5",
    "cmfpga track rec.h5 --roi auto",
    "cmfpga track --help",
    "cmfpga --print-completion bash > ~/.local/share/bash-completion/completions/cmfpga",
)


def load(name):
    """The module of the subcommand ``name``."""
    if name not in COMMANDS:
        raise UserError(f"{name[:40]!r}: no such subcommand; {one_of(name, COMMANDS)}")
    return importlib.import_module(f".{name}", __package__)


def _parser():
    made = cli.parser("cmfpga", "Contrast Maximization for event cameras on an FPGA.", EXAMPLES)
    purposes = "".join(f"  {name:<10} {purpose}\n" for name, purpose in COMMANDS.items())
    made.epilog = f"subcommands:\n{purposes}\n{made.epilog}"
    made.usage = "cmfpga [--help] [--version] [--print-completion SHELL] SUBCOMMAND …"
    text = "print a script by which bash, zsh or tcsh completes subcommands, options and files; needs shtab"
    made.add_argument("--print-completion", choices=("bash", "zsh", "tcsh"), metavar="SHELL", help=text)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    arguments = [*(sys.argv[1:] if arguments is None else arguments)]
    if arguments and not arguments[0].startswith("-"):
        name, *rest = arguments
        return load(name).main(rest)
    options, unknown = _parser().parse_known_args(arguments)
    if options.print_completion:
        print(_completion(options.print_completion))
        return 0
    if unknown:
        raise UserError(f"{unknown[0]}: a subcommand is needed first: {', '.join(COMMANDS)} (--help)")
    _parser().print_help()
    return 2


def _completion(shell):
    """A script for ``shell`` of all subcommands and their options."""
    with needs("shtab", "completion", "--print-completion"):
        import shtab
    whole = _parser()
    commands = whole.add_subparsers(prog="cmfpga")
    for name, purpose in COMMANDS.items():
        # The copy has the subcommand's own --help, too.
        commands.add_parser(name, parents=[load(name).parser()], add_help=False, help=purpose)
    return shtab.complete(whole, shell=shell)


def entry():
    """The entry point."""
    return cli.run(main)
