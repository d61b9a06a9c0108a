"""What the AXI top must give, by the models: wire, batches, integer core."""

import numpy as np
import torch

from cmfpga.events.arrays import Events
from cmfpga.imaging.camera import node_writes
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import COUNTS, fields_of
from cmfpga.protocol.settings import schedule_table, settings_values
from cmfpga.protocol.shapes import leaves
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.wire import BatchEnds, decode, sensor_gate, split_batches

torch.set_num_threads(1)


def links(config, settings, ends=None):
    """Settings by the registers' links, with the tables of schedules and of a camera's nodes."""
    values = settings_values(config, settings)
    ends = ends or BatchEnds()
    values |= {"batch_events": ends.events, "duration": ends.duration, "by_tlast": int(ends.by_tlast)}
    if config.ascent_rule.has_table:
        values["schedule"] = schedule_table(config, settings)
    if settings.camera:
        values["nodes"] = node_writes(config, settings.camera)
    return values


class Expected:
    """The integer core behind the models of the wire; counts as the hardware's counters do."""

    def __init__(self, config):
        self.config = config
        self.core = IntegerCore(config)
        self.totals = dict.fromkeys(
            (*COUNTS, "batches", "degenerate", "cut", "doubtful", "restarted", "events_taken",
             "events_in", "before_time", "out_of_sensor",
             "format_errors", "other_words", "time_high_back", "empty_ends"), 0
        )  # fmt: skip

    def receive(self, beats, form, ends=None, *, swap=False):
        """Batches of a stream, and the events behind the last end."""
        tokens, counts = decode(self.config, beats, form, swap=swap)
        passed, gated = sensor_gate(self.config, tokens)
        batches, rest, empty = split_batches(self.config, passed, ends or BatchEnds())
        for name, count in (counts | gated).items():
            self.totals[name] += count
        self.totals["empty_ends"] += empty
        self.totals["events_taken"] += sum(len(t) for t, *_ in batches)
        return batches, rest

    def result(self, batch, settings, *, wire=0, config_range=0):
        """A result's values, less ``cycles``."""
        t, x, y, cut = batch
        found = self.core.run(t, x, y, settings, cut=cut)
        counts = {name: getattr(found, name) for name in COUNTS}
        assert found.events == sum(counts.values()) == len(t)
        counts |= {flag.name.lower(): flag in found.flags for flag in (Flag.DOUBTFUL, Flag.DEGENERATE)}
        for name, count in (counts | {"batches": 1, "cut": cut, "restarted": found.restarted or 0}).items():
            self.totals[name] += count
        own = {"batch": self.totals["batches"], "wire": wire, "config_range": config_range}
        return raw_values(self.config, found) | own | {"t_ref": (int(t[0]) + found.span // 2) % (1 << 32)}


def raw_values(config, outcome):
    """``{leaf: raw value}`` of an outcome, less ``cycles``."""
    values = {}
    for field in fields_of("batch", "region", config=config):
        if field.name != "cycles":
            value = getattr(outcome, field.name)
            parts = value if isinstance(value, tuple) else (value,)
            for (leaf, q), part in zip(leaves(field.name, field.shape(config)).items(), parts, strict=True):
                values[leaf] = q.raw(part) if isinstance(part, float) else int(part)
    return values


def same(found, wanted, *, but=()):
    """Assert that values are equal, those named ``but`` left out; ``cycles`` of a result, too, which no model knows."""
    skipped = {*but, "cycles"}
    different = {
        name: f"{found.get(name)}, {wanted.get(name)} is right"
        for name in {*found, *wanted} - skipped
        if found.get(name) != wanted.get(name)
    }
    assert not different, different


def moving_events(config, count, seed, *, t0=1000, step=20):
    """Events of some edges that move over the sensor, and noise; times increase."""
    rng = np.random.default_rng(seed)
    t = t0 + np.cumsum(rng.integers(0, step, count))
    phase = (t - t[0]) / max(1, t[-1] - t[0])
    edges = rng.integers(0, 6, count)
    x = config.sensor_width / 2 + 3 * edges - 9 + 6 * phase + rng.normal(0, 0.4, count)
    y = config.sensor_height / 2 + rng.integers(-8, 8, count) + 3 * phase
    noise = rng.random(count) < 0.3
    x = np.where(noise, rng.integers(0, config.sensor_width, count), x).clip(0, config.sensor_width - 1)
    y = np.where(noise, rng.integers(0, config.sensor_height, count), y).clip(0, config.sensor_height - 1)
    return Events(t, x.astype(int), y.astype(int), rng.integers(0, 2, count))
