"""Facts of the KV260 design that software needs.

Generated from boards/kv260/board.toml by boards/kv260/facts.py; do not edit.
"""

APPLICATION = "cmfpga"  # name for ``xmutil loadapp``
BOARD = "KV260"
PART = "xck26-sfvc784-2LV-c"
VLNV = "cmfpga.org:ip:cmfpga:1.0"  # of the packaged IP; PYNQ binds by it
MODULE_VLNV = "xilinx.com:module_ref:cmfpga_kv260:1.0"  # if added as a module reference
CLOCK_HZ = 199_998_000  # of ``pl_clk0``
LINUX_CLOCK = "pl0_ref"  # below /sys/kernel/debug/clk
REGISTERS_ADDRESS = 0xA0000000
REGISTERS_SIZE = 0x10000  # bytes
REGISTERS_WIDTH = 32  # bits
DMA_ADDRESS = 0xA0010000
DMA_SIZE = 0x10000  # bytes
DMA_LENGTH_BITS = 26  # a transfer has less than 2**26 bytes
DMA_ADDRESS_BITS = 40
STREAM_WIDTH = 64  # bits; buffers are aligned to it
INTERRUPT_SPI = 89  # number at the GIC
UIO_REGISTERS = "cmfpga"  # in /sys/class/uio/uio*/name
UIO_DMA = "cmfpga-dma"  # the same
BUFFER_EVENTS = "cmfpga-events"  # /dev/… and /sys/class/u-dma-buf/…
BUFFER_EVENTS_SIZE = 0x1000000  # bytes
BUFFER_RESULTS = "cmfpga-results"  # the same
BUFFER_RESULTS_SIZE = 0x100000  # bytes
