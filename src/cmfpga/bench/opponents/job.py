"""What a program is given, and how it is asked."""

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass

from ...events import Events


class Unavailable(Exception):
    """A program cannot run here; the message is a line that says what is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One batch and what is to be done with it.

    Parameters
    ----------
    events : Events
        All N events of the batch.
    roi : (int, int)
        Left column and top row of the ROI, px.
    width, height : int
        Size of the ROI, px.
    iterations : int
        T.
    eta : float
        Step of the constant ascent.
    schedule : tuple of ScheduleEntry, or None
        Sign ascent instead, one entry per iteration.
    dither : bool
        Add the sub-pixel offsets of :func:`cmfpga.reference.floating.dither`.
    v_start : (float, float)
        Start, px per half batch.
    """

    events: Events
    roi: tuple[int, int]
    width: int
    height: int
    iterations: int
    eta: float = 1.0
    schedule: tuple | None = None
    dither: bool = False
    v_start: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self):
        if self.schedule is not None and len(self.schedule) != self.iterations:
            raise ValueError(f"{len(self.schedule)} entries of a schedule for {self.iterations} iterations")


class Program(ABC):
    """A program that runs jobs.

    Attributes
    ----------
    name : str
        For the table.
    how : str
        Compiler and options, or versions: what decides its speed beside the machine.
    clock : callable
        Seconds, to time it with: those that the processor gave to the thread, which other work does not lengthen.
    is_reference : bool
        Whether the others are compared with it.
    """

    name = ""
    how = ""
    clock = staticmethod(time.thread_time)
    is_reference = False

    @abstractmethod
    def load(self, job):
        """A :class:`Loaded`: the job with all memory that it needs, ready to be timed."""


class Loaded(ABC):
    """A job in a program. ``batch`` before ``ascent``."""

    @abstractmethod
    def batch(self, count=1):
        """The whole job, ``count`` times: crop, scale, T iterations. Returns v."""

    @abstractmethod
    def ascent(self, count=1):
        """What is left to do when the last event has arrived, ``count`` times: all but the cropping. Returns v."""

    @abstractmethod
    def gradient(self, v, level=0):
        """G/P = S − ΣI·ΣD/P at v, in the image of pixels 2^level px wide; P is that of the ROI at every level.

        The derivatives are those by v in units of that level's pixels, as in the hardware.
        """

    def close(self):  # noqa: B027 - most hold nothing
        """Free what the job holds."""
