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
    names : sequence of str
        The parameters'.
    fmt : Q
        Their format; they saturate.
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

    def __init__(self, names, fmt, *, target_bits):
        self.fmt = fmt
        v, target = (data.StructLayout(dict.fromkeys(names, signed(bits))) for bits in (fmt.width, target_bits))
        super().__init__(
            {
                **dict.fromkeys(("new_batch", "load", "move", "clipped"), In(1)),
                "start": In(v),
                "target": In(target),
                "v": Out(v),
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
