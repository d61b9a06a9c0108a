"""Which tests are long: found by what a test asks for, through its fixtures, helpers, parameters and configurations.

A test asks for what is named in its code, in that of its fixtures, and in that of all helpers of ``tests`` that these
name. It is long if one of these is a door of :data:`DOORS`, or one to hardware that is not in :data:`designs.QUICK`.
What no name tells, such as the engine in a command's options, a fixture says: ``long_tools``.
"""

import contextlib
import copy
import functools
import inspect
import sys
import types
from pathlib import Path

import pytest

from cmfpga.config import Config
from support import designs

ROOT = Path(__file__).parents[1]

#: Doors to what takes long, by module and name, and what lies behind them. An empty name: all that the module has.
DOORS = {
    ("subprocess", ""): "process",
    ("support.formal.harness", "solve"): "solver",
    ("support.verilog_tools", "icarus_compile"): "Icarus",
    ("support.verilog_tools", "require_icarus"): "Icarus",
    ("support.axi.simulators", ""): "cocotb",
    ("support.verilog_tools", "yosys"): "Yosys",
    ("support.verilog_tools", "verilator_lint"): "lint",
    **{("cmfpga.fpga.resources", name): "Yosys" for name in ("estimate", "core", "hard_blocks")},
    ("cmfpga.fpga.levels", "levels"): "Yosys",
    ("cmfpga.fpga.tools", "run"): "Yosys",
    ("cmfpga.fpga.tools", "yosys"): "Yosys",
    ("cmfpga.fpga.place", "place"): "place and route",
    ("cmfpga.fpga.place", "netlist_of"): "place and route",
    ("cmfpga.fpga.bitstream", "bitstream"): "place and route",
    ("support.mutation", "break_blocks"): "mutants",
    ("studies.bench.opponents", ""): "opponents",
    ("studies.crosscheck", "main"): "random designs",
}

#: Doors to a compiled or emitted design: quick where all configurations that the test names are.
HARDWARE_DOORS = {
    ("cmfpga.verilog.simulation", "VerilatedCore"),
    ("cmfpga.driver.simulation", "SimulatedTop"),
    ("support.serial_line", "SimulatedLine"),
    ("cmfpga.engines.rtl", "VerilatedEngine"),
    ("cmfpga.engines.rtl", "AmaranthEngine"),
    ("cmfpga.verilog.emit", "emit_verilog"),
    ("support.core", "drive_core"),
    ("cmfpga.verilog.compile", "compile_library"),
    ("cmfpga.verilog.compile", "kept_verilog"),
}
HARDWARE_FIXTURES = {"compiler", "emitted"}

#: Fixtures that are doors.
FIXTURES = {"browser": "browser", "data_dir": "recordings", "process": "process", "long_tools": "long tools"}
#: Of these none is quick: what they start is translated for a minute where it was never used before.
SLOW_TO_START = {"solver", "Yosys"}
#: One of each other kind, which ``make test`` runs nevertheless.
SMOKE = {
    "boards/test_bit2bin.py::test_fields_as_json",
    "studies/bench/test_programs.py::test_few_events[gather-5]",
    "cli/test_build.py::test_hardware_fields_change_the_verilog[sensor_width]",
    "cli/test_command.py::test_without_arguments_it_helps_and_fails",
    "driver/test_alone.py::test_the_driver_alone",
    "examples/test_examples.py::test_block_in_a_design",
    "show/report/test_browser.py::test_a_click_on_a_chart_goes_to_its_batch",
    "rtl/regions/test_regions.py::test_a_batch_without_any_event_in_a_region_is_degenerate_in_all[one unit]",
    "rtl/regions/test_distributor.py::test_each_row_once_and_in_order[family0-10]",
    "rtl/test_core.py::test_cold_and_warm_schedules[both]",
    "rtl/test_core.py::test_reset_in_the_middle[result-small]",
    "rtl/test_core_mutants.py::test_a_broken_block_is_noticed[one too many]",
    "verilog/simulation/test_axi.py::test_in_icarus[cocotb_registers]",
    "studies/test_crosscheck.py::test_interrupted_it_says_what_it_has",
    "protocol/test_words.py::test_a_real_file",
    "verilog/test_icarus.py::test_passes[two by two]",
    "fpga/test_place.py::test_nextpnr_fails",
    "verilog/test_verilator_lint.py::test_no_warning_beside_them_and_all_are_needed[two by two]",
}

#: What is long about each test that was found, by its name.
collected = {}


@functools.cache
def _is_ours(filename):
    return Path(filename).is_relative_to(ROOT)


class Asked:
    """What a test function and its fixtures name; ``kinds`` of long tools, and the configurations."""

    def __init__(self):
        self.kinds, self.designs, self.compiles, self._seen = set(), set(), False, set()

    def visit(self, thing, depth=0):
        """One object: a door, a configuration, a helper of ours, or a collection of these."""
        if id(thing) in self._seen:
            return
        if isinstance(thing, Config):
            self.designs.add(thing.hardware_hash)
        elif isinstance(thing, dict) and any(thing is options for options in designs.OPTIONS):
            self.designs.add(next(iter(designs.QUICK))[0])
        elif isinstance(thing, dict) and depth < 3:
            for value in thing.values():
                self.visit(value, depth + 1)
        elif isinstance(thing, list | tuple | set | frozenset) and depth < 3:
            for value in thing:
                self.visit(value, depth + 1)
        elif inspect.isfunction(thing) or inspect.isclass(thing) or inspect.ismethod(thing):
            self._seen.add(id(thing))
            self._callable(thing)
        elif isinstance(thing, functools.partial):
            for part in (thing.func, *thing.args, *thing.keywords.values()):
                self.visit(part, depth + 1)
        elif isinstance(thing, functools._lru_cache_wrapper):
            self.visit(thing.__wrapped__, depth)

    def _callable(self, thing):
        where = getattr(thing, "__module__", None), getattr(thing, "__name__", None)
        package = str(where[0]).rpartition(".")[0]
        self.kinds |= {DOORS[door] for door in (where, (where[0], ""), (package, "")) if door in DOORS}
        self.compiles |= where in HARDWARE_DOORS
        if inspect.isclass(thing):
            if str(where[0]).partition(".")[0] not in ("cmfpga", "amaranth", "numpy"):
                for value in vars(thing).values():
                    self.visit(getattr(value, "fget", None) or getattr(value, "__func__", None) or value)
            return
        if hasattr(thing, "__wrapped__"):
            self.visit(thing.__wrapped__)
        function = getattr(thing, "__func__", thing)
        for cell in function.__closure__ or ():
            with contextlib.suppress(ValueError):  # not filled yet
                self.visit(cell.cell_contents)
        if _is_ours(function.__code__.co_filename):
            self._code(function.__code__, function.__globals__)

    def _code(self, code, names):
        for name in code.co_names:
            found = names.get(name, sys.modules.get(name))
            if isinstance(found, types.ModuleType):
                for member in code.co_names:
                    self.visit(vars(found).get(member))
            elif found is not None:
                self.visit(found)
        for inner in code.co_consts:
            if isinstance(inner, types.CodeType):
                self._code(inner, names)

    @property
    def why(self):
        """The kinds of what is long about it; empty of a quick test."""
        quick = {hardware for hardware, _ in designs.QUICK}
        other = {"design"} if self.compiles and not (self.designs and self.designs <= quick) else set()
        return self.kinds | other


@functools.cache
def _whatever_the_parameters(function, fixtures):
    """Of all tests that share a function and the fixtures ``(name, function)``."""
    found = Asked()
    found.visit(function)
    for name, made_by in fixtures:
        found.compiles |= name in HARDWARE_FIXTURES
        if name in FIXTURES:
            found.kinds.add(FIXTURES[name])
        found.visit(made_by)
    return found


def asked(item):
    """What a collected test asks for."""
    fixtures = ((name, every[-1].func) for name, every in item._fixtureinfo.name2fixturedefs.items())
    found = copy.deepcopy(_whatever_the_parameters(item.obj, tuple(fixtures)))
    for value in (getattr(item, "callspec", None) and item.callspec.params.values()) or ():
        found.visit(value)
    return found


@pytest.fixture(scope="session")
def long_tools():
    """Asks for what no name in a test tells: processes, hardware beyond ``designs.QUICK``, many seconds."""


def pytest_addoption(parser):
    parser.addoption("--why-long", action="store_true", help="say what is long about each test that is chosen")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    for item in items:
        name = item.nodeid.removeprefix("tests/")
        why = collected[name] = asked(item).why
        if why and name not in SMOKE:
            item.add_marker(pytest.mark.long(*sorted(why)))
        if config.getoption("--why-long"):
            print(item.nodeid, *sorted(why), sep="  ")
