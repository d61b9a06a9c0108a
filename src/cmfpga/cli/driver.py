"""``cmfpga driver``: the accelerator's self-test, on a board or on the simulated Verilog."""

import contextlib
import json

from .. import cli
from ..driver import Accelerator
from ..errors import UserError, needs

BACKENDS = ("simulation", "uio", "serial")

EXAMPLES = (
    "cmfpga driver --preset fast                  # on the simulated Verilog",
    "cmfpga driver --preset fast --backend uio    # on a board, as root",
    "cmfpga driver --backend serial --port /dev/ttyUSB0    # on a board at a serial port",
)


def parser():
    """Parser of the arguments of ``cmfpga driver``."""
    made = cli.parser("cmfpga driver", "Check the accelerator: identity, registers, interrupt, a batch.", EXAMPLES)
    text = "simulation: the emitted Verilog; uio: plain Linux on a board; serial: a board at --port"
    made.add_argument("--backend", default="simulation", choices=BACKENDS, help=f"{text} (default: simulation)")
    made.add_argument("--port", metavar="PORT", help="with serial: such as /dev/ttyUSB0")
    made.add_argument("--baud", type=cli.positive, metavar="N", help="with serial: as it was built (default: 3000000)")
    made.add_argument("--timeout", type=float, default=10.0, metavar="S", help="s that anything may take (default: 10)")
    made.add_argument("--no-interrupt", action="store_true", help="look at registers instead of waiting for interrupts")
    made.add_argument("--json", action="store_true", help="print what was found as JSON")
    cli.add_config_options(made)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    config = cli.make_config(options)
    interrupt = False if options.no_interrupt else None
    if (options.backend == "serial") != bool(options.port) or (options.baud and not options.port):
        raise UserError("--backend serial needs --port, and --port and --baud need --backend serial")
    with contextlib.closing(_backend(options, config)) as backend:
        accelerator = Accelerator(backend, config, timeout=options.timeout, interrupt=interrupt)
        found = accelerator.self_test()
        accelerator.close()
    if options.json:
        print(json.dumps(found, indent=2, ensure_ascii=False))
    else:
        print(*(f"{name}: {what}" for name, what in found.items()), sep="\n")
    return 0


def _backend(options, config):
    if options.backend == "serial":
        from ..driver.uart import SerialLine, UartBackend

        return UartBackend(SerialLine(options.port, **({"baud": options.baud} if options.baud else {})))
    if options.backend == "uio":
        from ..driver.uio import UioBackend

        return UioBackend()
    with needs("", "", "--backend simulation (on a board --backend uio or serial is needed)"):
        from ..driver.simulation import SimulationBackend
    return SimulationBackend(config)
