"""What was unusual about a batch."""

import enum
import functools
import operator


class Flag(enum.IntFlag):
    """What was unusual about a batch. The hardware's ``flags`` output has these bits."""

    DEGENERATE = 1  # too few ROI events, or t_1 = t_N, or T = 0: v stays, the ROI does not move by it
    OVERFLOW = 2  # more ROI events than the buffer holds; the surplus was dropped
    TIME_BACK = 4  # events whose time steps back were dropped
    TIME_SPAN = 8  # events later than the span that relative times can hold were dropped
    CUT = 16  # the batch reached max_batch_events before its end was marked
    SATURATED = 32  # the gradient or v reached the end of its format in some iteration
    ROI_CLAMPED = 64  # the ROI's position was limited to the sensor
    SCHEDULE = 128  # an entry of the schedule was out of range, and limited
    THINNED = 256  # ROI events were left out evenly, to keep their number down
    DOUBTFUL = 512  # the contrast's peak is too flat for v to be trusted
    SHORT = 1024  # v is so short that it is found too large

    @property
    def warnings(self):
        """Without the notes: those that say that something was lost or went wrong."""
        return self & ~NOTES

    @classmethod
    def parse(cls, text):
        """The flags of a :attr:`text`."""
        return functools.reduce(operator.or_, (cls[name.upper()] for name in filter(None, text.split("|"))), cls(0))

    @property
    def text(self):
        """Lower-case names joined by ``|``; empty where no bit is set."""
        return "|".join(flag.name.lower() for flag in Flag if flag in self)


#: Flags by which nothing was lost or went wrong; all others are warnings.
NOTES = Flag.THINNED | Flag.SHORT

#: Those of hardware that measures how sure v is.
OF_CONFIDENCE = (Flag.DOUBTFUL, Flag.SHORT)
