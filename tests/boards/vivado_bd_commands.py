"""Commands of the strict model: the block design."""

from pathlib import Path

from vivado_design import BlockDesign, Cell, parse_assignment
from vivado_objects import Thing, VivadoError
from vivado_state import command


@command("create_bd_design", "name")
def create_bd_design(state, _, name):
    project = state.need_project()
    if state.design is not None:
        raise VivadoError("a block design is open already")
    state.design = BlockDesign(name)
    file = Path(project.properties["DIRECTORY"]) / f"{project.name}.srcs/sources_1/bd/{name}/{name}.bd"
    state.store.add(Thing("file", str(file)))


@command("create_bd_cell", "-type= -vlnv= name")
def create_bd_cell(state, options, name):
    design, ip = state.need_design(), state.catalog.get(options.get("-vlnv"))
    if ip is None:
        raise VivadoError(f"the catalog has no IP {options.get('-vlnv')}")
    if options.get("-type") != ip.type:
        raise VivadoError(f"{ip.vlnv} is of type {ip.type}, not {options.get('-type')}")
    if name in design.cells or "/" in name:
        raise VivadoError(f"cell name {name!r} is taken or not plain")
    design.touch()
    cell = state.store.add(Cell(name, ip))
    design.cells[name] = cell
    return cell.handle


@command("apply_bd_automation", "-rule= -config= cell")
def apply_bd_automation(state, options, handle):
    cell = state.thing(handle, "cell")
    if options.get("-rule") != "xilinx.com:bd_rule:zynq_ultra_ps_e" or "zynq_ultra_ps_e" not in cell.ip.vlnv:
        raise VivadoError(f"rule {options.get('-rule')} does not fit {cell.short}")
    if state.split(options.get("-config", "")) != ("apply_board_preset", "1"):
        raise VivadoError("expected -config {apply_board_preset 1}")
    if not state.project.properties["board_connections"]:
        raise VivadoError("no carrier is connected: its UART, SD card and Ethernet would be missing from the preset")
    cell.preset = True


@command("create_bd_port", "-dir= -type= name")
def create_bd_port(state, options, name):
    if options.get("-dir") not in ("I", "O"):
        raise VivadoError("a port wants -dir I or O")
    state.need_design().touch()
    state.design.ports[name] = (options["-dir"], options.get("-type", "data"), 1)


def getter(name, kind, names):
    @command(name, "-quiet pattern")
    def get(state, options, pattern):
        return state.pick(kind, names(state.need_design()), pattern, "-quiet" in options)


getter("get_bd_ports", "port", lambda design: design.ports)
getter("get_bd_pins", "pin", BlockDesign.pins)
getter("get_bd_intf_pins", "intf_pin", BlockDesign.interfaces)
getter("get_bd_addr_spaces", "addr_space", BlockDesign.spaces)
getter("get_bd_addr_segs", "addr_seg", BlockDesign.segments)


@command("connect_bd_net", "objects...")
def connect_bd_net(state, _, *objects):
    names = [thing.name[1:] for text in objects for thing in state.things(text, "pin", "port")]
    state.need_design().connect(names)


@command("connect_bd_intf_net", "one other")
def connect_bd_intf_net(state, _, one, other):
    state.need_design().link(*(state.thing(text, "intf_pin").name[1:] for text in (one, other)))


@command("assign_bd_address", "-offset= -range= -target_address_space= segments")
def assign_bd_address(state, options, segments):
    if set(options) != {"-offset", "-range", "-target_address_space"}:
        raise VivadoError("without -offset, -range and -target_address_space Vivado would choose")
    space = state.thing(options["-target_address_space"], "addr_space").name[1:]
    state.need_design().assign(space, state.thing(segments, "addr_seg").name[1:], *parse_assignment(options))


@command("exclude_bd_addr_seg", "-target_address_space= segment")
def exclude_bd_addr_seg(state, options, segment):
    space = state.thing(options["-target_address_space"], "addr_space").name[1:]
    key = (space, state.thing(segment, "addr_seg").name[1:])
    if key in state.need_design().assigned:
        raise VivadoError(f"{key[1]} is assigned in {space}")
    state.design.excluded.add(key)


@command("regenerate_bd_layout")
def regenerate_bd_layout(state, _):
    state.need_design()


@command("validate_bd_design")
def validate_bd_design(state, _):
    state.need_design().validate()


@command("save_bd_design")
def save_bd_design(state, _):
    state.need_design().saved = True


@command("generate_target", "target files")
def generate_target(state, _, target, files):
    design = state.need_design()
    if target != "all" or not (design.valid and design.saved):
        raise VivadoError("target all, of a design that was validated and saved since its last change")
    state.thing(files, "file")
    state.steps.append("generated")
    project = state.project
    handoff = Path(project.properties["DIRECTORY"]) / f"{project.name}.gen/sources_1/bd/{design.name}/hw_handoff"
    handoff.mkdir(parents=True)
    (handoff / f"{design.name}.hwh").write_text("<!-- of the model, empty -->\n", encoding="utf-8")


@command("make_wrapper", "-files= -top")
def make_wrapper(state, options):
    design, project = state.need_design(), state.project
    if "-top" not in options or "generated" not in state.steps:
        raise VivadoError("-top, after generate_target")
    state.thing(options["-files"], "file")
    folder = Path(project.properties["DIRECTORY"]) / f"{project.name}.gen/sources_1/bd/{design.name}/hdl"
    folder.mkdir(parents=True)
    wrapper = folder / f"{design.name}_wrapper.v"
    wrapper.write_text(f"module {design.name}_wrapper; endmodule\n", encoding="utf-8")
    return str(wrapper)
