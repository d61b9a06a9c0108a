"""12-bank accumulator: images whose words grow."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from ..read_modify_write import ReadAddWrite


class Accumulator(Block):
    """Sums votes into the images I, Dx and Dy, each spread over four banks by the parity of column and row.

    All twelve contributions of an event are written in one cycle. A sweep uses the same path as a vote: it reads
    an address of all banks, forwarding included, and leaves zero there, so it may follow the last vote at once.

    One event, or one swept address, per cycle; ``o`` follows the sweep by :attr:`latency` cycles.

    Members
    -------
    i : ``In``, flow of :func:`payloads.votes`
        Not in the same cycle as ``sweep``.
    sweep : ``In``, flow of :func:`payloads.sweep_address`
        Addresses to read and clear.
    o : ``Out``, flow of an array of four :func:`payloads.pixel`
        What ``sweep`` read, bank by bank.
    """

    latency = ReadAddWrite.latency

    def __init__(self, config):
        super().__init__(
            config,
            i=In(payloads.flow(payloads.votes(config))),
            sweep=In(payloads.flow(payloads.sweep_address(config))),
            o=Out(payloads.flow(data.ArrayLayout(payloads.pixel(config), 4))),
        )

    def elaborate(self, platform):
        m = Module()
        word = payloads.pixel(self.config)
        vote = payloads.votes(self.config)["banks"].shape.elem_shape
        add = data.StructLayout({name: vote[name].shape for name in word.members})
        swept = Signal(self.latency)
        m.d.sync += swept.eq((swept << 1) | self.sweep.valid)
        m.d.comb += self.o.valid.eq(swept[-1])
        for number in range(4):
            bank = ReadAddWrite(word, add, self.config.geometry.bank_depth)
            m.submodules[f"bank_{number}"] = bank
            vote = self.i.payload.banks[number]
            m.d.comb += [
                bank.i.valid.eq((self.i.valid & vote.valid) | self.sweep.valid),
                bank.i.payload.clear.eq(self.sweep.valid),
                bank.i.payload.address.eq(vote.address),
                self.o.payload[number].eq(bank.o.payload),
            ]
            m.d.comb += [bank.i.payload.add[name].eq(vote[name]) for name in word.members]
            with m.If(self.sweep.valid):
                m.d.comb += bank.i.payload.address.eq(self.sweep.payload.address)
        return m
