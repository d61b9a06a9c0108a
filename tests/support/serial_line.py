"""The serial top's emitted Verilog in Verilator, as the serial line of :class:`cmfpga.driver.uart.UartBackend`."""

import ctypes
import functools
import math
from pathlib import Path

import numpy as np

from cmfpga.rtl.uart.top import UartTop
from cmfpga.verilog import compile
from cmfpga.verilog.emit import UART_TOP

HARNESS = Path(__file__).with_name("uart_harness.cpp")

#: Clock cycles that one call runs for, and bytes that it takes.
SLICE_CYCLES = 20_000
ROOM = 4096
#: Of the time that the line shows, not of the board's design.
CLOCK_HZ = 1_000_000


@functools.cache
def _library(config, divisor):
    top, harness = UartTop(config, clock_hz=divisor, baud=1), HARNESS.read_text(encoding="utf-8")
    library = compile.load(compile._library(top, top=UART_TOP, harness=harness))
    library.uart_new.restype = ctypes.c_void_p
    for name in ("uart_run", "uart_sensor_left", "uart_cycles"):
        getattr(library, name).restype = ctypes.c_int64
    return library


class SimulatedLine:
    """Bytes to and from one simulated board, whose clock only runs in :meth:`read` and :meth:`play`.

    Its times are the board's, in seconds of a clock of 1 MHz, which is about what a computer simulates. ``divisor``:
    clock cycles per bit; ``sensor_clock``: of the sensor's port, in parts of the board's clock, at most 5; ``seed``: of
    the memories' contents at the begin.
    """

    def __init__(self, config, *, divisor=5, sensor_clock=0.83, seed=1):
        self.name = "simulated board"
        self.baud = CLOCK_HZ / divisor
        self.reply_seconds = 0.02
        self._library = _library(config, divisor)
        step = ctypes.c_int64(round(500 / sensor_clock))
        self._handle = ctypes.c_void_p(self._library.uart_new(seed, ctypes.c_int64(divisor), step))

    def write(self, content):
        self._library.uart_send(self._handle, bytes(content), ctypes.c_int64(len(content)))

    def read(self, timeout):
        """Bytes that came, at least one unless the time is over."""
        room, cycles = np.zeros(ROOM, np.uint8), ctypes.c_int64(math.ceil(timeout * CLOCK_HZ))
        count = self._library.uart_run(self._handle, cycles, ctypes.c_void_p(room.ctypes.data), ctypes.c_int64(ROOM))
        return room[:count].tobytes()

    def play(self, levels):
        """Put levels on the sensor's pins, and wait until they were there: data, HSYNC, VSYNC, uint8 [cycles, 3]."""
        levels = np.ascontiguousarray(levels, np.uint8)
        self._library.uart_sensor(self._handle, ctypes.c_void_p(levels.ctypes.data), ctypes.c_int64(len(levels)))
        while self._library.uart_sensor_left(self._handle):
            self._library.uart_run(self._handle, ctypes.c_int64(SLICE_CYCLES), None, ctypes.c_int64(0))

    def time(self):
        return self._library.uart_cycles(self._handle) / CLOCK_HZ

    def close(self):
        if self._handle:
            self._library.uart_free(self._handle)
            self._handle = None

    def __del__(self):
        if getattr(self, "_handle", None):
            self.close()
