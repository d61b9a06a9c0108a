"""What every tool assumes where the user says nothing."""

#: Engines that run here, and need no board and no AXI; the first is the usual one.
ENGINES = ("rtl", "model", "float")

#: Events of a batch.
BATCH_EVENTS = 5000

#: The clock that the article reports for its design on the KV260, MHz. Which one this core reaches is not known.
CLOCK_MHZ = 210.0
