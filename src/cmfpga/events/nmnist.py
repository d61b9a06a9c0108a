"""Recordings of N-MNIST and N-Caltech101, ``.bin``: records of five bytes, without a header.

They are x, y, and 24 bits, big-endian, of which the first is the polarity and the others the time in µs. x = 0 is the
left column, y = 0 the top row. A file is known by its extension and by times that do not fall at its begin.

Source: https://www.garrickorchard.com/datasets/n-mnist.
"""

import numpy as np

from .recording import Format
from .streamed import RecordsRecording


class NmnistRecording(RecordsRecording):
    """Events of a file of N-MNIST's form."""

    record_bytes, time_bits = 5, 23

    def __init__(self, path, *, time_unit=None, sensor=None, form=None):
        super().__init__(path, "N-MNIST", sensor=sensor, time_unit=time_unit)

    def _decode(self, content):
        return _events(content)


def _events(content):
    x, y, high, middle, low = np.frombuffer(content, np.uint8).reshape(-1, 5).T.astype(np.int64)
    return (high & 0x7F) << 16 | middle << 8 | low, x, y, high >> 7


def _matches(head, path):
    whole = len(head) // NmnistRecording.record_bytes * NmnistRecording.record_bytes
    return path.suffix.lower() == ".bin" and whole > 0 and not (np.diff(_events(head[:whole])[0]) < 0).any()


FORMAT = Format("N-MNIST", (".bin",), _matches, NmnistRecording, forms=("nmnist",))
