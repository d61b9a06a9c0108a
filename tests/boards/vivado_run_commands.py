"""Commands of the strict model: runs, reports, results, and the flow out of context."""

from pathlib import Path

import vivado_ipx
import vivado_reports
from vivado_objects import VivadoError, number
from vivado_state import command
from vivado_xdc import read_constraints


@command("get_runs", "name")
def get_runs(state, _, name):
    return state.store.get(f"run:{name}", "run").handle


@command("launch_runs", "-to_step= -jobs= run")
def launch_runs(state, options, handle):
    run = state.thing(handle, "run")
    if number(options.get("-jobs", "1")) < 1:
        raise VivadoError("-jobs must be positive")
    if run.name == "synth_1":
        top = state.store.get("fileset:sources_1").properties["top"]
        if top not in [path.stem for path in state.sources] or not state.need_design().valid:
            raise VivadoError(f"top {top!r} is not among the sources, or the block design is not valid")
    else:
        synthesis = state.store.get("run:synth_1").properties
        if synthesis["STATUS"] != "synth_design Complete!":
            raise VivadoError("synth_1 is not complete")
        if options.get("-to_step") != "write_bitstream":
            raise VivadoError("impl_1 without -to_step write_bitstream writes no bitstream")
    run.properties["STATUS"] = "Running"


@command("wait_on_run", "run")
def wait_on_run(state, _, handle):
    run = state.thing(handle, "run")
    if run.properties["STATUS"] != "Running":
        raise VivadoError(f"{run.name} was not launched")
    status = state.found["synth_status" if run.name == "synth_1" else "impl_status"]
    done = status.endswith("Complete!")
    run.properties |= {"STATUS": status, "PROGRESS": "100%" if done else "42%"}
    folder = Path(run.properties["DIRECTORY"])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "runme.log").write_text("of the model\n", encoding="utf-8")
    if run.name == "impl_1" and done:
        run_constraints(state)
        name = f"{state.design.name}_wrapper.bit"
        (folder / name).write_bytes(vivado_reports.bitstream(state.part))


def run_constraints(state):
    """Read the XDC files in an interpreter of their own; every port of the design needs a pin and a standard."""
    ports = {name: {} for name in state.design.ports}
    for path in state.constraints:
        read_constraints(path, ports)
    for name, properties in ports.items():
        if missing := {"PACKAGE_PIN", "IOSTANDARD"} - set(properties):
            raise VivadoError(f"[DRC UCIO-1, NSTD-1] port {name} has no {' and no '.join(sorted(missing))}")


@command("open_run", "name")
def open_run(state, _, name):
    run = state.store.get(f"run:{name}", "run")
    if run.properties["PROGRESS"] != "100%":
        raise VivadoError(f"{name} is not complete")
    state.open_design = name


REPORT_OPTIONS = {
    "report_timing_summary": "-delay_type= -max_paths= -report_unconstrained",
    "report_utilization": "-hierarchical",
    "report_power": "",
    "report_clock_interaction": "-delay_type= -no_header",
    "report_cdc": "-no_header -details -severity=",
    "report_bus_skew": "",
    "report_methodology": "",
    "report_drc": "",
    "report_ram_utilization": "",
}


def reporter(name, usage):
    @command(name, f"{usage} -file= -return_string")
    def report(state, options):
        state.need_open()
        if options.get("-delay_type", "min_max") != "min_max":
            raise VivadoError("only min_max covers setup and hold")
        if ("-file" in options) == ("-return_string" in options):
            raise VivadoError("-file or -return_string")
        text = vivado_reports.TEXTS[name](state.found)
        if "-return_string" in options:
            return text
        Path(options["-file"]).write_text(text, encoding="utf-8")


for _name, _usage in REPORT_OPTIONS.items():
    reporter(_name, _usage)


@command("write_hw_platform", "-fixed -include_bit -force -file= words...")
def write_hw_platform(state, options, *words):
    state.need_open()
    if words or not {"-fixed", "-include_bit", "-file"} <= set(options):
        raise VivadoError("-fixed -include_bit -file FILE")
    Path(options["-file"]).write_text("of the model\n", encoding="utf-8")


@command("read_verilog", "file")
def read_verilog(state, _, file):
    state.verilog = Path(file).read_text(encoding="utf-8")


@command("read_xdc", "-mode= file")
def read_xdc(state, options, file):
    if options.get("-mode") != "out_of_context" or state.verilog is None:
        raise VivadoError("-mode out_of_context, after read_verilog")
    state.constraints.append(Path(file))


@command("synth_design", "-mode= -top= -part=")
def synth_design(state, options):
    state.set_part(options.get("-part", ""))
    if options.get("-mode") != "out_of_context":
        raise VivadoError("-mode out_of_context, or every port would want a pin")
    if state.verilog is None:
        raise VivadoError("no source was read")
    ports = {name: {} for name in vivado_ipx.ports(state.verilog, options["-top"])}
    clocks = {}
    for path in state.constraints:
        read_constraints(path, ports, clocks)
    if not clocks:
        raise VivadoError("no clock: nothing would be timed")
    state.clocks, state.steps = clocks, ["synth_design"]


def flow_step(name, needs):
    @command(name)
    def step(state, _):
        if needs not in state.steps:
            raise VivadoError(f"{needs} comes first")
        state.steps.append(name)
        if name == "route_design":
            state.open_design = "routed"


for _name, _needs in (("opt_design", "synth_design"), ("place_design", "opt_design"),
                      ("phys_opt_design", "place_design"), ("route_design", "phys_opt_design")):  # fmt: skip
    flow_step(_name, _needs)


@command("write_checkpoint", "-force file")
def write_checkpoint(state, _, file):
    state.need_open()
    Path(file).write_text("of the model\n", encoding="utf-8")
