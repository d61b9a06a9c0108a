"""Velocity: holds v, and limits it to its format."""

from amaranth.hdl import Module, signed
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block
from ..arithmetic import is_beyond, saturate
from ..payloads import flow


class Velocity(Block):
    """The parameters of the motion: loaded when a batch begins, moved to a target in every iteration.

    ``v`` changes, and ``moved`` is high, :attr:`latency` cycle after ``move``.

    Parameters
    ----------
    layout : StructLayout
        Of v: a member for each parameter, a :class:`~cmfpga.rtl.payloads.Fixed`, which saturates.
    target_bits : int or None
        Width of a target, two's complement; None: that of v.
    probes : bool
        Whether events can be warped by another velocity than v.
    holds : bool
        Whether a move can leave v as it is.

    Members
    -------
    new_batch : ``In(1)``
        A batch begins: forget ``saturated``.
    load : ``In(1)``
        Take ``start``.
    move : ``In(1)``
        Take ``target``, limited.
    clipped : ``In(1)``
        With ``move``: what the target comes from was limited before.
    hold : ``In(1)``
        With ``move``: v stays. Only with ``holds``.
    start, target : ``In``
    v : ``Out``
        Zero after a reset.
    moved : ``Out(1)``
    probe : ``In``, flow of ``layout``
        Take it as ``warped``, which else is as v. Only with ``probes``.
    warped : ``Out``
        By what events are warped. Only with ``probes``.
    saturated : ``Out(1)``
        Whether something was limited since ``new_batch``.
    """

    latency = 1

    def __init__(self, layout, *, target_bits, probes=False, holds=False):
        targets = {name: signed(target_bits or shape.q.width) for name, shape in layout.members.items()}
        super().__init__(
            **dict.fromkeys(("new_batch", "load", "move", "clipped"), In(1)),
            start=In(layout),
            target=In(data.StructLayout(targets)),
            v=Out(layout),
            moved=Out(1),
            saturated=Out(1),
            **({"probe": In(flow(layout)), "warped": Out(layout)} if probes else {}),
            **({"hold": In(1)} if holds else {}),
        )

    def elaborate(self, platform):
        m = Module()
        limited, moves = self.clipped, self.move & ~self.hold if hasattr(self, "hold") else self.move
        for name, shape in self.v.shape().members.items():
            fmt = shape.q
            v, target = self.v[name], self.target[name]
            registers = [v, self.warped[name]] if hasattr(self, "warped") else [v]
            with m.If(self.load):
                m.d.sync += [register.eq(self.start[name]) for register in registers]
            with m.Elif(moves):
                m.d.sync += [register.eq(saturate(target, fmt.min, fmt.max)) for register in registers]
            if hasattr(self, "warped"):
                with m.If(self.probe.valid):
                    m.d.sync += self.warped[name].eq(self.probe.payload[name])
            limited |= is_beyond(target, fmt.min, fmt.max)
        m.d.sync += self.moved.eq(self.move)
        with m.If(self.new_batch):
            m.d.sync += self.saturated.eq(0)
        with m.Elif(self.move & limited):
            m.d.sync += self.saturated.eq(1)
        return m
