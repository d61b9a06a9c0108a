"""Model of a GenX320's parallel port: words to levels of its pins, packet by packet, frame by frame.

What it keeps to, and what of that is assumed, is in :mod:`cmfpga.rtl.shell.cpi`.
"""

import numpy as np

from cmfpga.rtl.shell.cpi import PADDING


def to_bytes(words, *, big_endian=False):
    """The words' bytes in the order in which they leave."""
    return np.asarray(words, ">u4" if big_endian else "<u4").tobytes()


def levels(content, *, packet=64, packets=3, low=(False, False), pad=True, gaps=None):
    """Data, HSYNC and VSYNC in each cycle of the sensor's clock: uint8 array [cycles, 3].

    ``packet``, ``packets``: bytes of a packet, packets of a frame; ``low``: whether HSYNC and VSYNC are active low;
    ``pad``: the last packet is filled with padding. With a generator ``gaps`` HSYNC falls within packets too, now and
    then: what a sensor that waits for events may do.
    """
    if pad:
        content += b"\xff" * (-len(content) % packet)
        assert PADDING == 0xFFFFFFFF
    rows, idle = [], [0x5A, 0, 0]
    for number, start in enumerate(range(0, len(content), packet)):
        if number % packets == 0:
            rows += [idle] * 5 + [[0x5A, 0, 1]]
        for byte in content[start : start + packet]:
            if gaps is not None and gaps.random() < 0.2:
                rows += [[0xA5, 0, 1]] * int(gaps.integers(1, 4))
            rows.append([byte, 1, 1])
        rows += [[0x5A, 0, 1]] * 2
    return np.array(rows + [idle] * 5, np.uint8) ^ np.array([0, *low], np.uint8)
