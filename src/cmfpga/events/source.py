"""Where events come from: what whoever cuts batches asks of a recording, or of anything else that gives events."""

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from .arrays import Events


@runtime_checkable
class EventSource(Protocol):
    """Events in order of time. A :class:`~cmfpga.events.Recording` is one; another needs no base class.

    Members
    -------
    name : str
        For people.
    width, height : int or None
        Size of the sensor, px; None where it is not known.
    seekable : bool
        :meth:`chunks` may be called more than once, and gives the same events again. What comes live is not seekable:
        it can be tracked, but no batch of it can be traced afterwards.
    """

    name: str
    width: int | None
    height: int | None
    seekable: bool

    def chunks(self, start: int, size: int) -> Iterator[Events]:
        """Iterator of :class:`Events` from event ``start`` (from 0) to the end, at most ``size`` at a time.

        None in their place says that no more are there yet: a track then yields None, and goes on when it is asked
        again.
        """
