"""What commands do to a run ``v``, those that do more than to be recorded: files, states of runs, the packaged IP."""

import fnmatch
import shutil
import tkinter
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from support.board_files import bitstream
from support.vivado import interfaces as found_in
from support.vivado.design import VivadoError, write


def create_project(v, _, name, folder):
    v.folder, v.bd, v.generated = Path(folder), None, Path(folder) / f"{name}.gen/sources_1/bd"
    shutil.rmtree(folder, ignore_errors=True)
    v.folder.mkdir(parents=True)
    for kind in ("project", "fileset"):
        v.add(kind)
    for run in ("synth_1", "impl_1"):
        v.add("run", run, STATUS="Not started", PROGRESS="0%", DIRECTORY=f"{folder}/{name}.runs/{run}")


def create_bd_design(v, _, name):
    v.bd = name
    v.add("file", f"{name}.bd")


def add_files(v, options, files):
    for file in map(Path, v.tcl.splitlist(files)):
        if not file.is_file():
            raise VivadoError(f"{file}: no such file")
        v.files[options.get("-fileset", "sources_1")].append(file)


def update_ip_catalog(v, _):
    root = ElementTree.parse(f"{v.things['project:']['ip_repo_paths']}/component.xml").getroot()
    v.ips[root.get("vlnv")] = ({}, [part.text for part in root.iter("part")])


def make_wrapper(v, _):
    write(path := v.generated / v.bd / f"hdl/{v.bd}_wrapper.v")
    return (str(path),)


def launch_runs(v, options, run):
    v.need(run)
    if (top := v.things["fileset:"].get("top")) not in [path.stem for path in v.files["sources_1"]]:
        raise VivadoError(f"top {top!r} is not among the sources")
    if run == "impl_1" and "-to_step" not in options:
        raise VivadoError("impl_1 without -to_step write_bitstream writes no bitstream")
    v.things[f"run:{run}"]["STATUS"] = "Running"


def wait_on_run(v, _, run):
    values, status = v.things[f"run:{run}"], v.found["synth_status" if run == "synth_1" else "impl_status"]
    if values["STATUS"] != "Running":
        raise VivadoError(f"{run} was not launched")
    values |= {"STATUS": status, "PROGRESS": "100%" if status.endswith("Complete!") else "42%"}
    if status.endswith("Complete!"):
        v.do(run)
    if "impl_1" in v.done:
        constrain(v, (), v.files["constrs_1"])
        for port in v.names("port"):
            if missing := {"PACKAGE_PIN", "IOSTANDARD"} - set(v.things[f"port:{port}"]):
                raise VivadoError(f"port {port} has no {' and no '.join(sorted(missing))}")
        write(Path(values["DIRECTORY"]) / f"{v.bd}_wrapper.bit", bitstream("xck26-sfvc784-2LV-c"))


def constrain(v, ports, files):
    """Read XDC files, in which the commands of constraints are allowed; returns the clocks, ns."""
    for port in ports:
        v.add("port", port)
    v.add("design")
    v.done.add("XDC")
    for path in files:
        try:
            v.tcl.call("source", str(path))
        except tkinter.TclError as error:
            raise VivadoError(f"{Path(path).name}: {error}") from None
    v.done.remove("XDC")
    return v.clocks


def synth_design(v, options):
    (verilog,) = v.files["sources_1"]
    ports = found_in.ports(verilog.read_text(encoding="utf-8"), options["-top"])
    if not constrain(v, ports, v.files["constrs_1"]):
        raise VivadoError("no clock: nothing would be timed")


def package_project(v, options):
    v.root, (verilog,) = Path(options["-root_dir"]), v.files["sources_1"]
    v.interfaces = found_in.infer(verilog.read_text(encoding="utf-8"), v.things["fileset:"]["top"])
    v.add("core", vendor=options["-vendor"], library=options["-library"])
    for name, entry in v.interfaces.items():
        v.add("interface", name, bus_type_vlnv=entry["bus"], interface_mode=entry["mode"])
        for key, value in entry["parameters"].items():
            v.add("parameter", f"{name}.{key}", value=value)
    v.add("map", "s_axi")
    v.add("block", "reg0")


def save_core(v, _, core):
    size, taken = int(v.things["block:reg0"]["range"]), {}
    if size < 4096 or size & (size - 1) or size > 1 << v.interfaces["s_axi"]["ports"]["AWADDR"][2]:
        raise VivadoError(f"an address block of {size:#x} bytes does not fit its address bits")
    for name in v.names("register"):
        offset = int(v.things[f"register:{name}"]["address_offset"], 0)
        if offset % 4 or not 0 <= offset < size or offset in taken:
            raise VivadoError(f"{name} at {offset:#x}: misaligned, outside of {size:#x}, or over {taken.get(offset)}")
        taken[offset] = name
    vlnv = ":".join(v.things["core:"][key] for key in ("vendor", "library", "name", "version"))
    root = ElementTree.Element("component", vlnv=vlnv)
    for kind, names in (("interface", v.interfaces), ("register", taken.values())):
        for name in names:
            ElementTree.SubElement(root, kind, name=name)
    for line in found_in.catalog_lines(v.interfaces):
        ElementTree.SubElement(root, "part").text = line
    write(v.root / "component.xml", ElementTree.tostring(root, encoding="unicode"))


ACTIONS = {
    "create_project": create_project, "add_files": add_files, "update_ip_catalog": update_ip_catalog,
    "create_bd_design": create_bd_design, "make_wrapper": make_wrapper, "launch_runs": launch_runs,
    "wait_on_run": wait_on_run, "synth_design": synth_design, "ipx::package_project": package_project,
    "ipx::save_core": save_core, "version": lambda v, _: v.found["version"],
    "close_project": lambda v, _: (v.things.clear(), v.done.clear())[:0],
    "get_board_parts": lambda v, _, pattern: tuple(sorted(fnmatch.filter(v.found["boards"], pattern))[-1:]),
    "get_ipdefs": lambda v, _, pattern: tuple(fnmatch.filter(v.ips, pattern)),
    "generate_target": lambda v, *_: write(v.generated / v.bd / f"hw_handoff/{v.bd}.hwh"),
    "write_checkpoint": lambda v, _, file: write(file),
    "read_verilog": lambda v, _, file: v.files["sources_1"].append(Path(file)),
    "read_xdc": lambda v, _, file: v.files["constrs_1"].append(file),
    "create_clock": lambda v, options, _: v.clocks.update({options["-name"]: float(options["-period"])}),
}  # fmt: skip
