"""IPs of the strict model: pins, interfaces, parameters and addresses, as far as the block design uses them.

Names and ranges are those of public block designs and of AMD's product guides (PG021 AXI DMA, PG164 reset, PG247
SmartConnect, PG085 AXI4-Stream infrastructure, PG201 Zynq UltraScale+ processing system).
"""

import dataclasses
import xml.etree.ElementTree as ElementTree

from vivado_objects import VivadoError, number


@dataclasses.dataclass
class Pin:
    """A pin: ``kind`` is clk, rst_n, rst, irq or data. An input that is not ``optional`` must be connected."""

    direction: str
    kind: str = "data"
    width: int = 1
    optional: bool = False


@dataclasses.dataclass
class Interface:
    """A bus interface: ``bus`` is axi or axis; ``shape`` must agree on both sides of a stream."""

    bus: str
    mode: str
    clock: str
    shape: dict = dataclasses.field(default_factory=dict)
    needs: tuple = ()  # signals of a stream that the other side must have


@dataclasses.dataclass
class Segment:
    """What a slave offers to address spaces; ``offset`` is fixed if it is not None."""

    interface: str
    path: str
    size: int
    offset: int | None = None


@dataclasses.dataclass
class View:
    """What a cell looks like with its present parameters; ``spaces`` is ``{name: (interface, bits, windows)}``."""

    pins: dict
    interfaces: dict
    spaces: dict = dataclasses.field(default_factory=dict)
    segments: list = dataclasses.field(default_factory=list)
    through: bool = False


class IP:
    """An IP: parameters (``{name: (default, allowed)}``) and what they make of it."""

    type = "ip"

    def __init__(self, vlnv, parameters, view):
        self.vlnv, self.parameters, self.view = vlnv, parameters, view


SWITCH = ("0", "1")


def whole(low, high):
    return range(low, high + 1)


def accepted(value, allowed):
    """Whether a parameter may have ``value``."""
    if allowed is None:
        return True
    if isinstance(allowed, range):
        return value.isdigit() and int(value) in allowed
    return value in allowed


PS_PARAMETERS = {
    "PSU__FPGA_PL0_ENABLE": ("1", SWITCH),
    "PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ": ("100", whole(1, 400)),
    "PSU__USE__M_AXI_GP0": ("1", SWITCH),
    "PSU__USE__M_AXI_GP1": ("1", SWITCH),
    "PSU__USE__M_AXI_GP2": ("0", SWITCH),
    **{f"PSU__USE__S_AXI_GP{n}": ("0", SWITCH) for n in range(7)},
    **{f"PSU__MAXIGP{n}__DATA_WIDTH": ("128", ("32", "64", "128")) for n in range(3)},
    **{f"PSU__SAXIGP{n}__DATA_WIDTH": ("128", ("32", "64", "128")) for n in range(7)},
    "PSU__USE__IRQ0": ("0", SWITCH),
    "PSU__USE__IRQ1": ("0", SWITCH),
    "PSU__TTC0__PERIPHERAL__ENABLE": ("0", SWITCH),
    "PSU__TTC0__WAVEOUT__ENABLE": ("0", SWITCH),
    "PSU__TTC0__WAVEOUT__IO": ("", ("", "EMIO")),
}
PS_MASTERS = (("M_AXI_HPM0_FPD", "maxihpm0_fpd_aclk"), ("M_AXI_HPM1_FPD", "maxihpm1_fpd_aclk"),
              ("M_AXI_HPM0_LPD", "maxihpm0_lpd_aclk"))  # fmt: skip
#: UG1085, "System Addresses".
PS_WINDOWS = {
    "M_AXI_HPM0_FPD": [(0xA000_0000, 0x1000_0000), (0x4_0000_0000, 0x1_0000_0000), (0x10_0000_0000, 224 << 30)],
    "M_AXI_HPM1_FPD": [(0xB000_0000, 0x1000_0000), (0x5_0000_0000, 0x1_0000_0000), (0x48_0000_0000, 224 << 30)],
    "M_AXI_HPM0_LPD": [(0x8000_0000, 0x2000_0000)],
}
PS_SLAVES = {0: "HPC0", 1: "HPC1", 2: "HP0", 3: "HP1", 4: "HP2", 5: "HP3"}


def processing_system(p):
    pins = {"pl_resetn0": Pin("O", "rst_n")}
    interfaces, segments, masters = {}, [], {}
    if p["PSU__FPGA_PL0_ENABLE"] == "1":
        pins["pl_clk0"] = Pin("O", "clk")
    for n, (name, clock) in enumerate(PS_MASTERS):
        if p[f"PSU__USE__M_AXI_GP{n}"] == "1":
            pins[clock] = Pin("I", "clk")
            interfaces[name] = Interface("axi", "master", clock)
            masters[name] = PS_WINDOWS[name]
    for n, name in PS_SLAVES.items():
        if p[f"PSU__USE__S_AXI_GP{n}"] == "1":
            clock = f"saxi{name.lower()}_fpd_aclk"
            pins[clock] = Pin("I", "clk")
            interfaces[f"S_AXI_{name}_FPD"] = Interface("axi", "slave", clock)
            segments += [
                Segment(f"S_AXI_{name}_FPD", f"SAXIGP{n}/{name}_{part}", size, offset)
                for part, offset, size in (
                    ("DDR_LOW", 0, 0x8000_0000), ("DDR_HIGH", 0x8_0000_0000, 32 << 30),
                    ("QSPI", 0xC000_0000, 0x2000_0000), ("LPS_OCM", 0xFF00_0000, 0x100_0000),
                )
            ]  # fmt: skip
    for n in (0, 1):
        if p[f"PSU__USE__IRQ{n}"] == "1":
            pins[f"pl_ps_irq{n}"] = Pin("I", "irq", optional=True)
    if (p["PSU__TTC0__PERIPHERAL__ENABLE"], p["PSU__TTC0__WAVEOUT__ENABLE"], p["PSU__TTC0__WAVEOUT__IO"]) == (
        "1", "1", "EMIO",
    ):  # fmt: skip
        pins["emio_ttc0_wave_o"] = Pin("O", width=3)
    return View(pins, interfaces, {"Data": (masters, 40)}, segments)


def reset(_):
    pins = {"slowest_sync_clk": Pin("I", "clk"), "ext_reset_in": Pin("I", "rst_n")}
    pins |= {name: Pin("I", optional=True) for name in ("aux_reset_in", "mb_debug_sys_rst", "dcm_locked")}
    pins |= {name: Pin("O", "rst_n") for name in ("peripheral_aresetn", "interconnect_aresetn")}
    pins |= {name: Pin("O", "rst") for name in ("peripheral_reset", "bus_struct_reset", "mb_reset")}
    return View(pins, {})


def smartconnect(p):
    interfaces = {f"S{n:02}_AXI": Interface("axi", "slave", "aclk") for n in range(int(p["NUM_SI"]))}
    interfaces |= {f"M{n:02}_AXI": Interface("axi", "master", "aclk") for n in range(int(p["NUM_MI"]))}
    pins = {"aclk": Pin("I", "clk"), "aresetn": Pin("I", "rst_n")}
    pins |= {f"aclk{n}": Pin("I", "clk") for n in range(1, int(p["NUM_CLKS"]))}
    return View(pins, interfaces, through=True)


WIDTHS = ("32", "64", "128", "256", "512", "1024")
BURSTS = ("2", "4", "8", "16", "32", "64", "128", "256")
DMA_PARAMETERS = {
    "c_include_sg": ("1", SWITCH),
    "c_sg_include_stscntrl_strm": ("1", SWITCH),
    "c_sg_length_width": ("14", whole(8, 26)),
    "c_addr_width": ("32", whole(32, 64)),
    "c_include_mm2s": ("1", SWITCH),
    "c_include_mm2s_dre": ("0", SWITCH),
    "c_m_axi_mm2s_data_width": ("32", WIDTHS),
    "c_m_axis_mm2s_tdata_width": ("32", ("8", "16", *WIDTHS)),
    "c_mm2s_burst_size": ("16", BURSTS),
    "c_include_s2mm": ("1", SWITCH),
    "c_include_s2mm_dre": ("0", SWITCH),
    "c_m_axi_s2mm_data_width": ("32", WIDTHS),
    "c_s_axis_s2mm_tdata_width": ("32", ("8", "16", *WIDTHS)),
    "c_s2mm_burst_size": ("16", BURSTS),
}


def dma(p):
    pins = {"s_axi_lite_aclk": Pin("I", "clk"), "axi_resetn": Pin("I", "rst_n")}
    interfaces = {"S_AXI_LITE": Interface("axi", "slave", "s_axi_lite_aclk")}
    spaces, bits = {}, int(p["c_addr_width"])

    def master(channel, clock):
        pins.setdefault(clock, Pin("I", "clk"))
        interfaces[f"M_AXI_{channel}"] = Interface("axi", "master", clock)
        spaces[f"Data_{channel}"] = ({f"M_AXI_{channel}": [(0, 1 << bits)]}, bits)

    for channel, stream, mode in (("MM2S", "M_AXIS_MM2S", "master"), ("S2MM", "S_AXIS_S2MM", "slave")):
        low = channel.lower()
        if p[f"c_include_{low}"] == "1":
            width = int(p[f"c_{stream.lower()}_tdata_width"])
            if width > int(p[f"c_m_axi_{low}_data_width"]):
                raise VivadoError(f"axi_dma: {channel}'s stream is wider than its memory side")
            master(channel, f"m_axi_{low}_aclk")
            interfaces[stream] = Interface(
                "axis", mode, f"m_axi_{low}_aclk", {"bytes": width // 8, "user": 0, "keep": 1, "last": 1},
                needs=("last",) if mode == "slave" else (),
            )  # fmt: skip
            pins[f"{low}_introut"] = Pin("O", "irq")
            pins[f"{low}_prmry_reset_out_n"] = Pin("O", "rst_n")
    if p["c_include_sg"] == "1":
        master("SG", "m_axi_sg_aclk")
    return View(pins, interfaces, spaces, [Segment("S_AXI_LITE", "S_AXI_LITE/Reg", 0x1_0000)])


SUBSET_PARAMETERS = {
    f"{side}_{name}": (default, allowed)
    for side in "SM"
    for name, default, allowed in (
        ("TDATA_NUM_BYTES", "1", whole(0, 512)), ("TUSER_WIDTH", "0", whole(0, 4096)), ("HAS_TREADY", "1", SWITCH),
        ("HAS_TKEEP", "0", SWITCH), ("HAS_TLAST", "0", SWITCH), ("HAS_TSTRB", "0", SWITCH),
    )
} | {f"{name}_REMAP": ("", None) for name in ("TDATA", "TUSER", "TKEEP", "TLAST")}  # fmt: skip


def subset_converter(p):
    for name, source, width in (
        ("TDATA", 8 * int(p["S_TDATA_NUM_BYTES"]), 8 * int(p["M_TDATA_NUM_BYTES"])),
        ("TKEEP", int(p["S_TDATA_NUM_BYTES"]), int(p["M_TDATA_NUM_BYTES"])),
    ):
        remap = p[f"{name}_REMAP"]
        if (remap and remap != f"{name.lower()}[{width - 1}:0]") or (remap and width > source):
            raise VivadoError(f"axis_subset_converter: {name}_REMAP {remap!r} does not give {width} of {source} bits")
    sides = {}
    for side, mode in (("S", "slave"), ("M", "master")):
        shape = {"bytes": int(p[f"{side}_TDATA_NUM_BYTES"]), "user": int(p[f"{side}_TUSER_WIDTH"]),
                 "keep": int(p[f"{side}_HAS_TKEEP"]), "last": int(p[f"{side}_HAS_TLAST"])}  # fmt: skip
        sides[f"{side}_AXIS"] = Interface("axis", mode, "aclk", shape)
    return View({"aclk": Pin("I", "clk"), "aresetn": Pin("I", "rst_n")}, sides)


def bit_slice(p):
    width, high, low = int(p["DIN_WIDTH"]), int(p["DIN_FROM"]), int(p["DIN_TO"])
    if not width > high >= low:
        raise VivadoError(f"slice: bits {high}:{low} are not within {width}")
    return View({"Din": Pin("I", width=width), "Dout": Pin("O", width=high - low + 1)}, {})


SLICE_PARAMETERS = {"DIN_WIDTH": ("32", whole(2, 4096)), "DIN_FROM": ("0", whole(0, 4095)),
                    "DIN_TO": ("0", whole(0, 4095))}  # fmt: skip


def standard_catalog(inline_slice=False):
    """The IPs of a Vivado, by VLNV; ``inline_slice`` as in 2025.x, where xlslice is gone."""
    listed = [
        IP("xilinx.com:ip:zynq_ultra_ps_e:3.4", PS_PARAMETERS, processing_system),
        IP("xilinx.com:ip:zynq_ultra_ps_e:3.5", PS_PARAMETERS, processing_system),
        IP("xilinx.com:ip:proc_sys_reset:5.0", {}, reset),
        IP("xilinx.com:ip:smartconnect:1.0",
           {"NUM_SI": ("1", whole(1, 16)), "NUM_MI": ("1", whole(1, 16)), "NUM_CLKS": ("1", whole(1, 8))},
           smartconnect),
        IP("xilinx.com:ip:axi_dma:7.1", DMA_PARAMETERS, dma),
        IP("xilinx.com:ip:axis_subset_converter:1.1", SUBSET_PARAMETERS, subset_converter),
        IP("xilinx.com:inline_hdl:ilslice:1.0" if inline_slice else "xilinx.com:ip:xlslice:1.0", SLICE_PARAMETERS,
           bit_slice),
    ]  # fmt: skip
    listed[-1].type = "inline_hdl" if inline_slice else "ip"
    return {ip.vlnv: ip for ip in listed}


def packaged_ip(component):
    """The IP of a ``component.xml`` that the model's packager wrote."""
    root = ElementTree.parse(component).getroot()
    clock = root.find("interface[@kind='clock']").get("name")
    pins, interfaces, segments = {}, {}, []
    for node in root.findall("interface"):
        name, kind = node.get("name"), node.get("kind")
        signals = {port.get("signal"): int(port.get("width")) for port in node.findall("port")}
        if kind in ("aximm", "axis"):
            shape = {} if kind == "aximm" else {
                "bytes": signals["TDATA"] // 8, "user": signals.get("TUSER", 0),
                "keep": int("TKEEP" in signals), "last": int("TLAST" in signals),
            }  # fmt: skip
            interfaces[name] = Interface("axis" if kind == "axis" else "axi", node.get("mode"), clock, shape)
        else:
            pins[name] = Pin("O" if kind == "interrupt" else "I", {"clock": "clk", "reset": "rst_n"}.get(kind, "irq"))
    for node in root.findall("loose"):
        pins[node.get("name")] = Pin("I" if node.get("direction") == "input" else "O", width=int(node.get("width")))
    for node in root.findall("map"):
        segments.append(Segment(node.get("name"), f"{node.get('name')}/reg0", number(node.get("range"))))
    return IP(root.get("vlnv"), {}, lambda _: View(pins, interfaces, {}, segments))
