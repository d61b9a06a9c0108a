"""An accelerator as an engine: one batch after the other, each ended by TLAST; and the results of packets."""

import collections
import contextlib
import dataclasses
import time

from ..engines import Engine
from ..errors import DeviceError, DeviceTimeout
from ..imaging.camera import seen
from ..imaging.iwe import events_in_roi
from ..protocol.results import WireResult, packet_beats
from ..protocol.settings import BatchSettings
from ..protocol.words import encode, result_values, split_packets

#: Seconds between two looks where no interrupt says when to look.
POLL_SECONDS = 0.0005


class AcceleratorEngine(Engine):
    """An :class:`Accelerator` by the contract of :class:`cmfpga.engines.Engine`, with results of packets."""

    name = "axi"
    result, traced = WireResult, False

    def __init__(self, accelerator):
        super().__init__(accelerator.config)
        self._accelerator = accelerator
        self._sent = collections.deque(maxlen=self.config.slices)  # events of each slice

    def _write(self, regions, anew):
        """What has changed is written with the next batch."""
        self._accelerator.control.table.replace(regions, anew)

    def trial(self, events, settings):
        """A batch whose length is tried; where windows slide a run with one window, of all its ROI events."""
        config = self.config
        if not config.slides:
            return super().trial(events, settings)
        place, size = (self.regions[0].x, self.regions[0].y), (config.roi_width, config.roi_height)
        inside = len(events_in_roi(seen(config, events), place, *size)[0])
        thinning = max(1, -(-inside // config.buffer_events))
        count = max(1, -(-inside // thinning))
        lengths = {"window_events": count, "hop_events": count, "window_us": 0, "hop_us": 0, "thinning": thinning}
        results = self.run(events, dataclasses.replace(BatchSettings.from_config(config, place), **lengths))
        return results[:1] or [self._nothing()]

    def _run(self, events, settings):
        """Raises :exc:`DeviceError`; the accelerator was reset then."""
        top = self._accelerator
        top.check_batchwise()
        words, most = encode(events, top.form), top.backend.max_words
        if len(words) > most and not self.config.slides:
            why = f"one transfer of {top.backend.name} has at most {most}"
            raise DeviceError(f"a batch of {len(words)} words: {why}; smaller batches, or a larger buffer, are needed")
        try:
            return self._slide(events, words, settings) if self.config.slides else self._batch(events, words, settings)
        except BaseException:
            with contextlib.suppress(DeviceError):
                top.reset()
            raise

    def _batch(self, events, words, settings):
        top, control = self._accelerator, self._accelerator.control
        before = control.read("COUNT_BUSY_CYCLES")["VALUE"]
        if control.status("EVENTS_WAITING"):
            raise DeviceError("words that no batch took wait inside: something else sends to s_axis")
        control.write_input(top.form, False, top.timeout)
        control.write_settings(settings, {"duration": 0, "by_tlast": 1})
        control.clear_interrupts()
        control.write("CTRL", START=1, DONE=1)
        top.backend.send(words)
        result = _result(top, len(events))
        top.backend.wait_sent(top.timeout)
        sent = sum((*self._sent, len(events))[-min(result.batch, self.config.slices) :])
        if result.events != sent:
            raise DeviceError(f"the result is of {result.events} events; {sent} were sent")
        self._sent.append(len(events))
        self.cycles = (control.read("COUNT_BUSY_CYCLES")["VALUE"] - before) % (1 << 32)
        return [result]

    def _slide(self, events, words, settings):
        """A result of each hop that closes with these events.

        A run begins where ``settings.roi`` is given, or none is under way; else it goes on, with its settings. Only
        lengths of windows and hops are new.
        """
        top, control, found, before = self._accelerator, self._accelerator.control, [], {}

        def count(name):
            return (control.read(f"COUNT_{name}")["VALUE"] - before.get(name, 0)) % (1 << 32)

        def evaluated():
            if count("EVENTS_IN") != len(events):
                return False
            status = control.read("STATUS")
            return not any(status[name] for name in ("EVENTS_WAITING", "COMPUTING", "RESULT_WAITING"))

        if settings.roi is not None or not control.status("TAKING_IN"):
            top.stop()
            control.write_input(top.form, False, top.timeout)
            control.write_settings(settings, {"every": 1})
            control.write("CTRL", START=1)
        else:
            control.write_lengths(settings)
        control.clear_interrupts()
        before |= {name: count(name) for name in ("EVENTS_IN", "BATCHES")}
        for first in range(0, len(words), top.backend.max_words):
            top.backend.send(words[first : first + top.backend.max_words])
            _fetch(top, found, top.sent, "words were not taken")
        _fetch(top, found, evaluated, "results did not end")
        _fetch(top, found, lambda: len(found) >= count("BATCHES"), "a result was lost")
        if found:
            _wait_done(top, len(events))
        return found

    def close(self):
        self._accelerator.close()


def _fetch(top, found, done, what):
    """Fetch results as they come until it is ``done``; nothing waits for longer than the time-out."""
    deadline = time.monotonic() + top.timeout
    while not done():
        with contextlib.suppress(DeviceTimeout):
            found.append(top.receive(POLL_SECONDS))
            deadline = time.monotonic() + top.timeout
        if time.monotonic() > deadline:
            raise top.late(what, f": {top.control.diagnosis()}")


def _result(top, events):
    """The next one. Of many regions it is fetched while it comes; one ROI's, when it is complete."""
    if not top.config.regions:
        _wait_done(top, events)
        return top.receive(top.timeout)
    try:
        result = top.receive(top.timeout)
    except DeviceTimeout:
        raise _no_result(top, events) from None
    _wait_done(top, events)
    return result


def _no_result(top, events):
    return top.late("no result", f" of a batch of {events} events: {top.control.diagnosis()}")


def _wait_done(top, events):
    """Until ISR says so, by interrupt or by looking."""
    deadline = time.monotonic() + top.timeout
    while True:
        left = deadline - time.monotonic()
        came = not top.interrupt or top.backend.wait_interrupt(max(left, 0))
        done = top.control.read("ISR")["DONE"]
        if done and came:
            break
        if done:
            raise top.late("the result came, but no interrupt", "; interrupt=False does without")
        if left <= 0:
            raise _no_result(top, events)
        if not top.interrupt:
            time.sleep(min(POLL_SECONDS, left))
    top.control.clear_interrupts()


def result_of(config, registers, words, name):
    """The :class:`WireResult` of a packet: a record, or with a table of regions one of each region, in any order.

    Raises :exc:`DeviceError` where it is not whole; ``name`` is who sent it.
    """
    beats = packet_beats(config)
    if len(words) % beats or not 1 <= len(words) // beats <= max(1, config.regions):
        raise DeviceError(f"{name}: a packet of {len(words)} words; {beats} make a result")
    records = [result_values(registers, record) for record in split_packets(registers, words)]
    if config.regions:
        numbers, lasts = [record["region"] for record in records], [record["last"] for record in records]
        if sorted(numbers) != list(range(len(numbers))) or lasts != [0] * (len(lasts) - 1) + [1]:
            raise DeviceError(f"{name}: results of the regions {numbers} came in one packet; one of each is needed")
        records.sort(key=lambda record: record["region"])
    return WireResult.decoded(config, records)
