"""Families of FPGAs that open tools from PyPI place and route: what each asks of Yosys and nextpnr."""

from collections.abc import Callable
from dataclasses import dataclass

from .packing import pack


@dataclass(frozen=True, kw_only=True)
class Family:
    """What differs between families; sizes and clocks are the tools' own."""

    title: str
    #: The command of nextpnr, one of ``tools.COMMANDS``; and the extra of this package that brings it.
    nextpnr: str
    extra: str = "families"
    #: Commands of Yosys between reading and writing; ``{top}`` is the module.
    synthesis: str
    #: ``{name: (what nextpnr calls it, its speed grades, the fastest first)}``; ``{speed}`` is the grade.
    devices: dict
    #: Further options of nextpnr.
    options: tuple = ()
    #: Resources by name: nextpnr's own, and title.
    resources: dict
    #: Changes the netlist's module in place.
    prepare: Callable
    #: What nextpnr has no delays of: then the clock that it reports is only a bound.
    untimed: str = ""


def _only_clock(module, kept=("clk", "aclk")):
    """Take the ports away: nextpnr would give each a pad, and there are more of them than pads."""
    module["ports"] = {name: port for name, port in module["ports"].items() if name in kept}


def _nexus(module):
    """The first cell of a carry chain has its carry-in on A1; ABC ties its unused CIN to 0, which nextpnr refuses."""
    _only_clock(module, ())
    chained = {bit for cell in module["cells"].values() for bit in cell["connections"].get("COUT", ())}
    for cell in module["cells"].values():
        if cell["type"] == "CCU2" and not chained.issuperset(cell["connections"].get("CIN", ())):
            del cell["connections"]["CIN"], cell["port_directions"]["CIN"]


def luts_of_four(module):
    """Smaller tables of a Gowin's are repeated in larger ones: nextpnr has delays of LUT4 alone."""
    for cell in module["cells"].values():
        if cell["type"] in ("LUT1", "LUT2", "LUT3"):
            table = cell["parameters"]["INIT"]
            cell["type"], cell["parameters"]["INIT"] = "LUT4", table * (16 // len(table))


def _gowin(module):
    """Without pads but the clock's, which is at a pin that feeds the global nets."""
    _only_clock(module)
    (clock,) = (port["bits"] for port in module["ports"].values())
    pads = {name: cell for name, cell in module["cells"].items() if cell["type"] in ("IBUF", "OBUF")}
    for name, cell in pads.items():
        if cell["connections"]["I"] == clock:
            cell["attributes"]["BEL"] = "X0Y2/IOBA"
        else:
            del module["cells"][name]
    luts_of_four(module)


# How much the placers weigh time against the length of wires. By nextpnr's own 10, ``fast`` has 8 to 20 % less clock on
# an ECP5; 30 and 100 are between.
TIMING = ("--placer-heap-timingweight", "60")

ECP5 = Family(
    title="Lattice ECP5",
    nextpnr="nextpnr-ecp5",
    extra="place",
    synthesis="synth_ecp5 -no-rw-check -top {top}",
    devices={
        name: (f"{option} --speed {{speed}}", (8, 7, 6))
        for name, option in {
            **{f"LFE5U-{size}F": f"--{size}k" for size in (12, 25, 45, 85)},
            **{f"LFE5UM-{size}F": f"--um-{size}k" for size in (25, 45, 85)},
        }.items()
    },
    options=(*TIMING, "--out-of-context", "--lpf-allow-unconstrained"),
    resources={
        "lut4": ("TRELLIS_COMB", "LUT4"),
        "ff": ("TRELLIS_FF", "FF"),
        "dp16kd": ("DP16KD", "DP16KD"),
        "mult18": ("MULT18X18D", "MULT18X18D"),
    },
    prepare=pack,
)

_SYNTH_NEXUS = "synth_nexus -family lifcl -no-rw-check -noiopad -nodsp -top {top} -run"
NEXUS = Family(
    title="Lattice Nexus",
    nextpnr="nextpnr-nexus",
    # Multipliers by themselves: Yosys 0.70 moves registers into them that others read, too, which then read nothing.
    synthesis=f"""{_SYNTH_NEXUS} begin:coarse
proc
flatten
opt
wreduce
opt_clean
techmap -map +/mul2dsp.v -map +/lattice/dsp_map_nexus.v -D DSP_A_MAXWIDTH=18 -D DSP_B_MAXWIDTH=18 \
-D DSP_A_MINWIDTH=2 -D DSP_B_MINWIDTH=2 -D DSP_NAME=$__NX_MUL18X18
chtype -set $mul t:$__soft_mul
{_SYNTH_NEXUS} coarse:""",
    devices={"LIFCL-40": ("--device LIFCL-40-{speed}BG400C", (9, 8, 7))},
    options=TIMING,
    resources={
        "lut4": ("OXIDE_COMB", "LUT4"),
        "ff": ("OXIDE_FF", "FF"),
        "ram": ("OXIDE_EBR", "EBR"),
        "mult18": ("MULT18_CORE", "MULT18"),
    },
    prepare=_nexus,
)

GOWIN = Family(
    title="Gowin GW2A",
    nextpnr="nextpnr-himbaechel-gowin",
    synthesis="synth_gowin -family gw2a -no-rw-check -top {top}",
    devices={
        name: (f"--device GW2A-LV18PG256C{{speed}}/I7 --vopt family={name}", (8,)) for name in ("GW2A-18", "GW2A-18C")
    },
    resources={
        "lut4": ("LUT4", "LUT4"),
        "alu": ("ALU", "ALU"),
        "ff": ("DFF", "FF"),
        "ram": ("BSRAM", "BSRAM"),
        "mult18": ("MULT18X18", "MULT18X18"),
        "mult9": ("MULT9X9", "MULT9X9"),
    },
    prepare=_gowin,
    untimed="multipliers",
)

GATEMATE = Family(
    title="Cologne Chip GateMate",
    nextpnr="nextpnr-himbaechel-gatemate",
    # nextpnr knows no multiplexers of eight.
    synthesis="synth_gatemate -luttree -nomx8 -noiopad -top {top}\nautoname",
    devices={"CCGM1A1": ("--device CCGM1A1", (1,))},
    options=("--placer-heap-beta", "0.6"),
    resources={"lut4": ("CPE_LT", "CPE_LT"), "ff": ("CPE_FF", "CPE_FF"), "ram": ("RAM_HALF", "RAM_HALF")},
    prepare=_only_clock,
    untimed="multipliers",
)

#: By the device's name.
FAMILIES = {device: family for family in (ECP5, NEXUS, GOWIN, GATEMATE) for device in family.devices}
