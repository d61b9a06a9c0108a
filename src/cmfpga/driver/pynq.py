"""Back end for PYNQ. Importing this module makes PYNQ give our IP the class :class:`CmfpgaIP`.

    from pynq import Overlay
    import cmfpga.driver.pynq

    overlay = Overlay("cmfpga.bit")
    accelerator = overlay.cmfpga.accelerator(overlay.dma)

Tried with PYNQ 4.0 on a simulated board, never on a real one. PYNQ sets clocks and port widths by itself: load no
device-tree overlay of ours beside it.
"""

import select

import numpy as np
from pynq import DefaultIP, UnsupportedConfiguration, allocate

from ..boards import BOARDS, DEFAULT, AxiBoard
from ..errors import WrongHardware
from .accelerator import Accelerator
from .backend import DmaBackend
from .control import check_version


class Registers:
    """Words of a ``pynq.MMIO``."""

    def __init__(self, mmio):
        self._mmio = mmio

    def read32(self, offset):
        """The word at a byte offset."""
        return int(self._mmio.read(offset))

    def write32(self, offset, value):
        """Write the word at a byte offset."""
        self._mmio.write(offset, int(value) & 0xFFFFFFFF)


class CmfpgaIP(DefaultIP):
    """The accelerator in an overlay.

    Raises ``pynq.UnsupportedConfiguration`` where the hardware was made by another version; PYNQ then warns, says
    which, and gives the IP its default class.
    """

    bindto = [  # noqa: RUF012 - what PYNQ's metaclass reads
        name for board in BOARDS.values() if isinstance(board, AxiBoard) for name in (board.vlnv, board.module_vlnv)
    ]

    def __init__(self, description):
        super().__init__(description=description)
        self.read32, self.write32 = (registers := Registers(self.mmio)).read32, registers.write32
        self.name, self.hint = "PYNQ", lambda: ""
        try:
            check_version(self)
        except WrongHardware as error:
            raise UnsupportedConfiguration(str(error)) from None

    def accelerator(self, dma, config=None, **options):
        """The :class:`~cmfpga.driver.Accelerator` with these ``options``, whose streams ``dma`` serves.

        That is a ``pynq.lib.dma.DMA`` in simple mode, whose channels nobody else uses.
        """
        return Accelerator(PynqBackend(self, dma), config, **options)


class PynqBuffer:
    """A contiguous buffer of PYNQ's."""

    def __init__(self, size, device):
        self._words = allocate((size // 8,), "u8", target=device)
        self.address = int(self._words.device_address)
        self.size = size // 8 * 8

    def write(self, words):
        part = self._words[: len(words)]
        part[:] = words
        part.flush()

    def read(self, count):
        part = self._words[:count]
        part.invalidate()
        return np.array(part, np.uint64)

    def close(self):
        """Free it. Safe to call twice."""
        if self._words is not None:
            self._words.freebuffer()
            self._words = None


class PynqBackend(DmaBackend):
    """The accelerator in a PYNQ overlay, by its :class:`CmfpgaIP` and DMA; ``board`` has the sizes of the buffers."""

    name = "PYNQ"

    def __init__(self, ip, dma, *, board=DEFAULT):
        limit = dma.buffer_max_size
        sizes = board.buffer_events_size, board.buffer_results_size
        buffers = [PynqBuffer(min(size, limit), ip.device) for size in sizes]
        super().__init__(Registers(ip.mmio), Registers(dma.mmio), *buffers, board=board)
        self._file = _interrupt_file(ip)
        self.has_interrupt = self._file is not None

    def wait_interrupt(self, timeout):
        # Not by asyncio, as pynq.Interrupt does: in a notebook the event loop is the one that runs this.
        self._file.write((1).to_bytes(4, "little"))
        ready, _, _ = select.select([self._file], [], [], timeout)
        if ready:
            self._file.read(4)
        return bool(ready)


def _interrupt_file(ip):
    """The UIO device of the IP's interrupt; None where there is none, or an interrupt controller is in between."""
    interrupt = getattr(ip, "irq", None)
    controller = interrupt.parent() if interrupt is not None else None
    return getattr(controller, "uio", None)
