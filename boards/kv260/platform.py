"""The Kria KV260 for Amaranth's build system.

The programmable logic of this board has no oscillator of its own: its clock, ``pl_clk0``, comes from the processing
system, which Vivado's block design sets up. So the platform has no ``default_clk``, and a design for it needs a clock
domain that is driven from outside. For the same reason a bitstream that is built from this platform alone has no
clock; use the platform for its part name, its pins and its Tcl script, and the packaged IP in a block design for
everything else (README.md in this folder).

Nothing of it was run in Vivado or on a board.
"""

import tomllib
from pathlib import Path

from amaranth.build import Attrs, Connector, PinsN, Resource
from amaranth.vendor import XilinxPlatform
from amaranth_boards.extensions.pmod import PmodGPIOType1Resource

__all__ = ["KV260Platform"]

_board = tomllib.loads((Path(__file__).parent / "board.toml").read_text(encoding="utf-8"))["board"]
_fan = _board["fan"]


class KV260Platform(XilinxPlatform):
    """XCK26 on the Kria K26 module with the Vision AI starter kit's carrier; facts from ``board.toml``.

    ``fan`` is the fan's enable, low active. ``pmod_gpio`` is the upper row of the Pmod connector, four plain pins for
    a logic analyser; the connector ``pmod_0`` has all eight.
    """

    device = _board["device"]
    package = _board["package"]
    speed = _board["speed"]

    #: What Vivado calls the part, and the board; the board's files come with Vivado.
    part = f"{device}-{package}-{speed}"
    board_part = _board["board_part"]

    resources = [  # noqa: RUF012 - Amaranth's convention
        Resource(
            "fan", 0, PinsN(_fan["pin"], dir="o"),
            Attrs(IOSTANDARD=_fan["iostandard"], SLEW=_fan["slew"], DRIVE=str(_fan["drive"])),
        ),
        PmodGPIOType1Resource("pmod_gpio", 0, Attrs(IOSTANDARD=_board["pmod_iostandard"]), pmod=0),
    ]  # fmt: skip
    # A Pmod has supply pins in the middle: signals are 1-4 and 7-10.
    connectors = [  # noqa: RUF012 - as above
        Connector("pmod", 0, "{} {} {} {} - - {} {} {} {} - -".format(*_board["pmod"].split())),
    ]
