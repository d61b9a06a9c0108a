"""Small hardware for the tests of ``cmfpga.build``, and what each top that it emits must pass."""

from pathlib import Path

from support.designs import TINY
from support.small_core import sets
from support.verilog_tools import verilator_lint

TINY_SETS = sets(TINY)
#: What is written of a core, in order.
FILES = (
    "cmfpga_core.v", "build-info.json", "build-info.md", "cmfpga_core_fields.vh", "cmfpga_core_example.v",
    "cmfpga_core_example_tb.v", "cmfpga_core_example.mem", "cmfpga_core.core", "component.xml",
)  # fmt: skip
WAIVERS = Path(__file__).parents[2] / "sim" / "verilator.vlt"


def check_lint(folder, top):
    """Verilator warns of nothing in a top's Verilog that it does not warn of in the core's."""
    waivers = folder / "verilator.vlt"
    waivers.write_text(WAIVERS.read_text().replace("cmfpga_core.v", f"{top}.v"))
    assert verilator_lint((folder / f"{top}.v").read_text(), folder, "-Wall", waivers, top=top) == (0, set())
