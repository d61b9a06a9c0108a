"""A package with the interface of ``neuromorphic-drivers`` 0.18, whose cameras send what a test gives them."""

import time
import types
from collections import deque
from enum import Enum

import numpy as np


class Name(Enum):
    EVK4 = "Prophesee EVK4"
    DVXPLORER = "iniVation DVXplorer"


class Connection(Enum):
    USB_SUPER = "USB 3.0 SuperSpeed (5.0 Gb/s)"


def listed(serial="00050001", name=Name.EVK4, error=None):
    """An entry of ``list_devices``."""
    return types.SimpleNamespace(name=name, connection=Connection.USB_SUPER, address="", serial=serial, error=error)


class Driver(types.ModuleType):
    """``cameras``: a list of :func:`listed`; ``packets``: callable, an iterator of ``(packet, backlog, dropped)``.

    A packet None is a time in which nothing came. At their end the camera is unplugged; it is there again at the second
    look, with the packets ``again``, if there are any.
    """

    def __init__(self, packets, *cameras, size=(32, 24), again=None):
        super().__init__("neuromorphic_drivers")
        self._packets, self._cameras, self._size = packets, cameras or (listed(),), size
        self._again, self.looks = again, None  # since it was unplugged
        self.opened, self.closed = [], 0

    def list_devices(self):
        if self.looks is not None:
            self.looks += 1
            if self.looks < 2 or self._again is None:
                return []
            self._packets, self._again, self.looks = self._again, None, None
        return [*self._cameras]

    def open(self, configuration=None, iterator_timeout=None, raw=False, serial=None):
        self.opened.append((serial, raw))
        return Device(self, self._packets(), self._size)


class Device:
    def __init__(self, driver, packets, size):
        self._driver, self._packets, self._size = driver, packets, size

    def properties(self):
        return types.SimpleNamespace(width=self._size[0], height=self._size[1])

    def __iter__(self):
        return self

    def __next__(self):
        packet, backlog, dropped = next(self._packets, (b"", 0, 0))
        if packet == b"":
            self._driver.looks = 0
            raise RuntimeError("Usb(Rusb(NoDevice))")
        ring = None if packet is None else types.SimpleNamespace(backlog=backlog, dropped_packets=dropped)
        return types.SimpleNamespace(system_time=time.time(), ring=ring), packet

    def close(self):
        self._driver.closed += 1


class Busy:
    """Packets of a camera of 1280×720 px that sends so many events/s for so long, whoever reads them.

    Half a percent of the events lie below the sensor. A ring holds ``ring`` packets; others are dropped. Of all packets
    the events are counted as ``sent``, of those as ``dropped``.
    """

    HIGH_PARTS = 25  # of the time, in what is repeated: 102 ms
    PACKETS = 20  # in that; of 88 kB at 20 million events/s

    def __init__(self, rng, *, rate=20_000_000, seconds=3.0, ring=64):
        self._seconds, self._ring, self.sent, self.dropped = seconds, ring, 0, 0
        us = self.HIGH_PARTS << 12
        self._packet_s = us / self.PACKETS / 1e6
        groups = round(rate * us / 1e6 / 16)  # words of time, row, base, and 32 columns with 16 events
        t, bits = np.sort(rng.integers(0, us, groups)), rng.random((groups, 32)) < 0.5
        vectors = [bits[:, begin : begin + 12] @ (1 << np.arange(12))[: 32 - begin] for begin in (0, 12, 24)]
        base = rng.integers(0, 2, groups) << 11 | rng.integers(0, 40, groups) * 32
        fields = (t >> 12, t & 0xFFF, rng.integers(0, 724, groups), base, *vectors)
        kinds = np.array([0x8, 0x6, 0x0, 0x3, 0x4, 0x4, 0x5]) << 12
        pieces = (np.array_split(each, self.PACKETS) for each in (np.stack(fields, 1) | kinds, bits))
        self._pieces = [(words, int(there.sum())) for words, there in zip(*pieces, strict=True)]

    def __call__(self):
        begin, made, dropped, waiting = time.monotonic(), 0, 0, deque()
        while waiting or made * self._packet_s < self._seconds:
            due = min(time.monotonic() - begin, self._seconds) / self._packet_s
            while made < due:
                events = self._pieces[made % self.PACKETS][1]
                self.sent += events
                if len(waiting) < self._ring:
                    waiting.append(made)
                else:
                    self.dropped += events
                    dropped += 1
                made += 1
            if not waiting:
                time.sleep(self._packet_s / 4)
                continue
            number = waiting.popleft()
            words = self._pieces[number % self.PACKETS][0].copy()
            words[:, 0] = 0x8000 | words[:, 0] + number // self.PACKETS * self.HIGH_PARTS & 0xFFF
            yield words.astype("<u2").tobytes(), len(waiting), dropped
