"""The Vivado scripts, run through a strict model of the commands that they use; seeded mistakes are caught."""

import json
import shutil

import pytest

from support.board_files import BOARD, REGISTERS, stand_in

pytest.importorskip("tkinter", reason="needs Python's tkinter: apt-get install python3-tk")

from vivado import Vivado
from vivado_state import COMMANDS
from vivado_xdc import read_constraints

SCRIPTS = BOARD / "vivado"


def package(folder, verilog, registers, scripts=SCRIPTS, found=None):
    run = Vivado(found)
    run.source(scripts / "package_ip.tcl", verilog, registers, folder / "ip")
    return run


def build(folder, scripts=SCRIPTS, found=None):
    run = Vivado(found)
    run.source(scripts / "build.tcl", folder / "ip", folder / "out", 2)
    return run


def out_of_context(folder, verilog, *arguments, found=None):
    run = Vivado(found)
    run.source(SCRIPTS / "ooc.tcl", verilog, folder / "ooc", *(arguments or ("200",)))
    return run


def said(run):
    return "\n".join(run.output)


@pytest.fixture
def packaged(tmp_path, rtl):
    run = package(tmp_path, *rtl)
    assert run.status == 0, said(run)
    return tmp_path


def test_ip_is_packaged(packaged, facts):
    text = (packaged / "ip" / "component.xml").read_text(encoding="utf-8")
    for name, *_ in facts["ip"]["interfaces"]:
        assert f'<interface name="{name}"' in text
    assert 'vlnv="cmfpga.org:ip:cmfpga:1.0"' in text
    assert '<register name="CTRL"' in text
    assert not (packaged / "ip" / "project").exists()


@pytest.mark.parametrize("found", [{}, {"inline_slice": True, "version": "2025.1.1"}], ids=["xlslice", "ilslice"])
def test_bitstream_is_built(packaged, found):
    run = build(packaged, found=found)
    assert run.status == 0, said(run)
    out = packaged / "out"
    assert {path.name for path in out.iterdir()} >= {"cmfpga.bit", "cmfpga.hwh", "cmfpga.xsa", "summary.json"}
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["passed"] is True and summary["complaints"] == []
    assert summary["timing"] == {
        "wns": 0.12, "tns": 0.0, "whs": 0.01, "ths": 0.0, "wpws": 1.5, "tpws": 0.0, "unclocked": 0,
    }  # fmt: skip
    assert summary["utilisation"] == {
        "luts": 12345, "registers": 9876, "block_rams": 10.5, "ultra_rams": 0, "dsps": 33,
    }  # fmt: skip
    assert summary["power_w"] == 3.412
    assert summary["clock_mhz"] == 200 and summary["fmax_mhz"] == round(1000 / (5 - 0.12), 1)
    assert len(list((out / "reports").iterdir())) == 10


def test_design_has_the_addresses_and_widths_of_the_facts(packaged, facts):
    design = build(packaged).state
    # close_project drops the objects, so look at a run that stops before it
    assert design.design is None
    run = Vivado()
    run.tcl.eval("rename close_project model_close; proc close_project {} {}")
    run.source(SCRIPTS / "build.tcl", packaged / "ip", packaged / "out", 2)
    design = run.state.design
    control, memory = facts["control"], facts["memory"]
    assert design.assigned == {
        ("ps/Data", "cmfpga/s_axi/reg0"): (control["cmfpga"]["address"], control["cmfpga"]["size"]),
        ("ps/Data", "dma/S_AXI_LITE/Reg"): (control["dma"]["address"], control["dma"]["size"]),
        **{
            (f"dma/Data_{channel}", f"ps/SAXIGP2/HP0_DDR_{half.upper()}"): tuple(memory[f"ddr_{half}"])
            for channel in ("MM2S", "S2MM")
            for half in ("low", "high")
        },
    }
    ps = design.cells["ps"].values
    assert int(ps["PSU__MAXIGP0__DATA_WIDTH"]) == control["data_width"]
    assert int(ps["PSU__SAXIGP2__DATA_WIDTH"]) == memory["data_width"]
    assert int(ps["PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ"]) == facts["clock"]["mhz"]
    assert [name for name, value in ps.items() if name.startswith("PSU__USE__") and value == "1"] == [
        "PSU__USE__M_AXI_GP0", "PSU__USE__S_AXI_GP2", "PSU__USE__IRQ0",
    ]  # fmt: skip
    assert design.driver("ps/pl_ps_irq0") == "cmfpga/irq"
    assert {
        design.driver(name) for name, pin in design.pins().items() if pin.kind == "clk" and pin.direction == "I"
    } == {"ps/pl_clk0"}


def test_out_of_context(tmp_path, rtl):
    run = out_of_context(tmp_path, rtl[0], "250")
    assert run.status == 0, said(run)
    summary = json.loads((tmp_path / "ooc" / "summary.json").read_text(encoding="utf-8"))
    assert (summary["flow"], summary["clock_mhz"], summary["fmax_mhz"]) == ("out_of_context", 250, 257.7)
    assert run.state.clocks == {"aclk": 4.0}
    assert out_of_context(tmp_path, rtl[0], found={"wns": "-0.5"}).status == 1


def test_the_shipped_clock_constraint(tmp_path, facts):
    clocks = {}
    read_constraints(SCRIPTS / "cmfpga_ooc.xdc", {"aclk": {}}, clocks)
    assert clocks == {"aclk": 1000 / facts["clock"]["mhz"]}


def test_every_command_of_the_model_is_used(packaged, rtl):
    """A model that knows more than the scripts need would hide a wrong name."""
    used = package(packaged, *rtl).used | build(packaged).used | out_of_context(packaged, rtl[0]).used
    assert used == set(COMMANDS)


#: A run that goes wrong in Vivado: what it finds, and what the script must say.
FAILURES = {
    "timing missed": ({"wns": "-0.210"}, "setup timing is missed by 0.21"),
    "hold missed": ({"whs": "-0.010"}, "hold timing is missed"),
    "pulse width": ({"wpws": "-1.000"}, "pulse width timing is missed"),
    "nothing timed": ({"wns": "NA"}, "no constrained path"),
    "unclocked registers": ({"unclocked": 7}, "7 registers have no clock"),
    "unsafe crossing": ({"unsafe": True}, "clock crossing without constraint"),
    "critical crossing": ({"critical_cdc": True}, "critical clock-domain crossing"),
    "unknown report": ({"strange_layout": True}, "no row of slacks"),
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
    run = build(packaged, found=found)
    assert run.status == 1
    assert text in said(run) and "ERROR: cmfpga:" in said(run)
    if name != "old Vivado":
        assert not (packaged / "out" / "cmfpga.bit").exists()
    if name in ("timing missed", "unsafe crossing"):
        summary = json.loads((packaged / "out" / "summary.json").read_text(encoding="utf-8"))
        assert summary["passed"] is False and text in summary["complaints"][0]


#: Mistakes in the scripts: file, what is replaced (once), by what, and what the model must say.
MISTAKES = {
    "misspelt command": ("design.tcl", "regenerate_bd_layout", "regenerate_layout", "invalid command name"),
    "unknown option": ("build.tcl", "-fixed -include_bit", "-fixed -include_bits", "unknown option"),
    "misspelt pin": ("design.tcl", "dma/m_axi_s2mm_aclk]", "dma/m_axi_s2m_aclk]", "no pin matches"),
    "misspelt interface": ("design.tcl", "control/M01_AXI", "control/M02_AXI", "no intf_pin matches"),
    "unknown parameter": ("design.tcl", "CONFIG.c_include_mm2s 1", "CONFIG.c_with_mm2s 1", "no parameter"),
    "value out of range": ("facts.tcl", "fact(dma_length_width)        26", "fact(dma_length_width) 27",
                           "cannot be '27'"),
    "unknown IP": ("design.tcl", "xilinx.com:ip:proc_sys_reset", "xilinx.com:ip:proc_sysreset", "Vivado has no IP"),
    "clock not connected": ("design.tcl", "cmfpga/aclk to_core/aclk", "to_core/aclk",
                            "cmfpga/aclk (clk) is not connected"),
    "reset not connected": ("design.tcl", "{control/aresetn memory/aresetn}", "{control/aresetn}",
                            "memory/aresetn (rst_n) is not connected"),
    "reset of the wrong polarity": ("design.tcl", "reset/peripheral_aresetn", "reset/peripheral_reset", "wants rst_n"),
    "reset for a clock": ("design.tcl", "ps/pl_resetn0] [get_bd_pins reset/ext_reset_in",
                          "ps/pl_clk0] [get_bd_pins reset/ext_reset_in", "wants rst_n, ps/pl_clk0 gives clk"),
    "two drivers": ("design.tcl", "ps/emio_ttc0_wave_o] [get_bd_pins fan/Din]",
                    "ps/emio_ttc0_wave_o] [get_bd_pins cmfpga/irq]", "two drivers"),
    "stream left open": ("design.tcl", "from_core/M_AXIS dma/S_AXIS_S2MM", "",
                         "interface dma/S_AXIS_S2MM is not connected"),
    "stream widths differ": ("facts.tcl", "fact(stream_bytes)            8", "fact(stream_bytes) 4", "differ in bytes"),
    "no TUSER in between": ("design.tcl", "create_subset_converter to_core 0 $fact(stream_user_width)",
                            "create_subset_converter to_core 0 0", "differ in user"),
    "master to master": ("design.tcl", "memory/M00_AXI ps/$fact(memory_port)", "memory/M00_AXI dma/M_AXI_SG",
                         "no intf_pin matches"),
    "interface used twice": ("design.tcl", "dma/M_AXI_S2MM memory/S01_AXI", "dma/M_AXI_S2MM memory/S00_AXI",
                             "connected already"),
    "overlapping addresses": ("facts.tcl", "0xa0010000", "0xa0000000", "overlaps"),
    "misaligned address": ("facts.tcl", "0xa0010000", "0xa0018000", "misaligned"),
    "address outside of the window": ("facts.tcl", "0xa0010000", "0x90010000", "outside of the windows"),
    "address not assigned": ("design.tcl", "foreach half {low high}", "foreach half {low}", "DDR_HIGH has no address"),
    "address bits": ("facts.tcl", "fact(dma_address_width)       40", "fact(dma_address_width) 32", "32 address bits"),
    "second master port left on": ("facts.tcl", "{CONFIG.PSU__USE__M_AXI_GP1 CONFIG.PSU__USE__M_AXI_GP2}",
                                   "{CONFIG.PSU__USE__M_AXI_GP2}", "ps/maxihpm1_fpd_aclk (clk) is not connected"),
    "port without interrupt": ("design.tcl", "connect_bd_net [get_bd_pins cmfpga/irq] [get_bd_pins ps/pl_ps_irq0]", "",
                               "cmfpga/irq reaches no interrupt"),
    "preset forgotten": ("design.tcl", 'apply_bd_automation -rule xilinx.com:bd_rule:zynq_ultra_ps_e -config '
                         '{apply_board_preset "1"} $ps', "", "before the board's preset"),
    "carrier forgotten": ("build.tcl", "set_property board_connections", "list", "no carrier is connected"),
    "unknown board part": ("build.tcl", "[exactly_one \"board part\" $found]", "xilinx.com:kv260:part0:1.4",
                           "is not installed"),
    "change after validation": ("design.tcl", "    validate_bd_design\n",
                                "    validate_bd_design\n    create_bd_port -dir O spare\n", "validated and saved"),
    "not validated": ("design.tcl", "    validate_bd_design\n", "", "validated and saved"),
    "constraints forgotten": ("build.tcl", "add_files -fileset constrs_1", "add_files -fileset sources_1",
                              "port fan_en_b has no"),
    "pin forgotten": ("kv260.xdc", "set_property PACKAGE_PIN A12 [get_ports {fan_en_b}]\n", "",
                      "port fan_en_b has no PACKAGE_PIN"),
    "unknown port": ("kv260.xdc", "set_property SLEW SLOW [get_ports {fan_en_b}]", "set_property SLEW SLOW "
                     "[get_ports {fan}]", "no port fan"),
    "second constraint of the clock": ("kv260.xdc", "set_property SLEW SLOW [get_ports {fan_en_b}]",
                                       "create_clock -name c -period 5 [get_ports {fan_en_b}]", "already"),
    "top forgotten": ("build.tcl", "set_property top $fact(block_design)_wrapper", "set_property top $fact(top)",
                      "is not among the sources"),
    "bitstream forgotten": ("build.tcl", "run_to_end impl_1 write_bitstream", 'run_to_end impl_1 ""', "-to_step"),
    "unknown property": ("build.tcl", "get_property PROGRESS", "get_property PROGRES", "no property PROGRES"),
    "variable unset": ("design.tcl", "$fact(memory_excluded)", "$fact(memory_exclude)", "no such element"),
}  # fmt: skip


def broken(folder, mistake):
    file, old, new, text = mistake
    shutil.copytree(SCRIPTS, folder)
    path = folder / file
    content = path.read_text(encoding="utf-8").replace(" \\\n        ", " ").replace("  \n", "\n")
    assert content.count(old) == 1, f"{old!r} stands {content.count(old)} times in {file}"
    path.write_text(content.replace(old, new), encoding="utf-8")
    return text


@pytest.mark.parametrize("name", MISTAKES)
def test_mistake_in_the_design_is_caught(name, packaged):
    text = broken(packaged / "scripts", MISTAKES[name])
    run = build(packaged, packaged / "scripts")
    assert run.status == 1, said(run)
    assert text in said(run)
    assert not (packaged / "out" / "cmfpga.bit").exists()


#: Mistakes in the emitted top, or in the packaging: what is replaced, by what, and what must be said.
IP_MISTAKES = {
    "attribute forgotten": ('  (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 m_axis TLAST" *)\n', "",
                            "m_axis_tlast has no X_INTERFACE_INFO"),
    "signal misspelt": ("m_axis TVALID", "m_axis VALID", "ports missing: ['TVALID']"),
    "interface not associated": ("s_axi:s_axis:m_axis", "s_axi:s_axis", "ASSOCIATED_BUSIF is s_axi s_axis"),
    "active-high reset": ("POLARITY ACTIVE_LOW", "POLARITY ACTIVE_HIGH", "POLARITY"),
    "edge interrupt": ("SENSITIVITY LEVEL_HIGH", "SENSITIVITY EDGE_RISING", "SENSITIVITY"),
    "signal twice": ("s_axi BRESP", "s_axi RRESP", "has another port with signal RRESP"),
    "other protocol": ("PROTOCOL AXI4LITE", "PROTOCOL AXI4", "PROTOCOL"),
    "other module name": ("module cmfpga_kv260(", "module cmfpga_core(", "no module cmfpga_kv260"),
    "wrong bus": ("xilinx.com:signal:interrupt:1.0", "xilinx.com:signal:clock:1.0", "ports missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", IP_MISTAKES)
def test_mistake_in_the_top_is_caught(name, tmp_path, rtl):
    old, new, text = IP_MISTAKES[name]
    assert stand_in().count(old) == 1
    rtl[0].write_text(stand_in().replace(old, new), encoding="utf-8")
    run = package(tmp_path, *rtl)
    assert run.status == 1 and text in said(run), said(run)
    assert not (tmp_path / "ip" / "component.xml").exists()


def test_there_are_as_many_mistakes_as_the_documents_say():
    assert len(MISTAKES) + len(IP_MISTAKES) > 40


def test_registers_over_each_other_are_caught(tmp_path, rtl):
    rtl[1].write_text(
        REGISTERS.replace("set register", "foreach name {A B} {\n set register", 1).replace("CTRL", "$name")[:-2]
        + "}\n}\n",
        encoding="utf-8",
    )
    run = package(tmp_path, *rtl)
    assert run.status == 1 and "over A" in said(run)


def test_missing_files_are_named(tmp_path, rtl):
    run = package(tmp_path, tmp_path / "none.v", rtl[1])
    assert run.status == 1 and "none.v does not exist: make rtl" in said(run)
    run = build(tmp_path)
    assert run.status == 1 and "no component.xml: make ip" in said(run)
    assert out_of_context(tmp_path, rtl[0], "fast").status == 1
    assert out_of_context(tmp_path, rtl[0], "200", "xc7z020clg400-1").status == 1
