"""Engines: the same batches through the emitted Verilog, the integer model, or the float reference.

Their contract, :class:`Engine`: a table of regions, events in, results out.
"""

import contextlib
import dataclasses
import operator
import pkgutil
from abc import ABC, abstractmethod

from ..config import DEFAULT_PRESET, SLIDING_PRESET, preset
from ..config.presets import ENGINES
from ..errors import ConfigError, needs
from ..protocol.regions import Region
from ..protocol.results import BatchResult
from ..protocol.settings import BatchSettings, clamp_roi
from ..protocol.trace import Trace
from ..verilog.compiler import CompilerError, cannot_compile

#: The accelerator as a board has it, in Verilator: the core with its decoders, registers and packets around it; and a
#: board at a serial port, named behind a colon: ``serial:/dev/ttyUSB0``.
AXI, SERIAL = "axi", "serial"

#: ``module:function`` that makes an engine of a configuration. It is loaded when it is asked for: only some need torch,
#: and the accelerator's lies above this package.
_MAKERS = {
    "rtl": "cmfpga.engines:_make_rtl_engine",
    AXI: "cmfpga.driver.simulation:simulated_engine",
    SERIAL: "cmfpga.driver.uart:serial_engine",
    "model": "cmfpga.engines.model:ModelEngine",
    "float": "cmfpga.engines.model:FloatEngine",
}

#: Engines whose windows can slide.
_SLIDING = ("rtl", "model")
#: A sensor on which any ROI that a sensor has finds its place, px.
_LARGEST = {"sensor_width": 1280, "sensor_height": 800}


def check_roi(config, roi, pixel=1):
    """Raise :exc:`ConfigError` unless an ROI with its left column and top row at ``roi`` lies on the sensor.

    Of hardware with binning ``roi`` is in the image's pixels, or with its ``pixel`` in the sensor's.
    """
    try:
        x, y = map(operator.index, roi)
    except (TypeError, ValueError):
        raise ConfigError(f"roi = {roi!r}: left column and top row, two whole numbers, are needed") from None
    if clamp_roi(config, (x // pixel, y // pixel))[1]:
        most = config.geometry.roi_x_max * pixel, config.geometry.roi_y_max * pixel
        size = config.roi_width * pixel, config.roi_height * pixel
        sensor = config.geometry.size if config.pixel > pixel else (config.sensor_width, config.sensor_height)
        raise ConfigError(
            f"ROI at {x},{y}: 0,0 to {most[0]},{most[1]} is needed for {size[0]}×{size[1]} px on a sensor of "
            f"{sensor[0]}×{sensor[1]} px"
        )


def check_events(config, events):
    """Events outside the sensor would be taken for others: the hardware only has the bits that the sensor needs."""
    for name, values, size in (("x", events.x, config.sensor_width), ("y", events.y, config.sensor_height)):
        if len(values) and values.max() >= size:
            raise ConfigError(
                f"{name} of an event is {values.max()}: 0 to {size - 1} is allowed on a sensor of "
                f"{config.sensor_width}×{config.sensor_height} px (sensor_width, sensor_height)"
            )


def batches_of(config):
    """The configuration that takes batches where ``config`` has windows; others as they are."""
    return config.replace(windows="batches", buffers=2, when_full="thin") if config.slides else config


class Engine(ABC):
    """Runs events, and keeps what the hardware keeps between runs: v and place of each region of its table.

    A core of one ROI has a table of one row. That row is as large as the image, and it moves
    (:meth:`Region.roi <cmfpga.protocol.regions.Region.roi>`); after a reset it lies at 0, 0.

    ``config`` shapes the hardware; run-time values come with each run.
    """

    name = ""  #: as on the command line
    note = ""  #: what the user should know about how this engine runs; may be empty
    result, traced = BatchResult, True  # kind of the results, and whether they have a trace

    def __init__(self, config):
        self.config, self._batches = config, None
        self.regions = []  #: the table: list of Region
        #: Clock cycles of the last run, of all its regions; None without a clock, or without events.
        self.cycles = None
        self.forget()

    def forget(self):
        """Return to the state after a reset: each row where it was written, a core's ROI at 0, 0."""
        if not self.config.regions:
            self.regions = [Region.roi(self.config, (0, 0))]
        #: Left column and top row, px, with which each region crops the next events.
        self.places = [(row.x, row.y) for row in self.regions]
        self._last, self._loads, self._begun = [None] * len(self.regions), False, None

    def write(self, regions, anew=()):
        """Replace the table of regions, between runs.

        A row that changes, or whose number is in ``anew``, forgets what it measured and where it moved to. Raises
        :exc:`ConfigError`: the hardware cannot hold a row.
        """
        regions = list(regions)
        fresh = {k for k, row in enumerate(regions) if k in anew or self.regions[k : k + 1] != [row]}
        if self.config.regions:
            self._write(regions, anew)
        elif regions and regions == [Region.roi(self.config, place := (regions[0].x, regions[0].y))]:
            check_roi(self.config, place)
            self._loads |= bool(fresh)
        else:
            raise ConfigError("regions = 0: the table has one row, which is as large as the ROI, and moves")
        self.places = [(row.x, row.y) if k in fresh else self.places[k] for k, row in enumerate(regions)]
        self._last += [None] * (len(regions) - len(self._last))
        self.regions = regions

    def run(self, events, settings):
        """Process events: one batch; with ``slices`` one slice; where windows slide any number.

        ``settings``, a :class:`~cmfpga.protocol.settings.BatchSettings`, are run-time inputs. ``roi`` writes the row of
        a core of one ROI anew. A table of regions reads neither that nor ``thinning``, ``thin_target`` and
        ``start_last``. Where windows slide, all are taken over when the row is written anew, and from then on
        :data:`~cmfpga.protocol.settings.LENGTHS` alone: the next hop has them.

        Returns
        -------
        list of BatchResult
            In the order of their last events, each with an outcome for each region. A batch has one. That of a slice
            is its window's, of the last so many slices. Where windows slide there is one of each hop that ends with
            these events; they go on where the last ones ended, unless the row is written anew. An accelerator's
            results have no trace.

        Raises
        ------
        ConfigError
            There are more events than the hardware counts to, or an event or the ROI lies outside the sensor.
        """
        config, limit = self.config, self.config.slice_events
        if len(events) > limit and not config.slides:
            raise ConfigError(f"a batch of {len(events)} events: at most {limit} are allowed (max_batch_events)")
        check_events(config, events)
        if settings.roi is not None and not config.regions:
            self.write([Region.roi(config, settings.roi)], {0})
        self.cycles = None
        if not len(events):
            return [] if config.slides else [self._nothing()]
        if config.slides:
            if self._begun and not self._loads:
                settings = self._begun.with_lengths(settings)
            self._begun = settings
        results = self._run(events, dataclasses.replace(settings, roi=self.places[0] if self._loads else None))
        self._loads = False
        if not results:
            return results
        self._last = list(results[-1].regions)
        self.places = [one.roi_next for one in self._last]
        if not config.regions:
            self.cycles = results[-1].cycles
        return results

    def trial(self, events, settings):
        """:meth:`run`, of a batch whose length is tried: where windows slide by hardware that takes batches."""
        if not self.config.slides:
            return self.run(events, settings)
        if self._batches is None:
            self._batches = type(self)(batches_of(self.config))
        self._batches.write(self.regions, {0})
        return self._batches.run(events, BatchSettings.from_config(self._batches.config))

    def _nothing(self):
        """The result of no events, which never reach the hardware."""
        rows, still = [], (0.0,) * len(self.config.motion_model.names)
        for place, last in zip(self.places, self._last, strict=False):
            path = tuple(last.trace.v[-1].tolist()) if last and last.trace else (0,) * len(still)
            trace = Trace.without_iterations(self.config, path) if self.traced else None
            rows.append({"roi": place, "roi_next": place, "v": last.v if last else still, "trace": trace})
        return self.result.nothing(*rows)

    def _write(self, regions, anew):
        """Replace the hardware's table; of hardware that has one."""
        raise NotImplementedError

    @abstractmethod
    def _run(self, events, settings):
        """Checked events, at least one; ``settings.roi`` where a core of one ROI loads it."""

    def close(self):
        """Release what the engine holds."""
        if self._batches is not None:
            self._batches.close()


def engine_name(text):
    """``text``, if it names an engine; :exc:`ConfigError` otherwise."""
    kind, colon, port = text.partition(":") if isinstance(text, str) else (None, "", "")
    if kind not in _MAKERS or bool(port) != (kind == SERIAL) or (colon and not port):
        raise ConfigError(f"engine {text!r}: one of {', '.join((*ENGINES, AXI))}, {SERIAL}:PORT is needed")
    return text


def make_engine(name, config):
    """The engine ``rtl``, ``axi``, ``model``, ``float``, or ``serial:PORT`` for ``config``.

    ``rtl`` compiles the emitted Verilog, or, where Verilator or a C++ compiler is missing, uses Amaranth's simulator
    (its ``note`` says so). ``axi`` needs both; its results have no trace, and neither have those of a board at a
    serial port. Only ``model`` and ``float`` import torch.
    """
    kind, _, port = engine_name(name).partition(":")
    return pkgutil.resolve_name(_MAKERS[kind])(config, *([port] if port else []))


def preload(name):
    """Import what an engine needs, before events wait for it; says nothing where that is missing."""
    with contextlib.suppress(ImportError):
        pkgutil.resolve_name(_MAKERS[engine_name(name).partition(":")[0]])


def _make_rtl_engine(config):
    """The emitted Verilog compiled by Verilator, or Amaranth's simulator where that or a C++ compiler is missing."""
    from .rtl import AmaranthEngine, VerilatedEngine

    why = cannot_compile()
    if not why or config.regions:
        try:
            return VerilatedEngine(config)
        except CompilerError as error:
            if config.regions:
                raise
            why = str(error)
    if config.slides:
        raise ConfigError(f"windows = sliding: engine rtl needs a C++ compiler: {why}; engine model needs none")
    return AmaranthEngine(config, why)


def open_engine(name, config, *, option="engine"):
    """:func:`make_engine`, where a missing torch is the user's to mend; ``option`` is what chose it."""
    with needs("torch", "reference", f"{option} {name}"):
        return make_engine(name, config)


def usual_preset(given, *, batches=False, engine="rtl", objects=1):
    """The preset of a track that names none: that whose windows slide, unless batches are asked for or needed.

    ``given`` are the fields that the user gives; ``batches``: the user asks for them. Returns the preset, and a note
    for the user where windows cannot slide, or None.
    """
    if batches:
        return DEFAULT_PRESET, None
    why = None
    if engine not in _SLIDING:
        why = f"engine {engine} has no windows that slide"
    elif objects > 1:
        why = "several objects share them"
    elif engine == "rtl" and cannot_compile():
        why = f"windows that slide need a C++ compiler, or engine model: {cannot_compile()}"
    else:
        try:
            config = preset(SLIDING_PRESET).replace(**_LARGEST | given)
            if not (config.confidence and config.judge):
                why = "how long windows are follows from the confidence, which is not measured"
        except ConfigError as error:
            why = str(error)
            try:
                preset(DEFAULT_PRESET).replace(**_LARGEST | given)
            except ConfigError:  # batches don't mend it: who makes the configuration says why
                return DEFAULT_PRESET, None
    return (DEFAULT_PRESET, f"in batches: {why}") if why else (SLIDING_PRESET, None)
