"""A simulated board: the verilated AXI top, a model of AMD's AXI DMA (PG021, simple mode), and memory."""

import os
import socket
import threading

import numpy as np

from cmfpga.driver.simulation import CYCLES, INTERRUPT, PACKET, SENT

#: Clock cycles that pass while the processor does one access: far fewer than on a board.
ACCESS_CYCLES = 100

RUN, RESET, HALTED, IDLE, INTERNAL_ERROR = 1, 4, 1, 2, 1 << 4


class Memory:
    """Bytes at bus addresses: buffers that the processor and the DMA share."""

    def __init__(self):
        self._buffers = {}

    def add(self, address, array):
        """``array``: anything with a writable buffer."""
        self._buffers[address] = memoryview(array).cast("B")

    def at(self, address, size):
        """A writable view; KeyError where there is no memory."""
        for begin, view in self._buffers.items():
            if begin <= address and address + size <= begin + len(view):
                return view[address - begin : address - begin + size]
        raise KeyError(f"{address:#x}")


class SimulatedDma:
    """Registers of the DMA; words go to and from the simulated top."""

    def __init__(self, top, memory):
        self.top, self.memory = top, memory
        self.stuck_after = -1  # words that are sent before the DMA does nothing any more; below 0: it does not stop
        self.dead = False  # its reset never ends
        self._reset()

    def _reset(self):
        self.registers = {}
        self.running, self.busy, self.error = ({0x00: 0, 0x30: 0} for _ in range(3))
        self.top.forget()
        self.top.limit(send=-1, accept=0)

    def read32(self, offset):
        self._advance()
        base, register = (0x30, offset - 0x30) if offset >= 0x30 else (0x00, offset)
        if register == 0x00:
            return self.running[base] | (RESET if self.dead else 0)
        if register == 0x04:
            halted = HALTED if not self.running[base] or self.error[base] else 0
            return halted | (0 if self.busy[base] else IDLE) | self.error[base]
        return self.registers.get(offset, 0)

    def write32(self, offset, value):
        base, register = (0x30, offset - 0x30) if offset >= 0x30 else (0x00, offset)
        if register == 0x00:
            self.running[base] = value & RUN
            if value & RESET:
                self._reset()
            return
        self.registers[offset] = value
        if register != 0x28 or not self.running[base]:
            return
        address = self.registers[base + 0x18] | self.registers[base + 0x1C] << 32
        self.busy[base] = True
        if base == 0x00:
            self.top.send(np.frombuffer(self.memory.at(address, value), "<u8"))
            self.top.limit(send=self.stuck_after, accept=1 if self.busy[0x30] else 0)
        else:
            self.target = self.memory.at(address, value)
            self.top.limit(send=self.stuck_after, accept=1)

    def _advance(self):
        if self.busy[0x00] and self.top.run(0, SENT):
            self.busy[0x00] = False
        if self.busy[0x30] and self.top.run(0, PACKET):
            words = self.top.take()
            if words.nbytes > len(self.target):
                self.error[0x30] = INTERNAL_ERROR
                return
            self.target[: words.nbytes] = words.tobytes()
            self.registers[0x58] = words.nbytes
            self.busy[0x30] = False


class Board:
    """What software sees at addresses; ``overrides``, ``{offset: word}``: registers that read as something else."""

    REGISTERS, DMA = 0xA0000000, 0xA0010000

    def __init__(self, top, *, overrides=()):
        self.top = top
        self.overrides = dict(overrides)
        self.memory = Memory()
        self.dma = SimulatedDma(top, self.memory)
        self.lock = threading.RLock()

    def words(self, base):
        """Registers from an address on, word by word, as ``pynq.MMIO.array`` or a mapping of UIO has them."""
        return Words(self, base)

    def read(self, address):
        with self.lock:
            self.top.run(ACCESS_CYCLES, CYCLES)
            if address >= self.DMA:
                return self.dma.read32(address - self.DMA)
            offset = address - self.REGISTERS
            return self.overrides.get(offset, self.top.read32(offset))

    def write(self, address, value):
        with self.lock:
            if address >= self.DMA:
                self.dma.write32(address - self.DMA, value)
            else:
                self.top.write32(address - self.REGISTERS, value)


class Words:
    """Words of 32 bits, and nothing else: slices, bytes and negative numbers are refused, as hardware does."""

    def __init__(self, board, base):
        self._board, self._base = board, base

    def _address(self, index):
        assert isinstance(index, int) and 0 <= index < 0x4000, index
        return self._base + 4 * index

    def __getitem__(self, index):
        return self._board.read(self._address(index))

    def __setitem__(self, index, value):
        assert 0 <= int(value) < 1 << 32, value
        self._board.write(self._address(index), int(value))

    def close(self):
        """Nothing to unmap."""


class Interrupts:
    """What the kernel makes of ``irq``: unmasked by writing 1 to a file, readable once when it is high; then masked.

    A thread runs the simulated clock while the interrupt is awaited, and ends by itself when the file is closed.
    """

    def __init__(self, board, *, broken=False):
        self.board, self.broken = board, broken
        mine, self._end = socket.socketpair()
        self.file = mine.detach()
        threading.Thread(target=self._serve, name="interrupts", daemon=True).start()

    def _serve(self):
        unmasked, count = False, 0
        with self._end as end:
            while True:
                end.settimeout(0.0001 if unmasked else 0.02)
                try:
                    written = end.recv(4)
                    if not written:
                        return
                    assert len(written) == 4 and any(written)
                    unmasked = True
                except TimeoutError:
                    pass
                except OSError:
                    return
                if not unmasked:
                    continue
                try:
                    with self.board.lock:
                        fired = self.board.top.run(2000, INTERRUPT)
                except ValueError:  # the simulation was closed, at the end of a test
                    return
                if fired and not self.broken:
                    unmasked, count = False, count + 1
                    end.sendall(count.to_bytes(4, "little"))


def uio_tree(root, *, buffers):
    """A folder that looks like a Linux with our overlay; ``buffers``: {name: (address, size)}. Files, no devices."""
    files = {"sys/kernel/debug/clk/pl0_ref/clk_enable_count": "1\n"}
    for number, (name, address) in enumerate((("cmfpga", Board.REGISTERS), ("cmfpga-dma", Board.DMA)), 3):
        folder = f"sys/class/uio/uio{number}"
        files |= {f"{folder}/name": f"{name}\n", f"{folder}/maps/map0/size": "0x0000000000010000\n"}
        files |= {f"{folder}/maps/map0/addr": f"{address:#018x}\n", f"dev/uio{number}": "\0" * 0x10000}
    for name, (address, size) in buffers.items():
        folder = f"sys/class/u-dma-buf/{name}"
        files |= {f"{folder}/phys_addr": f"{address:#018x}\n", f"{folder}/size": f"{size}\n"}
        files |= {f"{folder}/dma_coherent": "0\n", f"dev/{name}": "\0" * size}
    for path, content in files.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(content)
    return root


def descriptors():
    """Number of this process's open files, once no thread is about to close one."""
    for thread in threading.enumerate():
        if thread.name == "interrupts":
            thread.join(5)
            assert not thread.is_alive()
    return len(os.listdir("/proc/self/fd"))
