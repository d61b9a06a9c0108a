"""The block design of the strict model: cells, nets, addresses, and what ``validate_bd_design`` refuses."""

import fnmatch

from vivado_catalog import accepted
from vivado_objects import Thing, VivadoError, number


class Cell(Thing):
    """An instance of an IP."""

    def __init__(self, name, ip):
        super().__init__("cell", f"/{name}", {"VLNV": ip.vlnv})
        self.short, self.ip = name, ip
        self.values = {key: default for key, (default, _) in ip.parameters.items()}
        self.preset = not ip.vlnv.startswith("xilinx.com:ip:zynq_ultra_ps_e:")

    @property
    def view(self):
        return self.ip.view(self.values)

    def configure(self, settings):
        """Set parameters, all at once, as ``set_property -dict`` does."""
        if not self.preset:
            raise VivadoError(f"{self.short}: parameters set before the board's preset would be overwritten by it")
        for name, value in settings.items():
            key = name.removeprefix("CONFIG.")
            if not name.startswith("CONFIG.") or key not in self.ip.parameters:
                raise VivadoError(f"{self.short} ({self.ip.vlnv}) has no parameter {name}")
            if not accepted(value, self.ip.parameters[key][1]):
                raise VivadoError(f"{self.short}: {name} cannot be {value!r}")
            self.values[key] = value
        _ = self.view  # parameters that contradict each other


class BlockDesign:
    """State of one block design. Pins and interfaces are named ``cell/pin``; a port of the design is ``port``."""

    def __init__(self, name):
        self.name, self.cells, self.ports = name, {}, {}
        self.nets, self.links = [], {}  # sets of pins; interface → interface, both ways
        self.assigned, self.excluded = {}, set()  # (space, segment) → (offset, range)
        self.valid = self.saved = False

    def touch(self):
        self.valid = self.saved = False

    def pins(self):
        return {f"{c.short}/{name}": pin for c in self.cells.values() for name, pin in c.view.pins.items()}

    def interfaces(self):
        return {f"{c.short}/{name}": i for c in self.cells.values() for name, i in c.view.interfaces.items()}

    def spaces(self):
        return {f"{c.short}/{name}": space for c in self.cells.values() for name, space in c.view.spaces.items()}

    def segments(self):
        return {f"{c.short}/{s.path}": (c.short, s) for c in self.cells.values() for s in c.view.segments}

    @staticmethod
    def match(names, pattern):
        return [name for name in names if fnmatch.fnmatchcase(name, pattern.removeprefix("/"))]

    def endpoint(self, name):
        """``(is a driver, kind, width)`` of a pin or a port."""
        if name in self.ports:
            direction, kind, width = self.ports[name]
            return direction == "I", kind, width  # an input of the design drives what is inside
        pin = self.pins().get(name)
        if pin is None:
            raise VivadoError(f"{name} is connected, but its cell has no such pin any more")
        return pin.direction == "O", pin.kind, pin.width

    def connect(self, names):
        """Join pins and ports to one net; two drivers are refused at once."""
        self.touch()
        joined = set(names)
        if len(joined) < 2:
            raise VivadoError(f"a net of {sorted(joined)} connects nothing")
        for net in [net for net in self.nets if net & joined]:
            joined |= net
            self.nets.remove(net)
        drivers = sorted(name for name in joined if self.endpoint(name)[0])
        if len(drivers) > 1:
            raise VivadoError(f"two drivers on one net: {' and '.join(drivers)}")
        self.nets.append(joined)

    def link(self, one, other):
        """Connect two interfaces, a master and a slave of one bus."""
        self.touch()
        found = self.interfaces()
        for name in (one, other):
            if name in self.links:
                raise VivadoError(f"interface {name} is connected already, to {self.links[name]}")
        if {found[one].mode, found[other].mode} != {"master", "slave"} or found[one].bus != found[other].bus:
            raise VivadoError(f"{one} and {other} do not fit: a master and a slave of one bus are needed")
        self.links[one], self.links[other] = other, one

    def driver(self, name):
        """The pin that drives ``name``, or None."""
        for net in self.nets:
            if name in net:
                return next((pin for pin in net if self.endpoint(pin)[0]), None)
        return None

    def assign(self, space, segment, offset, size):
        self.touch()
        (masters, bits), (_, found) = self.spaces()[space], self.segments()[segment]
        where = f"{segment} in {space} at {offset:#x}, size {size:#x}"
        if size < 4096 or size & (size - 1):
            raise VivadoError(f"{where}: the size must be a power of two of at least 4K")
        if offset % size:
            raise VivadoError(f"{where}: misaligned, the address must be a multiple of the size")
        if size > found.size:
            raise VivadoError(f"{where}: the slave has only {found.size:#x}")
        if found.offset is not None and offset != found.offset:
            raise VivadoError(f"{where}: this memory lies at {found.offset:#x}")
        if offset + size > 1 << bits:
            raise VivadoError(f"{where}: beyond the {bits} address bits of the master")
        master = next((m for m in masters if segment in self.reachable(f"{space.split('/')[0]}/{m}")), None)
        if master is None:
            raise VivadoError(f"{where}: no path from the master to this slave")
        if not any(low <= offset and offset + size <= low + room for low, room in masters[master]):
            raise VivadoError(f"{where}: outside of the windows of {master}")
        for (other_space, other), (start, room) in self.assigned.items():
            if other_space == space and other != segment and start < offset + size and offset < start + room:
                raise VivadoError(f"{where}: overlaps {other} at {start:#x}")
        self.assigned[space, segment] = (offset, size)

    def reachable(self, interface):
        """Segments behind a master interface, through interconnects."""
        other = self.links.get(interface)
        if other is None:
            return set()
        name, pin = other.split("/")
        cell = self.cells[name]
        if cell.view.through:
            masters = [f"{name}/{key}" for key, i in cell.view.interfaces.items() if i.mode == "master"]
            return set().union(*(self.reachable(master) for master in masters))
        return {f"{name}/{segment.path}" for segment in cell.view.segments if segment.interface == pin}

    def validate(self):
        """Raise :class:`VivadoError` with all that is wrong."""
        wrong = [*self.wrong_pins(), *self.wrong_interfaces(), *self.wrong_addresses()]
        if wrong:
            raise VivadoError(f"validate_bd_design: {'; '.join(wrong)}")
        self.valid = True

    def wrong_pins(self):
        for net in self.nets:
            widths = {self.endpoint(name)[2] for name in net}
            if len(widths) > 1:
                yield f"net of {sorted(net)} has widths {sorted(widths)}"
        for name, pin in self.pins().items():
            source = self.driver(name)
            if pin.direction == "I" and source is None and not pin.optional:
                yield f"{name} ({pin.kind}) is not connected"
            elif pin.direction == "I" and source is not None:
                kind = self.endpoint(source)[1]
                if pin.kind in ("clk", "rst", "rst_n", "irq") and kind != pin.kind:
                    yield f"{name} wants {pin.kind}, {source} gives {kind}"
        for name, (direction, _, _) in self.ports.items():
            if direction == "O" and self.driver(name) is None:
                yield f"port {name} is not driven"
        for name, cell in self.cells.items():
            lines = [pin for pin, view in cell.view.pins.items() if view.kind == "irq" and view.direction == "O"]
            if cell.ip.vlnv.split(":")[0] != "xilinx.com":  # the DMA is polled, our own interrupt is not
                yield from (
                    f"{name}/{pin} reaches no interrupt input"
                    for pin in lines
                    if not any(f"{name}/{pin}" in net for net in self.nets)
                )

    def wrong_interfaces(self):
        found = self.interfaces()
        for name, interface in found.items():
            other = self.links.get(name)
            if other is None:
                yield f"interface {name} is not connected"
                continue
            if other not in found:
                yield f"{name} is connected to {other}, which is gone"
                continue
            clocks = [self.driver(f"{end.split('/')[0]}/{found[end].clock}") for end in (name, other)]
            if None not in clocks and clocks[0] != clocks[1]:
                yield f"{name} and {other} have different clocks"
            if interface.bus == "axis" and interface.mode == "master":
                theirs = found[other].shape
                differ = [key for key in interface.shape if interface.shape[key] != theirs[key]]
                if differ:
                    yield f"{name} and {other} differ in {', '.join(differ)}"

    def wrong_addresses(self):
        for space, (masters, _) in self.spaces().items():
            cell = space.split("/")[0]
            for master in masters:
                for segment in sorted(self.reachable(f"{cell}/{master}")):
                    if (space, segment) not in self.assigned and (space, segment) not in self.excluded:
                        yield f"{segment} has no address in {space}"


def parse_assignment(options):
    """``(offset, size)`` of an ``assign_bd_address``."""
    return number(options["-offset"]), number(options["-range"])
