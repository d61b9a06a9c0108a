"""Register bank: what a small map stores, shows, sets and clears, in every collision. Strobes: through the AXI top."""

import itertools

import pytest

from cmfpga.config import preset
from cmfpga.protocol.registers import Field, Register, RegisterMap, register_map
from cmfpga.rtl.shell.register_bank import RegisterBank, fields_of, in_memory, member
from cmfpga.rtl.shell.settings import WORDS
from support.bench import played_by, simulate
from support.values import Port


def bank_map():
    def field(name, lsb, width, access, **more):
        return Field(name=name, lsb=lsb, width=width, access=access, doc="", **more)

    return RegisterMap(
        (
            Register(
                name="A", offset=0, group="g", doc="",
                fields=(
                    field("GO", 0, 1, "flag"), field("HAPPENED", 1, 1, "sticky"), field("NOW", 2, 1, "command"),
                    field("LEVEL", 8, 5, "stored", reset=-3, signed=True), field("SEEN", 16, 9, "status"),
                ),
            ),
            Register(name="B", offset=0x44, group="g", doc="", fields=(field("MOST", 0, 31, "stored", reset=7),)),
            Register(name="C", offset=0xFFC, group="g", doc="", fields=(field("FIXED", 4, 8, "constant", reset=0xA5),)),
        )
    )  # fmt: skip


class Access:
    def __init__(self, ctx, bank):
        self.ctx, self.bank = ctx, bank
        self.ports = {name: Port(getattr(bank, name)) for name in ("values", "status", "set", "clear", "commands")}
        self.write_port, self.valid = Port(bank.bus.write.payload), Port(bank.bus.write.valid)
        self.status = {"a_seen": 0}

    async def cycle(self, *, write=None, strobe=15, set=0, clear=0):
        """One cycle; the commands in it."""
        address, data = write or (1023, 0xFFFFFFFF)
        self.write_port.set(self.ctx, {"address": address, "data": data, "strobe": strobe})
        self.valid.set(self.ctx, int(write is not None))
        self.ports["set"].set(self.ctx, {"a_happened": set})
        self.ports["clear"].set(self.ctx, {"a_go": clear})
        self.ports["status"].set(self.ctx, self.status)
        commands = self.ports["commands"].get(self.ctx)
        await self.ctx.tick()
        return commands

    async def read(self, address):
        Port(self.bank.bus.read_address).set(self.ctx, address)
        return self.ctx.get(self.bank.bus.read_data)


def run(check):
    bank = RegisterBank(bank_map())

    async def bench(ctx):
        await check(Access(ctx, bank))

    simulate(bank, bench)


@played_by(run)
async def test_reset_values_constants_and_nothing_elsewhere(access):
    assert await access.read(0) == (-3 & 31) << 8
    assert await access.read(0x44 // 4) == 7
    assert await access.read(0xFFC // 4) == 0xA50
    for address in (1, 16, 18, 1022, 512):
        assert await access.read(address) == 0


@played_by(run)
async def test_commands_last_one_cycle(access):
    assert (await access.cycle(write=(0, 4)))["a_now"] == 1
    assert (await access.cycle())["a_now"] == 0
    assert (await access.cycle(write=(0, 4), strobe=0b1110))["a_now"] == 0
    assert (await access.cycle(write=(17, 4)))["a_now"] == 0


@played_by(run)
async def test_flags_and_sticky_bits_in_every_collision(access):
    """All combinations of what was, what software writes and what hardware does in one cycle."""
    for go, happened, new, strobe, set_, clear in itertools.product(
        (0, 1), (0, 1), (None, 0, 1, 2, 3), (15, 14), (0, 1), (0, 1)
    ):
        await access.cycle(write=(0, 2 | go), clear=0)
        await access.cycle(set=happened)
        assert (await access.read(0)) & 3 == go | happened << 1
        await access.cycle(write=None if new is None else (0, new), strobe=strobe, set=set_, clear=clear)
        written = new if new is not None and strobe & 1 else None
        wanted_go = (0 if clear else go) if written is None else written & 1
        wanted = (0 if written is not None and written & 2 else happened) | set_
        assert (await access.read(0)) & 3 == wanted_go | wanted << 1, (go, happened, new, strobe, set_, clear)


@played_by(run)
async def test_status_is_shown_and_not_written(access):
    access.status = {"a_seen": 0x155}
    await access.cycle(write=(0, 0xFFFFFFFF))
    assert (await access.read(0)) >> 16 == 0x155


@pytest.mark.parametrize("name", ["paper", "fast"])
def test_every_register_has_one_place(name):
    """In the bank, in the memory of the settings, or as a word that another block answers with."""
    registers = register_map(preset(name))
    bank = RegisterBank(registers)
    kept = [register.name for register in registers if in_memory(register)]
    assert {"SCRATCH", "ROI", "BATCH_DURATION", "THINNING"} < set(kept) and "ROI_LOAD" not in kept
    for register, f in fields_of(registers, "stored", "flag", "sticky"):
        assert register.name not in kept and len(getattr(bank.values, member(register, f))) == f.width
    words = [register.offset // 4 % WORDS for register in registers if register.name in kept]
    assert len(set(words)) == len(words) > 10
