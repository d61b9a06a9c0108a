"""What all engines have in common."""

import dataclasses
import operator
from abc import ABC, abstractmethod

from ..errors import ConfigError
from ..protocol.results import BatchResult
from ..protocol.settings import clamp_roi
from ..protocol.trace import Trace


def check_roi(config, roi):
    """Raise :exc:`ConfigError` unless an ROI with its left column and top row at ``roi`` lies on the sensor."""
    try:
        x, y = map(operator.index, roi)
    except (TypeError, ValueError):
        raise ConfigError(f"roi = {roi!r}: left column and top row, two whole numbers, are needed") from None
    if clamp_roi(config, roi)[1]:
        raise ConfigError(
            f"ROI at {x},{y}: 0,0 to {config.geometry.roi_x_max},{config.geometry.roi_y_max} is needed for "
            f"{config.roi_width}×{config.roi_height} px on a sensor of {config.sensor_width}×{config.sensor_height} px"
        )


def check_events(config, events):
    """Events outside the sensor would be taken for others: the hardware only has the bits that the sensor needs."""
    for name, values, size in (("x", events.x, config.sensor_width), ("y", events.y, config.sensor_height)):
        if len(values) and values.max() >= size:
            raise ConfigError(
                f"{name} of an event is {values.max()}: 0 to {size - 1} is allowed on a sensor of "
                f"{config.sensor_width}×{config.sensor_height} px (sensor_width, sensor_height)"
            )


class Engine(ABC):
    """Runs batches, one after the other, and keeps what the hardware keeps between them: v and the ROI.

    Parameters
    ----------
    config : Config
        Shapes the hardware. Run-time values come with each batch.

    Attributes
    ----------
    name : str
        As on the command line.
    note : str
        What the user should know about how this engine runs; may be empty.
    roi : pair of int
        Left column and top row of the ROI that the next batch will be cut with, if its settings don't move it.
    """

    name = ""
    note = ""

    def __init__(self, config):
        self.config = config
        self.roi = (0, 0)
        self._waiting_roi = None

    def run(self, events, settings):
        """Process one batch.

        Parameters
        ----------
        events : Events
            All events of the batch.
        settings : BatchSettings
            Run-time inputs.

        Returns
        -------
        BatchResult
            Its trace is None from an accelerator, the engine ``axi``: only the result comes over the wire.

        Raises
        ------
        ConfigError
            The batch is larger than the hardware counts to, or an event or the ROI lies outside the sensor.
        """
        limit = self.config.max_batch_events
        if len(events) > limit:
            raise ConfigError(f"a batch of {len(events)} events: at most {limit} are allowed (max_batch_events)")
        check_events(self.config, events)
        if settings.roi is not None:
            check_roi(self.config, settings.roi)
            self.roi = self._waiting_roi = settings.roi
        if not len(events):
            return self._nothing(settings)
        result = self._run(events, dataclasses.replace(settings, roi=self._waiting_roi))
        self._waiting_roi = None
        self.roi = result.roi_next
        return result

    def _nothing(self, settings):
        """A batch without events never reaches the hardware; a new ROI waits for the next one."""
        trace = Trace.without_iterations(self.config, self._trace_v())
        return BatchResult.nothing(roi=self.roi, roi_next=self.roi, v=self.v, trace=trace)

    def _trace_v(self):
        """v as a trace has it."""
        return tuple(self.config.formats.v.raw(axis) for axis in self.v)

    @property
    @abstractmethod
    def v(self):
        """Velocity of the last batch, px per half batch."""

    @abstractmethod
    def _run(self, events, settings):
        """One checked batch of at least one event."""

    def close(self):  # noqa: B027 - most engines hold nothing
        """Release what the engine holds."""
