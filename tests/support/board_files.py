"""The board's folder as modules, and a stand-in for the emitted top with its ports and nothing behind them."""

import importlib.util
import struct
import sys
from pathlib import Path

from cmfpga.boards import BOARDS

ROOT = Path(__file__).parents[2]
KV260 = BOARDS["kv260"]
BOARD = ROOT / "boards" / KV260.name


def load(name, folder=BOARD):
    """A Python file of ``boards/kv260``, or of another folder, as a module."""
    spec = importlib.util.spec_from_file_location(f"{folder.name}_{name}", folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def stand_in(bytes_=8, user=1, address=16):
    """Verilog of a module with the ports of ``cmfpga_kv260``, laid out as Amaranth's Yosys does."""
    busif = "ASSOCIATED_BUSIF s_axi:s_axis:m_axis, ASSOCIATED_RESET aresetn"
    lines = [
        ("aclk", "input", 1, "xilinx.com:signal:clock:1.0 aclk CLK", f"XIL_INTERFACENAME aclk, {busif}"),
        ("aresetn", "input", 1, "xilinx.com:signal:reset:1.0 aresetn RST",
         "XIL_INTERFACENAME aresetn, POLARITY ACTIVE_LOW"),
        ("irq", "output", 1, "xilinx.com:signal:interrupt:1.0 irq INTERRUPT",
         "XIL_INTERFACENAME irq, SENSITIVITY LEVEL_HIGH"),
    ]  # fmt: skip
    for channel, master in (("AW", True), ("W", True), ("B", False), ("AR", True), ("R", False)):
        signals = {"AW": {"ADDR": address, "PROT": 3}, "W": {"DATA": 32, "STRB": 4}, "B": {"RESP": 2},
                   "AR": {"ADDR": address, "PROT": 3}, "R": {"DATA": 32, "RESP": 2}}[channel]  # fmt: skip
        for signal, width, forward in (
            *((name, bits, True) for name, bits in signals.items()), ("VALID", 1, True), ("READY", 1, False),
        ):  # fmt: skip
            direction = "input" if forward == master else "output"
            info = f"xilinx.com:interface:aximm:1.0 s_axi {channel}{signal}"
            parameter = "XIL_INTERFACENAME s_axi, PROTOCOL AXI4LITE" if channel + signal == "AWADDR" else None
            lines.append((f"s_axi_{channel}{signal}".lower(), direction, width, info, parameter))
    for name, master in (("s_axis", False), ("m_axis", True)):
        for signal, width in (("TDATA", 8 * bytes_), ("TKEEP", bytes_), ("TUSER", user), ("TLAST", 1), ("TVALID", 1),
                              ("TREADY", 1)):  # fmt: skip
            direction = "output" if (signal != "TREADY") == master else "input"
            info = f"xilinx.com:interface:axis:1.0 {name} {signal}"
            lines.append((f"{name}_{signal.lower()}", direction, width, info, None))
    text = f"module {KV260.top}({', '.join(line[0] for line in lines)});\n"
    for name, direction, width, info, parameter in lines:
        text += f'  (* X_INTERFACE_INFO = "{info}" *)\n'
        text += f'  (* X_INTERFACE_PARAMETER = "{parameter}" *)\n' if parameter else ""
        size = f"[{width - 1}:0] " if width > 1 else ""
        text += f"  {direction} {size}{name};\n  wire {size}{name};\n"
    return text + "endmodule\n"


def bitstream(part, words=64, seed=1):
    """A .bit with a header like Vivado's, and data that are no configuration of anything."""
    data = b"\xff" * 64 + bytes.fromhex("aa995566") + b"".join(
        struct.pack(">I", (seed * 2654435761 + 40503 * n) & 0xFFFFFFFF) for n in range(words)
    )  # fmt: skip
    bit = bytes.fromhex("0009 0ff00ff00ff00ff000 0001")
    texts = (("a", "cmfpga_bd_wrapper;UserID=0XFFFFFFFF;Version=2022.2"), ("b", part), ("c", "2024/01/02"),
             ("d", "03:04:05"))  # fmt: skip
    for key, text in texts:
        bit += key.encode() + struct.pack(">H", len(text) + 1) + text.encode() + b"\0"
    return bit + b"e" + struct.pack(">I", len(data)) + data


#: What the register map's generator writes, in little.
REGISTERS = """\
proc cmfpga_registers {address_block} {
    set register [ipx::add_register CTRL $address_block]
    set_property address_offset 0x0 $register
    set_property size 32 $register
    set_property access read-write $register
    set field [ipx::add_field start $register]
    set_property bit_offset 0 $field
    set_property bit_width 1 $field
}
"""


def check_ports(interfaces, tcl):
    listed = tcl["ip_interfaces"].split()
    assert {name: (i["bus"], i["mode"]) for name, i in interfaces.items()} == {
        name: (bus, mode) for name, bus, mode in zip(listed[::3], listed[1::3], listed[2::3], strict=True)
    }
    width = {(name, signal): bits for name, i in interfaces.items() for signal, (_, _, bits) in i["ports"].items()}
    for stream in ("s_axis", "m_axis"):
        assert (
            width[stream, "TDATA"] == 8 * width[stream, "TKEEP"] == KV260.stream_width == 8 * int(tcl["stream_bytes"])
        )
        assert width[stream, "TUSER"] == int(tcl["stream_user_width"])
        assert (stream, "TLAST") in width
    assert width["s_axi", "WDATA"] == width["s_axi", "RDATA"] == KV260.registers_width
    assert 1 << width["s_axi", "AWADDR"] == 1 << width["s_axi", "ARADDR"] == KV260.registers_size
    assert int(tcl["dma_data_width"]) == KV260.stream_width
    assert int(tcl["dma_length_width"]) == KV260.dma_length_bits
    assert int(tcl["dma_address_width"]) == KV260.dma_address_bits
