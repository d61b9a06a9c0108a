"""Memory words that are read, changed and written, one operation a cycle: with a three-entry forwarding buffer."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data, memory, stream
from amaranth.lib.wiring import In, Out

from . import Block, payloads


class ReadModifyWrite(Block):
    """Memory words that change with what arrives, one address per cycle, the same address as often as it likes.

    Each member of ``word`` is a RAM of its own; all share the address and the forwarding buffer, which holds
    the three youngest words. They cover the three cycles between a read and the write of the same
    operation, so the result never depends on what a RAM returns when a row is read and written at one edge::

        stage   0 ........ 1 ........ 2 ............... 3 ......... 4 ....... 5
                address    RAM reads  output register   RAM writes  │         │
                                      changed ───────►  youngest    second    third
                                        ▲──────────────────┴───────────┴─────────┘  where the address is equal

    One operation per cycle; ``o`` has the value before the operation, :attr:`latency` cycles after it.

    Parameters
    ----------
    word : :class:`StructLayout`
        The RAMs and their widths.
    add : :class:`StructLayout`
        What arrives.
    depth : int
        Words.

    Members
    -------
    i : ``In``, flow of ``{address, clear, add}``
        Change a word, or set it to zero where ``clear``.
    o : ``Out``, flow of ``word``
        Its value before that.
    """

    latency = 3

    def __init__(self, word, add, depth):
        self.word = word
        self.depth = depth
        self.operation = data.StructLayout({"address": range(max(2, depth)), "clear": 1, "add": add})
        super().__init__(i=In(stream.Signature(self.operation, always_ready=True)), o=Out(payloads.flow(word)))

    def changed(self, name, before, operand):
        """``(value, statements)``: what a member becomes, and what has to be done, combinationally, for that."""
        raise NotImplementedError

    def elaborate(self, platform):
        m = Module()
        ports = {}
        for name, shape in self.word.members.items():
            ram = memory.Memory(shape=shape, depth=self.depth, init=[])
            m.submodules[name] = ram
            ports[name] = ram.read_port(), ram.write_port()

        valid = [self.i.valid] + [Signal(name=f"valid_s{stage}") for stage in range(1, 6)]
        address = [self.i.payload.address] + [
            Signal(range(max(2, self.depth)), name=f"address_s{stage}", reset_less=True) for stage in range(1, 6)
        ]
        for stage in range(1, 6):
            m.d.sync += [valid[stage].eq(valid[stage - 1]), address[stage].eq(address[stage - 1])]
        operation_s1 = Signal(self.operation, reset_less=True)
        operation_s2 = Signal(self.operation, reset_less=True)
        read_s2 = Signal(self.word, reset_less=True)
        total = {stage: Signal(self.word, name=f"total_s{stage}", reset_less=True) for stage in (3, 4, 5)}
        base = Signal(self.word)

        # Stage 1: the RAMs read. Which younger sums will replace what they return, once this is in stage 2?
        m.d.sync += [operation_s1.eq(self.i.payload), operation_s2.eq(operation_s1)]
        matches = {}
        for stage in (3, 4, 5):
            matches[stage] = Signal(name=f"match_s{stage}", reset_less=True)
            m.d.sync += matches[stage].eq(valid[stage - 1] & (address[stage - 1] == address[1]))

        # Stage 2: output register; the youngest matching sum wins.
        m.d.comb += base.eq(read_s2)
        for stage in (5, 4, 3):
            with m.If(matches[stage]):
                m.d.comb += base.eq(total[stage])

        # Stage 3: write. Stages 4, 5 only remember.
        m.d.sync += [total[4].eq(total[3]), total[5].eq(total[4])]
        for name, (read, write) in ports.items():
            m.d.comb += [
                read.addr.eq(address[0]),
                write.addr.eq(address[3]),
                write.data.eq(total[3][name]),
                write.en.eq(valid[3]),
            ]
            after, statements = self.changed(name, base[name], operation_s2.add)
            m.d.comb += statements
            m.d.sync += [read_s2[name].eq(read.data), total[3][name].eq(after), self.o.payload[name].eq(base[name])]
        with m.If(operation_s2.clear):
            m.d.sync += total[3].eq(0)
        m.d.sync += self.o.valid.eq(valid[2])
        return m


class ReadAddWrite(ReadModifyWrite):
    """Memory words that grow by what arrives: ``add`` has the same members as ``word``."""

    def changed(self, name, before, operand):
        return before + operand[name], []
