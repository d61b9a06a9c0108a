"""The core with plain Verilog ports: what ``cmfpga build`` emits as ``cmfpga_core``."""

from amaranth.hdl import Shape, Signal
from amaranth.lib import data

from .core import Core
from .regions.regions import Regions
from .sliding.core import SlidingCore


def flatten(layout, prefix):
    """``{port name: (path of member names, shape)}`` of a layout's leaves, in order; shapes know their formats."""
    leaves = {}
    members = enumerate([layout.elem_shape] * layout.length) if isinstance(layout, data.ArrayLayout) else None
    for key, shape in members or layout.members.items():
        name = f"{prefix}_{key}"
        if isinstance(shape, data.Layout):
            leaves |= {port: ((key, *path), leaf) for port, (path, leaf) in flatten(shape, name).items()}
        else:
            leaves[name] = ((key,), shape)
    return leaves


class PlainPorts:
    """What turns a component's streams into ports, a field each (``event_x``, ``result_v_x`` …).

    Attributes
    ----------
    inputs, outputs : dict of str to Signal
        The ports, in order, without clock and reset.
    """

    def __init__(self, config):
        super().__init__(config)
        own = getattr(self, "traces", None)  # each unit of hardware with regions has one
        traces = {f"trace_{number}": trace for number, trace in enumerate(own)} if own else {"trace": self.trace}
        self._links = []  # (port, signal inside, is the port an input)
        self.inputs, self.outputs = {}, {}
        groups = {
            "event": (self.i, {"valid": True, "payload": True, "ready": False}),
            "settings": (self.settings, {"": True}),
            "result": (self.o, {"valid": False, "payload": False, "ready": True}),
            **{name: (trace, {"valid": False, "payload": False}) for name, trace in traces.items()},
        }
        for prefix in ("schedule", "mask", "node", "row"):
            if hasattr(self, f"{prefix}_write"):
                groups[prefix] = (getattr(self, f"{prefix}_write"), {"valid": True, "payload": True})
        if hasattr(self, "pixels"):
            groups["trace_pixels"] = (self.pixels, {"valid": False, "payload": False})
        if hasattr(self, "busy"):
            self._add("busy", self.busy.shape(), self.busy, False)
        for prefix, (member, signals) in groups.items():
            for name, is_input in signals.items():
                inside = getattr(member, name) if name else member
                if isinstance(inside, data.View):
                    for port, (path, shape) in flatten(inside.shape(), prefix).items():
                        leaf = inside
                        for key in path:
                            leaf = leaf[key]
                        self._add(port, shape, leaf, is_input)
                else:
                    self._add(f"{prefix}_{name}", inside.shape(), inside, is_input)

    @property
    def port_order(self):
        """Names of all ports, clock and reset first."""
        return ["clk", "rst", *self.inputs, *self.outputs]

    def _add(self, name, shape, inside, is_input):
        port = Signal(Shape.cast(shape), name=name)
        self._links.append((port, inside, is_input))
        (self.inputs if is_input else self.outputs)[name] = port

    def elaborate(self, platform):
        m = super().elaborate(platform)
        for port, inside, is_input in self._links:
            m.d.comb += inside.eq(port) if is_input else port.eq(inside)
        return m


class VerilogCore(PlainPorts, Core):
    """:class:`Core` with plain ports."""


class VerilogRegions(PlainPorts, Regions):
    """:class:`~cmfpga.rtl.regions.regions.Regions` with plain ports; each unit has a trace of its own."""


class VerilogSliding(PlainPorts, SlidingCore):
    """:class:`~cmfpga.rtl.sliding.core.SlidingCore` with plain ports."""


def verilog_top(config):
    """The one that a configuration asks for."""
    return (VerilogRegions if config.regions else VerilogSliding if config.slides else VerilogCore)(config)
