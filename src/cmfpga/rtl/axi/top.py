"""The AXI top: the shell behind AXI4-Lite and AXI4-Stream, as a Vivado block design expects it."""

from amaranth.hdl import ClockDomain, Elaboratable, Module
from amaranth.lib.wiring import connect

from ...protocol.registers.declaration import ADDRESS_BITS
from ..shell import payloads
from ..shell.shell import Shell
from .lite_slave import CHANNELS, LiteSlave
from .ports import axi_ports


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
        self.inputs, self.outputs = axi_ports(address_bits=ADDRESS_BITS, data_bits=payloads.DATA_BITS)
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
