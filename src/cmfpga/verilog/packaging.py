"""What other tools read of the core: FuseSoC's ``.core`` file (CAPI 2), and IP-XACT (IEEE 1685-2009)."""

from xml.etree import ElementTree

from .. import __version__
from .emit import TOP
from .example import BENCH, EXAMPLE, FIELDS
from .fields import packed
from .ports import plain

VENDOR, LIBRARY = "cmfpga.org", "ip"
_SPIRIT = "http://www.spiritconsortium.org/XMLSchema/SPIRIT/1685-2009"
_ABOUT = "Contrast Maximization for event cameras"


def fusesoc():
    """``cmfpga_core.core``: the core for other cores to depend on, and targets that lint and simulate the example."""
    return f"""\
CAPI=2:
# fusesoc --cores-root=. run --target=sim {VENDOR}:{LIBRARY}:{TOP}
name: {VENDOR}:{LIBRARY}:{TOP}:{__version__}
description: {_ABOUT}

filesets:
  core:
    files: [{TOP}.v]
    file_type: verilogSource
  example:
    files:
      - {FIELDS}.vh: {{is_include_file: true}}
      - {EXAMPLE}.v
    file_type: verilogSource
  bench:
    files:
      - {BENCH}.v: {{file_type: verilogSource}}
      - {EXAMPLE}.mem: {{file_type: user, copyto: {EXAMPLE}.mem}}

targets:
  # What a core that depends on this one gets.
  default:
    filesets: [core]
    toplevel: {TOP}
  # A batch through the example, by Icarus Verilog.
  sim:
    default_tool: icarus
    filesets: [core, example, bench]
    toplevel: {BENCH}
  lint:
    default_tool: verilator
    filesets: [core, example]
    toplevel: {EXAMPLE}
    tools:
      verilator:
        mode: lint-only
        # Operands are extended to the result's width, by Verilog's rules.
        verilator_options: [-Wno-WIDTHEXPAND]
"""


def _add(parent, name, text=None):
    made = ElementTree.SubElement(parent, f"{{{_SPIRIT}}}{name}")
    made.text = text
    return made


def _type(parent, name, vendor, library, type_, version):
    values = {"vendor": vendor, "library": library, "name": type_, "version": version}
    made = _add(parent, name)
    for key, value in values.items():
        made.set(f"{{{_SPIRIT}}}{key}", value)


def _vector(parent, high, low):
    vector = _add(parent, "vector")
    _add(vector, "left", str(high))
    _add(vector, "right", str(low))


def _bus(parent, name, kind, mode, maps):
    """A bus interface; ``maps`` are (logical, its highest and lowest bit or None, physical port)."""
    library, type_ = kind
    bus = _add(parent, "busInterface")
    _add(bus, "name", name)
    _type(bus, "busType", "xilinx.com", library, type_, "1.0")
    _type(bus, "abstractionType", "xilinx.com", library, f"{type_}_rtl", "1.0")
    _add(bus, mode)
    listed = _add(bus, "portMaps")
    for logical, bits, physical in maps:
        pair = _add(listed, "portMap")
        port = _add(pair, "logicalPort")
        _add(port, "name", logical)
        if bits:
            _vector(port, *bits)
        _add(_add(pair, "physicalPort"), "name", physical)


def _stream(parent, table, group, mode):
    """An AXI4-Stream whose TDATA has the fields where ``fields.vh`` says, but for ``last``."""
    places, _ = packed(table, group)
    maps = [("TVALID", None, f"{group}_valid"), ("TREADY", None, f"{group}_ready")]
    for port, lsb in places:
        if port.name == "event_last":  # the highest field
            maps.append(("TLAST", None, port.name))
        else:
            maps.append(("TDATA", (lsb + port.bits - 1, lsb), port.name))
    _bus(parent, group, ("interface", "axis"), mode, maps)


def ip_xact(table):
    """``component.xml``: clock, reset, the streams of events and results, and all ports.

    Parameters
    ----------
    table : list of Port
        :func:`~cmfpga.verilog.ports.port_table` of the core.
    """
    ElementTree.register_namespace("spirit", _SPIRIT)
    root = ElementTree.Element(f"{{{_SPIRIT}}}component")
    for name, text in (("vendor", VENDOR), ("library", LIBRARY), ("name", TOP), ("version", __version__)):
        _add(root, name, text)
    buses = _add(root, "busInterfaces")
    _bus(buses, "clk", ("signal", "clock"), "slave", [("CLK", None, "clk")])
    _bus(buses, "rst", ("signal", "reset"), "slave", [("RST", None, "rst")])
    _stream(buses, table, "event", "slave")
    _stream(buses, table, "result", "master")
    model = _add(root, "model")
    view = _add(_add(model, "views"), "view")
    for name, text in (("name", "verilog"), ("envIdentifier", "verilogSource::"), ("language", "verilog")):
        _add(view, name, text)
    _add(view, "modelName", TOP)
    _add(_add(view, "fileSetRef"), "localName", "verilog")
    ports = _add(model, "ports")
    for port in table:
        made = _add(ports, "port")
        _add(made, "name", port.name)
        _add(made, "description", plain(port.meaning))
        wire = _add(made, "wire")
        _add(wire, "direction", {"input": "in", "output": "out"}[port.direction])
        if port.bits > 1:
            _vector(wire, port.bits - 1, 0)
    files = _add(_add(root, "fileSets"), "fileSet")
    _add(files, "name", "verilog")
    file = _add(files, "file")
    _add(file, "name", f"{TOP}.v")
    _add(file, "fileType", "verilogSource")
    _add(root, "description", _ABOUT)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
