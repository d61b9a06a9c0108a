"""Waveforms of one batch: a VCD file of what goes between the blocks, and how GTKWave and Surfer show it.

The batch runs through the emitted Verilog by itself, from the ROI and the v that it had in the track. Fixed-point
numbers are written as real numbers, so that every viewer shows them in their units.
"""

import contextlib
import dataclasses
import itertools
import re
from dataclasses import dataclass

import numpy as np
from amaranth.hdl import Const, Shape, Signal
from amaranth.lib import data
from vcd import VCDWriter
from vcd.gtkw import GTKWSave

from ..engines import AXI
from ..errors import ConfigError, naming
from ..protocol.settings import BatchSettings, settings_values
from ..protocol.trace import to_batch_result
from ..rtl.payloads import Fixed
from ..rtl.top import VerilogCore, flatten
from ..verilog.compiler import cannot_compile

#: Top scope of the file.
SCOPE = "cmfpga"

#: Groups that GTKWave shows folded: what does not change while the batch iterates.
CLOSED = ("core", "roi_filter", "thinner", "reciprocal")

#: What only repeats other signals: `block:member`.
LEFT_OUT = re.compile(r"core:(trace|pixels)\w*|ingest_control:settings|\w+:(handover_batch|run_settings)")


@dataclass(frozen=True)
class Probe:
    """One signal of the file, of ``width`` bits, ``fraction`` of which are behind the point.

    ``block`` is as in :attr:`cmfpga.rtl.core.Core.blocks`, ``name`` its member and field without ``payload``.
    """

    block: str
    name: str
    width: int
    signed: bool
    fraction: int

    @property
    def format(self):
        """For people, such as ``Q5.6``; empty for bits and whole numbers."""
        whole = self.width - self.fraction - self.signed
        return f"{'' if self.signed else 'U'}Q{whole}.{self.fraction}" if self.fraction else ""


class WaveCore(VerilogCore):
    """:class:`VerilogCore` with outputs ``wave_0`` … that repeat what goes between its blocks.

    ``probes``, a list of :class:`Probe`, says what each of them is, in the order of data flow.
    """

    def __init__(self, config):
        super().__init__(config)
        self.probes = []
        for block, component in [("core", self), *self.blocks.items()]:
            leaves = list(component.signature.flatten(component))
            members = [path[0] for path, _, _ in leaves]
            # Of a stream, valid and ready stand before what they speak of.
            leaves.sort(key=lambda leaf, members=members: (members.index(leaf[0][0]), leaf[0][-1] == "payload"))
            for path, member, value in leaves:
                self._probe(block, "_".join(str(part) for part in path if part != "payload"), member.shape, value)

    def _probe(self, block, name, shape, value):
        if isinstance(value, Const) or LEFT_OUT.fullmatch(f"{block}:{name}"):
            return
        leaves = {name: ((), shape)}
        if isinstance(value, data.View):
            leaves = flatten(value.shape(), name)
        for leaf, (path, shape) in leaves.items():
            signal = value
            for key in path:
                signal = signal[key]
            fraction = shape.q.f if isinstance(shape, Fixed) else 0
            shape = Shape.cast(shape)
            if block == "core":  # as the emitted Verilog's ports
                leaf = re.sub("^i_", "event_", re.sub("^o_", "result_", leaf))
            probe = Probe(block, leaf, shape.width, shape.signed, fraction)
            port = Signal(shape, name=f"wave_{len(self.probes)}")
            self.probes.append(probe)
            self._links.append((port, signal, False))
            self.outputs[port.name] = port


@dataclass(frozen=True, eq=False)
class Waves:
    """A recorded batch: ``cycles``, ``ports`` and ``values`` as VerilatedCore.take_waves gives them.

    Cycle 0 is that of the batch's first event.
    """

    probes: list
    cycles: np.ndarray
    ports: np.ndarray
    values: np.ndarray

    def ones(self, block, name):
        """Cycles in which a signal becomes 1."""
        port = next(k for k, probe in enumerate(self.probes) if (probe.block, probe.name) == (block, name))
        return self.cycles[(self.ports == port) & (self.values == 1)].tolist()


class WaveTaker:
    """Waits for batch number ``wanted`` of a track by the engine of this name, and records it.

    Raises :exc:`ConfigError` where the engine has other numbers than the hardware, or no trace; or where there is no
    Verilator or C++ compiler.
    """

    def __init__(self, config, engine, wanted):
        if engine == "float":
            raise ConfigError("--wave: the float engine has not the hardware's numbers; rtl or model is needed")
        if engine == AXI:
            raise ConfigError("--wave: the axi engine gives only results, and a trace is needed: take rtl or model")
        if config.background:
            raise ConfigError("--wave: one batch by itself does not know what background = 1 remembers of those before")
        if why := cannot_compile():
            raise ConfigError(f"--wave: {why}; Verilator and g++ or clang++ are needed")
        self.config, self.wanted = config, wanted
        self._found = None

    def add(self, batch):
        """Take one :class:`~cmfpga.tracking.loop.TrackedBatch`, which follows the last one."""
        if batch.index == self.wanted:
            self._found = batch

    def record(self):
        """The :class:`Waves`. Raises :exc:`ConfigError` if the batch never came, or has no events."""
        if self._found is None:
            raise ConfigError(f"--wave {self.wanted}: the track has no such batch")
        if not len(self._found.events):
            raise ConfigError(f"--wave {self.wanted}: the batch has no events, so the hardware never saw it")
        return _record(self.config, self._found)


def _record(config, batch):
    """Run a :class:`~cmfpga.tracking.loop.TrackedBatch` by itself as it ran in the track: :class:`Waves`."""
    from ..verilog.simulation import VerilatedCore

    settings = dataclasses.replace(
        BatchSettings.from_config(config.replace(thinning=batch.thinning, thin_target=0), batch.result.roi),
        start_last=False,
        v_start=tuple(int(axis) for axis in batch.result.trace.v[0]),
        cold=tuple(batch.plan) if config.ascent_rule.has_table else (),
        warm=(),
    )
    core, events = WaveCore(config), batch.events
    with contextlib.closing(VerilatedCore(config, core=core)) as running:
        running.write_tables(settings)
        running.start_waves()
        rows, traces, _ = running.play([(events.t, events.x, events.y)], [settings_values(config, settings)])
        waves = running.take_waves()
    if to_batch_result(config, rows, traces).trace != batch.result.trace:
        raise AssertionError("the batch by itself ran otherwise than in the track")
    return Waves(core.probes, *_from_cycle(Waves(core.probes, *waves).ones("core", "opened")[0], *waves))


def _from_cycle(first, cycles, ports, values):
    """Changes from a cycle on, which becomes cycle 0; what was before it is the state that it begins with."""
    count = int(np.searchsorted(cycles, first, side="right"))
    # Of each port the last change up to then: the first one seen from behind.
    _, behind = np.unique(ports[:count][::-1], return_index=True)
    kept = np.concatenate([count - 1 - behind, np.arange(count, len(cycles))])
    return np.maximum(cycles[kept] - first, 0), ports[kept], values[kept]


def write_waves(waves, folder, name):
    """Write ``name.vcd``, ``name.gtkw`` and ``name.sucl`` into ``folder``; returns their paths.

    In the file a clock cycle lasts 1 ns, so that times are numbers of cycles.
    """
    paths = [folder / f"{name}{suffix}" for suffix in (".vcd", ".gtkw", ".sucl")]
    for path, write in zip(paths, (_write_vcd, _write_gtkw, _write_surfer), strict=True):
        with naming(path), path.open("w") as file:
            write(waves, file, paths[0].name)
    return paths


def _write_vcd(waves, file, _):
    with VCDWriter(file, timescale="1 ns", date="", comment="1 ns is one clock cycle") as writer:
        variables = []
        for probe in waves.probes:
            kind, size = ("real", 64) if probe.fraction else ("wire", probe.width)
            variables.append(writer.register_var(f"{SCOPE}.{probe.block}", probe.name, kind, size=size, init=0))
        # Vectors hold the bits of a negative number, reals its value.
        steps = [2.0**-probe.fraction if probe.fraction else None for probe in waves.probes]
        masks = [(1 << probe.width) - 1 for probe in waves.probes]
        for cycle, port, value in zip(waves.cycles.tolist(), waves.ports.tolist(), waves.values.tolist(), strict=True):
            shown = value & masks[port] if steps[port] is None else value * steps[port]
            writer.change(variables[port], cycle, shown)
        writer.close(int(waves.cycles[-1]) + 1)


def _write_gtkw(waves, file, vcd_name):
    save = GTKWSave(file)
    save.dumpfile(vcd_name, abspath=False)
    save.treeopen(SCOPE)
    save.size(1600, 1000)
    save.sst_expanded(False)
    save.signals_width(340)
    # Markers a, b, c … where the buffer begins to give out the events of an iteration.
    starts = waves.ones("event_buffer", "replay")
    marks = dict(zip("abcdefghijklmnopqrstuvwxyz", starts, strict=False))
    save.zoom_markers(-3.0, starts[0] if starts else 0, **marks)
    save.timestart(max(0, starts[0] - 10) if starts else 0)
    for block, probes in itertools.groupby(waves.probes, lambda probe: probe.block):
        with save.group(block, closed=block in CLOSED):
            for probe in probes:
                suffix = f"[{probe.width - 1}:0]" if probe.width > 1 and not probe.fraction else ""
                shown = "real" if probe.fraction else "signed" if probe.signed else "bin" if probe.width == 1 else "dec"
                alias = f"{probe.name} {probe.format}" if probe.format else None
                save.trace(f"{SCOPE}.{block}.{probe.name}{suffix}", alias=alias, datafmt=shown)


def _write_surfer(waves, file, _):
    """A command file: a divider per block, then its signals."""
    for block, probes in itertools.groupby(waves.probes, lambda probe: probe.block):
        print(f"divider_add {block}", file=file)
        for probe in probes:
            print(f"variable_add {SCOPE}.{block}.{probe.name}", file=file)
            if not probe.fraction and probe.width > 1:
                print(f"item_set_format {'Signed' if probe.signed else 'Unsigned'}", file=file)
