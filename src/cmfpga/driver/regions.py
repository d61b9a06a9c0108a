"""Results of packets; and an accelerator's table of regions, for :class:`cmfpga.engines.regions.RegionEngine`."""

import collections

import numpy as np

from ..errors import DeviceError
from ..events.arrays import Events
from ..protocol.results import RegionOutcome, WireResult, decode, fields_of, packet_beats
from ..protocol.words import result_values, split_packets
from .engine import transact


class AcceleratorRegions:
    """The table of regions of an accelerator, and its batches.

    Parameters
    ----------
    accelerator : Accelerator

    Attributes
    ----------
    cycles : int or None
        Of the last batch, with which it was under way.
    """

    def __init__(self, accelerator):
        self._accelerator = accelerator
        self._sent = collections.deque(maxlen=accelerator.config.slices)  # events of each slice
        self.cycles = None

    def write(self, regions, anew=()):
        """Replace the table; what has changed is written with the next batch. Raises :exc:`ConfigError`."""
        self._accelerator.control.table.replace(regions, anew)

    def run(self, t, x, y, settings):
        """One batch: a :class:`WireResult` with an outcome for each region."""
        top = self._accelerator
        before = top.control.read("COUNT_BUSY_CYCLES")["VALUE"]
        result = transact(top, Events(t, x, y, np.zeros(len(t), np.int64)), settings, self._sent)
        self._sent.append(len(t))
        self.cycles = (top.control.read("COUNT_BUSY_CYCLES")["VALUE"] - before) % (1 << 32)
        return result

    def close(self):
        self._accelerator.close()


def result_of(config, registers, words, name):
    """The :class:`WireResult` of a packet: a record, or with a table of regions one of each region, in any order.

    Raises :exc:`DeviceError` where it is not whole; ``name`` is who sent it.
    """
    beats = packet_beats(config)
    if len(words) % beats or not 1 <= len(words) // beats <= max(1, config.regions):
        raise DeviceError(f"{name}: a packet of {len(words)} words; {beats} make a result")
    records = [result_values(registers, record) for record in split_packets(registers, words)]
    if not config.regions:
        return WireResult(**decode(config, records[0], "wrapper"))
    numbers, lasts = [record["region"] for record in records], [record["last"] for record in records]
    if sorted(numbers) != list(range(len(numbers))) or lasts != [0] * (len(lasts) - 1) + [1]:
        raise DeviceError(f"{name}: results of the regions {numbers} came in one packet; one of each is needed")
    found = [decode(config, record, "wrapper") for record in records]
    own = {f.name for f in fields_of("region", config=config)}
    outcomes = {
        number: RegionOutcome(**{name: values[name] for name in own})
        for number, values in zip(numbers, found, strict=True)
    }
    batch = {name: value for name, value in found[0].items() if name not in own}
    batch |= {name: any(values[name] for values in found) for name in ("wire", "config_range")}
    return WireResult(regions=tuple(outcomes[number] for number in sorted(outcomes)), **batch)
