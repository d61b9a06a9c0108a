"""What the package knows of a board."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Board:
    """A board, and the design for it."""

    #: What ``build --top`` takes; the board's files are in ``boards/<name>``.
    name: str
    #: As people write it.
    title: str
    #: Name of the top module that is emitted for it.
    top: str
    device: str
    package: str
    speed: str
    #: What the device has, by the names of :data:`cmfpga.fpga.resources.KINDS`, or of a family in ``fpga.families``.
    resources: dict[str, int]
    #: Of the design, in Hz: what the board makes of the frequency that is asked.
    clock_hz: int


@dataclass(frozen=True, kw_only=True)
class SerialBoard(Board):
    """A board without a processor: the serial top, and open tools for its FPGA."""

    #: Of its oscillator, in Hz, of which a PLL makes :attr:`Board.clock_hz` where they differ; and what that runs at
    #: inside.
    oscillator_hz: int
    vco_hz: int = 0
    #: Of the serial line, unless another is asked for.
    baud: int
    #: The fastest clock of a sensor that the design is made for, in Hz.
    sensor_clock_hz: int
    #: ``{signal: pins}`` of the sensor's port; of amaranth-boards' connector where one is named, else of the device.
    sensor_pins: dict[str, str]
    sensor_connector: tuple[str, int] | None = None


@dataclass(frozen=True, kw_only=True)
class AxiBoard(Board):
    """A board with a processor beside the logic: the AXI top, and the names and sizes that its software finds.

    Sizes are in bytes, addresses those of the processor.
    """

    #: The clock's name below ``/sys/kernel/debug/clk``.
    linux_clock: str
    #: Name for ``xmutil loadapp``.
    application: str
    #: Vendor, library, name and version of the packaged IP; PYNQ binds by it.
    vlnv: str
    registers_address: int
    registers_size: int
    registers_width: int
    dma_address: int
    dma_size: int
    #: A transfer has less than 2 to the power of this many bytes.
    dma_length_bits: int
    dma_address_bits: int
    #: Bits of a word of the streams; buffers are aligned to it.
    stream_width: int
    #: Number at the GIC.
    interrupt_spi: int
    #: In ``/sys/class/uio/uio*/name``.
    uio_registers: str
    uio_dma: str
    #: In ``/dev`` and ``/sys/class/u-dma-buf``.
    buffer_events: str
    buffer_events_size: int
    buffer_results: str
    buffer_results_size: int

    @property
    def part(self):
        """What Vivado calls the device."""
        return f"{self.device}-{self.package}-{self.speed}"

    @property
    def module_vlnv(self):
        """:attr:`vlnv` of the top where it was added to a block design as a module."""
        return f"xilinx.com:module_ref:{self.top}:1.0"
