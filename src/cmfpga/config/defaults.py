"""What every tool assumes where the user says nothing."""

#: Events of a batch.
BATCH_EVENTS = 5000

#: The clock that the article reports for its design on the KV260, MHz. Which one this core reaches is not known.
CLOCK_MHZ = 210.0
