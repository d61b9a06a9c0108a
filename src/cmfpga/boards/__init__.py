"""Boards: the facts of each that tools and driver need."""

from .board import AxiBoard, Board, SerialBoard
from .kv260 import KV260
from .serial import TANG_PRIMER_20K, ULX3S

__all__ = ["BOARDS", "DEFAULT", "TANG_PRIMER_20K", "ULX3S", "AxiBoard", "Board", "SerialBoard"]

#: By name.
BOARDS = {board.name: board for board in (KV260, ULX3S, TANG_PRIMER_20K)}

#: The board where none is named. Tables compare with its device.
DEFAULT = KV260
