"""What ``cmfpga build --top kv260`` writes is what the board's files expect."""

import pytest

from cmfpga.cli import build
from support.board_files import BOARD, check_ports
from support.vivado.interfaces import infer

tkinter = pytest.importorskip("tkinter", reason="needs Python's tkinter: apt-get install python3-tk")


@pytest.fixture(scope="module")
def emitted(tmp_path_factory, command):
    folder = tmp_path_factory.mktemp("rtl")
    done = command(build, "--top", "kv260", "--preset", "fast", "--set", "buffer_events=64", "--out", folder)
    assert done.status == 0, done.err
    return folder


def test_ports_are_those_of_the_facts(emitted, maker, facts):
    tcl = dict(line.split(maxsplit=2)[1:] for line in maker.facts_tcl(facts).splitlines() if line.startswith("set"))
    tcl = {name.removeprefix("fact(").removesuffix(")"): value.strip("{}") for name, value in tcl.items()}
    check_ports(infer((emitted / "cmfpga_kv260.v").read_text(encoding="utf-8"), facts["design"]["top"]), tcl)


def test_packages_and_builds(emitted, tmp_path):
    from support.vivado.model import Vivado

    run = Vivado()
    arguments = (emitted / "cmfpga_kv260.v", emitted / "regs.tcl", tmp_path / "ip")
    assert run.source(BOARD / "vivado" / "package_ip.tcl", *arguments) == 0, "\n".join(run.output)
    assert "<register " in (tmp_path / "ip" / "component.xml").read_text(encoding="utf-8")
    run = Vivado()
    arguments = (tmp_path / "ip", tmp_path / "out", 1)
    assert run.source(BOARD / "vivado" / "build.tcl", *arguments) == 0, "\n".join(run.output)
