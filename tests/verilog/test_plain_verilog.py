"""The emitted text: plain Verilog-2001, named and ordered for people."""

import re

import pytest

from cmfpga.verilog.emit import TOP
from support.verilog_tools import CONFIGS, emitted, modules, require_icarus, run, verilator_lint


@pytest.fixture(params=CONFIGS)
def core_and_text(request):
    return emitted(CONFIGS[request.param])


def test_verilog_2001_by_two_tools(core_and_text, tmp_path):
    _, text = core_and_text
    assert verilator_lint(text, tmp_path, "--language", "1364-2001", "-Wno-lint") == (0, set())
    require_icarus()
    assert run(["iverilog", "-g2001", "-Wall", "-tnull", tmp_path / f"{TOP}.v"]) == (0, "")


def test_a_newer_word_would_be_refused(tmp_path):
    _, text = emitted(CONFIGS["two by two"])
    for old, new in (("  always @(posedge clk)", "  always_ff @(posedge clk)"), ("  reg ", "  logic ")):
        assert old in text
        status, found = verilator_lint(text.replace(old, new, 1), tmp_path, "--language", "1364-2001", "-Wno-lint")
        assert status and found == {"error"}


def test_no_task_of_a_simulator(core_and_text):
    assert not re.search(r"\$(?:display|finish|readmem|error|fatal|random)", core_and_text[1])


def test_initial_values_of_registers_only(core_and_text):
    _, text = core_and_text
    for module in modules(text).values():
        memories = re.findall(r"^  reg (?:\[\d+:0\] )?(\S+) \[\d+:0\];$", module, re.MULTILINE)
        initial = re.findall(r"\binitial\b.*", module)
        named = re.findall(r"^  initial (\S+) += \d*'?[a-z]?[\da-f]+;$", module, re.MULTILINE)
        assert len(named) == len(initial)
        assert not set(memories) & set(named)


def test_the_memories_are_where_they_should_be(core_and_text):
    core, text = core_and_text
    config = core.config
    found = {
        name.removeprefix(f"{TOP}_"): sorted(
            (int(width or 0) + 1, int(depth) + 1)
            for width, depth in re.findall(r"^  reg (?:\[(\d+):0\] )?\S+ \[(\d+):0\];$", module, re.MULTILINE)
        )
        for name, module in modules(text).items()
    }
    pixel = [config.widths.image_bits, config.widths.derivative_image_bits, config.widths.derivative_image_bits]
    # The four banks are one module.
    assert {name: sizes for name, sizes in found.items() if sizes} == {
        "image_accumulator_bank": sorted((bits, config.geometry.bank_depth) for bits in pixel),
        "event_buffer": [(len(core.event_buffer.i.payload.as_value()), config.buffer_events)],
    }
    assert text.count(f"\n  {TOP}_image_accumulator_bank bank_") == 4
