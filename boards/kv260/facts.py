#!/usr/bin/env python3
"""Makes the files of this folder that hold facts, from ``board.toml``.

    python boards/kv260/facts.py            # write them, print what changed
    python boards/kv260/facts.py --check    # exit status 1 and their names, if some are not current

Needs Python 3.11 and nothing else.
"""

import argparse
import sys
import tomllib
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
NOTE = "Generated from boards/kv260/board.toml by boards/kv260/facts.py; do not edit."

#: What a field of an AFI register means (device-tree-xlnx: common_proc.tcl); the two directions count differently.
AFI_SLAVE = {128: 0, 64: 1, 32: 2}
AFI_MASTER = {32: 0, 64: 1, 128: 2}


class FactError(ValueError):
    """``board.toml`` contradicts itself."""


def load(path=FOLDER / "board.toml"):
    """The facts, checked against each other. Raises :class:`FactError` with one line."""
    facts = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    check(facts)
    return facts


def check(facts):
    """Refuse facts that cannot all be true."""
    control, memory, dma = facts["control"], facts["memory"], facts["dma"]
    low, high = control["window"], control["window"] + control["window_size"]
    blocks = [(name, control[name]["address"], control[name]["size"]) for name in ("cmfpga", "dma")]
    for name, address, size in blocks:
        if size < 4096 or size & (size - 1) or address % size:
            raise FactError(f"control.{name}: {address:#x} must be a multiple of its size {size:#x}, a power of two")
        if not low <= address <= high - size:
            raise FactError(f"control.{name}: {address:#x} is outside of {control['port']}'s window from {low:#x}")
    (_, first, first_size), (_, second, second_size) = blocks
    if first < second + second_size and second < first + first_size:
        raise FactError("control.cmfpga and control.dma overlap")
    if facts["ip"]["control_address_width"] != (control["cmfpga"]["size"] - 1).bit_length():
        raise FactError("ip.control_address_width does not span control.cmfpga.size")
    if control["data_width"] not in AFI_MASTER or memory["data_width"] not in AFI_SLAVE:
        raise FactError("control.data_width and memory.data_width must be 32, 64 or 128")
    if dma["data_width"] != facts["ip"]["stream_data_width"]:
        raise FactError("dma.data_width must be ip.stream_data_width: nothing between them changes the width")
    if memory["ddr_high"][0] + memory["ddr_high"][1] > 1 << dma["address_width"]:
        raise FactError("dma.address_width does not reach the end of memory.ddr_high")
    for name in ("events", "results"):
        size = facts["linux"][f"buffer_{name}_size"]
        if size % 4096 or size >= 1 << dma["length_width"]:
            raise FactError(f"linux.buffer_{name}_size must be whole pages, less than 2^{dma['length_width']} bytes")
    if abs(facts["clock"]["hertz"] - facts["clock"]["mhz"] * 1_000_000) > 20 * facts["clock"]["mhz"]:
        raise FactError("clock.hertz and clock.mhz differ by more than 20 ppm: change both")


def part(facts):
    """What Vivado calls the device."""
    return "{device}-{package}-{speed}".format(**facts["board"])


def vlnv(facts):
    """What Vivado and PYNQ call the IP."""
    return "{vendor}:{library}:{name}:{version}".format(**facts["ip"])


def afi(facts):
    """``(register, value)`` pairs of the ports in use; the others are left alone."""
    control, memory = facts["control"], facts["memory"]
    pairs = [(register, AFI_SLAVE[memory["data_width"]]) for register in memory["afi_registers"]]
    return [*pairs, (control["afi_register"], AFI_MASTER[control["data_width"]] << control["afi_shift"])]


def facts_tcl(facts):
    """What the Vivado scripts read: one array, ``fact``."""
    board, clock, control, memory = facts["board"], facts["clock"], facts["control"], facts["memory"]
    dma, ip, fan = facts["dma"], facts["ip"], facts["board"]["fan"]
    values = {
        **facts["design"],
        "part": part(facts),
        **{key: board[key] for key in ("board_part", "board_part_pattern", "carrier_connector", "carrier")},
        "fan_port": fan["port"],
        "fan_timer_bit": fan["timer_bit"],
        "clock_mhz": clock["mhz"],
        "clock_hertz": clock["hertz"],
        "vlnv": vlnv(facts),
        **{f"ip_{key}": ip[key] for key in ("vendor", "library", "name", "version")},
        "ip_interfaces": "{" + " ".join(word for line in ip["interfaces"] for word in line) + "}",
        "stream_bytes": ip["stream_data_width"] // 8,
        "stream_user_width": ip["stream_user_width"],
        **_port("control", control),
        "control_unused": "{" + " ".join(f"CONFIG.PSU__USE__{name}" for name in control["unused"]) + "}",
        **{f"{block}_{key}": f"{control[block][key]:#x}" for block in ("cmfpga", "dma") for key in ("address", "size")},
        **_port("memory", memory),
        "memory_segments": f"{memory['parameter']}/{memory['segment']}",
        "memory_excluded": "{" + " ".join(memory["excluded"]) + "}",
        **{
            f"{half}_{key}": f"{value:#x}"
            for half in ("ddr_low", "ddr_high")
            for key, value in zip(("offset", "size"), memory[half], strict=True)
        },
        **{f"dma_{key}": dma[key] for key in ("length_width", "address_width", "burst", "data_width")},
    }
    width = max(map(len, values))
    return f"# {NOTE}\n" + "".join(f"set fact({name}){' ' * (width - len(name))} {v}\n" for name, v in values.items())


def _port(name, port):
    """A port of the PS, which names its switch and its width differently: ``M_AXI_GP0``, ``MAXIGP0``."""
    return {
        f"{name}_port": port["port"],
        f"{name}_use": f"CONFIG.PSU__USE__{port['parameter'].replace('AXIGP', '_AXI_GP')}",
        f"{name}_width_parameter": f"CONFIG.PSU__{port['parameter']}__DATA_WIDTH",
        f"{name}_width": port["data_width"],
        f"{name}_clock_pin": port["clock_pin"],
    }


def xdc(facts):
    """The only pin, and the bitstream's properties."""
    fan = facts["board"]["fan"]
    port = f"[get_ports {{{fan['port']}}}]"
    return f"""\
# {NOTE}
# No clock here: the block design brings the constraint of pl_clk0, a second one would be a duplicate.
set_property PACKAGE_PIN {fan["pin"]} {port}
set_property IOSTANDARD {fan["iostandard"]} {port}
set_property SLEW {fan["slew"]} {port}
set_property DRIVE {fan["drive"]} {port}
set_property BITSTREAM.GENERAL.COMPRESS TRUE [current_design]
set_property BITSTREAM.CONFIG.OVERTEMPSHUTDOWN ENABLE [current_design]
"""


def dtso(facts):
    """The device-tree overlay. Labels, not paths, name the targets: the paths differ between kernels."""
    clock, control, interrupt, linux = facts["clock"], facts["control"], facts["interrupt"], facts["linux"]
    name = facts["design"]["name"]
    pairs = ", ".join(f"<{register} {value:#x}>" for register, value in afi(facts))

    def uio(label, node, block, extra=""):
        address, size = control[block]["address"], control[block]["size"]
        return f"""\
	{label}: {node}@{address:x} {{
		compatible = "generic-uio";
		linux,uio-name = "{node}";
		reg = <0x0 {address:#x} 0x0 {size:#x}>;
		clocks = <&zynqmp_clk {clock["linux_clock"]}>;
{extra}	}};
"""

    def buffer(which):
        device = linux[f"buffer_{which}"]
        return f"""\
	cmfpga_{which}: {device} {{
		compatible = "ikwzm,u-dma-buf";
		device-name = "{device}";
		size = <{linux[f"buffer_{which}_size"]:#x}>;
		dma-mask = <{facts["dma"]["address_width"]}>;
	}};
"""

    irq = (
        "\t\tinterrupt-parent = <&gic>;\n"
        f"\t\tinterrupts = <0 {interrupt['gic_spi'] + interrupt['line']} {interrupt['trigger']}>;\n"
    )
    return f"""\
/* {NOTE} */
/dts-v1/;
/plugin/;

&fpga_full {{
	#address-cells = <2>;
	#size-cells = <2>;
	firmware-name = "{name}.bit.bin";
	resets = <&zynqmp_reset {clock["linux_reset"]}>;
}};

&amba {{
	#address-cells = <2>;
	#size-cells = <2>;

	/* Widths of the ports between PS and PL; must equal the block design's. */
	cmfpga_afi: afi0 {{
		compatible = "xlnx,afi-fpga";
		config-afi = {pairs};
	}};

	/* Keeps the PL's clock running: without a user Linux turns it off, and the first register access hangs. */
	cmfpga_clock: clocking0 {{
		compatible = "xlnx,fclk";
		#clock-cells = <0>;
		clocks = <&zynqmp_clk {clock["linux_clock"]}>;
		assigned-clocks = <&zynqmp_clk {clock["linux_clock"]}>;
		assigned-clock-rates = <{clock["hertz"]}>;
		clock-output-names = "fabric_clk";
	}};

{uio("cmfpga_registers", linux["uio_cmfpga"], "cmfpga", irq)}
{uio("cmfpga_dma", linux["uio_dma"], "dma")}
{buffer("events")}
{buffer("results")}}};
"""


def bif(facts):
    """For those who prefer bootgen to ``bit2bin.py``."""
    return f"/* {NOTE} */\nall:\n{{\n\t[destination_device = pl] {facts['design']['name']}.bit\n}}\n"


def make_variables(facts):
    """What the Makefile needs."""
    design = facts["design"]
    lines = ("APP", design["name"]), ("TOP", design["top"]), ("PART", part(facts)), ("CLOCK_MHZ", facts["clock"]["mhz"])
    return f"# {NOTE}\n" + "".join(f"{name} := {value}\n" for name, value in lines)


def python_module(facts):
    """The :class:`cmfpga.boards.AxiBoard`, for the package, which is installed without this folder."""
    design, board, control, linux, dma = (facts[name] for name in ("design", "board", "control", "linux", "dma"))
    numbers = ", ".join(f'"{kind}": {number:_}' for kind, number in board["resources"].items())
    fields = {
        "name": f'"{FOLDER.name}"',
        "title": '"KV260"',
        "top": f'"{design["top"]}"',
        **{name: f'"{board[name]}"' for name in ("device", "package", "speed")},
        "resources": f"{{{numbers}}}",
        "clock_hz": f"{facts['clock']['hertz']:_}",
        "linux_clock": '"pl0_ref"',
        "application": f'"{design["name"]}"',
        "vlnv": f'"{vlnv(facts)}"',
        "registers_address": f"0x{control['cmfpga']['address']:08X}",
        "registers_size": f"{control['cmfpga']['size']:#x}",
        "registers_width": facts["ip"]["control_data_width"],
        "dma_address": f"0x{control['dma']['address']:08X}",
        "dma_size": f"{control['dma']['size']:#x}",
        "dma_length_bits": dma["length_width"],
        "dma_address_bits": dma["address_width"],
        "stream_width": facts["ip"]["stream_data_width"],
        "interrupt_spi": facts["interrupt"]["gic_spi"] + facts["interrupt"]["line"],
        "uio_registers": f'"{linux["uio_cmfpga"]}"',
        "uio_dma": f'"{linux["uio_dma"]}"',
        **{f"buffer_{which}{size}": form.format(linux[f"buffer_{which}{size}"])
           for which in ("events", "results") for size, form in (("", '"{}"'), ("_size", "{:#x}"))},
    }  # fmt: skip
    lines = "".join(f"    {name}={value},\n" for name, value in fields.items())
    head = f'"""Facts of the KV260 design that software needs.\n\n{NOTE}\n"""\n\nfrom .board import AxiBoard\n\n'
    return f"{head}KV260 = AxiBoard(\n{lines})\n"


#: File, relative to the repository, and what makes its text.
FILES = {
    "boards/kv260/facts.mk": make_variables,
    "boards/kv260/vivado/facts.tcl": facts_tcl,
    "boards/kv260/vivado/kv260.xdc": xdc,
    "boards/kv260/sw/cmfpga.dtso": dtso,
    "boards/kv260/sw/cmfpga.bif": bif,
    "src/cmfpga/boards/kv260.py": python_module,
}


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Make the files that hold facts of the KV260 from board.toml.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 1 if a file is not current")
    options = parser.parse_args(arguments)
    try:
        facts = load()
    except (FactError, tomllib.TOMLDecodeError) as error:
        print(f"error: board.toml: {error}", file=sys.stderr)
        return 2
    texts = {ROOT / name: make(facts) for name, make in FILES.items()}
    stale = [path for path, text in texts.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in stale:
        if options.check:
            print(f"not current: {path.relative_to(ROOT)}; run python boards/kv260/facts.py", file=sys.stderr)
        else:
            path.write_text(texts[path], encoding="utf-8")
            print(path.relative_to(ROOT))
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
