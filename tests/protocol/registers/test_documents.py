"""What is generated from the register map says what the map says."""

import re
import shutil
import subprocess
from xml.etree import ElementTree

import pytest

from cmfpga.config import preset
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.documents import BY_PEAKRDL, markdown, write_documents
from support.verilog_tools import check_ip_xact

PRESETS = ("paper", "fast")


@pytest.fixture(scope="module", params=PRESETS)
def written(request, tmp_path_factory):
    """(map, folder) with all documents."""
    pytest.importorskip("peakrdl_ipxact", reason="PeakRDL is not installed: pip install 'cmfpga[registers]'")
    registers = register_map(preset(request.param))
    folder = tmp_path_factory.mktemp(request.param)
    paths = write_documents(registers, 'A "title"', folder)
    assert all(path.stat().st_size for path in paths) and len(paths) == 4 + len(BY_PEAKRDL)
    return registers, folder


def test_systemrdl(written):
    """Compiled by another program than ours: every register and field at its place, with reset and access."""
    from systemrdl import RDLCompiler

    registers, folder = written
    compiler = RDLCompiler()
    compiler.compile_file(str(folder / "registers.rdl"))
    top = compiler.elaborate().top
    assert top.get_property("desc") == 'A "title"'
    found = {}
    for node in top.registers(unroll=False):
        fields = {
            f.inst_name: (f.low, f.width, f.get_property("reset"), f.is_sw_writable, f.is_sw_readable, f.is_hw_writable)
            for f in node.fields()
        }
        count = node.array_dimensions[0] if node.is_array else 1
        found[node.inst_name] = (node.raw_address_offset if node.is_array else node.address_offset, count, fields)
    assert list(found) == [register.name for register in registers]
    for register in registers:
        fields = {
            f.name: (f.lsb, f.width, None if f.access == "status" else f.reset & ((1 << f.width) - 1), f.writable,
                     f.access != "command", f.access in ("status", "flag", "sticky"))
            for f in register.fields
        }  # fmt: skip
        assert found[register.name] == (register.offset, register.count, fields)


def test_c_header(written, tmp_path):
    """Compiled by a C compiler: offsets, masks, and what is constant."""
    registers, folder = written
    compiler = next((path for path in map(shutil.which, ("cc", "gcc", "clang")) if path), None)
    if not compiler:
        pytest.skip("no C compiler")
    lines = ['#include "cmfpga_registers.h"']
    for register in registers:
        known = {f"CMFPGA_{register.name}": register.offset}
        for f in register.fields:
            name = f"CMFPGA_{register.name}__{f.name}"
            known |= {f"{name}_LSB": f.lsb, f"{name}_MASK": f.mask}
            known |= {f"{name}_{key}": value for key, value in f.values.items()}
            if f.access == "constant":
                known[f"{name}_VALUE"] = f.reset & f.mask >> f.lsb
        lines += [f'_Static_assert({name} == {value:#x}u, "{name}");' for name, value in known.items()]
    (tmp_path / "check.c").write_text("\n".join([*lines, "int main(void) { return 0; }"]) + "\n")
    done = subprocess.run(
        [compiler, "-fsyntax-only", f"-I{folder}", tmp_path / "check.c"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert len(lines) > 200


def test_ip_xact(written):
    registers, folder = written
    tree = ElementTree.parse(folder / "registers.xml")
    space = re.match(r"\{.*\}", tree.getroot().tag)[0]

    def text(node, name):
        return node.find(space + name).text

    assert text(tree.getroot(), "name") == "cmfpga"
    found = {}
    for node in tree.iter(f"{space}register"):
        parts = node.iter(f"{space}field")
        fields = {text(f, "name"): (int(text(f, "bitOffset"), 0), int(text(f, "bitWidth"), 0)) for f in parts}
        found[text(node, "name")] = (int(text(node, "addressOffset").replace("'h", "0x"), 0), fields)
    assert found == {
        register.name: (register.offset, {f.name: (f.lsb, f.width) for f in register.fields}) for register in registers
    }


def test_ip_xact_keeps_its_schema(written):
    check_ip_xact((written[1] / "registers.xml").read_bytes())


def test_html(written):
    registers, folder = written
    paths = [path for kind in ("*.js*", "*.html") for path in (folder / "registers-html").rglob(kind)]
    text = "".join(path.read_text() for path in paths)
    assert all(register.name in text for register in registers)


@pytest.mark.parametrize("name", PRESETS)
def test_markdown(name):
    """Every field is a row, under its register's offset."""
    registers = register_map(preset(name))
    found, offset = {}, None
    for line in markdown(registers).splitlines():
        cells = [cell.strip(" `") for cell in line.strip("|").split(" | ")]
        if len(cells) == 7 and cells[2][:1].isdigit():
            offset = int(cells[0], 16) if cells[0] else offset
            found[offset, cells[3]] = cells[2].split(":")
    fields = [(register.offset, f) for register in registers for f in register.fields]
    assert found == {
        (at, f.name): [f"{f.lsb + f.width - 1}", f"{f.lsb}"] if f.width > 1 else [f"{f.lsb}"] for at, f in fields
    }


def test_without_peakrdl(tmp_path, monkeypatch):
    monkeypatch.setattr("cmfpga.protocol.registers.documents.has_peakrdl", lambda: False)
    paths = write_documents(register_map(preset("fast")), "t", tmp_path)
    assert sorted(path.name for path in paths) == sorted(path.name for path in tmp_path.iterdir())
    assert [path.name for path in paths] == ["registers.rdl", "registers.md", "regs.tcl", "cmfpga_registers.h"]
