"""A camera's calibration as a configuration has it: nine numbers in OpenCV's order."""

import math

from ..errors import ConfigError

#: Focal lengths and principal point, px; radial (k) and tangential (p) distortion, the model "plumb_bob".
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def parse_camera(text, what="camera"):
    """The nine numbers of ``fx,fy,cx,cy,k1,k2,p1,p2,k3``, or of the same with spaces; () of an empty text.

    Distortion, or k3 alone, may be left out: it is 0. Raises :exc:`ConfigError`, which names ``what``.
    """
    words = text.replace(",", " ").split()
    if not words:
        return ()
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        numbers = ()
    if len(numbers) not in (4, 8, 9) or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{what}: {' '.join(words)[:60]!r}: {' '.join(NAMES)} is needed, nine numbers")
    if min(numbers[:2]) <= 0:
        raise ConfigError(f"{what}: fx = {numbers[0]:g}, fy = {numbers[1]:g}: focal lengths above 0 px are needed")
    return numbers + (0.0,) * (len(NAMES) - len(numbers))
