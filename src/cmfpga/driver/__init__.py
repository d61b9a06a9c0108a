"""The accelerator from Python: the same class on a board and on the simulated Verilog.

Modules of the back ends are imported where they are wanted: :mod:`cmfpga.driver.simulation`,
:mod:`cmfpga.driver.uio`, :mod:`cmfpga.driver.pynq`. On a board NumPy and h5py are enough.
"""

from ..errors import DeviceError, DeviceTimeout, WrongHardware
from ..protocol.results import WireResult
from .accelerator import Accelerator
from .backend import Backend

__all__ = ["Accelerator", "Backend", "DeviceError", "DeviceTimeout", "WireResult", "WrongHardware"]
