"""Engines of hardware with a table of regions: the same batches through the emitted Verilog, the models, float64."""

import pkgutil

from ..errors import ConfigError
from .base import check_events

#: ``module:function`` that makes hardware of a configuration: the emitted core, or the accelerator as a board has it.
_HARDWARE = {
    "rtl": "cmfpga.verilog.simulation.regions:VerilatedRegions",
    "axi": "cmfpga.driver.simulation:simulated_regions",
}
#: ``module:class`` of what ascends, by the engine's name.
_CORES = {
    "model": "cmfpga.reference.integer.core:IntegerCore",
    "float": "cmfpga.reference.float_core:FloatCore",
}
ENGINES = (*_HARDWARE, *_CORES)


class RegionEngine:
    """Runs batches, one after the other, and keeps what the hardware keeps between them: each region's v and place.

    Parameters
    ----------
    name : str
        One of :data:`ENGINES`.
    config : Config
        With ``regions``.
    hardware : object, optional
        What runs the batches, where it is there already: with ``write``, ``run`` and ``cycles`` as those of
        :class:`~cmfpga.verilog.simulation.regions.VerilatedRegions`.

    Attributes
    ----------
    note : str
        What the user should know about how this engine runs; may be empty.
    """

    def __init__(self, name, config, hardware=None):
        if name not in ENGINES:
            raise ConfigError(f"engine {name!r}: one of {', '.join(ENGINES)} is needed where there are regions")
        if not config.regions:
            raise ConfigError("regions = 0: hardware with regions of 1 or more is needed")
        self.name, self.config, self.note = name, config, ""
        if hardware is not None:
            self._hardware = hardware
        elif name in _HARDWARE:
            self._hardware = pkgutil.resolve_name(_HARDWARE[name])(config)
        else:
            import torch

            from ..reference.regions import RegionSequence

            torch.set_num_threads(1)
            self._hardware = RegionSequence(pkgutil.resolve_name(_CORES[name])(config))

    def write(self, regions, anew=()):
        """Replace the table of regions by these :class:`~cmfpga.protocol.regions.Region`; between batches.

        A row that changes, or whose number is in ``anew``, forgets what was measured, and where it moved to. Raises
        :exc:`ConfigError`.
        """
        self._hardware.write(regions, anew)

    def run(self, events, settings):
        """One batch of at least one event: a :class:`BatchResult` with an outcome for each row of the table.

        With ``slices`` it is a slice, and the result that of the window of the last so many, of fewer at the begin.

        Parameters
        ----------
        events : Events
        settings : BatchSettings
            Run-time inputs; ``roi``, ``thinning``, ``thin_target`` and ``start_last`` mean nothing here.

        Raises
        ------
        ConfigError
            The batch is larger than the store, or an event lies outside the sensor.
        """
        limit = self.config.slice_events
        if not 1 <= len(events) <= limit:
            raise ConfigError(f"a batch of {len(events)} events: 1 to {limit} are allowed (max_batch_events)")
        check_events(self.config, events)
        return self._hardware.run(events.t, events.x, events.y, settings)

    @property
    def cycles(self):
        """Of the last batch, from the offer of its first event to its last result; None without a clock."""
        return getattr(self._hardware, "cycles", None)

    def close(self):
        """Release what the engine holds."""
        if hasattr(self._hardware, "close"):
            self._hardware.close()
