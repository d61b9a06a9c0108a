"""Velocity: holds v, and limits it to its format."""

from amaranth.hdl import Module, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..arithmetic import saturate


class Velocity(wiring.Component):
    """The parameters of the motion: loaded when a batch begins, moved to a target in every iteration.

    ``v`` changes, and ``moved`` is high, :attr:`latency` cycle after ``move``.

    Parameters
    ----------
    layout : StructLayout
        Of v: a member for each parameter.
    fmt : Q
        The format of each; they saturate.
    target_bits : int
        Width of a target, two's complement.

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
    start, target : ``In``
    v : ``Out``
        Zero after a reset.
    moved : ``Out(1)``
    saturated : ``Out(1)``
        Whether something was limited since ``new_batch``.
    """

    latency = 1

    def __init__(self, layout, fmt, *, target_bits):
        self.fmt = fmt
        super().__init__(
            {
                **dict.fromkeys(("new_batch", "load", "move", "clipped"), In(1)),
                "start": In(layout),
                "target": In(data.StructLayout(dict.fromkeys(layout.members, signed(target_bits)))),
                "v": Out(layout),
                "moved": Out(1),
                "saturated": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        limited = self.clipped
        for name in self.v.shape().members:
            v, target = self.v[name], self.target[name]
            with m.If(self.load):
                m.d.sync += v.eq(self.start[name])
            with m.Elif(self.move):
                m.d.sync += v.eq(saturate(target, self.fmt.min, self.fmt.max))
            limited |= (target > self.fmt.max) | (target < self.fmt.min)
        m.d.sync += self.moved.eq(self.move)
        with m.If(self.new_batch):
            m.d.sync += self.saturated.eq(0)
        with m.Elif(self.move & limited):
            m.d.sync += self.saturated.eq(1)
        return m
