"""What crosses the boundary of the hardware: settings, results, flags, words, registers."""
