"""Write all that tb_cmfpga_core.v needs: the core, and what goes in and must come out, from the integer model."""

import dataclasses
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmfpga import __version__, cli
from cmfpga.engines.rtl import settings_values
from cmfpga.errors import ConfigError
from cmfpga.protocol.batch import BatchSettings, Flag, clamp_roi
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog.emit import TOP, emit_verilog

BENCH = Path(__file__).with_name(f"tb_{TOP}.v")
GAP_BITS = 8
STALL_BITS = 16
RESET_BITS = 32
EXAMPLES = (
    "python sim/make_vectors.py --out build/sim",
    "python sim/make_vectors.py --set roi_width=50 --set roi_height=36 --batches 30 --seed 7 --out build/sim",
)


@dataclass(kw_only=True)
class Batch:
    """One batch as it is played into the core."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    settings: BatchSettings
    gaps: np.ndarray  # idle cycles before each event
    stall: int = 0  # clock cycles for which the result is left waiting
    by_count: bool = False  # ends by batch_events, or max_batch_events; no event is marked as the last
    reset_at: float = 0.0  # part of the cycles between the last event and the result after which a reset comes; 0: none


# ---------------------------------------------------------------- batches

KINDS = {}


def kind(function):
    """Register ``function(make, roi)``: a dictionary of a :class:`Batch`'s fields, with ``pixels`` for x and y."""
    KINDS[function.__name__] = function
    return function


class Maker:
    """Makes the batches one after the other; knows where the model's ROI is by then."""

    def __init__(self, config, rng):
        self.config = config
        self.rng = rng
        # Events that a batch may have in the ROI, so that only the batch that shall overflow the buffer does.
        self.n = min(160, max(1, 3 * config.buffer_events // 4))

    def inside(self, n, roi):
        """``n`` random pixels of the ROI."""
        return (
            roi[0] + self.rng.integers(self.config.roi_width, size=n),
            roi[1] + self.rng.integers(self.config.roi_height, size=n),
        )

    def anywhere(self, n):
        """``n`` random pixels of the sensor."""
        return self.rng.integers(self.config.sensor_width, size=n), self.rng.integers(self.config.sensor_height, size=n)

    def mixed(self, n, roi):
        """``n`` pixels, half of them in the ROI for sure."""
        order = self.rng.permutation(n)
        pixels = zip(self.inside(n - n // 2, roi), self.anywhere(n // 2), strict=True)
        return [np.concatenate(axis)[order] for axis in pixels]

    def times(self, n):
        """Rising times, the first anywhere."""
        t = np.cumsum(self.rng.integers(0, 40, size=n)) + int(self.rng.integers(1 << (self.config.time_bits - 1)))
        t[-1] += 1  # no batch without a duration by accident
        return t

    def settings(self, **changes):
        """Settings unlike the batch before."""
        config, rng = self.config, self.rng
        roi = (int(rng.integers(config.geometry.roi_x_max + 1)), int(rng.integers(config.geometry.roi_y_max + 1)))
        fields = {
            "roi": roi if rng.random() < 0.5 else None,
            "iterations": min(config.max_iterations, int(rng.integers(1, 5))),
            "eta": min(config.formats.eta.max, int(rng.choice([1, 500, 1024, 5000, 1 << 20]))),
            "roi_gain": int(rng.integers(config.formats.roi_gain.max + 1)),
            "start_last": bool(rng.random() < 0.5),
            "v_start": tuple(
                int(v) for v in rng.integers(config.formats.v.min, config.formats.v.max + 1, 2) >> rng.integers(0, 9)
            ),
            "min_roi_events": 1,
        }
        return BatchSettings(**{**fields, **changes})

    def make(self, name, roi):
        """A batch of kind ``name``; ``roi`` is where the core's ROI stands."""
        settings = self.settings()
        changes = KINDS[name](self, clamp_roi(self.config, settings.roi or roi)[0])
        x, y = changes.pop("pixels")
        fields = {
            "t": self.times(len(x)),
            "gaps": np.zeros(len(x), np.int64),
            "stall": int(self.rng.integers(4)),
            "settings": dataclasses.replace(settings, **changes.pop("settings", {})),
        }
        return Batch(x=x, y=y, **{**fields, **changes})


@kind
def steady(make, roi):
    """Events in and around the ROI, one per cycle."""
    return {"pixels": make.mixed(make.n, roi)}


@kind
def thinned(make, roi):
    """Only every third ROI event is stored."""
    return {"pixels": make.mixed(make.n, roi), "settings": {"thinning": 3}}


@kind
def hesitant(make, roi):
    """Gaps between the events, and a result that waits for long."""
    gaps = make.rng.integers(0, 6, make.n) * (make.rng.random(make.n) < 0.4)
    gaps[0] = 20
    return {"pixels": make.inside(make.n, roi), "gaps": gaps, "stall": 40}


@kind
def repeated(make, roi):
    """The same few pixels again after 1, 2, … 6 events, for the forwarding, and a step as large as can be."""
    x, y = make.inside(6, roi)
    order = np.concatenate([np.tile(np.arange(distance), 7) for distance in range(1, 7)])[: make.n]
    settings = {"eta": make.config.formats.eta.max, "start_last": False, "v_start": (0, 0)}
    return {"pixels": (x[order], y[order]), "settings": settings}


@kind
def degenerate(make, roi):
    """Fewer ROI events than asked for: neither v nor the ROI changes."""
    least = min(8, make.config.buffer_events)
    return {"pixels": make.inside(max(1, least - 1), roi), "settings": {"min_roi_events": least}}


@kind
def borders(make, roi):
    """Events on both sides of the ROI's border, and a v that throws many of them out."""
    config, rng, n = make.config, make.rng, make.n
    x, y = make.inside(n, roi)
    edge = np.arange(n) % 8
    left, top, right, bottom = roi[0], roi[1], roi[0] + config.roi_width, roi[1] + config.roi_height
    x = np.select([edge == 0, edge == 1, edge == 2, edge == 3], [left - 1, left, right - 1, right], x)
    y = np.select([edge == 4, edge == 5, edge == 6, edge == 7], [top - 1, top, bottom - 1, bottom], y)
    order = rng.permutation(n)
    pixels = np.clip(x, 0, config.sensor_width - 1)[order], np.clip(y, 0, config.sensor_height - 1)[order]
    return {
        "pixels": pixels,
        "settings": {"start_last": False, "v_start": (config.formats.v.max, config.formats.v.min)},
    }


@kind
def reset_in_iterations(make, roi):
    """A reset while the banks hold votes."""
    settings = {"iterations": min(3, make.config.max_iterations)}
    return {"pixels": make.inside(make.n, roi), "settings": settings, "reset_at": make.rng.uniform(0.3, 0.9)}


@kind
def after_reset(make, roi):
    """No ROI is loaded and v is the last one: both must be zero after the reset."""
    return {"pixels": make.inside(make.n, (0, 0)), "settings": {"roi": None, "start_last": True}}


@kind
def overfull(make, roi):
    """More ROI events than the buffer holds."""
    x, y = make.inside(make.config.buffer_events + 10, roi)
    return {"pixels": (x, y), "settings": {"iterations": 1}}


@kind
def odd_times(make, roi):
    """Time stamps that wrap, step back, and lie beyond the span."""
    config, rng = make.config, make.rng
    n = make.n
    t = np.cumsum(rng.integers(0, 40, size=n)) + (1 << config.time_bits) - 10 * n
    t[rng.integers(n, size=4)] -= 300
    t[rng.integers(n // 2, n, size=4)] += 1 << config.span_bits
    return {"pixels": make.mixed(n, roi), "t": t}


@kind
def counted(make, roi):
    """A batch that ends by its length: the largest one, where that does not take long."""
    most = make.config.max_batch_events
    return {"pixels": make.inside(most if most < 3000 else make.n, roi), "by_count": True}


@kind
def nothing_to_iterate(make, roi):
    """T = 0."""
    return {"pixels": make.inside(20, roi), "settings": {"iterations": 0}}


@kind
def one_instant(make, roi):
    """All events at one time: the range that everything is divided by is zero."""
    return {"pixels": make.inside(20, roi), "t": np.full(20, 5)}


@kind
def outside_the_sensor(make, roi):
    """An ROI that is asked for where it does not fit, and followed with the largest gain."""
    config = make.config
    corner = ((1 << config.geometry.x_bits) - 1, (1 << config.geometry.y_bits) - 1)
    gain = config.formats.roi_gain.max
    # The corner is limited to the sensor, so the events have to lie there.
    return {"pixels": make.inside(make.n, clamp_roi(config, corner)[0]), "settings": {"roi": corner, "roi_gain": gain}}


# ---------------------------------------------------------------- memories


def pack(values, widths):
    """One word of a memory: ``values``, the first at the top, each of its number of bits."""
    word = 0
    for value, width in zip(values, widths, strict=True):
        if not -(1 << width >> 1) <= value < 1 << width:
            raise AssertionError(f"{value} does not fit {width} bits")
        word = (word << width) | (value & ((1 << width) - 1))
    return word


def write_memory(path, words, width):
    """A file for ``$readmemh``."""
    digits = -(-width // 4)
    path.write_text("".join(f"{word:0{digits}x}\n" for word in words), encoding="ascii")


class Vectors:
    """The memories' words, filled batch by batch."""

    def __init__(self, config):
        self.config = config
        self.core = VerilogCore(config)
        self.verilog = emit_verilog(self.core)
        self.model = IntegerCore(config)
        self.seen = Flag(0)
        self.widths = {name: len(port) for name, port in {**self.core.inputs, **self.core.outputs}.items()}
        self.words = {"batches": [], "events": [], "results": [], "trace": []}
        event, settings, result = self.names("event_"), self.names("settings_"), self.names("result_")
        self.layouts = {
            "batches": [32, STALL_BITS, RESET_BITS, *(self.widths[name] for name in settings)],
            "events": [GAP_BITS, *(self.widths[name] for name in event)],
            "results": [32, *(self.widths[name] for name in result)],
            "trace": [self.widths[name] for name in self.names("trace_") if not name.startswith("trace_pixels_")],
        }

    def names(self, prefix):
        """Ports that carry values, not valid and ready."""
        return [name for name in self.widths if name.startswith(prefix) and not name.endswith(("_valid", "_ready"))]

    def add(self, batch):
        """Play ``batch`` into the model and append what it needs and gives."""
        config = self.config
        n = len(batch.t)
        if n > config.max_batch_events:
            raise ConfigError(f"max_batch_events = {config.max_batch_events}: a batch of {n} events is made here")
        cut = batch.by_count and n == config.max_batch_events
        result = self.model.run(batch.t, batch.x, batch.y, batch.settings, cut=cut)
        inputs = settings_values(config, batch.settings)
        if batch.by_count and not cut:
            inputs["batch_events"] = n
        cycles = reset_after = 0  # 0: the formula does not hold for a degenerate batch
        if Flag.DEGENERATE not in result.flags:
            work = {"roi_events": result.roi_events, "iterations": result.iterations}
            cycles = self.core.cycles(events=n + int(batch.gaps[1:].sum()), **work)
            reset_after = int(batch.reset_at * self.core.cycles(events=0, **work))
        time_mask = (1 << config.time_bits) - 1
        for k in range(n):
            last = k == n - 1 and not batch.by_count
            self._put("events", batch.gaps[k], batch.t[k] & time_mask, batch.x[k], batch.y[k], last)
        trace = result.trace
        rows = np.column_stack([trace.v[:-1], trace.sum_i, trace.sum_d, trace.s])
        for row in rows:
            self._put("trace", *row)
        settings = [inputs[name.removeprefix("settings_")] for name in self.names("settings_")]
        self._put("batches", n, batch.stall, reset_after, *settings)
        outputs = {
            **{
                name: getattr(result, name)
                for name in ("span", "events", "roi_events", "outside", "overflow", "thinned")
            },
            **{name: getattr(result, name) for name in ("time_back", "time_span", "iterations")},
            "v_x": trace.v[-1][0],
            "v_y": trace.v[-1][1],
            "t_first": batch.t[0] & time_mask,
            "cycles": cycles,
            "flags": int(result.flags),
        }
        for name, pair in (("roi", result.roi), ("roi_next", result.roi_next)):
            outputs |= {f"{name}_x": pair[0], f"{name}_y": pair[1]}
        last_sums = rows[-1][2:] if len(rows) else [0] * 5
        outputs |= dict(zip(("sums_i", "sums_dx", "sums_dy", "sums_sx", "sums_sy"), last_sums, strict=True))
        self._put("results", len(rows), *(outputs[name.removeprefix("result_")] for name in self.names("result_")))
        if reset_after:
            self.model = IntegerCore(config)
        else:
            self.seen |= result.flags
        return result

    def _put(self, memory, *values):
        self.words[memory].append(pack([int(value) for value in values], self.layouts[memory]))

    def include(self):
        """``vectors.vh``."""
        config = self.config
        constants = {
            "BATCHES": len(self.words["batches"]),
            "EVENTS": len(self.words["events"]),
            "ITERATIONS": len(self.words["trace"]),
            "BANK_WORDS": config.geometry.bank_words,
            # After a reset the banks are swept, and the sums of that sweep settle.
            "CLEARING": self.core.image.sweep_cycles + self.core.image.latency,
            # Twice the longest time in which nothing that the bench counts can happen.
            "PATIENCE": 2 * (config.buffer_events + config.geometry.bank_words + 500),
            "GAP_BITS": GAP_BITS,
            "STALL_BITS": STALL_BITS,
            "RESET_BITS": RESET_BITS,
            **{f"{memory.upper()}_BITS": sum(widths) for memory, widths in self.layouts.items()},
            **{name.upper(): width for name, width in self.widths.items()},
        }
        lines = [
            f"// Written by make_vectors.py of cmfpga {__version__} for configuration {config.hardware_hash[:16]}.",
            "// Numbers of words, clock cycles, and bits: a port's name in capitals is its width.",
            *(f"localparam {name} = {value};" for name, value in constants.items()),
        ]
        return "\n".join(lines) + "\n"

    def write(self, folder):
        """All files of the simulation into ``folder``."""
        (folder / f"{TOP}.v").write_text(self.verilog, encoding="ascii")
        shutil.copyfile(BENCH, folder / BENCH.name)
        (folder / "vectors.vh").write_text(self.include(), encoding="ascii")
        for memory, words in self.words.items():
            write_memory(folder / f"{memory}.hex", words, sum(self.layouts[memory]))


def make_vectors(config, *, batches, seed):
    """:class:`Vectors` of ``batches`` batches, each kind in turn."""
    vectors = Vectors(config)
    maker = Maker(config, np.random.default_rng(seed))
    roi = (0, 0)
    for number in range(batches):
        batch = maker.make(list(KINDS)[number % len(KINDS)], roi)
        result = vectors.add(batch)
        roi = (0, 0) if batch.reset_at else result.roi_next
    return vectors


def main(arguments=None):
    """Run the command; returns the exit status."""
    made = cli.parser("make_vectors", "Write the core and the vectors of its Verilog test bench.", EXAMPLES)
    made.prog = "python sim/make_vectors.py"
    made.add_argument("--out", default="build/sim", metavar="DIR", help="folder to write into (default: build/sim)")
    made.add_argument(
        "--batches", type=cli.positive, default=len(KINDS), metavar="B", help=f"batches (default: {len(KINDS)})"
    )
    made.add_argument("--seed", type=cli.natural, default=1, metavar="S", help="of the random events (default: 1)")
    cli.add_config_options(made)
    made.set_defaults(preset="paper")  # the bench checks its trace of swept pixels
    options = made.parse_args(arguments)
    config = cli.make_config(options)
    if config.gradient != "sweep" or config.ascent != "constant":
        raise ConfigError(
            f"preset {options.preset}: gradient = sweep and ascent = constant are needed, as in preset paper"
        )
    folder = cli.output_folder(options.out)
    vectors = make_vectors(config, batches=options.batches, seed=options.seed)
    vectors.write(folder)
    counts = ", ".join(f"{len(words)} {memory}" for memory, words in vectors.words.items() if memory != "results")
    print(f"wrote {folder}: {counts}; flags {vectors.seen.text or 'none'}")
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))
