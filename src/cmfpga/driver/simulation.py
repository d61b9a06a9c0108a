"""Back end: the emitted Verilog of the AXI top, in Verilator.

The simulated clock only runs while the driver asks for something, or waits. Time-outs are in seconds of the computer's
clock, as on a board.
"""

import ctypes
import functools
import threading
import time
import weakref

import numpy as np

from ..errors import DeviceError, DeviceTimeout
from ..rtl.axi.top import AxiTop
from ..verilog.compile import compile_library, load
from .accelerator import Accelerator
from .backend import Backend

#: Clock cycles after which a register access is given up.
ACCESS_CYCLES = 1000

#: What :meth:`SimulatedTop.run` may wait for: only its cycles, the interrupt, a packet, or all words' being taken.
CYCLES, INTERRUPT, PACKET, SENT = range(4)


@functools.cache  # it takes seconds to find out that nothing is to be compiled
def _library(config):
    library = load(compile_library(AxiTop(config)))
    library.axi_new.restype = ctypes.c_void_p
    for name in ("axi_unsent", "axi_take", "axi_cycles"):
        getattr(library, name).restype = ctypes.c_int64
    return library


class SimulatedTop:
    """One simulated AXI top; may be used by several threads.

    The hardware fields of ``config`` choose the library, which is compiled on first use and kept in the user's cache;
    ``seed`` is that of the random contents that memories and reset-less registers start with.
    """

    def __init__(self, config, *, seed=1):
        self._library = _library(config)
        self._lock = threading.RLock()
        self._handle = ctypes.c_void_p(self._library.axi_new(seed))
        self._free = weakref.finalize(self, self._library.axi_free, self._handle)
        self.reset()

    def _call(self, name, *arguments):
        with self._lock:
            if not self._free.alive:
                raise ValueError("the simulated hardware is closed")
            return getattr(self._library, name)(self._handle, *arguments)

    def reset(self, cycles=4):
        """Hold ``aresetn`` low for some clock cycles."""
        self._call("axi_reset", ctypes.c_int64(cycles))

    def read32(self, offset):
        """A register, by AXI4-Lite."""
        value = ctypes.c_uint32()
        self._access("axi_read", ctypes.c_uint32(offset), ctypes.byref(value))
        return value.value

    def write32(self, offset, value):
        """Write a register, by AXI4-Lite."""
        self._access("axi_write", ctypes.c_uint32(offset), ctypes.c_uint32(value))

    def _access(self, *call):
        status = self._call(*call, ctypes.c_int64(ACCESS_CYCLES))
        if status == 1:
            raise DeviceTimeout(f"no answer to a register access within {ACCESS_CYCLES} clock cycles")
        if status:
            raise DeviceError(f"a register access was answered with the error {status - 256}")

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
            self._free()


#: Clock cycles between two looks at the time.
SLICE_CYCLES = 20_000


class SimulationBackend(Backend):
    """Runs the emitted Verilog of hardware of this configuration: ``top``, a :class:`SimulatedTop` from this seed."""

    name = "simulation"

    def __init__(self, config, *, seed=1):
        self.config = config
        self.top = SimulatedTop(config, seed=seed)

    def read32(self, offset):
        return self.top.read32(offset)

    def write32(self, offset, value):
        self.top.write32(offset, value)

    def send(self, words):
        if self.top.unsent:
            raise DeviceError("words were not sent yet, and more are to be")
        self.top.send(words)

    def wait_sent(self, timeout):
        if not self._wait(SENT, timeout):
            raise DeviceTimeout(f"{self.top.unsent} words were not taken within {timeout:g} s")

    def receive(self, timeout):
        if not self._wait(PACKET, timeout):
            raise DeviceTimeout(f"no packet within {timeout:g} s")
        return self.top.take()

    def wait_interrupt(self, timeout):
        return self._wait(INTERRUPT, timeout)

    def _wait(self, until, timeout):
        deadline = time.monotonic() + timeout
        while not self.top.run(SLICE_CYCLES if timeout else 0, until):
            if time.monotonic() >= deadline:
                return False
        return True

    def stop(self):
        self.top.forget()

    def close(self):
        self.top.close()


def simulated_engine(config):
    """The simulated AXI top as an engine."""
    return Accelerator(SimulationBackend(config)).engine
