"""An accelerator as an engine: one batch after the other, each ended by TLAST."""

import contextlib
import time

from ..engines import Engine
from ..errors import DeviceError, DeviceTimeout
from ..protocol.results import WireResult
from ..protocol.words import encode

#: Seconds between two looks where no interrupt says when to look.
POLL_SECONDS = 0.0005


class AcceleratorEngine(Engine):
    """An accelerator with the checks, the empty batches and the ROI of :class:`cmfpga.engines.Engine`.

    Its results are :class:`~cmfpga.protocol.results.WireResult`, which have no trace.

    Parameters
    ----------
    accelerator : Accelerator
    """

    name = "axi"

    def __init__(self, accelerator):
        super().__init__(accelerator.config)
        self._accelerator = accelerator
        self.forget()

    @property
    def v(self):
        return self._v

    def forget(self):
        """The state after a reset."""
        self.roi, self._waiting_roi = (0, 0), None
        self._v = (0.0,) * len(self.config.motion_model.names)

    def _nothing(self, settings):
        return WireResult.nothing(roi=self.roi, roi_next=self.roi, v=self.v)

    def close(self):
        self._accelerator.close()

    def _run(self, events, settings):
        result = transact(self._accelerator, events, settings)
        self._v = result.v
        return result


def transact(top, events, settings, before=()):
    """One batch of an accelerator, whatever its hardware measures: a :class:`WireResult`.

    ``before``: events of each of the slices before this one, where there are slices.

    Raises :exc:`DeviceError`; the accelerator was reset then.
    """
    backend = top.backend
    top.check_batchwise()
    words = encode(events, top.form)
    if len(words) > backend.max_words:
        raise DeviceError(
            f"a batch of {len(words)} words: one transfer of {backend.name} has at most "
            f"{backend.max_words}; smaller batches, or a larger buffer, are needed"
        )
    try:
        if top.control.status("EVENTS_WAITING"):
            raise DeviceError("words that no batch took wait inside: something else sends to s_axis")
        top.control.write_input(top.form, False, top.timeout)
        top.control.write_settings(settings, {"duration": 0, "by_tlast": 1})
        top.control.clear_interrupts()
        top.control.write("CTRL", START=1, DONE=1)
        backend.send(words)
        result = _result(top, len(events))
        backend.wait_sent(top.timeout)
        sent = sum((*before, len(events))[-min(result.batch, top.config.slices) :])
        if result.events != sent:
            raise DeviceError(f"the result is of {result.events} events; {sent} were sent")
    except BaseException:
        with contextlib.suppress(DeviceError):
            top.reset()
        raise
    return result


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
    return DeviceTimeout(
        f"{top.backend.name}: no result within {top.timeout:g} s of a batch of {events} events: "
        f"{top.control.diagnosis()}{top.control.hint}"
    )


def _wait_done(top, events):
    """Until ISR says so, by interrupt or by looking."""
    name = top.backend.name
    deadline = time.monotonic() + top.timeout
    while True:
        left = deadline - time.monotonic()
        came = not top.interrupt or top.backend.wait_interrupt(max(left, 0))
        done = top.control.read("ISR")["DONE"]
        if done and came:
            break
        if done:
            raise DeviceTimeout(
                f"{name}: the result came, but no interrupt within {top.timeout:g} s; "
                f"interrupt=False does without{top.control.hint}"
            )
        if left <= 0:
            raise _no_result(top, events)
        if not top.interrupt:
            time.sleep(min(POLL_SECONDS, left))
    top.control.clear_interrupts()
