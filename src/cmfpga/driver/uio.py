"""Back end for plain Linux: registers by UIO, buffers by u-dma-buf (https://github.com/ikwzm/udmabuf).

Never run on a board. Registers are only accessed in aligned words of 32 bits: others, and bulk copies, end in a bus
error (SIGBUS).
"""

import contextlib
import fcntl
import mmap
import os
import select
from pathlib import Path

import numpy as np

from ..boards import DEFAULT
from ..errors import DeviceError
from .backend import DmaBackend


def _open(path, question):
    """A descriptor of a device that nobody else has: two owners would undo each other's writes."""
    try:
        file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise DeviceError(f"{path}: {error.strerror}; {question}") from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        raise DeviceError(f"{path}: in use; close the program that has opened it") from None
    return file


def _number(path, low=0, step=1):
    """A number that sysfs tells."""
    try:
        value = int(path.read_text(), 0)
    except OSError as error:
        raise DeviceError(f"{path}: {error.strerror}; is its module loaded, and the overlay?") from None
    except ValueError:
        raise DeviceError(f"{path}: no number; is it of another kernel module?") from None
    if not low <= value < 1 << 63 or value % step:
        raise DeviceError(f"{path}: {value:#x}: a multiple of {step} from {low} on is needed")
    return value


def _map(path, make, *arguments):
    """What ``make`` maps of a device, which may be smaller than sysfs tells."""
    try:
        return make(*arguments)
    except (OSError, ValueError, OverflowError) as error:
        raise DeviceError(f"{path}: cannot be mapped: {getattr(error, 'strerror', None) or error}") from None


class Mapping:
    """Registers of a UIO device: ``size`` bytes of the descriptor ``file``."""

    def __init__(self, file, size):
        self._map = mmap.mmap(file, size, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE)
        self._view = memoryview(self._map)
        self._words = self._view.cast("I")  # one access of 32 bits for each word

    def __getitem__(self, index):
        return self._words[index]

    def __setitem__(self, index, value):
        self._words[index] = value

    def close(self):
        self._words.release()
        self._view.release()
        self._map.close()


class UioDevice:
    """One UIO device, found by its name in ``/sys/class/uio/uio*/name``; ``root`` is another folder for tests."""

    def __init__(self, name, *, root="/"):
        self.name = name
        folder = self._find(Path(root), name)
        self.size = _number(folder / "maps" / "map0" / "size", low=4, step=4)
        path = Path(root) / "dev" / folder.name
        self._file = _open(path, "are you root, or in its group?")
        try:
            self._words = _map(path, Mapping, self._file, self.size)
        except DeviceError:
            os.close(self._file)
            raise

    @staticmethod
    def _find(root, name):
        found = {}
        for path in sorted((root / "sys/class/uio").glob("uio*/name")):
            with contextlib.suppress(OSError, ValueError):
                found.setdefault(path.read_text().strip(), path.parent)
        if name not in found:
            raise DeviceError(
                f"no UIO device called {name} ({', '.join(found) or 'none'} found); is the overlay loaded, and "
                "uio_pdrv_genirq with of_id=generic-uio?"
            )
        return found[name]

    def read32(self, offset):
        """The word at a byte offset."""
        return int(self._words[self._index(offset)])

    def write32(self, offset, value):
        """Write the word at a byte offset."""
        self._words[self._index(offset)] = value & 0xFFFFFFFF

    def _index(self, offset):
        if offset % 4 or not 0 <= offset < self.size:
            raise DeviceError(f"{self.name}: offset {offset:#x}: multiples of 4 below {self.size:#x} are allowed")
        return offset // 4

    def wait_interrupt(self, timeout):
        """Whether the interrupt came in time. The kernel masks it when it comes; this unmasks it first."""
        os.write(self._file, (1).to_bytes(4, "little"))
        ready, _, _ = select.select([self._file], [], [], timeout)
        if ready:
            os.read(self._file, 4)  # the number of interrupts so far
        return bool(ready)

    def close(self):
        """Unmap and close. Safe to call twice."""
        if self._file is not None:
            self._words.close()
            os.close(self._file)
            self._file = None


class UdmaBuffer:
    """A buffer of u-dma-buf: ``/dev/<name>``, and ``/sys/class/u-dma-buf/<name>/``.

    Caches are cleaned and invalidated by its ``sync_for_…`` files, unless the buffer is coherent.
    """

    def __init__(self, name, *, root="/"):
        self.name = name
        self._folder = Path(root) / "sys/class/u-dma-buf" / name
        self.address, self.size = _number(self._folder / "phys_addr", step=8), _number(self._folder / "size", 8, 8)
        coherent, path = self._folder / "dma_coherent", Path(root) / "dev" / name
        self._coherent = coherent.exists() and bool(_number(coherent))
        file = _open(path, "is the module u-dma-buf loaded, and the overlay?")
        try:
            self._map = _map(path, mmap.mmap, file, self.size, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE)
        finally:
            os.close(file)  # the mapping keeps it, and with it the lock

    def write(self, words):
        self._map[: words.nbytes] = words.tobytes()
        self._sync("sync_for_device", words.nbytes, 1)

    def read(self, count):
        self._sync("sync_for_cpu", 8 * count, 2)
        return np.frombuffer(self._map[: 8 * count], "<u8").astype(np.uint64)

    def _sync(self, what, size, direction):
        """``direction``: 1 to the device, 2 from it."""
        if self._coherent or not size:
            return
        for name, value in (("sync_offset", 0), ("sync_size", size), ("sync_direction", direction), (what, 1)):
            (self._folder / name).write_text(str(value))

    def close(self):
        """Unmap. Safe to call twice."""
        self._map.close()


class UioBackend(DmaBackend):
    """The accelerator behind plain Linux.

    ``board`` has the names of the UIO devices, the buffers and the clock; ``root`` is another folder for tests. Raises
    :exc:`DeviceError` where something is missing: which, and what may be the reason.
    """

    name = "UIO"

    def __init__(self, *, board=DEFAULT, root="/"):
        self._board, self._root = board, Path(root)
        self._check_clock()
        makers = (
            *((UioDevice, name) for name in (board.uio_registers, board.uio_dma)),
            *((UdmaBuffer, name) for name in (board.buffer_events, board.buffer_results)),
        )
        with contextlib.ExitStack() as opened:  # all of them, or none
            parts = [opened.enter_context(contextlib.closing(make(part, root=root))) for make, part in makers]
            self._parts = opened.pop_all()
        super().__init__(*parts, board=board)

    def wait_interrupt(self, timeout):
        return self._registers.wait_interrupt(timeout)

    def _check_clock(self):
        """Without its clock the first access to a register never ends, and no time-out helps against that."""
        users = None  # cannot be read: it needs root, and debugfs
        with contextlib.suppress(OSError, ValueError):
            file = self._root / "sys/kernel/debug/clk" / self._board.linux_clock / "clk_enable_count"
            users = int(file.read_text())
        if users == 0:
            raise DeviceError(
                f"the clock {self._board.linux_clock} is off, and an access to a register would hang the processor; "
                "is the overlay with its clocking0 node loaded?"
            )

    def hint(self):
        return f"To look at: grep {self._board.uio_registers} /proc/interrupts"

    def close(self):
        self._parts.close()
