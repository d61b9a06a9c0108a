"""Facts of the Tang Primer 20K design, on its dock. Pins of the board itself are those of amaranth-boards."""

from .board import SerialBoard

TANG_PRIMER_20K = SerialBoard(
    name="tang_primer_20k",
    title="Tang Primer 20K",
    top="cmfpga_tang_primer_20k",
    device="GW2A-18C",
    package="PG256",
    speed="8",
    resources={"lut4": 20_736, "ff": 15_552, "ram": 46, "mult18": 48},
    # Without a PLL: far below the bound of nextpnr, which has no delays of multipliers.
    clock_hz=27_000_000,
    oscillator_hz=27_000_000,
    baud=3_000_000,  # 9 cycles a bit
    sensor_clock_hz=27_000_000,
    # Headers PMOD2 (data) and PMOD3.
    sensor_pins={
        "pclk": "P6",
        "hsync": "T7",
        "vsync": "P8",
        "data": "P11 R11 M15 J16 T11 T12 M14 J14",
    },
)
