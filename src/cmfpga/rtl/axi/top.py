"""The AXI top: what ``python -m cmfpga.build --top kv260`` emits as ``cmfpga_kv260``."""

from amaranth.hdl import ClockDomain, DomainRenamer, Elaboratable, Module, Mux, ResetInserter, Signal
from amaranth.lib.wiring import connect

from ...protocol.flags import Flag
from ...protocol.registers.declaration import ADDRESS_BITS, register_map
from ..core import Core
from ..shell import payloads
from ..shell.batch_end import BatchEnd
from ..shell.counters import Counters
from ..shell.input_path import InputPath
from ..shell.register_bank import RegisterBank
from ..shell.result_packet import ResultPacket
from ..shell.schedule_store import ScheduleStore
from ..shell.settings import Settings
from .lite_slave import LiteSlave
from .ports import axi_ports
from .skid_buffer import SkidBuffer


class KV260Top(Elaboratable):
    """The core with AXI ports, one clock for all::

        s_axis ─► skid buffer ─┬─► input path ─► batch end ─► core ─► result packet ─┬─► m_axis
                               └───────────────── bypass ───────────────────────────┘
        s_axi ─► lite slave ─► register bank ─► settings, schedule store ─► core
                                     ▲ status, results, counters, interrupt ─► irq

    Events: one per cycle. From the core's result to the packet's last word: :attr:`result_latency` cycles.

    Parameters
    ----------
    config : Config
        Raises :exc:`ConfigError` where :func:`cmfpga.protocol.registers.declaration.check` does.

    Attributes
    ----------
    registers : RegisterMap
    inputs, outputs : dict of str to Signal
        The ports, in order, with ``aclk`` and ``aresetn``.
    """

    def __init__(self, config):
        self.config = config
        self.registers = register_map(config)
        self.core = Core(config)
        self.inputs, self.outputs = axi_ports(address_bits=ADDRESS_BITS, data_bits=payloads.DATA_BITS)
        self.input = SkidBuffer(payloads.beat())
        self.input_path = InputPath(config)
        self.batch_end = BatchEnd(config)
        self.result_packet = ResultPacket(config, self.registers)
        self.bank = RegisterBank(self.registers)
        self.lite_slave = LiteSlave(self.registers.size, read_latency=self.bank.latency)
        self.settings = Settings(config, self.registers)
        self.counters = Counters(config)
        self.schedule_store = None
        if "SCHEDULE" in self.registers:
            self.schedule_store = ScheduleStore(config, self.registers["SCHEDULE"], latency=self.bank.latency)
        self.soft_reset = Signal()
        # What the input is taken for: the registers' values, once the words that came before have left.
        self.bypassing, self.form, self.swap = Signal(), Signal(2), Signal()
        self.input_pending = Signal()
        self.opened = Signal()
        self.outstanding = Signal(2)  # batches that were begun and whose result was not taken
        self.quiet = Signal()  # there are none

    @property
    def event_latency(self):
        """Cycles from the cycle in which a word with one event is taken to that in which the core is offered it."""
        return self.input.latency + self.input_path.latency + self.batch_end.latency

    @property
    def result_latency(self):
        """Cycles from the core's result to the last word of its packet, if nothing stalls."""
        return self.result_packet.latency + self.result_packet.beats - 1

    def elaborate(self, platform):
        m = Module()
        # Not the implicit domain, so that the clock's port is the clock.
        sync = ClockDomain("sync", local=True)
        sync.clk = self.inputs["aclk"]
        m.domains += sync
        m.d.comb += sync.rst.eq(~self.inputs["aresetn"])

        commands = self.bank.commands
        m.d.comb += self.soft_reset.eq(commands.ctrl_soft_reset)
        soft = ClockDomain("soft", local=True)
        soft.clk = self.inputs["aclk"]
        m.domains += soft
        m.d.comb += soft.rst.eq(sync.rst | self.soft_reset)
        # Words that are passed on may already be offered on m_axis.
        m.submodules.input = ResetInserter(self.soft_reset & ~self.bypassing)(self.input)
        for name in ("input_path", "batch_end", "core"):
            m.submodules[name] = DomainRenamer("soft")(getattr(self, name))
        m.submodules.result_packet = self.result_packet
        m.submodules.lite_slave = self.lite_slave
        m.submodules.bank = self.bank
        m.submodules.next_settings = self.settings
        m.submodules.counters = self.counters
        if self.schedule_store:
            m.submodules.schedule_store = self.schedule_store

        self._ports(m)
        self._events(m)
        self._batches(m)
        self._results(m)
        self._registers(m)
        return m

    @property
    def port_order(self):
        """Names of all ports, interface by interface."""
        names = [*self.inputs, *self.outputs]
        groups = ("aclk", "aresetn", "s_axi_", "s_axis_", "m_axis_", "irq")
        return [name for group in groups for name in names if name.startswith(group)]

    # ---------------------------------------------------------------- ports

    def _ports(self, m):
        """AXI names to streams."""
        i, o, lite = self.inputs, self.outputs, self.lite_slave
        for channel, names in (
            (lite.aw, {"awaddr": "payload"}),
            (lite.w, {"wdata": "payload.data", "wstrb": "payload.strb"}),
            (lite.ar, {"araddr": "payload"}),
        ):
            prefix = f"s_axi_{next(iter(names)).removesuffix('addr').removesuffix('data')}"
            m.d.comb += [channel.valid.eq(i[f"{prefix}valid"]), o[f"{prefix}ready"].eq(channel.ready)]
        m.d.comb += [
            lite.aw.payload.eq(i["s_axi_awaddr"]),
            lite.w.payload.data.eq(i["s_axi_wdata"]),
            lite.w.payload.strb.eq(i["s_axi_wstrb"]),
            lite.ar.payload.eq(i["s_axi_araddr"]),
            o["s_axi_bvalid"].eq(lite.b.valid),
            lite.b.ready.eq(i["s_axi_bready"]),
            o["s_axi_rvalid"].eq(lite.r.valid),
            o["s_axi_rdata"].eq(lite.r.payload.data),
            lite.r.ready.eq(i["s_axi_rready"]),
            # Not the constant here: Yosys makes one wire of two equal ones, with the attributes of the last.
            o["s_axi_bresp"].eq(lite.b.payload),
            o["s_axi_rresp"].eq(lite.r.payload.resp),
        ]
        entering = self.input.i
        m.d.comb += [
            entering.valid.eq(i["s_axis_tvalid"]),
            o["s_axis_tready"].eq(entering.ready),
            *(entering.payload[name].eq(i[f"s_axis_t{name}"]) for name in entering.payload.shape().members),
        ]

    # ---------------------------------------------------------------- words to events

    def _events(self, m):
        path, end, values = self.input_path, self.batch_end, self.bank.values
        connect(m, path.o, end.i)
        connect(m, end.o, self.core.i)
        m.d.comb += [
            path.i.valid.eq(self.input.o.valid & ~self.bypassing),
            path.i.payload.eq(self.input.o.payload),
            path.format.eq(self.form),
            path.swap.eq(self.swap),
        ]
        # Another kind of input begins when the last one has left.
        m.d.comb += [
            self.quiet.eq((self.outstanding == 0) & ~end.taking_in),
            self.input_pending.eq(
                (self.bypassing != values.input_bypass)
                | (self.form != values.input_format)
                | (self.swap != values.input_swap)
            ),
        ]
        drained = self.input.empty & path.empty & ~end.holding & self.quiet & ~self.result_packet.sending
        m.d.comb += path.restart.eq(self.input_pending & drained)
        with m.If(path.restart):
            m.d.sync += [
                self.bypassing.eq(values.input_bypass),
                self.form.eq(values.input_format),
                self.swap.eq(values.input_swap),
            ]

    # ---------------------------------------------------------------- batches

    def _batches(self, m):
        end, values, settings = self.batch_end, self.bank.values, self.settings
        taken = self.result_packet.taken
        m.d.comb += [
            self.opened.eq(self.core.opened),
            settings.written.eq(values),
            settings.lock.eq(values.settings_lock_lock),
            settings.opened.eq(self.opened),
            self.core.settings.eq(settings.o.core),
            end.settings.eq(settings.o.end),
            end.opened.eq(self.opened),
            end.taken.eq(self.core.take),
            end.idle.eq(self.input.empty & self.input_path.empty),
            end.end_batch.eq(self.bank.commands.ctrl_end_batch),
            self.bank.clear.ctrl_start.eq(self.opened & ~values.ctrl_auto_restart),
            self.bank.clear.roi_load_load.eq(settings.used_roi),
        ]
        may_begin = values.ctrl_start
        if store := self.schedule_store:
            m.d.comb += [
                store.write.valid.eq(self.lite_slave.write.valid),
                store.write.payload.eq(self.lite_slave.write.payload),
                store.read_address.eq(self.lite_slave.read_address),
                store.lock.eq(values.settings_lock_lock),
                store.quiet.eq(self.quiet),
                self.core.schedule_write.valid.eq(store.o.valid),
                self.core.schedule_write.payload.eq(store.o.payload),
            ]
            may_begin &= ~store.blocking
        m.d.comb += end.go.eq(may_begin)
        with m.If(self.soft_reset):
            m.d.sync += self.outstanding.eq(0)
        with m.Else():
            m.d.sync += self.outstanding.eq(self.outstanding + self.opened - taken)

    # ---------------------------------------------------------------- results

    def _results(self, m):
        i, o, packet, values = self.inputs, self.outputs, self.result_packet, self.bank.values
        connect(m, self.core.o, packet.i)
        counted = self.input_path.counted
        dropped = counted.format_errors | counted.before_time | counted.out_of_sensor
        wire = Signal()  # something was dropped since the last result
        with m.If(packet.taken | self.soft_reset):
            m.d.sync += wire.eq(dropped & ~self.soft_reset)
        with m.Elif(dropped):
            m.d.sync += wire.eq(1)
        # A batch's flag waits until its result comes; the next batch may have been opened by then.
        opened_limited, taken_limited = Signal(), Signal()
        with m.If(self.opened):
            m.d.sync += opened_limited.eq(self._limited())
        with m.If(self.core.take):
            m.d.sync += taken_limited.eq(opened_limited)
        m.d.comb += [
            packet.wire.eq(wire),
            packet.config_range.eq(taken_limited),
            packet.stream_results.eq(values.output_stream_results),
            packet.hold.eq(values.result_hold_hold),
            packet.forget.eq(self.soft_reset),
        ]
        passed = self.input.o
        m.d.comb += [
            o["m_axis_tvalid"].eq(Mux(self.bypassing, passed.valid, packet.o.valid)),
            passed.ready.eq(Mux(self.bypassing, i["m_axis_tready"], self.input_path.i.ready)),
            packet.o.ready.eq(i["m_axis_tready"] & ~self.bypassing),
            *(
                o[f"m_axis_t{name}"].eq(Mux(self.bypassing, passed.payload[name], packet.o.payload[name]))
                for name in passed.payload.shape().members
            ),
        ]

    def _limited(self):
        """A setting of the batch that is opened is not as it was written."""
        return self.settings.limited | (self.schedule_store.limited if self.schedule_store else 0)

    # ---------------------------------------------------------------- registers

    def _registers(self, m):
        bank, lite, counters, packet = self.bank, self.lite_slave, self.counters, self.result_packet
        i, o = self.inputs, self.outputs
        m.d.comb += [
            bank.write.valid.eq(lite.write.valid),
            bank.write.payload.eq(lite.write.payload),
            bank.read_address.eq(lite.read_address),
            lite.read_data.eq(bank.read_data | (self.schedule_store.read_data if self.schedule_store else 0)),
            counters.clear.eq(bank.commands.ctrl_clear_counters | self.soft_reset),
            counters.taken.eq(packet.taken),
            counters.result.eq(self.core.o.payload),
        ]
        entering = self.input.i
        counted = self.input_path.counted
        pulses = {
            "busy_cycles": ~self.quiet,
            "input_stalls": entering.valid & ~entering.ready,
            "output_stalls": o["m_axis_tvalid"] & ~i["m_axis_tready"],
            "result_stalls": packet.stalled,
            "beats_in": entering.valid & entering.ready,
            "beats_bypassed": self.bypassing & self.input.o.valid & i["m_axis_tready"],
            "events_taken": self.core.i.valid & self.core.i.ready,
            "empty_ends": self.batch_end.empty_end,
            "results_held_back": packet.held_back,
            **{name: counted[name] for name in counted.shape().members},
        }
        assert set(pulses) == set(counters.pulses.shape().members)
        m.d.comb += [counters.pulses[name].eq(pulse) for name, pulse in pulses.items()]

        states = {
            "idle": ~bank.values.ctrl_start & self.quiet,
            "ready": ~bank.values.ctrl_start,
            "taking_in": self.batch_end.taking_in,
            "computing": self.outstanding != 0,
            "result_waiting": packet.sending,
            "events_waiting": ~self.input.empty | ~self.input_path.empty | self.batch_end.holding,
            "time_known": self.input_path.time_known,
            "config_range": self.settings.out_of_range | (self.schedule_store.limited if self.schedule_store else 0),
            "input_pending": self.input_pending,
            "schedule_pending": self.schedule_store.pending if self.schedule_store else 0,
            "bypassing": self.bypassing,
        }
        for group in ("Control", "Operation", "Counters", "Result"):
            for k, register in enumerate(self.registers.group(group)):
                for f in register.fields:
                    if f.access != "status":
                        continue
                    target = bank.status[f"{register.name}_{f.name}".lower()]
                    if group == "Result":
                        m.d.comb += target.eq(packet.words[k][f.lsb : f.lsb + f.width])
                    else:
                        m.d.comb += target.eq(counters.values[f.link] if group == "Counters" else states[f.link])

        flags = self.core.o.payload.flags

        def flagged(*wanted):
            found = [flags[flag.bit_length() - 1] for flag in wanted]
            return packet.taken & (sum(found[1:], found[0]) != 0)

        dropped = counted.format_errors | counted.before_time | counted.out_of_sensor
        events = {
            "done": packet.taken,
            "ready": self.opened,
            "overflow": flagged(Flag.OVERFLOW),
            "wire": dropped,
            "time": counted.time_high_back | flagged(Flag.TIME_BACK, Flag.TIME_SPAN),
            "config_range": self.opened & self._limited(),
        }
        enabled = 0
        for name, event in events.items():
            m.d.comb += bank.set[f"isr_{name}"].eq(event)
            enabled |= bank.values[f"isr_{name}"] & bank.values[f"ier_{name}"]
        m.d.comb += [
            bank.set.ctrl_done.eq(packet.taken),
            o["irq"].eq(bank.values.gie_enable & enabled),
        ]
