"""The Vivado scripts, run through a strict model of the commands that they use; seeded mistakes are caught."""

import json
import re
import shutil

import pytest

from support.board_files import BOARD

pytest.importorskip("tkinter", reason="needs Python's tkinter: apt-get install python3-tk")

from support.vivado.catalog import COMMANDS
from support.vivado.model import Vivado

SCRIPTS = BOARD / "vivado"


def run(script, *arguments, scripts=SCRIPTS, found=None):
    made = Vivado(found)
    made.source(scripts / script, *arguments)
    made.said = "\n".join(made.output)
    return made


def package(folder, verilog, registers):
    return run("package_ip.tcl", verilog, registers, folder / "ip")


def build(folder, **options):
    return run("build.tcl", folder / "ip", folder / "out", 2, **options)


def out_of_context(folder, verilog, *arguments, **options):
    return run("ooc.tcl", verilog, folder / "ooc", *arguments, **options)


@pytest.fixture
def packaged(tmp_path, rtl):
    done = package(tmp_path, *rtl)
    assert done.status == 0, done.said
    return tmp_path


def test_ip_is_packaged(packaged, facts):
    text = (packaged / "ip" / "component.xml").read_text(encoding="utf-8")
    for name, *_ in facts["ip"]["interfaces"]:
        assert f'<interface name="{name}"' in text
    assert 'vlnv="cmfpga.org:ip:cmfpga:1.0"' in text and '<register name="CTRL"' in text
    assert not (packaged / "ip" / "project").exists()


@pytest.mark.parametrize("found", [{}, {"inline_slice": True, "version": "2025.1.1"}], ids=["xlslice", "ilslice"])
def test_bitstream_is_built(packaged, found):
    done, out = build(packaged, found=found), packaged / "out"
    assert done.status == 0, done.said
    assert {path.name for path in out.iterdir()} >= {"cmfpga.bit", "cmfpga.hwh", "cmfpga.xsa", "summary.json"}
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["passed"] is True and summary["complaints"] == []
    slacks = {"wns": 0.12, "tns": 0.0, "whs": 0.01, "ths": 0.0, "wpws": 1.5, "tpws": 0.0}
    assert summary["timing"] == {**slacks, "unclocked": 0} and summary["power_w"] == 3.412
    assert list(summary["utilisation"].values()) == [12345, 9876, 10.5, 0, 33]
    assert summary["clock_mhz"] == 200 and summary["fmax_mhz"] == round(1000 / (5 - 0.12), 1)
    assert len(list((out / "reports").iterdir())) == 10


def test_design_has_the_addresses_and_widths_of_the_facts(packaged, facts):
    design = build(packaged)
    control, memory = facts["control"], facts["memory"]
    blocks = {"cmfpga": "cmfpga/s_axi/reg0", "dma": "dma/S_AXI_LITE/Reg"}
    assert design.assigned == {
        ("ps/Data", block): (control[name]["address"], control[name]["size"]) for name, block in blocks.items()
    } | {
        (f"dma/Data_{channel}", f"ps/SAXIGP2/HP0_DDR_{half.upper()}"): tuple(memory[f"ddr_{half}"])
        for channel in ("MM2S", "S2MM") for half in ("low", "high")
    }  # fmt: skip
    _, ps = design.cells["ps"]
    assert int(ps["PSU__MAXIGP0__DATA_WIDTH"]) == control["data_width"]
    assert int(ps["PSU__SAXIGP2__DATA_WIDTH"]) == memory["data_width"]
    assert int(ps["PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ"]) == facts["clock"]["mhz"]
    on = {name for name, value in ps.items() if name.startswith("PSU__USE__") and value == "1"}
    assert on == {"PSU__USE__M_AXI_GP0", "PSU__USE__S_AXI_GP2", "PSU__USE__IRQ0"}
    assert design.driver("ps/pl_ps_irq0") == "cmfpga/irq"
    clocks = [name for name, fields in design.has["pin"].items() if fields[:2] == ["I", "clk"]]
    assert {design.driver(name) for name in clocks} == {"ps/pl_clk0"}


def test_out_of_context(tmp_path, rtl):
    done = out_of_context(tmp_path, rtl[0], "250")
    assert done.status == 0, done.said
    summary = json.loads((tmp_path / "ooc" / "summary.json").read_text(encoding="utf-8"))
    assert (summary["flow"], summary["clock_mhz"], summary["fmax_mhz"]) == ("out_of_context", 250, 257.7)
    assert done.clocks == {"aclk": 4.0}
    assert out_of_context(tmp_path, rtl[0], "200", found={"wns": "-0.5"}).status == 1


def test_every_command_and_option_of_the_catalogue_is_used(packaged, rtl):
    """A catalogue that knows more than the scripts need would hide a wrong name."""
    used = package(packaged, *rtl).used | build(packaged).used | out_of_context(packaged, rtl[0], "200").used
    options = {
        f"{name} {option}" for name, usage in COMMANDS.items() for option in re.findall(r"(?<!\S)!?(-\w+)", usage)
    }
    assert used == options | set(COMMANDS)


#: A run that goes wrong in Vivado: what it finds, and what the script must say.
FAILURES = {
    "timing missed": ({"wns": "-0.210"}, "setup timing is missed by 0.21"),
    "hold missed": ({"whs": "-0.010"}, "hold timing is missed"),
    "pulse width": ({"wpws": "-1.000"}, "pulse width timing is missed"),
    "nothing timed": ({"wns": "NA"}, "no constrained path"),
    "unclocked registers": ({"unclocked": 7}, "7 registers have no clock"),
    "unsafe crossing": ({"crossing": "Timed (unsafe)"}, "clock crossing without constraint"),
    "critical crossing": ({"cdc": "Critical"}, "critical clock-domain crossing"),
    "unknown report": ({"unit": ""}, "no row of slacks"),
    "synthesis fails": ({"synth_status": "synth_design ERROR"}, "synth_1 ended with"),
    "routing fails": ({"impl_status": "route_design ERROR"}, "impl_1 ended with"),
    "bitstream refused": ({"impl_status": "write_bitstream ERROR"}, "impl_1 ended with"),
    "no board files": ({"boards": []}, "no board files for xilinx.com:kv260_som"),
    "old Vivado": ({"version": "2021.2"}, "too old"),
}


@pytest.mark.parametrize("name", FAILURES)
def test_failure_gives_a_status_and_no_bitstream(name, packaged):
    found, text = FAILURES[name]
    (packaged / "out").mkdir()
    (packaged / "out" / "cmfpga.bit").write_text("of an earlier run")
    done = build(packaged, found=found)
    assert done.status == 1 and text in done.said and "ERROR: cmfpga:" in done.said
    assert (packaged / "out" / "cmfpga.bit").exists() == (name == "old Vivado")
    if name in ("timing missed", "unsafe crossing"):
        summary = json.loads((packaged / "out" / "summary.json").read_text(encoding="utf-8"))
        assert summary["passed"] is False and text in summary["complaints"][0]


#: Mistakes: name | file | what is replaced, once | by what | what must be said. ``.v`` and ``regs`` are of the IP.
MISTAKES = r"""
misspelt command | design.tcl | regenerate_bd_layout | regenerate_layout | invalid command name
unknown option | build.tcl | -include_bit | -include_bits | unknown option
misspelt pin | design.tcl | m_axi_s2mm_aclk] | m_axi_s2m_aclk] | no pin matches
misspelt interface | design.tcl | control/M01_AXI | control/M02_AXI | no intf_pin matches
unknown parameter | design.tcl | c_include_mm2s | c_with_mm2s | no parameter
value out of range | facts.tcl | length_width)        26 | length_width) 27 | cannot be '27'
unknown IP | design.tcl | ip:proc_sys_reset | ip:proc_sysreset | Vivado has no IP
clock not connected | design.tcl | cmfpga/aclk to_core/aclk | to_core/aclk | cmfpga/aclk (clk) is not connected
reset not connected | design.tcl | {control/aresetn memory/aresetn} | control/aresetn | memory/aresetn (rst_n)
reset of the wrong polarity | design.tcl | reset/peripheral_aresetn | reset/peripheral_reset | wants rst_n
reset for a clock | design.tcl | ps/pl_resetn0 | ps/pl_clk0 | wants rst_n, ps/pl_clk0 gives clk
two drivers | design.tcl | [get_bd_pins fan/Din] | [get_bd_pins cmfpga/irq] | two drivers
stream left open | design.tcl | from_core/M_AXIS dma/S_AXIS_S2MM | | dma/S_AXIS_S2MM is not connected
stream widths differ | facts.tcl | (stream_bytes)            8 | (stream_bytes) 4 | differ in bytes, user
no TUSER in between | design.tcl | to_core 0 $fact(stream_user_width) | to_core 0 0 | and [8, 0, 1, 1]
master to master | design.tcl | ps/$fact(memory_port) | dma/M_AXI_SG | no intf_pin matches
interface used twice | design.tcl | memory/S01_AXI | memory/S00_AXI | connected already
overlapping addresses | facts.tcl | 0xa0010000 | 0xa0000000 | overlaps
misaligned address | facts.tcl | 0xa0010000 | 0xa0018000 | misaligned
address outside of the window | facts.tcl | 0xa0010000 | 0x90010000 | outside of the windows
address not assigned | design.tcl | foreach half {low high} | foreach half {low} | DDR_HIGH has no address
address bits | facts.tcl | address_width)       40 | address_width) 32 | size 0x80000000: outside of the windows
second master port left on | facts.tcl | CONFIG.PSU__USE__M_AXI_GP1 | | ps/maxihpm1_fpd_aclk (clk) is
port without interrupt | design.tcl | connect_bd_net [get_bd_pins cmfpga/irq] | list | cmfpga/irq reaches no
preset forgotten | design.tcl | apply_bd_automation | list | set_property: apply_bd_automation comes
carrier forgotten | build.tcl | set_property board_connections | list | board_connections comes first
unknown board part | build.tcl | [exactly_one "board part" $found] | xilinx.com:kv260:part0:1.4 | is not installed
change after validation | design.tcl | save_bd_design | save_bd_design; create_bd_port -dir O x | validate_bd_design
not validated | design.tcl | validate_bd_design | | validate_bd_design comes first
constraints forgotten | build.tcl | -fileset constrs_1 | -fileset sources_1 | port fan_en_b has no
pin forgotten | kv260.xdc | set_property PACKAGE_PIN A12 [get_ports {fan_en_b}] | | fan_en_b has no PACKAGE_PIN
unknown port | kv260.xdc | SLOW [get_ports {fan_en_b}] | SLOW [get_ports {fan}] | no port matches 'fan'
second constraint of the clock | kv260.xdc | set_property SLEW SLOW | create_clock -name c -period 5 | read_xdc comes
top forgotten | build.tcl | $fact(block_design)_wrapper [c | $fact(top) [c | is not among the sources
bitstream forgotten | build.tcl | run_to_end impl_1 write_bitstream | run_to_end impl_1 "" | -to_step
unknown property | build.tcl | get_property PROGRESS | get_property PROGRES | no property PROGRES
variable unset | design.tcl | $fact(memory_excluded) | $fact(memory_exclude) | no such element
attribute forgotten | .v | (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 m_axis TLAST" *) | | m_axis_tlast has
signal misspelt | .v | m_axis TVALID | m_axis VALID | ports missing: ['TVALID']
interface not associated | .v | s_axi:s_axis:m_axis | s_axi:s_axis | ASSOCIATED_BUSIF is s_axi s_axis
active-high reset | .v | POLARITY ACTIVE_LOW | POLARITY ACTIVE_HIGH | POLARITY
edge interrupt | .v | SENSITIVITY LEVEL_HIGH | SENSITIVITY EDGE_RISING | SENSITIVITY
signal twice | .v | s_axi BRESP | s_axi RRESP | has another port with signal RRESP
other protocol | .v | PROTOCOL AXI4LITE | PROTOCOL AXI4 | PROTOCOL
other module name | .v | module cmfpga_kv260( | module cmfpga_core( | no module cmfpga_kv260
wrong bus | .v | xilinx.com:signal:interrupt:1.0 | xilinx.com:signal:clock:1.0 | ports missing
registers overlap | regs | r CTRL | r A $address_block]; set_property address_offset 0x0 [ipx::add_register B | over A
"""
MISTAKES = [line.split(" | ") for line in MISTAKES.replace("| |", "|  |").strip().splitlines()]
assert len(MISTAKES) > 40  # as README.md of the board says


@pytest.mark.parametrize("file, old, new, text", [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES])
def test_mistake_is_caught(file, old, new, text, tmp_path, rtl):
    """The mistake is what makes the run fail: without it the same run succeeds (above)."""
    scripts = shutil.copytree(SCRIPTS, tmp_path / "scripts")
    path = {".v": rtl[0], "regs": rtl[1]}.get(file, scripts / file)
    content = path.read_text(encoding="utf-8")
    assert content.count(old) == 1, f"{old!r} stands {content.count(old)} times in {file}"
    path.write_text(content.replace(old, new), encoding="utf-8")
    done = package(tmp_path, *rtl)
    assert (tmp_path / "ip" / "component.xml").exists() == (path.parent == scripts)
    if path.parent == scripts:
        assert done.status == 0, done.said
        done = build(tmp_path, scripts=scripts)
    assert done.status == 1 and text in done.said, done.said
    assert not (tmp_path / "out" / "cmfpga.bit").exists()


def test_missing_files_are_named(tmp_path, rtl):
    assert "none.v does not exist: make rtl" in package(tmp_path, tmp_path / "none.v", rtl[1]).said
    assert "no component.xml: make ip" in build(tmp_path).said
    for words in (("fast",), ("200", "xc7z020clg400-1")):
        assert out_of_context(tmp_path, rtl[0], *words).status == 1
