"""The Kria KV260 for Amaranth's build system.

The programmable logic of this board has no oscillator of its own: its clock, ``pl_clk0``, comes from the processing
system, which Vivado's block design sets up. So the platform has no ``default_clk``, and a design for it needs a clock
domain that is driven from outside. For the same reason a bitstream that is built from this platform alone has no
clock; use the platform for its part name, its constraints and its Tcl script, and the emitted Verilog in a block
design for everything else (README.md in this folder).

Nothing of it was run in Vivado or on a board.
"""

from amaranth.build import Attrs, PinsN, Resource
from amaranth.vendor import XilinxPlatform

__all__ = ["KV260Platform"]


class KV260Platform(XilinxPlatform):
    """XCK26 on the Kria K26 module with the Vision AI starter kit's carrier.

    ``fan`` is the fan's enable, low active: pin A12 of the package, HDA20 of the module's connector. The connectors are
    left out until a design of this project uses them.
    """

    device = "xck26"
    package = "sfvc784"
    speed = "2LV-c"

    #: What Vivado calls the part, and the board; the board's files come with Vivado.
    part = f"{device}-{package}-{speed}"
    board_part = "xilinx.com:kv260_som:part0:1.4"

    resources = [  # noqa: RUF012 - Amaranth's convention
        Resource("fan", 0, PinsN("A12", dir="o"), Attrs(IOSTANDARD="LVCMOS33", SLEW="SLOW", DRIVE="4")),
    ]
    connectors = []  # noqa: RUF012
