"""A Verilog module's interfaces as Vivado infers them of its attributes (UG994, "List of supported X_ attributes")."""

import re

from support.vivado.design import VivadoError

ATTRIBUTES = r"(?:\(\*(?:(?!\*\)).)*\*\)\s*)*"
PORT = re.compile(rf"({ATTRIBUTES})\b(input|output)\s+(?:wire\s+|reg\s+)?(?:\[(\d+):(\d+)\]\s*)?(\w+)\s*[;,)]", re.S)
#: By bus: signals that it needs, signals that it may have, the one that a master drives, parameters.
BUSES = {
    "clock": ("CLK", "", None, {}),
    "reset": ("RST", "", None, {"POLARITY": "ACTIVE_LOW"}),
    "interrupt": ("INTERRUPT", "", "INTERRUPT", {"SENSITIVITY": "LEVEL_HIGH"}),
    "aximm": ("AWADDR AWVALID AWREADY WDATA WSTRB WVALID WREADY BRESP BVALID BREADY ARADDR ARVALID ARREADY RDATA RRESP "
              "RVALID RREADY", "AWPROT ARPROT", "AWVALID", {"PROTOCOL": "AXI4LITE"}),
    "axis": ("TDATA TVALID TREADY", "TKEEP TLAST TUSER TSTRB TID TDEST", "TVALID", {}),
}  # fmt: skip


def ports(verilog, top):
    """``{name: (direction, width, attributes)}`` of a module."""
    plain = re.sub(r"//[^\n]*|/\*.*?\*/", "", verilog, flags=re.S)
    module = re.search(rf"^\s*{ATTRIBUTES}module\s+{re.escape(top)}\b.*?^\s*endmodule", plain, re.S | re.M)
    if not module:
        raise VivadoError(f"there is no module {top}")
    return {
        name: (way, int(high or 0) - int(low or 0) + 1, dict(re.findall(r'(X_INTERFACE_\w+)\s*=\s*"([^"]*)"', texts)))
        for texts, way, high, low, name in PORT.findall(module[0])
    }


def infer(verilog, top):
    """``{interface: {"kind", "bus", "mode", "ports": {signal: (port, direction, width)}, "parameters"}}``.

    A port without an interface is an error: what the IP has belongs to one.
    """
    found = {}
    for port, (direction, width, attributes) in ports(verilog, top).items():
        info = attributes.get("X_INTERFACE_INFO", "").split()
        if len(info) != 3:
            raise VivadoError(f"port {port} has no X_INTERFACE_INFO of bus, name, signal: {info}")
        bus, name, signal = info
        entry = found.setdefault(name, {"kind": bus.split(":")[2], "bus": bus, "ports": {}, "parameters": {}})
        if entry["bus"] != bus or signal in entry["ports"]:
            raise VivadoError(f"port {port}: {name} has another port with signal {signal}, or another bus")
        entry["ports"][signal] = (port, direction, width)
        words = dict(re.findall(r"(\w+)\s+([^,\s]+)", attributes.get("X_INTERFACE_PARAMETER", "")))
        if words.pop("XIL_INTERFACENAME", name) != name:
            raise VivadoError(f"port {port}: its parameters are for another interface than {name}")
        entry["parameters"] |= words
    for name, entry in found.items():
        needed, optional, leading, parameters = BUSES[entry["kind"]]
        signals = set(entry["ports"])
        if missing := set(needed.split()) - signals:
            raise VivadoError(f"interface {name}: ports missing: {sorted(missing)}")
        if unknown := signals - set(needed.split()) - set(optional.split()):
            raise VivadoError(f"interface {name}: {entry['bus']} has no signals {sorted(unknown)}")
        for key, value in parameters.items():
            if entry["parameters"].get(key) != value:
                raise VivadoError(f"interface {name}: {key} must say {value}")
        entry["mode"] = "master" if leading and entry["ports"][leading][1] == "output" else "slave"
    return found


def catalog_lines(interfaces):
    """What the packaged IP has, in lines of the catalogue."""
    (clock,) = (name for name, entry in interfaces.items() if entry["kind"] == "clock")
    for name, entry in interfaces.items():
        kind, mode, width = entry["kind"], entry["mode"], {key: port[2] for key, port in entry["ports"].items()}
        if kind == "aximm":
            yield from (f"axi {name} {mode} {clock}", f"segment {name}/reg0 {name} {1 << width['AWADDR']} -1")
        elif kind == "axis":
            shape = f"{width['TDATA'] // 8} {width.get('TUSER', 0)} {int('TKEEP' in width)} {int('TLAST' in width)}"
            yield f"axis {name} {mode} {clock} {shape}"
        else:
            yield f"pin {name} " + {"clock": "I clk 1", "reset": "I rst_n 1", "interrupt": "O irq! 1"}[kind]
