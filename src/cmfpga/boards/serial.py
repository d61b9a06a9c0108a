"""Facts of the boards without a processor. Pins of the boards themselves are those of amaranth-boards."""

from .board import SerialBoard

ULX3S = SerialBoard(
    name="ulx3s",
    title="ULX3S",
    top="cmfpga_ulx3s",
    device="LFE5U-85F",
    package="CABGA381",
    speed="6",
    resources={"lut4": 83_640, "ff": 83_640, "dp16kd": 208, "mult18": 156},
    clock_hz=75_000_000,
    oscillator_hz=25_000_000,
    vco_hz=600_000_000,  # 400 to 800 MHz (Lattice FPGA-DS-02012, "sysCLOCK PLL Timing")
    baud=3_000_000,  # the most that the board's FT231X makes, and 25 cycles a bit
    sensor_clock_hz=75_000_000,
    sensor_connector=("gpio", 0),
    # All of one bank, beside each other; the clock on one of its clock inputs.
    sensor_pins={"pclk": "0+", "hsync": "1+", "vsync": "1-", "data": "2+ 2- 3+ 3- 4+ 4- 5+ 5-"},
)

#: On its dock.
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
    sensor_pins={"pclk": "P6", "hsync": "T7", "vsync": "P8", "data": "P11 R11 M15 J16 T11 T12 M14 J14"},
)
