"""``track --wave``: what the VCD file says is what the batch's trace says, and the viewers' files fit it."""

import itertools
import json
import re

import numpy as np
import pytest
from vcd.reader import TokenKind, tokenize

import cmfpga
from cmfpga.cli import track
from cmfpga.events import Events, write_hdf5
from cmfpga.protocol.confidence import curvature
from cmfpga.protocol.flags import Flag
from cmfpga.rtl.top import VerilogCore
from cmfpga.show.wave import WaveCore
from support.designs import FAST, PAPER
from support.small_core import options

CONFIGS = pytest.mark.parametrize("config", [PAPER, FAST], ids=["paper", "fast"])
MODEL = ["--engine", "model", "--no-picture"]


# A core with further outputs is a design of its own, which no other test compiles.
pytestmark = pytest.mark.usefixtures("compiler", "long_tools")


class Vcd:
    """A VCD file, each signal as an array with one value per clock cycle."""

    def __init__(self, path):
        self.kinds, scope, ids, changes, now = {}, [], {}, {}, 0
        with path.open("rb") as file:
            for token in tokenize(file):
                if token.kind is TokenKind.SCOPE:
                    scope.append(token.scope.ident)
                elif token.kind is TokenKind.UPSCOPE:
                    scope.pop()
                elif token.kind is TokenKind.VAR:
                    name = ".".join([*scope, token.var.reference])
                    ids.setdefault(token.var.id_code, []).append(name)
                    self.kinds[name] = (token.var.type_.value, token.var.size)
                elif token.kind is TokenKind.CHANGE_TIME:
                    now = token.time_change
                elif token.kind in (TokenKind.CHANGE_SCALAR, TokenKind.CHANGE_VECTOR, TokenKind.CHANGE_REAL):
                    changes.setdefault(token.data.id_code, []).append((now, float(token.data.value)))
                elif token.kind is TokenKind.TIMESCALE:
                    self.timescale = f"{token.timescale.magnitude.value} {token.timescale.unit.value}"
        self.end = now
        self._changes = {name: changes[code] for code, names in ids.items() for name in names}

    def __getitem__(self, name):
        times, values = zip(*self._changes[f"cmfpga.{name}"], strict=True)
        return np.array(values)[np.searchsorted(times, np.arange(self.end), side="right") - 1]

    def __iter__(self):
        return iter(self.kinds)

    def sent(self, stream, *fields):
        """The fields of what a stream carries, in the cycles in which it is valid: [n, len(fields)]."""
        valid = self[f"{stream}_valid"] == 1
        return np.stack([self[f"{stream}_{field}"][valid] for field in fields], axis=1)


@pytest.fixture
def waves(command, dot, tmp_path):
    """``waves(config, batch, *options)``: the :class:`Vcd`, and the track from Python."""

    def waves(config, batch, *more):
        arguments = ["--roi", "8,9", "--batch-events", 90, *options(config), "--out", tmp_path, "--no-picture"]
        done = command(track, dot, *arguments, "--wave", batch, *more)
        # Batches of 90 events are few for a confidence.
        assert done.status == 0 and all("the object was lost in batches" in line for line in done.complaints)
        assert all(f"wrote {tmp_path}/batch-{batch}{suffix}\n" in done.out for suffix in (".vcd", ".gtkw", ".sucl"))
        return Vcd(tmp_path / f"batch-{batch}.vcd")

    return waves


@CONFIGS
@pytest.mark.parametrize("batch", [0, 2])
def test_what_goes_between_the_blocks_is_the_trace(waves, dot, config, batch):
    """Positions, votes, sums, gradients and velocities of every iteration, in their units."""
    vcd = waves(config, batch)
    tracking = cmfpga.track(dot, roi=(8, 9), batch_events=90, **config)
    trace, result = tracking.trace(batch), tracking.results[batch]
    n, evaluations, each = len(trace.t), len(trace), tracking.config.ascent_rule.evaluations
    assert n > 10 and evaluations > 2
    begin, end = ("warp.i", "voter.o") if each == 1 else ("evaluators.i", "evaluators.o_0")
    replayed = vcd.sent("event_buffer.o", "t", "x", "y").reshape(-1, n, 3)
    np.testing.assert_array_equal(replayed[0], np.stack([trace.t, trace.x, trace.y], axis=1))
    scaled = vcd.sent(begin, "dt", "x", "y").reshape(-1, n, 3)
    np.testing.assert_array_equal(scaled[0], np.stack([trace.dt, trace.x_dithered, trace.y_dithered], axis=1))
    gradients = vcd.sent("ascent.i", "x", "y")
    sums = vcd.sent("gradient.i", "i", "dx", "dy", "sx", "sy")
    speed = np.stack([vcd["ascent.v_x"], vcd["ascent.v_y"]], axis=1)
    centres = speed[vcd["gradient.i_valid"] == 1]
    # Evaluations of an event come one after the other.
    votes = vcd.sent(end, *(f"banks_{bank}_{name}" for bank in range(4) for name in ("valid", "i")))
    votes = votes.reshape(-1, n, each, 4, 2).swapaxes(1, 2).reshape(-1, n, 4, 2)
    for k in range(evaluations):
        now = trace[k]
        # The file has 16 digits.
        np.testing.assert_allclose(sums[k], [now.sum_i, *now.sum_d, *now.s], rtol=1e-15)
        np.testing.assert_allclose(gradients[k], now.g, rtol=1e-15)
        np.testing.assert_array_equal(centres[k] * 2**tracking.config.v_frac, result.trace.v[k // each])
        assert (votes[k, ..., 0] * votes[k, ..., 1]).sum() == now.sum_i
    assert len(sums) == len(votes) == len(gradients) == evaluations
    if each == 1:
        warped = vcd.sent("warp.o", "x", "y", "dt").reshape(-1, n, 3)
        for k in range(evaluations):
            np.testing.assert_array_equal(warped[k], np.stack([trace[k].x, trace[k].y, trace.dt], axis=1))
    else:
        fraction = tracking.config.weight_frac + tracking.config.derivative_frac
        np.testing.assert_array_equal(curvature(*(gradients[-4:] * 2**fraction)), result.curvature)
    np.testing.assert_array_equal(speed[-1], result.v)


@CONFIGS
def test_time_is_the_number_of_the_cycle(waves, dot, config):
    vcd = waves(config, 2)
    result = cmfpga.track(dot, roi=(8, 9), batch_events=90, **config).results[2]
    assert vcd.timescale == "1 ns"
    valid = vcd["core.result_valid"]
    assert int(np.flatnonzero(valid)[0]) == result.cycles == vcd["core.result_cycles"][-1]
    assert vcd["core.opened"][0] == 1 and vcd["core.event_valid"][0] == 1
    assert (vcd["core.event_valid"] * vcd["core.event_ready"]).sum() == result.events == 90
    assert vcd["core.result_roi_x"][-1] == result.roi[0] and vcd["core.result_roi_events"][-1] == result.roi_events


@CONFIGS
def test_the_viewers_files_fit(waves, tmp_path, config):
    vcd = waves(config, 1)
    order = ["core", *WaveCore(cmfpga.config.preset(config["preset"])).blocks]
    saved = (tmp_path / "batch-1.gtkw").read_text()
    assert saved.startswith('[dumpfile] "batch-1.vcd"\n')
    traces = re.findall(r"^(?:\+\{[^}]*\} )?(cmfpga\.[\w.]+)(\[\d+:0\])?$", saved, re.MULTILINE)
    assert sorted(name for name, _ in traces) == sorted(vcd)
    for name, suffix in traces:
        kind, size = vcd.kinds[name]
        assert suffix == ("" if kind == "real" or size == 1 else f"[{size - 1}:0]")
    # Group by group, in the order of data flow.
    assert re.findall(r"^-(\w+)$", saved, re.MULTILINE) == [name for name in order for _ in range(2)]
    assert [*dict.fromkeys(name.split(".")[1] for name, _ in traces)] == order
    marks = [int(mark) for mark in re.search(r"^\*-3\.0+ (.*)$", saved, re.MULTILINE)[1].split()]
    starts = np.flatnonzero(vcd["event_buffer.replay"]).tolist()
    assert marks[0] == starts[0] and [mark for mark in marks[1:] if mark >= 0] == starts[:26]

    commands = (tmp_path / "batch-1.sucl").read_text().splitlines()
    assert [line.split()[1] for line in commands if line.startswith("divider_add ")] == order
    assert [line.split()[1] for line in commands if line.startswith("variable_add ")] == [name for name, _ in traces]
    for before, line in itertools.pairwise(commands):
        if line.startswith("item_set_format"):
            kind, size = vcd.kinds[before.split()[1]]
            assert kind == "wire" and size > 1


def test_fixed_point_numbers_are_real_numbers():
    config = cmfpga.config.preset("fast")
    found = {(probe.block, probe.name): probe for probe in WaveCore(config).probes}
    for block, name, text in (
        ("core", "settings_v_start_x", "Q5.6"), ("core", "settings_eta", "UQ6.10"), ("core", "result_v_y", "Q5.6"),
        ("core", "result_sums_sx", "Q23.8"), ("dither", "o_x", "Q6.4"),
        ("evaluators", "i_dt", "Q1.8"), ("evaluators", "centre_x", "Q5.6"), ("evaluators", "o_0_banks_3_dy", "Q1.4"),
        ("evaluators", "o_0_banks_0_i", "UQ1.4"), ("gradient", "o_x", "Q35.8"), ("roi_updater", "roi_gain", "UQ2.4"),
        ("roi_updater", "v_x", "Q5.6"), ("tagged_accumulator", "o_2_total_dx", "Q11.4"), ("ascent", "v_x", "Q5.6"),
    ):  # fmt: skip
        assert found[block, name].format == text, (block, name)
    for block, name in (
        ("core", "event_x"), ("core", "settings_roi_x"), ("roi_filter", "o_x"), ("event_buffer", "o_y"),
        ("dither", "i_x"), ("reciprocal", "mantissa"), ("roi_updater", "corner_roi_x"), ("roi_updater", "x"),
        ("schedule", "distance"), ("evaluators", "o_0_banks_1_address"), ("iteration_control", "iterations"),
        ("core", "result_span"),
    ):  # fmt: skip
        assert not found[block, name].fraction and not found[block, name].format, (block, name)
    finer = {(probe.block, probe.name): probe.fraction for probe in WaveCore(config.replace(dither_frac=7)).probes}
    assert found["dither", "o_x"].fraction != finer["dither", "o_x"] == 7


def test_the_hardware_is_the_same_but_for_the_wave_ports():
    config = cmfpga.config.preset("fast")
    waves, plain = WaveCore(config), VerilogCore(config)
    assert list(waves.inputs) == list(plain.inputs)
    names = [name for name in waves.outputs if not name.startswith("wave_")]
    assert names == list(plain.outputs) and len(waves.outputs) - len(names) == len(waves.probes)


def test_every_kind_of_batch(waves, dot, dot_events, command, tmp_path):
    """Thinned, degenerate."""
    config = {**FAST, "thin_target": 12}
    vcd = waves(config, 3, "--engine", "model")
    result = cmfpga.track(dot, roi=(8, 9), batch_events=90, engine="model", **config).results[3]
    assert Flag.THINNED in result.flags and vcd["core.result_thinned"][-1] == result.thinned > 0
    assert vcd["core.result_flags"][-1] == int(result.flags) - (Flag.ROI_CLAMPED in result.flags) * 64
    vcd = waves({**FAST, "min_roi_events": 96}, 1, "--engine", "model")
    assert vcd["core.result_flags"][-1] == int(Flag.DEGENERATE) and vcd["core.result_iterations"][-1] == 0


def test_as_json(command, dot, tmp_path):
    arguments = ["--roi", "8,9", "--batch-events", 90, *options(FAST), *MODEL, "--out", tmp_path, "--json"]
    done = command(track, dot, *arguments, "--wave", 0)
    names = ["track.csv", "batch-0.vcd", "batch-0.gtkw", "batch-0.sucl"]
    assert json.loads(done.out)["files"] == [str(tmp_path / name) for name in names]


def test_mistakes(command, dot, dot_events, tmp_path, monkeypatch):
    arguments = ["--roi", "8,9", "--batch-events", 90, *options(FAST), "--out", tmp_path / "out", "--no-picture"]
    done = command(track, dot, *arguments, "--wave", 5, "--batches", 5)
    assert done.error == "--wave 5: 0 to 4 is needed with --batches 5"
    done = command(track, dot, *arguments, "--wave", 6, "--engine", "model")
    assert done.error == "--wave 6: the track has no such batch"
    assert (tmp_path / "out" / "track.csv").read_text().count("\n") == 7  # what was done is not lost
    done = command(track, dot, *arguments, "--wave", 0, "--engine", "float")
    assert done.error == "--wave: the float engine has not the hardware's numbers; rtl or model is needed"
    assert "a whole number of 0 or more" in command(track, dot, *arguments, "--wave", "-1").error
    paused = Events(dot_events.t + 3000 * (np.arange(600) >= 300), dot_events.x, dot_events.y, dot_events.p)
    write_hdf5(tmp_path / "paused.h5", paused, 32, 24)
    arguments = ["--roi", "8,9", "--batch-us", 1000, *options(FAST), *MODEL, "--out", tmp_path / "out"]
    done = command(track, tmp_path / "paused.h5", *arguments, "--wave", 4)
    assert done.error == "--wave 4: the batch has no events, so the hardware never saw it"
    monkeypatch.setattr("cmfpga.show.wave.cannot_compile", lambda: "no C++ compiler found")
    done = command(track, dot, *arguments, "--wave", 0)
    assert done.error == "--wave: no C++ compiler found; Verilator and g++ or clang++ are needed"
