"""Commands of the strict model: projects, files, properties, boards, the IP catalog."""

import shutil
from pathlib import Path

from vivado_catalog import packaged_ip
from vivado_design import BlockDesign, Cell
from vivado_objects import Thing, VivadoError
from vivado_state import command


@command("version", "-short")
def version(state, options):
    return state.found["version"] if options else f"Vivado v{state.found['version']} (64-bit)"


@command("create_project", "-force -part= name folder?")
def create_project(state, options, name, folder="."):
    if state.project is not None:
        raise VivadoError("a project is open already")
    state.set_part(options.get("-part", ""))
    folder = Path(folder)
    for old in [*folder.glob(f"{name}.*")]:
        if "-force" not in options:
            raise VivadoError(f"{old} exists")
        shutil.rmtree(old)
    folder.mkdir(parents=True, exist_ok=True)
    state.project = state.store.add(
        Thing("project", name, {"PART": state.part, "DIRECTORY": str(folder), "board_part": "", "board_connections": "",
                                "ip_repo_paths": ""}, {"board_part", "board_connections", "ip_repo_paths"})
    )  # fmt: skip
    state.store.add(Thing("fileset", "sources_1", {"top": ""}, {"top"}))
    state.store.add(Thing("fileset", "constrs_1"))
    for run in ("synth_1", "impl_1"):
        where = folder / f"{name}.runs" / run
        state.store.add(Thing("run", run, {"STATUS": "Not started", "PROGRESS": "0%", "DIRECTORY": str(where)}))


@command("close_project")
def close_project(state, _):
    state.need_project()
    state.project = state.design = state.open_design = None
    state.store.things.clear()


@command("current_project")
def current_project(state, _):
    return state.need_project().handle


@command("current_fileset")
def current_fileset(state, _):
    state.need_project()
    return "fileset:sources_1"


@command("add_files", "-norecurse -fileset= files")
def add_files(state, options, files):
    fileset = state.store.get(f"fileset:{options.get('-fileset', 'sources_1')}", "fileset")
    for name in state.split(files):
        if not Path(name).is_file():
            raise VivadoError(f"{name}: no such file")
        (state.constraints if fileset.name == "constrs_1" else state.sources).append(Path(name))
        if name not in {thing.name for thing in state.store.of_kind("file")}:
            state.store.add(Thing("file", name))


@command("get_files", "pattern")
def get_files(state, _, pattern):
    matched = [thing.handle for thing in state.store.of_kind("file") if Path(thing.name).match(pattern)]
    if not matched:
        raise VivadoError(f"no file matches {pattern!r}")
    return matched


@command("update_compile_order", "-fileset=")
def update_compile_order(state, options):
    state.store.get(f"fileset:{options.get('-fileset')}", "fileset")
    state.steps.append("compile order")


@command("set_property", "-dict= words...")
def set_property(state, options, *words):
    if "-dict" in options:
        pairs, (objects,) = state.split(options["-dict"]), expect(words, 1)
        if len(pairs) % 2:
            raise VivadoError("-dict wants pairs of name and value")
        settings = dict(zip(pairs[::2], pairs[1::2], strict=True))
    else:
        name, value, objects = expect(words, 3)
        settings = {name: value}
    for thing in state.things(objects):
        if isinstance(thing, Cell):
            state.need_design().touch()
            thing.configure(settings)
            continue
        for name, value in settings.items():
            if thing.kind == "project":
                check_board(state, name, value)
            thing.write(name, value)


def expect(words, count):
    if len(words) != count:
        raise VivadoError(f"expected {count} words, got {len(words)}")
    return words


def check_board(state, name, value):
    if name == "board_part" and value not in state.found["boards"]:
        raise VivadoError(f"board part {value!r} is not installed")
    if name == "board_connections":
        if not state.project.properties["board_part"]:
            raise VivadoError("board_connections comes after board_part")
        connector, part = state.split(value)
        if (connector, part) != ("som240_1_connector", "xilinx.com:kv260_carrier:som240_1_connector:1.3"):
            raise VivadoError(f"no such carrier: {value!r}")


@command("get_property", "name object")
def get_property(state, _, name, handle):
    return state.thing(handle).read(name)


@command("get_board_parts", "-quiet -latest_file_version pattern")
def get_board_parts(state, options, pattern):
    found = sorted(BlockDesign.match(state.found["boards"], pattern))
    return found[-1:] if "-latest_file_version" in options else found


@command("update_ip_catalog")
def update_ip_catalog(state, _):
    for folder in state.split(state.need_project().properties["ip_repo_paths"]):
        component = Path(folder) / "component.xml"
        if not component.is_file():
            raise VivadoError(f"{folder} holds no IP")
        ip = packaged_ip(component)
        state.catalog[ip.vlnv] = ip


@command("get_ipdefs", "pattern")
def get_ipdefs(state, _, pattern):
    state.need_project()
    return BlockDesign.match(state.catalog, pattern)
