"""Facts of the KV260 design that software needs.

Generated from boards/kv260/board.toml by boards/kv260/facts.py; do not edit.
"""

from .board import AxiBoard

KV260 = AxiBoard(
    name="kv260",
    title="KV260",
    top="cmfpga_kv260",
    device="xck26",
    package="sfvc784",
    speed="2LV-c",
    resources={"lut": 117_120, "ff": 234_240, "carry8": 14_640, "bram36": 144, "uram": 64, "dsp": 1_248},
    clock_hz=199_998_000,
    linux_clock="pl0_ref",
    application="cmfpga",
    vlnv="cmfpga.org:ip:cmfpga:1.0",
    registers_address=0xA0000000,
    registers_size=0x10000,
    registers_width=32,
    dma_address=0xA0010000,
    dma_size=0x10000,
    dma_length_bits=26,
    dma_address_bits=40,
    stream_width=64,
    interrupt_spi=89,
    uio_registers="cmfpga",
    uio_dma="cmfpga-dma",
    buffer_events="cmfpga-events",
    buffer_events_size=0x1000000,
    buffer_results="cmfpga-results",
    buffer_results_size=0x100000,
)
