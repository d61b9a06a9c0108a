"""Amaranth's simulator, with less to do around what it simulates.

Amaranth evaluates the design after each input that a test bench sets, and looks through all processes for those that
may run. Here the design is evaluated once, when a bench reads or time goes on, and a signal knows the processes that
read it. What the processes compute is Amaranth's own, and so is the order in which they see it.
"""

import re
from unittest import mock

from amaranth.hdl import Fragment, Signal
from amaranth.hdl._ast import Operator, SignalSet, _StatementList
from amaranth.hdl._xfrm import LHSMaskCollector
from amaranth.sim import _pyrtl
from amaranth.sim._async import AsyncProcess, TestbenchContext
from amaranth.sim.pysim import PySimEngine


def _compile(text, *arguments):
    """A process's text: slots are local names, and what stays as it is is not written again."""
    text = re.sub(r"(slots\[(\d+)\])(\.update\(next_\2, .*)", r"if next_\2 != \1.next: \1\3", text)
    used = sorted(set(re.findall(r"slots\[(\d+)\]", text)))
    text = re.sub(r"slots\[(\d+)\]", r"s\1", text)
    return compile(text.replace("run()", f"run({', '.join(f's{n}=slots[{n}]' for n in used)})", 1), *arguments)


def _split(fragment):
    """Give statements that drive different signals fragments of their own, so that each runs when its inputs change."""
    for part, *_ in fragment.subfragments:
        _split(part)
    groups = []  # (signals, statements)
    for statement in fragment.statements.pop("comb", ()):
        collector = LHSMaskCollector()
        collector.visit_stmt(statement)
        driven, statements = SignalSet(signal for signal, _ in collector.masks()), [statement]
        apart = []
        for group in groups:
            if any(signal in group[0] for signal in driven):
                driven, statements = SignalSet([*group[0], *driven]), group[1] + statements
            else:
                apart.append(group)
        groups = [*apart, (driven, statements)]
    for _, statements in groups:
        part = Fragment()
        part.statements["comb"] = _StatementList(statements)
        fragment.subfragments.append((part, None, None))


class _Context(TestbenchContext):
    """What a bench sets and reads; whole signals, which are most of it, the short way."""

    def set(self, expr, value):
        if type(expr) is Signal and type(value) is int:
            self._engine.set_value(expr, value)
        else:
            super().set(expr, value)

    def get(self, expr):
        return self._engine.get_value(expr) if type(expr) is Signal else super().get(expr)


class _Bench(AsyncProcess):
    def __init__(self, design, engine, constructor, background):
        self.constructor, self.background = constructor, background
        self.context = _Context(design, engine, self)
        self.reset()


class QuickEngine(PySimEngine):
    """Give it to :class:`amaranth.sim.Simulator` as ``engine``."""

    def __init__(self, design):
        _split(design.fragment)
        with mock.patch.object(_pyrtl, "compile", _compile, create=True):
            super().__init__(design)
        self._woken = set()
        self._running_bench = self._unsettled = False
        self._slots = {}  # of signals that benches use, by their identity: these live as long as the design
        self._readers = {}  # by slot: processes that run when it changes; those of an edge, with the level after it
        for slot in self._state.slots:
            readers = []
            for waker in slot.wakers:
                names = dict(zip(waker.__code__.co_freevars, waker.__closure__, strict=True))
                polarity = names["polarity"].cell_contents if "polarity" in names else None
                readers.append((names["process"].cell_contents, polarity))
            slot.wakers.clear()
            plain = {process for process, polarity in readers if polarity is None}
            edges = {level: {process for process, polarity in readers if polarity == level} for level in (0, 1)}
            self._readers[slot] = plain | edges[0], plain | edges[1]
        self._start()

    def _start(self):
        self._woken.clear()
        self._woken.update(p for p in self._processes if type(p) is _pyrtl.PyRTLProcess and p.is_comb)
        self._others = None

    def reset(self):
        super().reset()
        self._start()

    def add_async_testbench(self, simulator, process, *, background):
        self._testbenches.append(_Bench(self._design, self, process, background))

    def _slot(self, signal):
        if id(signal) not in self._slots:
            self._slots[id(signal)] = self._state.slots[self._state.get_signal(signal)], signal
        return self._slots[id(signal)][0]

    def get_value(self, expr):
        if self._unsettled:
            self._settle()
        if type(expr) is Signal:
            return self._slot(expr).curr
        if type(expr) is Operator and expr.operator == "u" and type(expr.operands[0]) is Signal:
            signal = expr.operands[0]
            return self._slot(signal).curr & ((1 << len(signal)) - 1)
        return super().get_value(expr)

    def set_value(self, expr, value):
        self._unsettled = True
        signal = expr.operands[0] if type(expr) is Operator and expr.operator == "u" else expr
        slot = self._slot(signal) if type(signal) is Signal else None
        if slot is None or slot.is_comb:
            super().set_value(expr, value)
            return
        value &= (1 << len(signal)) - 1
        if signal._signed and value >> (len(signal) - 1):
            value -= 1 << len(signal)
        slot.update(value)

    def step_design(self):
        if self._running_bench:  # which may set more
            self._unsettled = True
        else:
            self._settle()

    def _settle(self):
        """Delta cycles, until nothing changes."""
        assert not self._vcd_writers
        self._unsettled = False
        if self._others is None:  # clocks, which are added later
            self._others = [process for process in self._processes if type(process) is not _pyrtl.PyRTLProcess]
        state, triggers, readers, woken = self._state, self._active_triggers, self._readers, self._woken
        pending = state.pending
        while True:
            for trigger in triggers:
                trigger.run()
            triggers.clear()
            for process in self._others:
                if process.runnable:
                    process.runnable = False
                    process.run()
            for process in woken:
                process.run()
            woken.clear()
            if not pending:
                return
            for slot in pending:
                if slot in readers:
                    if slot.commit():
                        woken |= readers[slot][getattr(slot, "curr", 0) & 1]
                else:  # of a signal that only benches know
                    slot.commit()
            pending.clear()

    def advance(self):
        self._settle()
        self._running_bench = True
        try:
            while runnable := [bench for bench in self._testbenches if bench.runnable]:
                for bench in runnable:
                    bench.runnable = False
                    bench.run()
        finally:
            self._running_bench = False
        if self._unsettled:
            self._settle()
        self._state.timeline.advance()
        return any(each.critical for each in (*self._others, *self._testbenches))
