"""Numbers of Prophesee's EVT 2.0 and EVT 2.1 words, for encoders and decoders alike."""

#: Types of words.
TIME_HIGH = 0x8
EVENT_TYPES = (0x0, 0x1)
#: Known types without an event of the sensor: external trigger, others, continued.
OTHER_TYPES = (0xA, 0xE, 0xF)

LOW_BITS = 6  # of a time stamp, beside each event; 28 high bits come in words of their own
HIGH_BITS = 28
COLUMN_BITS = 11
