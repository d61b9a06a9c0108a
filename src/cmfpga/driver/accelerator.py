"""The accelerator: batches in, velocities out, by registers and streams."""

import contextlib
import time

import numpy as np

from ..config.windows import needs_batches
from ..errors import ConfigError, DeviceError, DeviceTimeout
from ..protocol.settings import BatchSettings
from .control import Control, identify
from .engine import POLL_SECONDS, AcceleratorEngine, result_of

#: Seconds that a time-out may have.
LONGEST_SECONDS = 86_400


class Accelerator:
    """One AXI top, whatever leads to it.

    Making one checks that the hardware is what the configuration says, and puts it into its state after a reset.

    Parameters
    ----------
    backend : Backend
        Closed by :meth:`close`.
    config : Config, optional
        Of the hardware; its run-time fields are the settings of the batches. By default what the back end simulates,
        or whichever preset the hardware says it is.
    form : str, optional
        Words that :meth:`run` encodes events into: a key of :data:`cmfpga.protocol.registers.FORMATS`; by default what
        suits the back end. ``EVT30`` needs hardware with ``evt3``, and times that do not step back.
    timeout : float
        Seconds that anything may take, where a method is not told another time.
    interrupt : bool, optional
        Wait by the interrupt, or look at the registers now and then; by default the interrupt where there is one.

    Attributes
    ----------
    registers : RegisterMap
    engine : cmfpga.engines.Engine
        The same as an engine of :mod:`cmfpga.engines`, for :func:`cmfpga.tracking.loop.track`.

    Raises
    ------
    WrongHardware
        The hardware is something else: which, and what was expected.
    DeviceError, DeviceTimeout
        It does not answer, or does not become quiet.
    """

    def __init__(self, backend, config=None, *, form=None, timeout=10.0, interrupt=None):
        if interrupt and not backend.has_interrupt:
            raise DeviceError(f"{backend.name}: there is no interrupt to wait for; interrupt=False does without")
        self.backend = backend
        self.config = identify(backend, config)
        self.control = Control(backend, self.config)
        self.registers = self.control.registers
        self.timeout = self._seconds(timeout)
        self.interrupt = backend.has_interrupt if interrupt is None else interrupt
        self.form = form or backend.form
        self.control.check_form(self.form)
        self.engine = AcceleratorEngine(self)
        self.reset()

    # ---------------------------------------------------------------- batch by batch

    def run(self, events, *, roi=None, settings=None, timeout=None):
        """Process one batch; where windows slide, events of a run, which goes on unless an ROI is given.

        Parameters
        ----------
        events : Events
            All events of the batch, or any that follow those of the run, in order of time.
        roi : pair of int, optional
            Left column and top row of the ROI, px; by default where the last batch moved it. Means nothing to a table
            of regions.
        settings : BatchSettings, optional
            Instead of ``roi`` and the configuration's run-time fields.
        timeout : float, optional
            Seconds.

        Returns
        -------
        WireResult
            With an outcome for each region; where windows slide a list, of each hop that closed.

        Raises
        ------
        ConfigError
            An event or the ROI lies outside the sensor, or the batch is larger than the hardware counts to.
        DeviceTimeout, DeviceError
            No result came. The hardware was reset: v is 0 and the ROI at 0, 0, as at the begin.
        """
        settings = settings or BatchSettings.from_config(self.config, roi)
        with self._other_timeout(timeout):
            results = self.engine.run(events, settings)
        return results if self.config.slides else results[0]

    def write_regions(self, regions, anew=()):
        """Replace the table of regions by these :class:`~cmfpga.protocol.regions.Region`; the next batch is theirs.

        A row that changes, or whose number is in ``anew``, forgets what was measured, and where it moved to. Raises
        :exc:`ConfigError`: a row that the table cannot hold.
        """
        self.engine.write(regions, anew)

    def track(self, recording, *, roi, batches=None, start_event=0, consumers=(), every=1, **size):
        """Follow an object through a recording, an event source or a path.

        Yields each :class:`~cmfpga.tracking.loop.TrackedBatch`, as :func:`cmfpga.tracking.loop.track` does with the
        same options. One of ``events``, ``duration_us`` and ``roi_events`` says what makes a batch complete
        (:class:`cmfpga.events.BatchCutter`). Without, batches suit the motion
        (:func:`cmfpga.tracking.fit.batch_cutter`).
        """
        from ..tracking.fit import batch_cutter
        from ..tracking.loop import track
        from ..tracking.source import Source

        with contextlib.ExitStack() as stack:
            source = Source(recording).open(stack)
            most = self.backend.max_words // 2  # at most two words an event
            cutter = batch_cutter(source, self.config, start_event=start_event, most=most, **size)
            yield from track(self.engine, cutter, roi=roi, batches=batches, consumers=consumers, every=every)

    # ---------------------------------------------------------------- streams

    def start(
        self, *, roi=None, events=0, roi_events=0, duration_us=0, by_tlast=False, every=1, form=None, swap=False,
        settings=None,
    ):  # fmt: skip
        """Process batch after batch, or hop after hop, of whatever comes on ``s_axis``, until :meth:`stop`.

        Parameters
        ----------
        roi : pair of int, optional
            Of the first batch.
        events, roi_events, duration_us : int
            What ends a batch: so many events, stored ROI events, or µs; 0: not this. At least one of them, or
            ``by_tlast``; none where windows slide.
        by_tlast : bool
            End a batch also at TLAST, which :meth:`send` and a DMA set at the end of each transfer.
        every : int
            Where windows slide: send the first of so many results.
        form : str, optional
            What comes: a key of :data:`cmfpga.protocol.registers.FORMATS`.
        swap : bool
            Its 32-bit halves are exchanged, as an IMX636 does.
        settings : BatchSettings, optional
            Instead of ``roi`` and the configuration's run-time fields.
        """
        self.check_batchwise()
        ends = {"batch_events": events, "batch_roi_events": roi_events, "duration": duration_us, "by_tlast": by_tlast}
        if self.config.slides:
            if any(ends.values()):
                needs_batches(self.config, "what ends a batch")
            ends = {"every": every}
            self.stop()
        elif every != 1 or not any(ends.values()):
            raise ValueError("what ends a batch: one of events, roi_events, duration_us, by_tlast is needed; no every")
        settings = settings or BatchSettings.from_config(self.config, roi)
        self.control.write_input(form or self.form, swap, self.timeout)
        self.control.write_settings(settings, ends)
        self.control.write("CTRL", START=1, AUTO_RESTART=not self.config.slides, DONE=1)
        self._streaming, self._every = True, every

    def send(self, words, timeout=None):
        """Send words to ``s_axis``, once those before them have been taken (:func:`cmfpga.protocol.words.encode`)."""
        words = np.ascontiguousarray(words, np.uint64)
        timeout = self._seconds(timeout)
        for first in range(0, len(words), self.backend.max_words):
            self.backend.wait_sent(timeout)
            self.backend.send(words[first : first + self.backend.max_words])

    def results(self, count, timeout=None):
        """The next ``count`` results, each a :class:`WireResult`, as they come.

        Raises :exc:`DeviceTimeout`: one did not come in time; the others stay.
        """
        timeout = self._seconds(timeout)
        for _ in range(count):
            yield self.receive(timeout)

    def stop(self, timeout=None):
        """End :meth:`start`: end the batch, or the run, under way with the events that have come, begin no other.

        Returns the list of results that were not fetched. Words that no batch took are forgotten, and with them
        counters, v and the ROI; with slices always.
        """
        deadline = time.monotonic() + self._seconds(timeout)
        self.control.write("CTRL")  # begin no other
        if self.control.status("TAKING_IN"):
            self.control.write("CTRL", END_BATCH=1)
        found = []
        while self.control.status("COMPUTING") or self.control.status("RESULT_WAITING"):
            with contextlib.suppress(DeviceTimeout):
                found.append(self.receive(POLL_SECONDS))
            self._check_time(deadline, "the batch under way did not end")
        with contextlib.suppress(DeviceTimeout):  # those that came before, and were not fetched
            while True:
                found.append(self.receive(0))
                self._check_time(deadline, "results do not end")
        self._streaming, self._every = False, 1
        if self.config.slices > 1 or self.control.status("EVENTS_WAITING") or not self.sent():
            self.reset()
        return found

    def sent(self):
        """Whether all words were taken."""
        with contextlib.suppress(DeviceTimeout):
            self.backend.wait_sent(0)
            return True
        return False

    def check_batchwise(self):
        """Raise :exc:`DeviceError` where batches are processed since :meth:`start`."""
        if self._streaming:
            raise DeviceError("batches are processed since start(): stop() first")

    # ---------------------------------------------------------------- state

    def counters(self):
        """``{name: count}`` since the last reset or :meth:`clear_counters`; what is counted: ``registers``' docs."""
        return self.control.counters()

    def clear_counters(self):
        """Set all counters to 0."""
        asked = self.control.read("CTRL")
        self.control.write("CTRL", CLEAR_COUNTERS=1, **{name: asked[name] for name in ("START", "AUTO_RESTART")})

    def status(self):
        """``{name: value}`` of the register STATUS."""
        return {name.lower(): bool(value) for name, value in self.control.read("STATUS").items()}

    def reset(self):
        """State after a hardware reset; :exc:`DeviceTimeout` where the hardware does not become quiet.

        Events, batches under way, v, the ROI and counters are forgotten.
        """
        deadline = time.monotonic() + self.timeout
        self.backend.stop()
        while True:
            self.control.write("GIE")
            self.control.write("CTRL", SOFT_RESET=1, DONE=1)
            while self.control.status("RESULT_WAITING"):  # a packet that has begun is completed
                with contextlib.suppress(DeviceTimeout):
                    self.backend.receive(POLL_SECONDS)
                self._check_time(deadline, "a packet does not end")
            status = self.control.read("STATUS")
            if not any(status[name] for name in ("EVENTS_WAITING", "COMPUTING", "TAKING_IN", "RESULT_WAITING")):
                break
            self.backend.stop()
            self._check_time(deadline, f"the reset has no effect ({self.control.diagnosis()})")
        self.backend.stop()
        self.control.usual_state(interrupt=self.interrupt)
        self._streaming, self._every, self._last_batch = False, 1, 0  # the second: of so many results one is sent
        self.engine.forget()

    def self_test(self, *, timeout=None):
        """Check identity, registers, interrupt, and one batch whose result is known.

        ``{name of the check: what was found}``, in order. Raises :exc:`DeviceError`: the first check that failed.
        """
        from .golden import self_test

        with self._other_timeout(timeout):
            return self_test(self)

    def close(self):
        """Stop, and close the back end."""
        with contextlib.suppress(DeviceError, OSError, ValueError):
            self.control.write("CTRL")
            self.control.write("GIE")
        self.backend.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def receive(self, timeout):
        """The next result: :class:`WireResult`. Raises :exc:`DeviceTimeout`."""
        result = result_of(self.config, self.registers, self.backend.receive(timeout), self.backend.name)
        last, self._last_batch = self._last_batch, result.batch
        if not last < result.batch <= last + self._every:
            raise DeviceError(f"{self.backend.name}: the result of batch {result.batch} came, not of {last + 1}")
        return result

    def late(self, what, more=""):
        """A :exc:`DeviceTimeout` that says what did not happen in time, and what to look at."""
        return DeviceTimeout(f"{self.backend.name}: {what} within {self.timeout:g} s{more}{self.control.hint}")

    def _check_time(self, deadline, what):
        if time.monotonic() > deadline:
            raise self.late(what)

    @contextlib.contextmanager
    def _other_timeout(self, timeout):
        usual, self.timeout = self.timeout, self._seconds(timeout)
        try:
            yield
        finally:
            self.timeout = usual

    def _seconds(self, timeout):
        """A time-out that ends, by default the usual one."""
        timeout = self.timeout if timeout is None else timeout
        if not 0 <= timeout <= LONGEST_SECONDS:
            raise ConfigError(f"time-out {timeout} s: 0 to {LONGEST_SECONDS} s is allowed")
        return timeout
