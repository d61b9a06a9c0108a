"""Waveforms of one batch: a VCD file of what goes between the blocks, and how GTKWave and Surfer show it.

The batch runs through the emitted Verilog by itself, from the ROI and the v that it had in the track. Fixed-point
numbers are written as real numbers, so that every viewer shows them in their units.
"""

import contextlib
import dataclasses
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
    """One signal of the file.

    Parameters
    ----------
    block, name : str
        As in :attr:`cmfpga.rtl.core.Core.blocks`; member and field, joined by ``_``, without ``payload``.
    width : int
        Bits.
    signed : bool
    fraction : int
        Fraction bits; 0 for a whole number.
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

    Attributes
    ----------
    probes : list of Probe
        What each of them is, in the order of data flow.
    """

    def __init__(self, config):
        super().__init__(config)
        self.probes = []
        for block, component in [("core", self), *self.blocks.items()]:
            leaves = list(component.signature.flatten(component))
            members = [path[0] for path, _, _ in leaves]
            # Of a stream, valid and ready stand before what they speak of.
            for path, member, value in sorted(
                leaves, key=lambda leaf: (members.index(leaf[0][0]), leaf[0][-1] == "payload")
            ):
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
    """A recorded batch.

    Parameters
    ----------
    probes : list of Probe
    cycles, ports, values : int arrays
        See :meth:`cmfpga.verilog.simulation.VerilatedCore.take_waves`. Cycle 0 is that of the batch's first event.
    result : BatchResult
        Of this run; its trace equals that of the track, its ROI moves from whole pixels.
    """

    probes: list
    cycles: np.ndarray
    ports: np.ndarray
    values: np.ndarray
    result: object


class WaveTaker:
    """Waits for one batch of a track, and records it.

    Parameters
    ----------
    config : Config
    engine : str
        Name of the track's engine; ``rtl`` and ``model`` have the hardware's numbers.
    wanted : int
        Number of the batch.

    Raises
    ------
    ConfigError
        The engine has other numbers than the hardware, or no trace; or there is no Verilator or C++ compiler.
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
        return record(self.config, self._found)


def record(config, batch):
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
    again = to_batch_result(config, rows, traces)
    if again.trace != batch.result.trace:
        raise AssertionError("the batch by itself ran otherwise than in the track")
    opened = _cycles_of(core.probes, waves, "core", "opened")[0]
    return Waves(core.probes, *_from_cycle(opened, *waves), again)


def _cycles_of(probes, changes, block, name):
    """Cycles in which a signal becomes 1."""
    cycles, ports, values = changes
    port = next(k for k, probe in enumerate(probes) if (probe.block, probe.name) == (block, name))
    return cycles[(ports == port) & (values == 1)].tolist()


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
    with naming(paths[0]), paths[0].open("w") as file:
        _write_vcd(waves, file)
    with naming(paths[1]), paths[1].open("w") as file:
        _write_gtkw(waves, file, paths[0].name)
    with naming(paths[2]), paths[2].open("w") as file:
        file.writelines(f"{line}\n" for line in _surfer_commands(waves))
    return paths


def _write_vcd(waves, file):
    with VCDWriter(file, timescale="1 ns", date="", comment="1 ns is one clock cycle") as writer:
        variables = []
        for probe in waves.probes:
            kind = "real" if probe.fraction else "wire"
            size = 64 if probe.fraction else probe.width
            scope = f"{SCOPE}.{probe.block}"
            variables.append(writer.register_var(scope, probe.name, kind, size=size, init=0))
        # Vectors hold the bits of a negative number, reals its value.
        steps = [2.0**-probe.fraction if probe.fraction else None for probe in waves.probes]
        masks = [(1 << probe.width) - 1 for probe in waves.probes]
        for cycle, port, value in zip(waves.cycles.tolist(), waves.ports.tolist(), waves.values.tolist(), strict=True):
            shown = value & masks[port] if steps[port] is None else value * steps[port]
            writer.change(variables[port], cycle, shown)
        writer.close(int(waves.cycles[-1]) + 1)


def _groups(probes):
    """``{block: its probes}``, in the order of data flow."""
    found = {}
    for probe in probes:
        found.setdefault(probe.block, []).append(probe)
    return found


def _write_gtkw(waves, file, vcd_name):
    save = GTKWSave(file)
    save.dumpfile(vcd_name, abspath=False)
    save.treeopen(SCOPE)
    save.size(1600, 1000)
    save.sst_expanded(False)
    save.signals_width(340)
    # Markers a, b, c … where the buffer begins to give out the events of an iteration.
    starts = _cycles_of(waves.probes, (waves.cycles, waves.ports, waves.values), "event_buffer", "replay")
    marks = dict(zip("abcdefghijklmnopqrstuvwxyz", starts, strict=False))
    save.zoom_markers(-3.0, starts[0] if starts else 0, **marks)
    save.timestart(max(0, starts[0] - 10) if starts else 0)
    for block, probes in _groups(waves.probes).items():
        with save.group(block, closed=block in CLOSED):
            for probe in probes:
                suffix = f"[{probe.width - 1}:0]" if probe.width > 1 and not probe.fraction else ""
                shown = "real" if probe.fraction else "signed" if probe.signed else "bin" if probe.width == 1 else "dec"
                alias = f"{probe.name} {probe.format}" if probe.format else None
                save.trace(f"{SCOPE}.{block}.{probe.name}{suffix}", alias=alias, datafmt=shown)


def _surfer_commands(waves):
    """A command file for Surfer: a divider per block, then its signals."""
    for block, probes in _groups(waves.probes).items():
        yield f"divider_add {block}"
        for probe in probes:
            yield f"variable_add {SCOPE}.{block}.{probe.name}"
            if not probe.fraction and probe.width > 1:
                yield f"item_set_format {'Signed' if probe.signed else 'Unsigned'}"
