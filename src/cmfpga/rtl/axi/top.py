"""The AXI top: the shell behind AXI4-Lite and AXI4-Stream, as a Vivado block design expects it.

Its ports have the attributes by which Vivado recognises its interfaces. Their syntax: AMD UG994, "General Usage of
X_INTERFACE_INFO attribute". Never read by Vivado so far.
"""

from amaranth.hdl import ClockDomain, Elaboratable, Module, Signal
from amaranth.lib.wiring import connect

from ...protocol.registers.declaration import ADDRESS_BITS
from ..shell import payloads
from ..shell.shell import Shell
from .lite_slave import CHANNELS, LiteSlave

LITE_INPUTS = {
    "awaddr": ADDRESS_BITS, "awprot": 3, "awvalid": 1, "wdata": 32, "wstrb": 4, "wvalid": 1, "bready": 1,
    "araddr": ADDRESS_BITS, "arprot": 3, "arvalid": 1, "rready": 1,
}  # fmt: skip
LITE_OUTPUTS = {
    "awready": 1, "wready": 1, "bresp": 2, "bvalid": 1, "arready": 1, "rdata": 32, "rresp": 2, "rvalid": 1,
}  # fmt: skip


def _port(name, width, info, parameter=None):
    parameters = {"X_INTERFACE_PARAMETER": parameter} if parameter else {}
    return Signal(width, name=name, attrs={"X_INTERFACE_INFO": info} | parameters)


def axi_ports():
    """``(inputs, outputs)``, dictionaries of signals by name, in the order of the port list."""

    def ports(interface, kind, widths):
        kind = f"xilinx.com:interface:{kind}:1.0 {interface}"
        parameters = {"awaddr": "XIL_INTERFACENAME s_axi, PROTOCOL AXI4LITE"}
        return {
            (port := f"{interface}_{name}"): _port(port, width, f"{kind} {name.upper()}", parameters.get(name))
            for name, width in widths.items()
        }

    ready = {"tready": 1}
    words = {"tdata": payloads.DATA_BITS, "tkeep": payloads.KEEP_BITS, "tlast": 1, "tuser": 1, "tvalid": 1}
    inputs = {
        "aclk": _port(
            "aclk", 1, "xilinx.com:signal:clock:1.0 aclk CLK",
            "XIL_INTERFACENAME aclk, ASSOCIATED_BUSIF s_axi:s_axis:m_axis, ASSOCIATED_RESET aresetn",
        ),
        "aresetn": _port(
            "aresetn", 1, "xilinx.com:signal:reset:1.0 aresetn RST", "XIL_INTERFACENAME aresetn, POLARITY ACTIVE_LOW"
        ),
    }  # fmt: skip
    inputs |= ports("s_axi", "aximm", LITE_INPUTS)
    inputs |= ports("s_axis", "axis", words) | ports("m_axis", "axis", ready)
    outputs = ports("s_axi", "aximm", LITE_OUTPUTS)
    outputs |= ports("s_axis", "axis", ready) | ports("m_axis", "axis", words)
    outputs["irq"] = _port(
        "irq", 1, "xilinx.com:signal:interrupt:1.0 irq INTERRUPT", "XIL_INTERFACENAME irq, SENSITIVITY LEVEL_HIGH"
    )
    return inputs, outputs


class AxiTop(Elaboratable):
    """The shell with AXI ports, one clock for all, and a reset that is active low::

        s_axi ─► lite slave ─► shell ─► irq
        s_axis ─────────────►       ─► m_axis

    Parameters
    ----------
    config : Config
        Raises :exc:`ConfigError` where :class:`Shell` does.

    Attributes
    ----------
    shell : Shell
    inputs, outputs : dict of str to Signal
        The ports, in order, with ``aclk`` and ``aresetn``.
    """

    def __init__(self, config):
        self.config = config
        self.inputs, self.outputs = axi_ports()
        self.shell = Shell(config, clock=self.inputs["aclk"])
        self.lite_slave = LiteSlave(self.shell.registers.size, self.shell.registers.nowhere)

    @property
    def port_order(self):
        """Names of all ports, interface by interface."""
        names = [*self.inputs, *self.outputs]
        groups = ("aclk", "aresetn", "s_axi_", "s_axis_", "m_axis_", "irq")
        return [name for group in groups for name in names if name.startswith(group)]

    def elaborate(self, platform):
        m = Module()
        # Not the implicit domain, so that the clock's port is the clock.
        sync = ClockDomain("sync", local=True)
        sync.clk = self.inputs["aclk"]
        m.domains += sync
        m.d.comb += sync.rst.eq(~self.inputs["aresetn"])
        m.submodules.shell = self.shell
        m.submodules.lite_slave = self.lite_slave
        connect(m, self.lite_slave.bus, self.shell.bus)
        channels = {f"s_axi_{name}": getattr(self.lite_slave, name) for name in CHANNELS}
        for prefix, channel in (channels | {"s_axis_t": self.shell.i, "m_axis_t": self.shell.o}).items():
            self._join(m, prefix, channel)
        m.d.comb += self.outputs["irq"].eq(self.shell.irq)
        return m

    def _join(self, m, prefix, channel):
        """The ports whose names begin with ``prefix`` are a stream and the members of its payload."""
        members = channel.payload.shape().members
        inside = {"valid": channel.valid, "ready": channel.ready} | {name: channel.payload[name] for name in members}
        for name, signal in inside.items():
            port = f"{prefix}{name}"
            m.d.comb += signal.eq(self.inputs[port]) if port in self.inputs else self.outputs[port].eq(signal)
