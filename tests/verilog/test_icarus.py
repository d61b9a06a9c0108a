"""sim/tb_cmfpga_core.v in Icarus Verilog: passes with the emitted core, fails with a broken one."""

import re
import shutil
import sys

import make_vectors
import pytest
from amaranth.back import verilog

from cmfpga.config import Config
from cmfpga.errors import ConfigError
from cmfpga.protocol.flags import Flag
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog.emit import TOP
from support.verilog_mutants import MUTANTS
from support.verilog_tools import CONFIGS, emitted, icarus_compile, icarus_run, require_icarus, run

SMALL = Config(sensor_width=64, sensor_height=48, roi_width=16, roi_height=10, buffer_events=64)
KINDS = len(make_vectors.KINDS)


@pytest.fixture(autouse=True)
def _icarus():
    require_icarus()


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A folder with everything for SMALL; not to be changed."""
    folder = tmp_path_factory.mktemp("small")
    make_vectors.make_vectors(SMALL, batches=KINDS, seed=3).write(folder)
    return folder


def simulate(folder):
    assert icarus_compile(folder) == ""
    return icarus_run(folder)


def simulate_other_core(small, folder, text):
    shutil.copytree(small, folder, dirs_exist_ok=True)
    (folder / f"{TOP}.v").write_text(text)
    return simulate(folder)


# ---------------------------------------------------------------- the core passes


@pytest.mark.parametrize("name", [pytest.param("default", marks=pytest.mark.slow), *list(CONFIGS)[1:]])
def test_passes(name, tmp_path):
    vectors = make_vectors.make_vectors(CONFIGS[name], batches=KINDS, seed=2)
    vectors.write(tmp_path)
    lines = simulate(tmp_path)
    words = vectors.words
    expected = f"PASS: {KINDS} batches, {len(words['events'])} events, {len(words['trace'])} iterations, "
    assert len(lines) == 1 and lines[0].startswith(expected)
    # Eleven values of each iteration, and at least those of a result but its sums and the formula's cycles.
    checks = int(re.search(r"(\d+) checks", lines[0])[1])
    assert checks > 11 * len(words["trace"]) + 18 * (KINDS - 1)


def test_the_vectors_are_worth_it():
    vectors = make_vectors.make_vectors(SMALL, batches=KINDS, seed=3)
    assert vectors.seen == Flag(sum(Flag) - Flag.CUT - Flag.SCHEDULE)
    cut = make_vectors.make_vectors(CONFIGS["narrow formats"], batches=KINDS, seed=2)
    assert Flag.CUT in cut.seen


def test_the_same_in_newer_verilog(small, tmp_path):
    """Vivado and Questa read a .v file as Verilog, but it may be given to them as SystemVerilog."""
    shutil.copytree(small, tmp_path, dirs_exist_ok=True)
    for language in ("2001", "2012"):
        assert icarus_compile(tmp_path, language) == ""
        (line,) = icarus_run(tmp_path)
        assert line.startswith("PASS: ")


def test_the_bench_knows_every_port(sim_dir):
    core, _ = emitted(SMALL)
    text = (sim_dir / f"tb_{TOP}.v").read_text()
    assert re.findall(r"^    \.(\w+)\(\1\)", text, re.MULTILINE) == ["clk", "rst", *core.inputs, *core.outputs]
    looked_at = re.findall(r"result_\w+|trace_\w+", text.partition("cmfpga_core core")[2].partition(");")[2])
    assert set(core.outputs) - {"event_ready"} <= set(looked_at)


# ---------------------------------------------------------------- and a broken one does not


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_a_broken_core_fails(mutant, small, tmp_path):
    lines = simulate_other_core(small, tmp_path, mutant.apply((small / f"{TOP}.v").read_text()))
    assert lines[-1].startswith("FAIL: ")
    assert re.search(mutant.says, "\n".join(lines))


def test_every_field_is_checked(small, tmp_path):
    """Flip the highest bit of everything that is expected of the first batch."""
    vectors = make_vectors.make_vectors(SMALL, batches=1, seed=3)
    changed = {"results": vectors.names("result_"), "trace": [f"trace_{n}" for n in ("v_x", "v_y")]}
    changed["trace"] += vectors.names("trace_sums_")
    for memory, names in changed.items():
        widths = vectors.layouts[memory]
        widths = widths[len(widths) - len(names) :]  # without the number of iterations, on which the others depend
        for k in range(len(names)):
            vectors.words[memory][0] ^= 1 << (sum(widths[k:]) - 1)
    vectors.write(tmp_path)
    lines = simulate(tmp_path)
    wrong = {match[1] for line in lines if (match := re.search(r": (\w+) is \w+, \w+ is right$", line))}
    assert wrong == {name for names in changed.values() for name in names}
    # Twice: ΣI, ΣDx and ΣDy are also compared with the images.
    assert lines[-1].startswith(f"FAIL: {len(wrong) + 3} of ")


# ---------------------------------------------------------------- what emit.py does to Amaranth's text


def raw_verilog(config):
    """What Amaranth writes, before it is cleaned up."""
    core = VerilogCore(config)
    ports = [*core.inputs.values(), *core.outputs.values()]
    return verilog.convert(core, name=TOP, ports=ports, emit_src=False, strip_internal_attrs=True)


def test_clean_up_changes_nothing(small, tmp_path):
    raw, (_, clean) = raw_verilog(SMALL), emitted(SMALL)
    assert raw != clean
    assert simulate_other_core(small, tmp_path, raw) == simulate(small)
    # A reset hides this: the values that registers have before it.
    values = re.findall(r"^  reg (?:\[\d+:0\] )?(\S+ ?) = (\S+);$", raw, re.MULTILINE)
    assert values and values == re.findall(r"^  initial (\S+ ?) = (\S+);$", clean, re.MULTILINE)


# ---------------------------------------------------------------- commands


def test_make(sim_dir, tmp_path):
    if not shutil.which("make"):
        pytest.skip("make is not installed (Debian package make)")
    fields = "--set roi_width=6 --set roi_height=4 --set buffer_events=30"
    command = ["make", "-C", sim_dir, f"PYTHON={sys.executable}", f"OUT={tmp_path}", f"VECTORS={fields} --batches 3"]
    status, output = run(command)
    assert status == 0 and "\nPASS: 3 batches" in output, output
    status, output = run([*command, "-o", "vectors"])
    assert status == 0, output
    (tmp_path / "trace.hex").write_text("0\n" * len((tmp_path / "trace.hex").read_text().splitlines()))
    status, output = run([*command, "-o", "vectors"])
    assert status != 0 and "\nFAIL: " in output, output


def test_a_configuration_that_is_too_small_is_refused():
    with pytest.raises(ConfigError, match="max_batch_events = 40: a batch of 48 events is made here"):
        make_vectors.make_vectors(SMALL.replace(max_batch_events=40), batches=1, seed=1)
