"""Facts of the ULX3S design. Pins of the board itself are those of amaranth-boards."""

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
    sensor_pins={
        "pclk": "0+",
        "hsync": "1+",
        "vsync": "1-",
        "data": "2+ 2- 3+ 3- 4+ 4- 5+ 5-",
    },
)
