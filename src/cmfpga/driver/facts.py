"""Facts of the KV260 design that the back ends need; those of ``boards/kv260/board.toml``."""

VLNV = "cmfpga.org:ip:cmfpga:1.0"  # of the packaged IP; PYNQ binds by it
MODULE_VLNV = "xilinx.com:module_ref:cmfpga_kv260:1.0"  # if added as a module reference
LINUX_CLOCK = "pl0_ref"  # below /sys/kernel/debug/clk
DMA_LENGTH_BITS = 26  # a transfer has less than 2**26 bytes
UIO_REGISTERS = "cmfpga"  # in /sys/class/uio/uio*/name
UIO_DMA = "cmfpga-dma"  # the same
BUFFER_EVENTS = "cmfpga-events"  # /dev/… and /sys/class/u-dma-buf/…
BUFFER_RESULTS = "cmfpga-results"  # the same
BUFFER_EVENTS_SIZE = 0x1000000  # bytes
BUFFER_RESULTS_SIZE = 0x100000  # bytes
