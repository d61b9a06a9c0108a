"""The emitted Verilog of a top in Verilator, driven from here: the AXI top, and the serial top with its line."""

import ctypes
import functools
import math
import threading

import numpy as np

from ...errors import DeviceError, DeviceTimeout
from ...rtl.axi.top import AxiTop
from ...rtl.uart.top import UartTop
from ..compile import compile_axi_library, compile_uart_library, load

#: Clock cycles after which a register access is given up.
ACCESS_CYCLES = 1000

#: What :meth:`SimulatedTop.run` may wait for: only its cycles, the interrupt, a packet, or all words' being taken.
CYCLES, INTERRUPT, PACKET, SENT = range(4)


@functools.cache  # it takes seconds to find out that nothing is to be compiled
def _axi_library(config):
    library = load(compile_axi_library(AxiTop(config)))
    library.axi_new.restype = ctypes.c_void_p
    for name in ("axi_unsent", "axi_take", "axi_cycles"):
        getattr(library, name).restype = ctypes.c_int64
    return library


class SimulatedTop:
    """One simulated AXI top; may be used by several threads.

    Parameters
    ----------
    config : Config
        Hardware fields choose the library; it is compiled on first use and kept in the user's cache.
    seed : int
        Of the random contents that memories and reset-less registers start with.
    """

    def __init__(self, config, *, seed=1):
        self._library = _axi_library(config)
        self._lock = threading.RLock()
        self._handle = ctypes.c_void_p(self._library.axi_new(seed))
        self.reset()

    def _call(self, name, *arguments):
        with self._lock:
            if not self._handle:
                raise ValueError("the simulated hardware is closed")
            return getattr(self._library, name)(self._handle, *arguments)

    def reset(self, cycles=4):
        """Hold ``aresetn`` low for some clock cycles."""
        self._call("axi_reset", ctypes.c_int64(cycles))

    def read32(self, offset):
        """A register, by AXI4-Lite."""
        value = ctypes.c_uint32()
        _check(self._call("axi_read", ctypes.c_uint32(offset), ctypes.byref(value), ctypes.c_int64(ACCESS_CYCLES)))
        return value.value

    def write32(self, offset, value):
        """Write a register, by AXI4-Lite."""
        arguments = (ctypes.c_uint32(offset), ctypes.c_uint32(value), ctypes.c_int64(ACCESS_CYCLES))
        _check(self._call("axi_write", *arguments))

    def send(self, words, *, last=True):
        """Put 64-bit words into the queue for ``s_axis``."""
        words = np.ascontiguousarray(words, np.uint64)
        self._call("axi_send", ctypes.c_void_p(words.ctypes.data), ctypes.c_int64(len(words)), int(last))

    @property
    def unsent(self):
        """Words in that queue."""
        return self._call("axi_unsent")

    def limit(self, *, send=-1, accept=-1, words=-1):
        """What a stuck DMA does: words that may still be offered, packets taken, words of them. Below 0: no limit."""
        self._call("axi_limit", *map(ctypes.c_int64, (send, accept, words)))

    def forget(self):
        """Forget the words that were not sent, and those that were received."""
        self._call("axi_forget")

    def run(self, cycles, until=CYCLES):
        """Run for at most so many cycles, until something is the case; returns whether it is."""
        return bool(self._call("axi_run", ctypes.c_int64(cycles), until))

    def take(self):
        """The next complete packet, uint64 array; None if there is none."""
        with self._lock:
            room = self._call("axi_take", None, ctypes.c_int64(0))
            if not room:
                return None
            words = np.zeros(room, np.uint64)
            self._call("axi_take", ctypes.c_void_p(words.ctypes.data), ctypes.c_int64(room))
        return words

    @property
    def cycles(self):
        """Clock cycles since the begin, resets included."""
        return self._call("axi_cycles")

    def close(self):
        """Free the simulation. Safe to call twice."""
        with self._lock:
            if self._handle:
                self._library.axi_free(self._handle)
                self._handle = None

    def __del__(self):
        if getattr(self, "_handle", None):
            self.close()


def _check(status):
    if status == 1:
        raise DeviceTimeout(f"no answer to a register access within {ACCESS_CYCLES} clock cycles")
    if status:
        raise DeviceError(f"a register access was answered with the error {status - 256}")


#: Clock cycles that one call runs for, and bytes that it takes.
SLICE_CYCLES = 20_000
ROOM = 4096
#: Of the time that the line shows, not of the board's design.
CLOCK_HZ = 1_000_000


@functools.cache
def _uart_library(config, divisor):
    library = load(compile_uart_library(UartTop(config, clock_hz=divisor, baud=1)))
    library.uart_new.restype = ctypes.c_void_p
    for name in ("uart_run", "uart_sensor_left", "uart_cycles"):
        getattr(library, name).restype = ctypes.c_int64
    return library


class SimulatedLine:
    """Bytes to and from one simulated board, whose clock only runs in :meth:`read` and :meth:`play`.

    Its times are the board's, in seconds of a clock of 1 MHz, which is about what a computer simulates.

    Parameters
    ----------
    config : Config
    divisor : int
        Clock cycles per bit.
    sensor_clock : float
        Of the sensor's port, in parts of the board's clock; at most 5.
    seed : int
        Of the memories' contents at the begin.
    """

    def __init__(self, config, *, divisor=5, sensor_clock=0.83, seed=1):
        self.name = "simulated board"
        self.baud = CLOCK_HZ / divisor
        self.reply_seconds = 0.02
        self._library = _uart_library(config, divisor)
        step = ctypes.c_int64(round(500 / sensor_clock))
        self._handle = ctypes.c_void_p(self._library.uart_new(seed, ctypes.c_int64(divisor), step))

    def write(self, content):
        """Put bytes on the way to the board."""
        self._library.uart_send(self._handle, bytes(content), ctypes.c_int64(len(content)))

    def read(self, timeout):
        """Bytes that came, at least one unless the time is over."""
        room, cycles = np.zeros(ROOM, np.uint8), ctypes.c_int64(math.ceil(timeout * CLOCK_HZ))
        count = self._library.uart_run(self._handle, cycles, ctypes.c_void_p(room.ctypes.data), ctypes.c_int64(ROOM))
        return room[:count].tobytes()

    def play(self, levels):
        """Put levels on the sensor's pins, and wait until they were there.

        Parameters
        ----------
        levels : uint8 array [cycles of the sensor's clock, 3]
            Data, HSYNC and VSYNC.
        """
        levels = np.ascontiguousarray(levels, np.uint8)
        self._library.uart_sensor(self._handle, ctypes.c_void_p(levels.ctypes.data), ctypes.c_int64(len(levels)))
        while self._library.uart_sensor_left(self._handle):
            self._library.uart_run(self._handle, ctypes.c_int64(SLICE_CYCLES), None, ctypes.c_int64(0))

    def time(self):
        """Seconds since the begin."""
        return self._library.uart_cycles(self._handle) / CLOCK_HZ

    def close(self):
        """Free the simulation. Safe to call twice."""
        if self._handle:
            self._library.uart_free(self._handle)
            self._handle = None

    def __del__(self):
        if getattr(self, "_handle", None):
            self.close()
