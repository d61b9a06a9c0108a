"""The few designs that tests compile. Whatever else a test needs is derived from one of them by ``replace``."""

from cmfpga.config import Config, preset
from cmfpga.verilog.emit import AXI_TOP, TOP, UART_TOP

#: Sizes of the small hardware, but the sensor's, which a recording says.
_SIZES = {
    "roi_width": 8, "roi_height": 8, "buffer_events": 96, "max_batch_events": 100, "time_bits": 16, "span_bits": 10,
    "max_iterations": 15, "v_int": 3,
}  # fmt: skip
HARDWARE = {"sensor_width": 32, "sensor_height": 24, **_SIZES}

#: Both ascents in the small hardware, as options of ``cmfpga.track`` for recordings that say how large their sensor is.
PAPER = {"preset": "paper", **_SIZES, "iterations": 15, "eta": 0.1, "min_roi_events": 3}
FAST = {
    "preset": "fast", **_SIZES, "min_roi_events": 3, "max_level": 2, "cold": "2:3/2:2 1:1:1 0:3/4:3/4",
    "warm": "1:1:3/2 0:3/4:1/8",
}  # fmt: skip


def configured(options, **changes):
    """The configuration that such options give, of a sensor of 32×24 px."""
    fields = {**HARDWARE, **options, **changes}
    return preset(fields.pop("preset")).replace(**fields)


SMALL = Config(**HARDWARE, iterations=3)
#: The smallest, of which the text is looked at.
TINY = {"sensor_width": 16, "sensor_height": 12, "roi_width": 4, "roi_height": 4, "buffer_events": 8}

#: Behind AXI or a serial line.
SHELL_SIZES = {"sensor_width": 48, "sensor_height": 32, "roi_width": 16, "roi_height": 16, "buffer_events": 64}
SHELL = preset("fast").replace(**SHELL_SIZES)

#: What a test that is not long may emit and compile, each once a run: (hardware, top module).
QUICK = {
    (config.hardware_hash, top)
    for config, *tops in ((SMALL, TOP), (configured(FAST), TOP), (SHELL, AXI_TOP, UART_TOP), (Config(**TINY), TOP))
    for top in tops
}
#: Fields that make one of them, wherever they are used as options.
OPTIONS = (HARDWARE, PAPER, FAST, SHELL_SIZES, TINY)
