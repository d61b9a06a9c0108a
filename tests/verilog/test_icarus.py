"""sim/tb_cmfpga_core.v in Icarus Verilog: passes with the emitted core, fails with a broken one."""

import re
import shutil
import sys

import make_vectors
import pytest
from amaranth.back import verilog

from cmfpga.config import Config, preset
from cmfpga.errors import ConfigError
from cmfpga.protocol.flags import Flag
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog.compile import kept_verilog
from cmfpga.verilog.emit import TOP
from support.verilog_mutants import MUTANTS
from support.verilog_tools import CONFIGS, emitted, icarus_compile, icarus_run, require_icarus, run

SIZE = {"sensor_width": 64, "sensor_height": 48, "roi_width": 16, "roi_height": 10, "buffer_events": 64}
SMALL = Config(**SIZE)
FAST = preset("fast").replace(**SIZE, tag_bits=3)  # so few tags that they come back soon
SEED = 5  # with which either meets every flag that it can, and every mutant is seen
KINDS = len(make_vectors.KINDS)


@pytest.fixture(autouse=True, scope="module")
def _icarus():
    require_icarus()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(make_vectors, "emit_verilog", lambda core: kept_verilog(core, TOP))
        yield


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Folders with everything for SMALL and for FAST; not to be changed."""
    made = {"paper": SMALL, "fast": FAST}
    for name, config in made.items():
        made[name] = tmp_path_factory.mktemp(name)
        make_vectors.make_vectors(config, batches=KINDS, seed=SEED).write(made[name])
    return made


def simulate(folder):
    assert icarus_compile(folder) == ""
    return icarus_run(folder)


def simulate_other_core(small, folder, text):
    shutil.copytree(small, folder, dirs_exist_ok=True)
    (folder / f"{TOP}.v").write_text(text)
    return simulate(folder)


FULL = {"fast": preset("fast"), "default": CONFIGS["default"]}
OTHERS = {name: config for name, config in CONFIGS.items() if name not in FULL} | {
    "fast, small": FAST,
    "four evaluators": FAST.replace(evaluators=4),
    "fast, one buffer": FAST.replace(buffers=1, roi_width=15),
    "fast, by sweep": FAST.replace(gradient="sweep", ascent="constant"),
    "paper, in one pass": SMALL.replace(gradient="one_pass"),
    "similarity": preset("similarity").replace(**SIZE, tag_bits=4),
    "rotation": preset("rotation").replace(
        **SIZE, tag_bits=4, ram_style="auto", camera="60,61,31,23,-0.1,0.02,0.001,0,0"
    ),
}


@pytest.mark.parametrize("name", [*FULL, *OTHERS])
def test_passes(name, tmp_path):
    batches = 3 if name in FULL else KINDS  # of each kind those of the small ones
    vectors = make_vectors.make_vectors((FULL | OTHERS)[name], batches=batches, seed=2)
    vectors.write(tmp_path)
    lines = simulate(tmp_path)
    rows = vectors.rows
    expected = f"PASS: {batches} batches, {len(rows['events'])} events, {len(rows['trace'])} iterations, "
    assert len(lines) == 1 and lines[0].startswith(expected), lines
    # Values and images' sums of each iteration, and at least those of a result but its sums and the formula's cycles.
    checks = int(re.search(r"(\d+) checks", lines[0])[1])
    assert checks > (11 if vectors.core.sweep_cycles else 7) * len(rows["trace"]) + 18 * (batches - 1)


def test_the_vectors_are_worth_it():
    for config in (SMALL, FAST):
        vectors = make_vectors.make_vectors(config, batches=KINDS, seed=SEED)
        unseen = Flag.CUT | Flag.SCHEDULE | (Flag(0) if config.when_full == "drop" else Flag.OVERFLOW)
        assert vectors.seen == Flag(sum(Flag)) & ~(unseen if config.confidence else unseen | Flag.DOUBTFUL | Flag.SHORT)
    assert Flag.CUT in make_vectors.make_vectors(CONFIGS["narrow formats"], batches=KINDS, seed=2).seen


def test_the_same_in_newer_verilog(folders, tmp_path):
    """Vivado and Questa read a .v file as Verilog, but it may be given to them as SystemVerilog."""
    shutil.copytree(folders["paper"], tmp_path, dirs_exist_ok=True)
    for language in ("2001", "2012"):
        assert icarus_compile(tmp_path, language) == ""
        (line,) = icarus_run(tmp_path)
        assert line.startswith("PASS: ")


@pytest.mark.parametrize("config", [SMALL, FAST], ids=["paper", "fast"])
def test_the_bench_knows_every_port(config):
    """Each is connected; each that carries a value has a column in a memory, or is summed."""
    vectors = make_vectors.make_vectors(config, batches=1, seed=SEED)
    core, text = vectors.core, vectors.include()
    assert re.findall(r"\.(\w+)\(\1\)", text) == core.port_order
    columns = {name for columns in vectors.columns.values() for name in columns}
    flow = {name for name in core.port_order if name.endswith(("_valid", "_ready"))}
    pixels = {name for name in core.outputs if name.startswith("trace_pixels_")}
    assert set(core.port_order) - {"clk", "rst"} - flow - pixels <= columns
    assert all(f" + {name}" in text for name in pixels - flow)


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_a_broken_core_fails(mutant, folders, tmp_path):
    small = folders[mutant.preset]
    lines = simulate_other_core(small, tmp_path, mutant.apply((small / f"{TOP}.v").read_text()))
    assert lines[-1].startswith("FAIL: ")
    assert re.search(mutant.says, "\n".join(lines))


@pytest.mark.parametrize("config", [SMALL, FAST], ids=["paper", "fast"])
def test_every_field_is_checked(config, tmp_path):
    """Flip the highest bit of everything that is expected of the first batch."""
    vectors = make_vectors.make_vectors(config, batches=1, seed=SEED)
    # Without the number of iterations, on which the others depend, and what the model says nothing of.
    unsaid = {"count", *(name for name, value in vectors.rows["results"][0].items() if value is None)}
    wanted = set()
    for memory in ("results", "trace"):
        row, widths = vectors.rows[memory][0], vectors.columns[memory]
        for name in set(row) - unsaid:
            row[name] = (int(row[name]) & ((1 << widths[name]) - 1)) ^ (1 << (widths[name] - 1))
            wanted.add(name)
    vectors.write(tmp_path)
    lines = simulate(tmp_path)
    wrong = {match[1] for line in lines if (match := re.search(r": (\w+) is \w+, \w+ is right$", line))}
    assert wrong == wanted >= set(vectors.core.outputs) & {"result_v_x", "result_flags", "trace_sums_sx"}
    # With a sweep twice: ΣI, ΣDx and ΣDy are also compared with the images.
    assert lines[-1].startswith(f"FAIL: {len(wrong) + (3 if vectors.core.sweep_cycles else 0)} of ")


def test_clean_up_changes_nothing(folders, tmp_path):
    core, (_, clean), small = VerilogCore(SMALL), emitted(SMALL), folders["paper"]
    ports = [*core.inputs.values(), *core.outputs.values()]
    raw = verilog.convert(core, name=TOP, ports=ports, emit_src=False, strip_internal_attrs=True)
    assert raw != clean
    assert simulate_other_core(small, tmp_path, raw) == simulate(small)
    # A reset hides this: the values that registers have before it.
    values = re.findall(r"^  reg (?:\[\d+:0\] )?([^\s$]+ ?) = (\S+);$", raw, re.MULTILINE)
    assert values and {*values} <= {*re.findall(r"^  initial (\S+ ?) = (\S+);$", clean, re.MULTILINE)}


@pytest.mark.parametrize("name", ["paper", "fast"])
def test_make(name, sim_dir, tmp_path):
    if not shutil.which("make"):
        pytest.skip("make is not installed (Debian package make)")
    fields = "--set roi_width=6 --set roi_height=4 --set buffer_events=30"
    told = f"PYTHON={sys.executable}", f"OUT={tmp_path}", f"VECTORS={fields} --batches 3", f"PRESET={name}"
    command = ["make", "-C", sim_dir, *told]
    status, output = run(command)
    assert status == 0 and "\nPASS: 3 batches" in output, output
    status, output = run([*command, "-o", "vectors"])
    assert status == 0, output
    (tmp_path / "trace.mem").write_text("0\n" * len((tmp_path / "trace.mem").read_text().splitlines()))
    status, output = run([*command, "-o", "vectors"])
    assert status != 0 and "\nFAIL: " in output, output


def test_a_configuration_that_is_too_small_is_refused():
    with pytest.raises(ConfigError, match="max_batch_events = 40: a batch of 48 events is made here"):
        make_vectors.make_vectors(SMALL.replace(max_batch_events=40), batches=1, seed=1)


def test_what_the_bench_cannot_play_is_refused():
    with pytest.raises(ConfigError, match=r"^hot_pixels = 1: hot_pixels = 0 is needed, this bench has no more$"):
        make_vectors.make_vectors(SMALL.replace(hot_pixels=1), batches=1, seed=1)
    with pytest.raises(ConfigError, match=r"^motion = rotation: a calibration is needed: camera = fx,fy"):
        make_vectors.make_vectors(preset("rotation"), batches=1, seed=1)
