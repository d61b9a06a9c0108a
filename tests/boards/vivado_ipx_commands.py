"""Commands of the strict model: the IP packager."""

from pathlib import Path

import vivado_ipx
from vivado_design import BlockDesign
from vivado_objects import Thing, VivadoError, number
from vivado_state import command


@command(
    "ipx::package_project",
    "-root_dir= -vendor= -library= -taxonomy= -import_files -set_current= -force",
)
def package_project(state, options):
    top = state.store.get("fileset:sources_1").properties["top"]
    if "compile order" not in state.steps or not top or len(state.sources) != 1:
        raise VivadoError("one source, its top and update_compile_order come first")
    if options.get("-set_current") != "true" or "-import_files" not in options:
        raise VivadoError("without -import_files and -set_current true the IP would point to the project's files")
    interfaces, loose = vivado_ipx.infer(state.sources[0].read_text(encoding="utf-8"), top)
    names = ("name", "version", "display_name", "description", "supported_families", "auto_family_support_level")
    state.core = state.store.add(
        Thing("core", top, {key: "" for key in names} | {"vendor": options["-vendor"], "library": options["-library"]},
              names)
    )  # fmt: skip
    state.core.root, state.core.interfaces, state.core.loose = Path(options["-root_dir"]), interfaces, loose
    state.core.registers, state.core.done = [], set()
    for interface in interfaces.values():
        state.store.add(
            Thing("bus_interface", interface.name, {"bus_type_vlnv": interface.bus, "interface_mode": interface.mode,
                                                    "abstraction_type_vlnv": interface.bus.replace(":1.0", "_rtl:1.0")})
        )  # fmt: skip
        for key, value in interface.parameters.items():
            state.store.add(Thing("bus_parameter", f"{interface.name}.{key}", {"value": value}, {"value"}))
        if interface.kind == "aximm":
            state.store.add(Thing("memory_map", interface.name))
            size = 1 << interface.ports["AWADDR"][2]
            state.store.add(Thing("address_block", "reg0", {"range": size, "width": 32}, {"range", "usage"}))


@command("ipx::current_core")
def current_core(state, _):
    if state.core is None:
        raise VivadoError("no core is open")
    return state.core.handle


def of_core(state, options):
    state.thing(options["-of_objects"], "core")


@command("ipx::get_bus_interfaces", "-of_objects= pattern")
def get_bus_interfaces(state, options, pattern):
    of_core(state, options)
    return [f"bus_interface:{name}" for name in BlockDesign.match(state.core.interfaces, pattern)]


@command("ipx::get_bus_parameters", "-of_objects= name")
def get_bus_parameters(state, options, name):
    interface = state.thing(options["-of_objects"], "bus_interface")
    handle = f"bus_parameter:{interface.name}.{name}"
    return [handle] if handle in state.store.things else []


@command("ipx::get_memory_maps", "-of_objects= pattern")
def get_memory_maps(state, options, pattern):
    of_core(state, options)
    return state.pick_listed("memory_map", pattern)


@command("ipx::get_address_blocks", "-of_objects= pattern")
def get_address_blocks(state, options, pattern):
    state.thing(options["-of_objects"], "memory_map")
    return state.pick_listed("address_block", pattern)


REGISTER = ("address_offset", "size", "access", "description", "display_name", "reset_value")
FIELD = ("bit_offset", "bit_width", "access", "description", "display_name", "modified_write_value", "read_action")


@command("ipx::add_register", "name block")
def add_register(state, _, name, block):
    state.thing(block, "address_block")
    thing = state.store.add(Thing("register", name, writable=REGISTER))
    state.core.registers.append(thing)
    return thing.handle


@command("ipx::add_field", "name register")
def add_field(state, _, name, register):
    owner = state.thing(register, "register")
    return state.store.add(Thing("field", f"{owner.name}.{name}", writable=FIELD)).handle


def core_step(name, needs=()):
    @command(name, "core")
    def step(state, _, core):
        state.thing(core, "core")
        if missing := set(needs) - state.core.done:
            raise VivadoError(f"{', '.join(sorted(missing))} comes first")
        state.core.done.add(name)


core_step("ipx::create_xgui_files")
core_step("ipx::update_checksums", ["ipx::create_xgui_files"])
core_step("ipx::check_integrity", ["ipx::update_checksums"])


@command("ipx::save_core", "core")
def save_core(state, _, core):
    core = state.thing(core, "core")
    if "ipx::check_integrity" not in core.done:
        raise VivadoError("ipx::check_integrity comes first")
    size = number(state.store.get("address_block:reg0").properties["range"])
    if size < 4096 or size & (size - 1) or size > 1 << core.interfaces["s_axi"].ports["AWADDR"][2]:
        raise VivadoError(f"address block of {size:#x} bytes does not fit its address bits")
    taken = {}
    for register in state.core.registers:
        offset = number(register.read("address_offset"))
        if offset % 4 or not 0 <= offset < size or offset in taken:
            raise VivadoError(
                f"register {register.name} at {offset:#x}: misaligned, outside, or over {taken.get(offset)}"
            )
        taken[offset] = register.name
    vlnv = ":".join(core.properties[key] for key in ("vendor", "library", "name", "version"))
    registers = [(name, offset) for offset, name in taken.items()]
    text = vivado_ipx.component_xml(vlnv, core.interfaces, core.loose, size, registers)
    (core.root / "component.xml").write_text(text, encoding="utf-8")
