"""Ports of the AXI top, with the attributes by which Vivado recognises its interfaces.

Syntax of the attributes: AMD UG994, "General Usage of X_INTERFACE_INFO attribute". Never read by Vivado so far.
"""

from amaranth.hdl import Signal

LITE_INPUTS = {
    "awaddr": None, "awprot": 3, "awvalid": 1, "wdata": 32, "wstrb": 4, "wvalid": 1, "bready": 1,
    "araddr": None, "arprot": 3, "arvalid": 1, "rready": 1,
}  # fmt: skip
LITE_OUTPUTS = {
    "awready": 1, "wready": 1, "bresp": 2, "bvalid": 1, "arready": 1, "rdata": 32, "rresp": 2, "rvalid": 1,
}  # fmt: skip


def _port(name, width, info, parameter=None):
    attributes = {"X_INTERFACE_INFO": info}
    if parameter:
        attributes["X_INTERFACE_PARAMETER"] = parameter
    return Signal(width, name=name, attrs=attributes)


def axi_ports(*, address_bits, data_bits):
    """``(inputs, outputs)``, dictionaries of signals by name, in the order of the port list."""

    def lite(name, width):
        info = f"xilinx.com:interface:aximm:1.0 s_axi {name.upper()}"
        parameter = "XIL_INTERFACENAME s_axi, PROTOCOL AXI4LITE" if name == "awaddr" else None
        return {f"s_axi_{name}": _port(f"s_axi_{name}", width or address_bits, info, parameter)}

    def axis(interface):
        widths = {"tdata": data_bits, "tkeep": data_bits // 8, "tlast": 1, "tuser": 1, "tvalid": 1}
        return {
            f"{interface}_{name}": _port(
                f"{interface}_{name}", width, f"xilinx.com:interface:axis:1.0 {interface} {name.upper()}"
            )
            for name, width in widths.items()
        }

    def ready(interface):
        name = f"{interface}_tready"
        return {name: _port(name, 1, f"xilinx.com:interface:axis:1.0 {interface} TREADY")}

    inputs = {
        "aclk": _port(
            "aclk", 1, "xilinx.com:signal:clock:1.0 aclk CLK",
            "XIL_INTERFACENAME aclk, ASSOCIATED_BUSIF s_axi:s_axis:m_axis, ASSOCIATED_RESET aresetn",
        ),
        "aresetn": _port(
            "aresetn", 1, "xilinx.com:signal:reset:1.0 aresetn RST", "XIL_INTERFACENAME aresetn, POLARITY ACTIVE_LOW"
        ),
    }  # fmt: skip
    for name, width in LITE_INPUTS.items():
        inputs |= lite(name, width)
    inputs |= axis("s_axis") | ready("m_axis")
    outputs = {}
    for name, width in LITE_OUTPUTS.items():
        outputs |= lite(name, width)
    outputs |= ready("s_axis") | axis("m_axis")
    outputs["irq"] = _port(
        "irq", 1, "xilinx.com:signal:interrupt:1.0 irq INTERRUPT", "XIL_INTERFACENAME irq, SENSITIVITY LEVEL_HIGH"
    )
    return inputs, outputs
