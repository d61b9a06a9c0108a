"""The strict model's reading of a Verilog module: the interfaces that Vivado would infer of its attributes.

By UG994, "List of supported X_ attributes": one port of an interface with the attribute means that all of its ports
need it.
"""

import re
import xml.etree.ElementTree as ElementTree

from vivado_objects import VivadoError

PORT = re.compile(
    r"((?:\(\*(?:(?!\*\)).)*\*\)\s*)*)\b(input|output)\s+(?:wire\s+|reg\s+)?(?:\[(\d+):(\d+)\]\s*)?(\w+)\s*[;,)]", re.S
)
ATTRIBUTE = re.compile(r"(X_INTERFACE_\w+)\s*=\s*\"([^\"]*)\"")

SIGNALS = {
    "clock": ({"CLK"}, set()),
    "reset": ({"RST"}, set()),
    "interrupt": ({"INTERRUPT"}, set()),
    "aximm": (
        {"AWADDR", "AWVALID", "AWREADY", "WDATA", "WSTRB", "WVALID", "WREADY", "BRESP", "BVALID", "BREADY",
         "ARADDR", "ARVALID", "ARREADY", "RDATA", "RRESP", "RVALID", "RREADY"}, {"AWPROT", "ARPROT"},
    ),
    "axis": ({"TDATA", "TVALID", "TREADY"}, {"TKEEP", "TLAST", "TUSER", "TSTRB", "TID", "TDEST"}),
}  # fmt: skip


class Inferred:
    """An interface: its bus as Vivado names it, mode, ports (signal → (name, direction, width)), parameters."""

    def __init__(self, name, bus):
        self.name, self.bus = name, bus
        self.ports, self.parameters = {}, {}
        self.kind = bus.split(":")[2]

    @property
    def mode(self):
        if self.kind in ("clock", "reset"):
            return "slave"
        signal = {"interrupt": "INTERRUPT", "axis": "TVALID", "aximm": "AWVALID"}[self.kind]
        return "master" if self.ports[signal][1] == "output" else "slave"

    def check(self):
        if self.kind not in SIGNALS:
            raise VivadoError(f"interface {self.name}: unknown bus {self.bus}")
        needed, optional = SIGNALS[self.kind]
        if missing := needed - set(self.ports):
            raise VivadoError(f"interface {self.name}: ports missing: {sorted(missing)}")
        if unknown := set(self.ports) - needed - optional:
            raise VivadoError(f"interface {self.name}: {self.bus} has no signals {sorted(unknown)}")


def module_text(verilog, top):
    """The text of one module, without comments."""
    plain = re.sub(r"//[^\n]*|/\*.*?\*/", "", verilog, flags=re.S)
    found = re.search(
        rf"^\s*(?:\(\*(?:(?!\*\)).)*\*\)\s*)*module\s+{re.escape(top)}\b.*?^\s*endmodule", plain, re.S | re.M
    )
    if not found:
        raise VivadoError(f"there is no module {top}")
    return found[0]


def ports(verilog, top):
    """``{name: (direction, width, {attribute: value})}`` of a module."""
    found = {}
    for attributes, direction, high, low, name in PORT.findall(module_text(verilog, top)):
        width = int(high) - int(low) + 1 if high else 1
        found[name] = (direction, width, dict(ATTRIBUTE.findall(attributes)))
    return found


def infer(verilog, top):
    """``({name: Inferred}, {port without interface: (direction, width)})``."""
    interfaces, loose = {}, {}
    for port, (direction, width, attributes) in ports(verilog, top).items():
        info = attributes.get("X_INTERFACE_INFO", "").split()
        if not info:
            loose[port] = (direction, width)
            continue
        if len(info) != 3:
            raise VivadoError(f"port {port}: X_INTERFACE_INFO must be bus, name, signal: {info}")
        bus, name, signal = info
        interface = interfaces.setdefault(name, Inferred(name, bus))
        if interface.bus != bus or signal in interface.ports:
            raise VivadoError(f"port {port}: {name} has another port with signal {signal}, or another bus")
        interface.ports[signal] = (port, direction, width)
        words = [word.strip() for word in attributes.get("X_INTERFACE_PARAMETER", "").split(",") if word.strip()]
        for word in words:
            key, value = word.split(maxsplit=1)
            if key == "XIL_INTERFACENAME":
                if value != name:
                    raise VivadoError(f"port {port}: parameter is for interface {value}, not {name}")
            else:
                interface.parameters[key] = value
    for interface in interfaces.values():
        interface.check()
    for port in loose:
        owner = next((name for name in interfaces if port.startswith(f"{name}_")), None)
        if owner:
            raise VivadoError(f"port {port} has no X_INTERFACE_INFO, so it is not taken into interface {owner}")
    check_parameters(interfaces)
    return interfaces, loose


def check_parameters(interfaces):
    """A reset's polarity, an interrupt's level, and what a clock says of the others."""
    for interface in interfaces.values():
        if interface.kind == "reset" and interface.parameters.get("POLARITY") != "ACTIVE_LOW":
            raise VivadoError(f"reset {interface.name}: POLARITY must say ACTIVE_LOW, AXI's resets are")
        if interface.kind == "interrupt" and interface.parameters.get("SENSITIVITY") != "LEVEL_HIGH":
            raise VivadoError(f"interrupt {interface.name}: SENSITIVITY must say LEVEL_HIGH")
        if interface.kind == "aximm" and interface.parameters.get("PROTOCOL") != "AXI4LITE":
            raise VivadoError(f"interface {interface.name}: PROTOCOL must say AXI4LITE")
        if interface.kind == "clock":
            for key in ("ASSOCIATED_BUSIF", "ASSOCIATED_RESET"):
                for name in filter(None, interface.parameters.get(key, "").split(":")):
                    if name not in interfaces:
                        raise VivadoError(f"clock {interface.name}: {key} names {name}, which is no interface")


def component_xml(vlnv, interfaces, loose, map_range, registers):
    """What ``ipx::save_core`` leaves for the model's own IP catalog."""
    root = ElementTree.Element("component", vlnv=vlnv)
    for interface in interfaces.values():
        node = ElementTree.SubElement(root, "interface", name=interface.name, kind=interface.kind, mode=interface.mode)
        for signal, (port, direction, width) in interface.ports.items():
            ElementTree.SubElement(node, "port", signal=signal, name=port, direction=direction, width=str(width))
        if interface.kind == "aximm":
            node = ElementTree.SubElement(root, "map", name=interface.name, range=str(map_range))
            for name, offset in registers:
                ElementTree.SubElement(node, "register", name=name, offset=str(offset))
    for name, (direction, width) in loose.items():
        ElementTree.SubElement(root, "loose", name=name, direction=direction, width=str(width))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
