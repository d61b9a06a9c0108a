"""What stands around a core on any board: words in, packets out, settings, counters, a sensor's port."""
