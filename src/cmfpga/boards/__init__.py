"""Boards: the facts of each that tools and driver need."""

from .board import Board
from .kv260 import KV260

__all__ = ["BOARDS", "DEFAULT", "Board"]

#: By name.
BOARDS = {board.name: board for board in (KV260,)}

#: The board where none is named. Tables compare with its device.
DEFAULT = KV260
