"""Back end: the emitted Verilog of the AXI top, in Verilator.

The simulated clock only runs while the driver asks for something, or waits. Time-outs are in seconds of the computer's
clock, as on a board.
"""

import time

from ..errors import DeviceError, DeviceTimeout
from ..verilog.simulation.axi_top import INTERRUPT, PACKET, SENT, SimulatedTop
from .accelerator import Accelerator
from .backend import Backend

#: Clock cycles between two looks at the time.
SLICE_CYCLES = 20_000


class SimulationBackend(Backend):
    """Runs the emitted Verilog.

    Parameters
    ----------
    config : Config
        The hardware to simulate.
    seed : int
        Of the memories' contents at the begin.

    Attributes
    ----------
    top : SimulatedTop
    """

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
