"""Numbers of Prophesee's EVT 2.0, 2.1 and 3.0 words, for encoders and decoders alike."""

from enum import IntEnum

#: Types of words.
TIME_HIGH = 0x8
EVENT_TYPES = (0x0, 0x1)
#: Known types without an event of the sensor: external trigger, others, continued.
OTHER_TYPES = (0xA, 0xE, 0xF)

LOW_BITS = 6  # of a time stamp, beside each event; 28 high bits come in words of their own
HIGH_BITS = 28
COLUMN_BITS = 11


class Evt3(IntEnum):
    """Types of EVT 3.0 words, with :data:`TIME_HIGH`: four bits of 16."""

    Y = 0x0
    X = 0x2
    BASE = 0x3
    VECTOR_12 = 0x4
    VECTOR_8 = 0x5
    TIME_LOW = 0x6


#: Columns of each type of vector words.
VECTORS = {Evt3.VECTOR_12: 12, Evt3.VECTOR_8: 8}
#: EVT 3.0: bits of either part of a time; words without an event: those of EVT 2.x, and continued by 4 bits.
TIME_BITS = 12
#: Where vectors do not go beyond, so that a column has 13 bits: off all sensors.
LAST_COLUMN = 4096
OTHER_TYPES_3 = (0x7, *OTHER_TYPES)
