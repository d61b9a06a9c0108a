"""The block design as the scripts describe it, and what Vivado would refuse of it."""

import re
from pathlib import Path

NUMBERS = {"pin": 2, "axi": 3, "axis": 2, "segment": 1, "through": 0, "must": 0}  # the first field that is a number


class VivadoError(Exception):
    """What Vivado, or a strict reading of its manuals, would refuse."""


def write(path, content="of the model\n"):
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


class Design:
    """Methods have the names of commands. Pins are named ``cell/pin``; a port of the design, an output, ``port``."""

    def __init__(self, ips):
        self.ips, self.cells, self.nets, self.links = ips, {}, [], {}  # cell → (VLNV, parameters), sets of pins
        self.assigned, self.excluded, self.has = {}, set(), {kind: {} for kind in (*NUMBERS, "space")}

    def create_bd_cell(self, options, name):
        vlnv, kind = options["-vlnv"], options["-type"]
        if vlnv not in self.ips or name in self.cells or ("inline_hdl" in vlnv) != (kind == "inline_hdl"):
            raise VivadoError(f"no IP {vlnv} of type {kind}, or the name {name} is taken")
        self.cells[name] = vlnv, {key: default for key, (default, _) in self.ips[vlnv][0].items()}
        self.configure(name, {})

    def configure(self, cell, settings):
        """Set a cell's parameters; ``has`` is what the cells have then: ``{kind: {cell/name: fields}}``."""
        vlnv, parameters = self.cells[cell]
        for name, value in settings.items():
            _, allowed = self.ips[vlnv][0].get(name.removeprefix("CONFIG."), (None, None))
            if allowed is None or not name.startswith("CONFIG."):
                raise VivadoError(f"{cell} ({vlnv}) has no parameter {name}")
            if not (re.fullmatch(allowed, value) if isinstance(allowed, str) else value in map(str, allowed)):
                raise VivadoError(f"{cell}: {name} cannot be {value!r}")
            parameters[name.removeprefix("CONFIG.")] = value
        known = {key: int(value) if value.isdigit() else value for key, value in parameters.items()}
        for found in self.has.values():
            for name in [name for name in found if name.startswith(f"{cell}/")]:
                del found[name]
        for line in self.ips[vlnv][1]:
            line, _, times = line.partition(" for ")
            line, _, condition = line.partition(" if ")
            kind, name, *fields = line.split()
            if eval(condition or "True", {}, known):
                fields[NUMBERS[kind] :] = [eval(field, {}, known) for field in fields[NUMBERS[kind] :]]
                self.has[kind] |= {f"{cell}/{name.format(n)}": fields for n in range(eval(times or "1", {}, known))}
                if kind == "must" and not all(fields):
                    raise VivadoError(f"{cell}: {line} does not hold")
                if kind == "axi" and len(fields) > 2:
                    self.has["space"][f"{cell}/{fields[2]}"] = True

    def driver(self, name):
        pins = self.has["pin"]
        return next((pin for net in self.nets if name in net for pin in net if pins.get(pin, "I")[0] == "O"), None)

    def connect_bd_net(self, _, *names):
        net = set(names).union(*(net for net in self.nets if net & set(names)))
        drivers = [name for name in net if self.has["pin"].get(name, "I")[0] == "O"]
        if len(set(names)) < 2 or len(drivers) > 1:
            raise VivadoError(f"nothing to connect, or two drivers: {sorted(net)}")
        if len({self.has["pin"].get(name, (0, 0, 1))[2] for name in net}) > 1:
            raise VivadoError(f"a net of {sorted(net)} has different widths")
        self.nets = [other for other in self.nets if not other & net] + [net]

    def connect_bd_intf_net(self, _, one, other):
        found, axi = self.has["axi"] | self.has["axis"], self.has["axi"]
        if one in self.links or other in self.links:
            raise VivadoError(f"interface {one} or {other} is connected already")
        if found[one][0] == found[other][0] or (one in axi) != (other in axi):
            raise VivadoError(f"{one} and {other} do not fit: a master and a slave of one bus are needed")
        self.links |= {one: other, other: one}

    def behind(self, master):
        """Segments that a master interface reaches, through interconnects."""
        cell, _, interface = self.links.get(master, "/").partition("/")
        if f"{cell}/-" in self.has["through"]:
            masters = [n for n, fields in self.has["axi"].items() if n.startswith(f"{cell}/") and fields[0] == "master"]
            return set().union(*map(self.behind, masters))
        return {n for n, fields in self.has["segment"].items() if n.startswith(f"{cell}/") and fields[0] == interface}

    def windows(self, space):
        """``(low, high, segments behind)`` of the masters of an address space."""
        cell, _, name = space.partition("/")
        masters = [(n, *fields[2:]) for n, fields in self.has["axi"].items() if n.startswith(f"{cell}/") and fields[2:]]
        return [(low, low + size, self.behind(master)) for master, here, low, size in masters if here == name]

    def assign_bd_address(self, options, segment):
        space, offset, size = options["-target_address_space"], int(options["-offset"], 0), int(options["-range"], 0)
        where, (_, room, fixed) = f"{segment} in {space} at {offset:#x}, size {size:#x}", self.has["segment"][segment]
        if size < 4096 or size & (size - 1) or size > room or offset % size:
            raise VivadoError(f"{where}: misaligned, or not a power of two from 4096 to {room:#x}")
        fits = [low <= offset <= high - size and segment in behind for low, high, behind in self.windows(space)]
        if fixed not in (-1, offset) or not any(fits):
            raise VivadoError(f"{where}: outside of the windows of the masters that reach it")
        for (other_space, other), (start, span) in self.assigned.items():
            if other_space == space and other != segment and start < offset + size and offset < start + span:
                raise VivadoError(f"{where}: overlaps {other} at {start:#x}")
        self.assigned[space, segment] = (offset, size)

    def exclude_bd_addr_seg(self, options, segment):
        self.excluded.add((options["-target_address_space"], segment))

    def validate_bd_design(self, _):
        if wrong := [*self.wrong_pins(), *self.wrong_interfaces()]:
            raise VivadoError("; ".join(wrong))

    def wrong_pins(self):
        pins = self.has["pin"]
        for name, (direction, kind, _) in pins.items():
            source = self.driver(name)
            if source is None and direction == "I" and not kind.endswith("?"):
                yield f"{name} ({kind}) is not connected"
            elif source and kind.rstrip("?!") not in ("data", pins[source][1].rstrip("?!")):
                yield f"{name} wants {kind}, {source} gives {pins[source][1]}"
            elif source is None and kind.endswith("!"):
                yield f"{name} reaches no input"
        yield from (f"port {name} is not driven" for name in self.names("port") if self.driver(name) is None)

    def wrong_interfaces(self):
        found = self.has["axi"] | self.has["axis"]
        for name, fields in found.items():
            other = self.links.get(name)
            ends = [f"{end.partition('/')[0]}/{found[end][1]}" for end in (name, other) if end in found]
            if len(ends) < 2:
                yield f"interface {name} is not connected"
            elif self.driver(ends[0]) != self.driver(ends[1]):
                yield f"{name} and {other} have different clocks"
            elif name in self.has["axis"] and fields[2:] != found[other][2:]:
                yield f"{name} and {other} differ in bytes, user, keep, last: {fields[2:]} and {found[other][2:]}"
        for space in self.has["space"]:
            for segment in sorted(set().union(*(behind for *_, behind in self.windows(space)))):
                if (space, segment) not in self.assigned and (space, segment) not in self.excluded:
                    yield f"{segment} has no address in {space}"
