"""The shell: the core with a register bus, a stream of words in and one out, and an interrupt; of no board."""

import functools
import operator

from amaranth.hdl import Cat, ClockDomain, DomainRenamer, Module, Mux, ResetInserter, ResetSignal, Signal
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out, connect

from ...protocol.flags import Flag
from ...protocol.registers.declaration import register_map
from ...protocol.registers.layout import BASE
from ...protocol.results import counts_of
from ...protocol.tables import tables_of
from .. import Block
from ..core import Core
from ..regions.regions import Regions
from ..sliding.core import SlidingCore
from . import payloads
from .batch_end import BatchEnd
from .counters import Counters, filtered
from .input_path import InputPath
from .register_bank import RegisterBank, fields_of, member
from .result_packet import ResultPacket
from .runs import HopResults, RunEnd, hops_in_windows
from .settings import Settings
from .skid_buffer import SkidBuffer
from .tables import ScheduleStore, Tables


class Shell(Block):
    """Everything around the core that every board needs::

        i ─► skid buffer ─┬─► input path ─► batch end ─► core ─► result packet ─┬─► o
                          └───────────────────── bypass ───────────────────────┘
        bus ─► register bank ─► settings, schedule store, tables ─► core
                     ▲ status, results, counters, interrupt ─► irq

    The core is that of one ROI, or hardware with a table of regions. Events: one per cycle. From its result to the
    packet's last word: :attr:`result_latency` cycles. Where windows slide, a batch is a run (:class:`RunEnd`).

    Parameters
    ----------
    config : Config
        Raises :exc:`ConfigError` where :func:`cmfpga.protocol.registers.declaration.check` does.
    clock : Signal
        That of the domain ``sync``. The core is in a domain of its own with the same clock, which software resets too.

    Attributes
    ----------
    registers : RegisterMap

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Ready but for some cycles behind a reset and the end of ``SETTINGS_LOCK``. ``read_data`` come a cycle later than
        a block's.
    i : ``In``, stream of :func:`payloads.beat`
        Words of events.
    o : ``Out``, stream of :func:`payloads.beat`
        Packets of results, or the words of ``i`` where the registers ask for that.
    irq : ``Out(1)``
        High as long as an enabled event stands in the register ISR.
    """

    def __init__(self, config, *, clock):
        self.clock = clock
        self.registers = register_map(config)
        more = {"skips": True} if config.skips else {}
        self.core = (SlidingCore if config.slides else Regions if config.regions else Core)(config, **more)
        self.input = SkidBuffer(payloads.beat())
        self.input_path = InputPath(config)
        self.batch_end = (RunEnd if config.slides else BatchEnd)(config)
        self.hop_results = HopResults() if config.slides else None
        self.result_packet = ResultPacket(config, self.registers)
        self.bank = RegisterBank([r for r in self.registers if r.group not in ("Result", "Counters", "Tables")])
        self.settings = Settings(config, self.registers)
        self.counters = Counters(config)
        schedule = self.registers.by_name.get("SCHEDULE")
        self.schedule_store = ScheduleStore(config, schedule) if schedule else None
        self.tables = Tables(config, self.registers) if tables_of(config) else None
        # Asked for until it was done, as soon as no result is being taken over. Registers: much hangs on them.
        self.soft_reset, self.resetting = Signal(), Signal()
        # What the input is taken for: the registers' values, once the words that came before have left.
        self.bypassing, self.form, self.swap = Signal(), Signal(2), Signal()
        self.input_pending = Signal()
        self.opened = Signal()
        self.outstanding = Signal(3 if config.regions else 2)  # batches that were begun and whose result was not taken
        self.quiet = Signal()  # there are none
        super().__init__(
            config,
            bus=In(payloads.register_bus()),
            i=In(stream.Signature(payloads.beat())),
            o=Out(stream.Signature(payloads.beat())),
            irq=Out(1),
        )

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
        soft = ClockDomain("soft", local=True)
        soft.clk = self.clock
        m.domains += soft
        # A result that is being taken over stays in the core until it is complete; nothing new begins meanwhile.
        m.d.sync += [
            self.resetting.eq(self.bank.commands.ctrl_soft_reset | (self.resetting & ~self.soft_reset)),
            self.soft_reset.eq(self.resetting & ~self.soft_reset & ~self.result_packet.writing),
        ]
        m.d.comb += [self.result_packet.wait.eq(self.resetting), soft.rst.eq(ResetSignal() | self.soft_reset)]
        # Words that are passed on may already be offered on o.
        m.submodules.input = ResetInserter(self.soft_reset & ~self.bypassing)(self.input)
        for name in ("input_path", "batch_end", "core", *(("tables",) if self.tables else ())):
            block = getattr(self, name)
            if name == "core" and self.config.slides:
                block = ResetInserter(self.batch_end.ended)(block)
            m.submodules[name] = DomainRenamer("soft")(block)
        for name in ("result_packet", "bank", "settings", "counters", "schedule_store", "hop_results"):
            if block := getattr(self, name):
                m.submodules["next_settings" if name == "settings" else name] = block

        m.d.comb += [
            self.input.i.payload.eq(self.i.payload),
            self.input.i.valid.eq(self.i.valid & ~self.resetting),
            self.i.ready.eq(self.input.i.ready & ~self.resetting),
        ]
        self._events(m)
        self._batches(m)
        self._results(m)
        self._bus(m)
        self._registers(m)
        return m

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
        if self.config.skips:
            m.d.comb += [path.roi.eq(self.core.roi), path.opened.eq(self.core.opened), end.far.eq(self.core.far)]
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

    def _batches(self, m):
        end, values, settings = self.batch_end, self.bank.values, self.settings
        m.d.comb += [
            self.opened.eq(self.core.begins if self.config.slides else self.core.opened),
            *(settings.written[name].eq(values[name]) for name in settings.written.shape().members),
            settings.lock.eq(values.settings_lock_lock),
            settings.opened.eq(self.opened),
            *self._set(m, settings),
            end.opened.eq(self.opened),
            *([end.busy.eq(self.core.busy)] if self.config.slides else [end.taken.eq(self.core.take)]),
            end.idle.eq(self.input.empty & self.input_path.empty),
            end.end_batch.eq(self.bank.commands.ctrl_end_batch),
            self.bank.clear.ctrl_start.eq(self.opened & ~values.ctrl_auto_restart),
        ]
        if "ROI_LOAD" in self.registers:
            m.d.comb += self.bank.clear.roi_load_load.eq(settings.used_roi)
        may_begin = values.ctrl_start & ~settings.blocking & ~self.resetting
        if store := self.schedule_store:
            m.d.comb += [
                store.lock.eq(values.settings_lock_lock),
                store.quiet.eq(self.quiet),
                self.core.schedule_write.valid.eq(store.o.valid),
                self.core.schedule_write.payload.eq(store.o.payload),
            ]
            may_begin &= ~store.blocking
        if tables := self.tables:
            m.d.comb += [tables.quiet.eq(self.quiet), tables.opened.eq(self.opened)]
            m.d.comb += [tables.settings.eq(settings.o.core), tables.clear.eq(self.bank.commands.ctrl_clear_counters)]
            for name in tables.writes:
                connect(m, getattr(tables, name), getattr(self.core, name))
            may_begin &= ~(tables.pending | tables.rows_missing)
        m.d.comb += end.go.eq(may_begin)
        with m.If(self.soft_reset):
            m.d.sync += self.outstanding.eq(0)
        with m.Else():
            m.d.sync += self.outstanding.eq(self.outstanding + self.opened - self._over)

    def _set(self, m, settings):
        """Settings of the core, and of what ends batches."""
        if not self.config.slides:
            return [self.core.settings.eq(settings.o.core), self.batch_end.settings.eq(settings.o.end)]
        given, self.beyond = hops_in_windows(m, settings.o.core)
        m.d.comb += self.hop_results.every.eq(settings.o.end.every)
        return [self.core.settings.eq(given)]

    def _results(self, m):
        packet, values, hops = self.result_packet, self.bank.values, self.hop_results
        connect(m, self.core.o, packet.i)
        if hops:
            m.d.comb += [
                hops.begun.eq(packet.begun),
                hops.restart.eq(self.batch_end.ended | self.soft_reset),
                hops.clear.eq(self.counters.clear),
            ]
        wire = Signal()  # something was dropped since the last result
        with m.If(packet.begun | self.soft_reset):
            m.d.sync += wire.eq(self._dropped & ~self.soft_reset)
        with m.Elif(self._dropped):
            m.d.sync += wire.eq(1)
        # A batch's flag waits until its result comes; the next batch may have been opened by then.
        opened_limited, taken_limited = Signal(), Signal()
        with m.If(self.opened):
            m.d.sync += opened_limited.eq(self._limited)
        if self.config.slides:  # and so do those of the run's other hops
            taken_limited = opened_limited
        else:
            with m.If(self.core.take):
                m.d.sync += taken_limited.eq(opened_limited)
        if self.config.regions:  # results of the batch before may still come
            before, taken_limited = taken_limited, Signal(name="results_limited")
            with m.If(self.core.takes_over):
                m.d.sync += taken_limited.eq(before)
        m.d.comb += [
            packet.wire.eq(wire),
            packet.config_range.eq(taken_limited),
            packet.stream_results.eq(values.output_stream_results & hops.due if hops else values.output_stream_results),
            packet.hold.eq(values.result_hold_hold),
            packet.forget.eq(self.soft_reset),
        ]
        passed = self.input.o
        m.d.comb += [
            self.o.valid.eq(Mux(self.bypassing, passed.valid, packet.o.valid)),
            self.o.payload.eq(Mux(self.bypassing, passed.payload, packet.o.payload)),
            passed.ready.eq(Mux(self.bypassing, self.o.ready, self.input_path.i.ready)),
            packet.o.ready.eq(self.o.ready & ~self.bypassing),
        ]

    @property
    def _done(self):
        """A batch's last result was taken; one that is sent, of a hop."""
        taken = self.result_packet.taken
        if self.config.slides:
            return taken & self.hop_results.sent
        return taken & self.core.o.payload.last if self.config.regions else taken

    @property
    def _taken(self):
        """How many events the core takes."""
        taken, skips = self.core.i.valid & self.core.i.ready, self.config.skips
        return Mux(taken & (self.core.i.payload.skip != 0), self.core.i.payload.skip, taken) if skips else taken

    @property
    def _over(self):
        """What was opened is over."""
        return self.batch_end.ended if self.config.slides else self._done

    @property
    def _dropped(self):
        """Something on the wire became no event of a batch."""
        counted = self.input_path.counted
        lost = counted.format_errors, counted.before_time, counted.out_of_sensor
        return Cat(lost).any() if self.config.evt3 else lost[0] | lost[1] | lost[2]

    @property
    def _limited(self):
        """A setting of the batch that is opened is not as it was written."""
        limited = self.settings.out_of_range | (self.schedule_store.limited if self.schedule_store else 0)
        return limited | self.beyond.any() if self.config.slides else limited

    def _bus(self, m):
        """All hear the bus; whoever is not asked answers 0, as do the words of a block's memory."""
        bus, counters, packet = self.bus, self.counters, self.result_packet
        m.d.comb += bus.write.ready.eq(self.settings.bus.write.ready)
        answers = []
        for block in (self.bank, self.settings, self.schedule_store, self.tables):
            if block:
                m.d.comb += [
                    block.bus.write.valid.eq(bus.write.valid & bus.write.ready),
                    block.bus.write.payload.eq(bus.write.payload),
                    block.bus.read.eq(bus.read),
                    block.bus.read_address.eq(bus.read_address),
                ]
                answers.append(block.bus.read_data)

        def asked(group, bits):
            return bus.read_address[bits:] == BASE[group] // 4 >> bits

        m.d.comb += [
            counters.address.eq(bus.read_address),
            packet.address.eq(bus.read_address[1:]),
            packet.read.eq(bus.read & asked("Result", 1 + len(packet.address))),
        ]
        word = counters.word
        more = {"RESULTS_SKIPPED": self.hop_results.skipped} if self.hop_results else {}
        once = self._done if self.config.regions else packet.taken  # a batch
        more |= filtered(m, counts_of(self.config), packet.i.payload, clear=counters.clear, once=once)
        for name, count in more.items():
            at = self.registers[f"COUNT_{name}"].offset // 4 % 32
            word = Mux(counters.address == at, count, word)
        answers.append(Mux(asked("Counters", len(counters.address)), word, 0))
        for half in range(2):
            mine = asked("Result", 1 + len(packet.address)) & (bus.read_address[0] == half) & packet.any_shown
            answers.append(Mux(mine, packet.words.word_select(half, 32), 0))
        # Registers that are cleared choose among them.
        answered = Signal(data.ArrayLayout(32, len(answers)), reset_less=True)
        m.d.sync += [kept.eq(answer) for kept, answer in zip(answered, answers, strict=True)]
        m.d.comb += bus.read_data.eq(functools.reduce(operator.or_, answered))

    def _registers(self, m):
        bank, counters, packet = self.bank, self.counters, self.result_packet
        m.d.comb += [
            counters.clear.eq(bank.commands.ctrl_clear_counters | self.soft_reset),
            counters.begun.eq(packet.begun),
            counters.held.eq(packet.held),
            counters.packet.eq(packet.written),
        ]
        if self.config.slides:  # an event is counted once, not in each of its windows
            word = self.registers["RESULT_ROI_EVENTS"].offset - BASE["Result"]
            with m.If(self.hop_results.beat == word // 8):
                m.d.comb += counters.packet[:32].eq(self.core.o.payload.fresh)
        if self.config.regions:
            m.d.comb += counters.last.eq(packet.i.payload.last)
        entering, leaving = self.i, self.o
        counted = self.input_path.counted
        pulses = {
            "busy_cycles": ~self.quiet,
            "input_stalls": entering.valid & ~entering.ready,
            "output_stalls": leaving.valid & ~leaving.ready,
            "result_stalls": packet.stalled,
            "beats_in": entering.valid & entering.ready,
            "beats_bypassed": self.bypassing & leaving.valid & leaving.ready,
            "events_taken": self._taken,
            "empty_ends": self.batch_end.empty_end,
            **{name: counted[name] for name in counted.shape().members},
        }
        assert set(pulses) == set(counters.pulses.shape().members)
        m.d.comb += [counters.pulses[name].eq(pulse) for name, pulse in pulses.items()]

        states = {
            "idle": ~bank.values.ctrl_start & self.quiet,
            "ready": ~bank.values.ctrl_start,
            "taking_in": self.batch_end.taking_in,
            "computing": self.core.busy | self.batch_end.ending if self.config.slides else self.outstanding != 0,
            "result_waiting": packet.sending,
            "events_waiting": ~self.input.empty | ~self.input_path.empty | self.batch_end.holding,
            "time_known": self.input_path.time_known,
            "config_range": self._limited,
            "input_pending": self.input_pending,
            "schedule_pending": self.schedule_store.pending if self.schedule_store else 0,
            "bypassing": self.bypassing,
        }
        if tables := self.tables:
            states |= {name: getattr(tables, name) for name in ("pending", "rows_missing", "refused")}
        for register, f in fields_of(bank.registers, "status"):
            m.d.comb += bank.status[member(register, f)].eq(states[f.link])

        flags = self.core.o.payload.flags

        def flagged(*wanted):
            found = [flags[flag.bit_length() - 1] for flag in wanted]
            return packet.taken & (sum(found[1:], found[0]) != 0)

        events = {
            "done": self._done,
            "ready": self.opened,
            "overflow": flagged(Flag.OVERFLOW),
            "wire": self._dropped,
            "time": counted.time_high_back | flagged(Flag.TIME_BACK, Flag.TIME_SPAN),
            "config_range": self.opened & self._limited,
        }
        enabled = 0
        for name, event in events.items():
            m.d.comb += bank.set[f"isr_{name}"].eq(event)
            enabled |= bank.values[f"isr_{name}"] & bank.values[f"ier_{name}"]
        m.d.comb += [bank.set.ctrl_done.eq(self._done), self.irq.eq(bank.values.gie_enable & enabled)]
