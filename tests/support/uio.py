"""The files of a Linux with the simulated board behind them."""

import mmap

from cmfpga.driver import uio
from cmfpga.driver.uio import UioBackend
from support.board import Board, Interrupts

BUFFERS = {"cmfpga-events": (0x8_0000_0000, 0x4000), "cmfpga-results": (0x8_0010_0000, 0x1000)}


class Linux:
    """The tree's files, with the simulated board behind the UIO devices and the buffers' memory."""

    def __init__(self, tree, top, monkeypatch):
        self.tree, self.board = tree, Board(top)
        bases, usual = {}, uio._open

        def opening(path, question):
            if path.name == "uio3":
                file, base = Interrupts(self.board).file, Board.REGISTERS
            elif path.name == "uio4":
                file, base = usual(path, question), Board.DMA
            else:
                return usual(path, question)
            bases[file] = base
            return file

        monkeypatch.setattr(uio, "_open", opening)
        monkeypatch.setattr(uio, "Mapping", lambda file, size: self.board.words(bases[file]))
        for name, (address, size) in BUFFERS.items():
            with (tree / "dev" / name).open("r+b") as file:
                self.board.memory.add(address, mmap.mmap(file.fileno(), size))

    backend_class = UioBackend

    def backend(self):
        return UioBackend(root=self.tree)
