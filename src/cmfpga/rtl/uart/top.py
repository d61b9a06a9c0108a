"""The serial top: the shell behind a serial line, and a sensor's port beside it, for a board without a processor."""

from amaranth.hdl import ClockDomain, Elaboratable, Module, Mux, Signal
from amaranth.lib.cdc import ResetSynchronizer
from amaranth.lib.wiring import connect

from ...errors import ConfigError
from ..shell.cpi import CpiPort
from ..shell.shell import Shell
from .bridge import Bridge
from .line import Receiver, Transmitter

#: Smallest number of clock cycles per bit, in which a bit's middle is a middle.
LEAST_DIVISOR = 4
#: How far the line's bits may be from those that were asked for: a byte's last bit is a tenth as exact.
TOLERANCE = 0.02


def divisor(clock_hz, baud):
    """Clock cycles per bit. Raises :exc:`ConfigError` where no whole number is near enough."""
    cycles = round(clock_hz / baud)
    if cycles < LEAST_DIVISOR or abs(cycles * baud / clock_hz - 1) > TOLERANCE:
        raise ConfigError(
            f"{baud} baud: a bit is {clock_hz / baud:.2f} cycles of {clock_hz / 1e6:g} MHz; {LEAST_DIVISOR} or more, "
            f"and a whole number within {TOLERANCE:.0%}, are needed"
        )
    return cycles


class UartTop(Elaboratable):
    """One clock for all but the sensor's port, which brings its own::

        uart_rx ─► receiver ─► bridge ─┬─► shell ─► irq
        cpi_… ─► CPI port ─────────────┘     │
        uart_tx ◄─ transmitter ◄─ bridge ◄───┘

    Parameters
    ----------
    config : Config
        Raises :exc:`ConfigError` where :class:`Shell` does.
    clock_hz, baud : int
        Of the clock; of the line: see :func:`divisor`.

    Attributes
    ----------
    shell : Shell
    inputs, outputs : dict of str to Signal
        The ports, in order, with ``clk`` and ``rst``.
    """

    def __init__(self, config, *, clock_hz, baud):
        self.config = config
        self.divisor = divisor(clock_hz, baud)
        widths = {"clk": 1, "rst": 1, "uart_rx": 1, "cpi_pclk": 1, "cpi_hsync": 1, "cpi_vsync": 1, "cpi_data": 8}
        self.inputs = {name: Signal(width, name=name) for name, width in widths.items()}
        self.outputs = {name: Signal(name=name) for name in ("uart_tx", "irq")}
        self.shell = Shell(config, clock=self.inputs["clk"])
        self.bridge = Bridge()
        self.cpi = CpiPort()

    @property
    def port_order(self):
        """Names of all ports."""
        return [*self.inputs, *self.outputs]

    def elaborate(self, platform):
        m = Module()
        ports = self.inputs | self.outputs
        # Without PCLK too, and so that the FIFO between the clocks has one kind of reset.
        sync, cpi = ClockDomain("sync", local=True), ClockDomain("cpi", local=True, async_reset=True)
        sync.clk, sync.rst, cpi.clk = ports["clk"], ports["rst"], ports["cpi_pclk"]
        m.domains += [sync, cpi]
        held = Signal(init=1, reset_less=True)  # a register, because it resets without a clock there
        m.d.sync += held.eq(sync.rst)
        m.submodules.cpi_reset = ResetSynchronizer(held, domain="cpi")
        m.submodules.receiver = receiver = Receiver(self.divisor)
        m.submodules.transmitter = transmitter = Transmitter(self.divisor)
        m.submodules.bridge = bridge = self.bridge
        m.submodules.shell = shell = self.shell
        m.submodules.cpi = port = self.cpi
        connect(m, receiver.o, bridge.received)
        connect(m, bridge.sent, transmitter.i)
        connect(m, bridge.bus, shell.bus)
        connect(m, shell.o, bridge.packets)
        m.d.comb += [
            receiver.wire.eq(ports["uart_rx"]),
            bridge.error.eq(receiver.error),
            ports["uart_tx"].eq(transmitter.wire),
            ports["irq"].eq(shell.irq),
            *(getattr(port, name).eq(ports[f"cpi_{name}"]) for name in ("hsync", "vsync", "data")),
            port.enable.eq(bridge.source.cpi),
            *(getattr(port, name).eq(bridge.source[name]) for name in ("big_endian", "hsync_low", "vsync_low")),
            bridge.counted.eq(port.counted),
            bridge.beat.eq(shell.i.valid),
        ]
        taken = bridge.source.cpi
        m.d.comb += [
            shell.i.valid.eq(Mux(taken, port.o.valid, bridge.words.valid)),
            shell.i.payload.eq(Mux(taken, port.o.payload, bridge.words.payload)),
            port.o.ready.eq(shell.i.ready & taken),
            bridge.words.ready.eq(shell.i.ready & ~taken),
        ]
        return m
