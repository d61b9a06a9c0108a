"""State of a session of the strict model, and the table of its commands.

``COMMANDS`` maps a name to its usage line and what it does to the state; the modules ``vivado_…_commands`` fill it.
Usages follow UG835, cut to the options that the scripts use.
"""

import tkinter

from vivado_catalog import standard_catalog
from vivado_design import BlockDesign
from vivado_objects import Store, Thing, VivadoError

COMMANDS = {}
TCL = tkinter.Tcl()  # to read lists; the scripts have their own


def command(name, usage=""):
    """Register a command. It is called with the state, the options, and the positional words."""

    def register(function):
        COMMANDS[name] = (usage, function)
        return function

    return register


class State:
    """Everything that a Vivado session holds."""

    def __init__(self, found):
        self.found, self.store = found, Store()
        self.catalog = standard_catalog(found["inline_slice"])
        self.project = self.design = self.core = self.open_design = None
        self.sources, self.verilog, self.constraints = [], None, []
        self.steps = []
        self.part = None

    @staticmethod
    def split(text):
        """The words of a Tcl list."""
        return TCL.splitlist(text)

    def things(self, text, *kinds):
        """The objects of a list of handles; an empty list is an error, as most commands of Vivado say."""
        handles = self.split(text)
        if not handles:
            raise VivadoError(f"no objects: expected {' or '.join(kinds)}")
        return [self.store.get(handle, *kinds) for handle in handles]

    def thing(self, text, *kinds):
        found = self.things(text, *kinds)
        if len(found) != 1:
            raise VivadoError(f"expected one {' or '.join(kinds)}, got {len(found)}")
        return found[0]

    def need_project(self):
        if self.project is None:
            raise VivadoError("no project is open")
        return self.project

    def need_design(self):
        if self.design is None:
            raise VivadoError("no block design is open")
        return self.design

    def need_open(self):
        if self.open_design is None:
            raise VivadoError("no design is open: open_run or route_design comes first")

    def pick(self, kind, names, pattern, quiet=False, **properties):
        """Handles of objects of the block design by pattern, made when first asked for."""
        matched = BlockDesign.match(names, pattern)
        if not matched and not quiet:
            raise VivadoError(f"no {kind} matches {pattern!r}; there are {', '.join(sorted(names)) or 'none'}")
        for name in matched:
            if f"{kind}:/{name}" not in self.store.things:
                self.store.add(Thing(kind, f"/{name}", properties))
        return [f"{kind}:/{name}" for name in matched]

    def pick_listed(self, kind, pattern):
        """Handles of objects that exist, by pattern; none is no error."""
        return [f"{kind}:{name}" for name in BlockDesign.match([t.name for t in self.store.of_kind(kind)], pattern)]

    def set_part(self, part):
        if part != "xck26-sfvc784-2LV-c":
            raise VivadoError(f"part {part!r} is not installed")
        self.part = part
