"""The AXI top of a configuration: words of random streams into it, packets out, counters; everything ``==``."""

import contextlib
import dataclasses
import functools

import numpy as np

from cmfpga.driver.accelerator import Accelerator
from cmfpga.driver.simulation import SimulationBackend
from cmfpga.errors import DeviceTimeout
from cmfpga.protocol.registers import formats_of
from cmfpga.protocol.word_format import TIME_HIGH, Evt3
from cmfpga.protocol.words import encode, swap_halves
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.regions import RegionSequence
from cmfpga.reference.wire import BatchEnds, decode, sensor_gate, split_batches, to_beats

from .batches import random_events, random_regions, random_settings, some_changed
from .compare import MismatchError, equal, events_of, same

#: Streams, each out of a reset in mid-batch; parts of each, between which settings and tables are written.
STREAMS, PARTS = 4, 4
CYCLES = 5_000_000  # clock cycles that a part may take
SETTLED = 20_000  # after so many cycles without a stall no word is left in a FIFO or a decoder


def through_the_shell(config, rng):
    """Random streams: (batches, iterations) that were equal. Raises :exc:`MismatchError`."""
    counts = np.zeros(2, int)
    with Accelerator(SimulationBackend(config, seed=int(rng.integers(1, 1 << 30)))) as top:
        for number in range(STREAMS):
            stream = _Stream(top, rng, f"stream {number}")
            stream.run()
            counts += len(stream.expected), sum(r.iterations for e in stream.expected for r in e.regions)
    return counts


class _Stream:
    """What the accelerator was given since a reset, and what the models make of it."""

    def __init__(self, top, rng, where):
        self.top, self.rng, self.where, self.config = top, rng, where, top.config
        self.core = self.model = IntegerCore(self.config)
        self.settings = random_settings(self.config, rng, (0, 0))[0]
        self.regions, self.beats, self.expected, self.found = [], [], [], 0
        if self.config.regions:
            self.model = RegionSequence(self.core)
            self._write_regions(random_regions(self.config, rng))
        small = max(self.config.sensor_width, self.config.sensor_height) <= 2048
        forms = list(formats_of(self.config)) if small else ["PACKED"]
        self.time = int(rng.integers(1 << 24))
        self.form, self.swap = str(rng.choice(forms)), bool(rng.random() < 0.5)
        longest = self.config.slice_events
        self.ends = BatchEnds(
            events=int(rng.choice([0, 0, min(longest, 60), longest])),
            duration=min((1 << self.config.span_bits) - 1, int(rng.choice([0, 0, 50, 2000, 1 << 20]))),
            by_tlast=bool(rng.random() < 0.8),
        )
        if not (self.ends.events or self.ends.duration):
            self.ends = BatchEnds()

    def run(self):
        """Parts of the stream; then a batch that a reset ends."""
        top = self.top
        for number in range(PARTS):
            self.part = f"{self.where}, part {number}"
            if not number:
                self._start()
            rest = self._offer(list(self._packets()))
            under_way = not rest and number + 1 < PARTS and self.rng.random() < 0.7
            self._play(results=not under_way)
            if rest:
                break
            if number + 1 < PARTS:
                self._rewrite(under_way)
        top.backend.top.run(SETTLED)  # words behind the last result may still be inside
        found = top.counters()
        for name, count in self.counts.items():
            equal(self.part, f"counter {name}", found[name], count, "model")
        if rest:  # what stop() ends
            self._expect((*np.array(rest, np.int64).T, False))
        for result in top.stop():
            self._take(result)
        equal(self.part, "results", self.found, len(self.expected), "model")
        if self.regions:
            top.write_regions(self.regions)
        self._start()
        top.backend.top.send(next(self._packets()))
        top.backend.top.run(int(np.exp(self.rng.uniform(0, np.log(20_000)))))
        top.reset()

    def _start(self):
        ends = {"events": self.ends.events, "duration_us": self.ends.duration, "by_tlast": self.ends.by_tlast}
        self.top.start(settings=self.settings, form=self.form, swap=self.swap, **ends)

    def _packets(self):
        """Words of a few packets; in some of them words that no camera sends."""
        config, rng = self.config, self.rng
        for _ in range(int(rng.integers(1, 5))):
            if self.regions:
                events = events_of(config, rng, self.regions)
            else:
                events = random_events(config, rng, self.core.follower.next_corner)[1]
            words = self._vectors(events) if self.form == "EVT30" else encode(events, self.form)
            if rng.random() < 0.3 or not len(words):
                places = rng.integers(len(words) + 1, size=3)
                words = np.insert(words, places, rng.integers(1 << 64, size=3, dtype=np.uint64))
            yield swap_halves(words) if self.swap else words

    def _vectors(self, events):
        """EVT 3.0 at one's own times: an event, or vectors that begin with it, often of the row before."""
        rng, words = self.rng, []
        for x, y in zip(events.x.tolist(), events.y.tolist(), strict=True):
            if rng.random() < 0.4 or not words:
                self.time += int(rng.integers(1, 30)) if rng.random() < 0.95 else int(rng.integers(20_000))
                words += [TIME_HIGH << 12 | self.time >> 12 & 0xFFF, Evt3.TIME_LOW << 12 | self.time & 0xFFF]
            if rng.random() < 0.5 or len(words) == 2:
                words.append(y)
            count = int(rng.integers(4))
            masks = rng.integers(1 << 12, size=count) | (rng.random(count) < 0.3) * 0xFFF
            kinds = rng.choice([Evt3.VECTOR_12, Evt3.VECTOR_8], count) << 12
            words += [(Evt3.BASE if count else Evt3.X) << 12 | x, *(masks | kinds).tolist()]
        return np.array(words + [0xF000] * (-len(words) % 4), "<u2").view("<u8").astype(np.uint64)

    def _offer(self, packets):
        """Put them into the queue; returns the events behind the last batch's end."""
        for words in packets:
            self.top.backend.top.send(words)
            self.beats += to_beats(words)
        tokens, self.counts = decode(self.config, self.beats, self.form, swap=self.swap)
        passed, gated = sensor_gate(self.config, tokens)
        batches, rest, empty = split_batches(self.config, passed, self.ends)
        self.counts |= {**gated, "empty_ends": empty, "batches": len(batches)}
        for batch in batches[len(self.expected) :]:
            self._expect(batch)
        return rest

    def _expect(self, batch):
        *columns, cut = batch
        self.expected.append(self.model.run(*columns, self.settings, cut=cut and self.config.slices == 1))
        self.settings = dataclasses.replace(self.settings, roi=None)  # it is loaded once

    def _play(self, results):
        """Run under random stalls of both streams, until all results have come, or all events were taken in."""
        simulated, rng, stalls = self.top.backend.top, self.rng, self.rng.random() < 0.5
        limit = simulated.cycles + CYCLES
        waits = functools.partial(self.top.control.status, "EVENTS_WAITING")
        while simulated.unsent or (self.found < self.counts["batches"] if results else waits()):
            if stalls:
                simulated.limit(send=int(rng.integers(0, 9)), words=int(rng.integers(0, 9)))
            simulated.run(int(rng.integers(1, 60)) if stalls else 500)
            with contextlib.suppress(DeviceTimeout):
                while True:
                    self._take(self.top.receive(0))
            if simulated.cycles > limit:
                raise MismatchError(
                    f"{self.part}: {self.found} of {self.counts['batches']} results after {CYCLES} clock cycles, "
                    f"{simulated.unsent} words not taken: {self.top.control.diagnosis()}"
                )
        simulated.limit()
        simulated.run(0)

    def _take(self, found):
        if self.found >= len(self.expected):
            raise MismatchError(f"{self.part}: a result of {found.events} events more than the model has")
        same(f"{self.part}, batch {self.found}", found, self.expected[self.found], traced=False)
        self.found += 1

    def _rewrite(self, under_way):
        """Other settings and tables. With a batch under way no more than one row of a table may wait."""
        settings = random_settings(self.config, self.rng, (0, 0))[0]
        if under_way:
            settings = dataclasses.replace(settings, camera=self.settings.camera, hot_mask=self.settings.hot_mask)
        if self.regions:
            if under_way:
                settings = dataclasses.replace(settings, cold=self.settings.cold, warm=self.settings.warm)
            self._write_regions(some_changed(self.config, self.rng, self.regions))
            if under_way:  # the driver would not let a row wait
                control = self.top.control
                for row in control.table.changes(settings)[0]:
                    control.write_row("row", dict(zip(control.table.names, row, strict=True)))
        self.settings = settings
        ends = {"batch_events": self.ends.events, "duration": self.ends.duration, "by_tlast": self.ends.by_tlast}
        self.top.control.write_settings(settings, ends)

    def _write_regions(self, regions):
        self.regions = regions
        self.top.write_regions(regions)
        self.model.write(regions)
