"""What crosses the boundary of the hardware: settings, results, flags, words, registers.

For a driver on a board: no module imports Amaranth, and only ``trace`` and ``words`` import NumPy.
"""
