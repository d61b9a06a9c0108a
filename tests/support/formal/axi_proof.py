"""Rules of AXI4-Lite and AXI4-Stream on the AXI top, for the solver.

The core is replaced by one that does anything: offers any result at any time (and keeps it until it is taken), takes
events or not, opens and ends batches whenever. What holds around it holds around the real one.
"""

from amaranth.asserts import AnySeq
from amaranth.hdl import Assert, Assume, Cat, ClockDomain, Cover, Elaboratable, Module, Signal, Value
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from cmfpga.config import Config
from cmfpga.rtl import payloads
from cmfpga.rtl.axi.top import AxiTop

CONFIG = Config(
    sensor_width=12, sensor_height=10, roi_width=4, roi_height=4, buffer_events=7, max_batch_events=15, time_bits=12,
    span_bits=6, max_iterations=3, iterations=2,
)  # fmt: skip


class AnyCore(wiring.Component):
    """A core of which only the ports are known, and that its result stays until it is taken."""

    def __init__(self, config):
        super().__init__(
            {
                "i": In(stream.Signature(payloads.event(config))),
                "o": Out(stream.Signature(payloads.result(config))),
                "settings": In(payloads.settings(config)),
                "opened": Out(1),
                "take": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.d.comb += [self.opened.eq(AnySeq(1)), self.take.eq(AnySeq(1))]
        result = Value.cast(self.o.payload)
        m.d.comb += [self.i.ready.eq(AnySeq(1)), self.o.valid.eq(AnySeq(1)), result.eq(AnySeq(len(result)))]
        waiting, kept = Signal(), Signal(len(result))
        m.d.sync += [waiting.eq(self.o.valid & ~self.o.ready), kept.eq(result)]
        with m.If(waiting):
            m.d.comb += Assume(self.o.valid & (result == kept))
        return m


class AnyContent:
    """A platform whose memories may return anything at any time, but for the two words of a skid buffer."""

    def get_memory(self, memory):
        if memory.depth <= 2:
            return memory.elaborate(None)
        m = Module()
        for port in memory.read_ports:
            m.d.comb += Value.cast(port.data).eq(AnySeq(len(Value.cast(port.data))))
        return m


class AxiHarness(Elaboratable):
    """The AXI top with masters that keep the rules and otherwise do anything, and a reset at any time."""

    #: Number of its cover statements.
    COVERS = 5
    platform = AnyContent()

    def __init__(self, top=None):
        self.top = top or AxiTop(CONFIG)
        self.top.shell.core = AnyCore(self.top.config)
        self.top.shell.settings.fill = 2  # enough, since memories return anything
        self.sync = ClockDomain("proof", reset_less=True)  # the top has a domain sync of its own

    def elaborate(self, platform):
        m = Module()
        m.domains.proof = self.sync
        m.submodules.top = top = self.top
        m.d.comb += top.inputs["aclk"].eq(self.sync.clk)
        ports = top.inputs | top.outputs
        for name, port in top.inputs.items():
            if name != "aclk":
                m.d.comb += port.eq(AnySeq(len(port)))
        started, was_reset = Signal(), Signal()
        reset = Signal()
        m.d.comb += reset.eq(~ports["aresetn"])
        m.d.proof += [started.eq(1), was_reset.eq(reset)]
        with m.If(~started):
            m.d.comb += Assume(reset)

        def channel(prefix, data):
            valid, ready = ports[f"{prefix}valid"], ports[f"{prefix}ready"]
            return valid, ready, Cat(ports[f"{prefix}{name}"] for name in data)

        stream_data = ("data", "keep", "last", "user")
        given = {"s_axi_aw": ("addr", "prot"), "s_axi_w": ("data", "strb"), "s_axi_ar": ("addr", "prot")}
        given = {prefix: channel(prefix, data) for prefix, data in given.items()}
        given["s_axis"] = channel("s_axis_t", stream_data)
        taken = {"s_axi_b": channel("s_axi_b", ("resp",)), "s_axi_r": channel("s_axi_r", ("data", "resp"))}
        taken["m_axis"] = channel("m_axis_t", stream_data)

        # Valid stays, and so does what goes with it, until ready; a reset ends everything.
        for prefix, (valid, ready, payload) in (given | taken).items():
            waiting, kept = Signal(name=f"{prefix}_waiting"), Signal(len(payload), name=f"{prefix}_kept")
            m.d.proof += [waiting.eq(valid & ~ready & ~reset), kept.eq(payload)]
            rule = Assume if prefix in given else Assert
            with m.If(waiting & ~reset):
                m.d.comb += rule(valid & (payload == kept))

        # Quiet after a reset.
        quiet = [ports[f"s_axi_{name}"] for name in ("awready", "wready", "bvalid", "arready", "rvalid")]
        quiet += [ports["s_axis_tready"], ports["m_axis_tvalid"], ports["irq"]]
        with m.If(started & was_reset):
            m.d.comb += Assert(Cat(quiet) == 0)

        self._answers(m, reset, given, taken)
        self._packets(m, reset, ports, taken["m_axis"])
        return m

    def _answers(self, m, reset, given, taken):
        """No response without a request, never an error."""
        waiting = {}
        for prefix in ("s_axi_aw", "s_axi_w", "s_axi_ar"):
            waiting[prefix] = Signal(4, name=f"{prefix}_unanswered")
            valid, ready, _ = given[prefix]
            answer_valid, answer_ready, answer = taken["s_axi_r" if prefix == "s_axi_ar" else "s_axi_b"]
            more, fewer = valid & ready, answer_valid & answer_ready
            m.d.proof += waiting[prefix].eq(waiting[prefix] + more - fewer)
            with m.If(reset):
                m.d.proof += waiting[prefix].eq(0)
            with m.Elif(answer_valid):
                m.d.comb += [Assert(waiting[prefix] != 0), Assert(answer[-2:] == 0)]
            m.d.comb += Cover(~reset & fewer & (waiting[prefix] == 1))

    def _packets(self, m, reset, ports, packet):
        """Packets of results have their length, TLAST at their end, and TKEEP of ones; unless words are passed on."""
        valid, ready, _ = packet
        position = Signal(8)
        beats = self.top.shell.result_packet.beats
        with m.If(reset):
            m.d.proof += position.eq(0)
        with m.Elif(valid & ~self.top.shell.bypassing):
            m.d.comb += [Assert(ports["m_axis_tlast"] == (position == beats - 1)), Assert(ports["m_axis_tkeep"].all())]
            with m.If(ready):
                m.d.proof += position.eq(position + 1)
                with m.If(ports["m_axis_tlast"]):
                    m.d.proof += position.eq(0)
        m.d.comb += [
            Cover(~reset & valid & ready & (position == 3) & ~self.top.shell.bypassing),
            Cover(~reset & valid & ready & self.top.shell.bypassing),
        ]
