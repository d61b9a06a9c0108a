"""Register access on the AXI top."""

import cocotb

from support.axi.board import Board


def writable(registers):
    """Registers that only store: (register, mask of the bits that do)."""
    for register in registers:
        if register.fields and all(f.access == "stored" for f in register.fields) and register.name != "INPUT":
            yield register, sum(f.mask for f in register.fields)


@cocotb.test()
async def reset_values(dut):
    board = Board(dut)
    await board.reset()
    status = {"CTRL": 0b1100}  # idle, ready
    for register in board.registers:
        if register.count == 1 and register.name not in ("COUNT_CYCLES", "STATUS"):
            assert await board.read_word(register.offset) == status.get(register.name, register.reset), register.name


@cocotb.test()
async def every_bit_is_stored(dut):
    """Of words, and of one to four bytes at any place, aligned or not; some bits of a word do not exist."""
    board = Board(dut, seed=1, pauses=0.3)
    await board.reset()
    masks, written = {}, {}
    for register, mask in writable(board.registers):
        for offset in range(register.offset, register.offset + 4 * register.count, 4):
            word = board.random.getrandbits(32)
            masks[offset], written[offset] = mask, word & mask
            await board.write_word(offset, word)
    for _ in range(60):
        offset, start = board.random.choice([*masks]), board.random.randrange(4)
        data = board.random.randbytes(board.random.randint(1, 4 - start))
        await board.lite.write(offset + start, data)
        word = bytearray(written[offset].to_bytes(4, "little"))
        word[start : start + len(data)] = data
        written[offset] = int.from_bytes(word, "little") & masks[offset]
        assert await board.read_word(offset) == written[offset], (hex(offset), start, data)
    for offset, word in written.items():
        assert await board.read_word(offset) == word, hex(offset)
    assert len(written) > 18
    for k in range(4):  # bytes read one by one
        offset = board.registers["SCRATCH"].offset
        assert (await board.lite.read_byte(offset + k)) == written[offset] >> 8 * k & 0xFF


@cocotb.test()
async def unmapped_addresses(dut):
    """Read 0, take writes, answer OKAY; and change nothing."""
    board = Board(dut, seed=4, pauses=0.2)
    await board.reset()
    await board.write("SCRATCH", 0x12345678)
    used = {register.offset + 4 * k for register in board.registers for k in range(register.count)}
    free = [offset for offset in range(0, 0x1000, 4) if offset not in used]
    beyond = [0x1000, 0x1FFC, 0x8000, 0xFFFC, 0x1000 + board.registers["SCRATCH"].offset - 0xFFC]
    for offset in [*board.random.sample(free, 30), *beyond]:
        answer = await board.lite.write(offset, b"\xff\xff\xff\xff")
        assert answer.resp == 0
        answer = await board.lite.read(offset, 4)
        assert answer.resp == 0 and bytes(answer.data) == bytes(4), hex(offset)
    assert await board.read("SCRATCH") == 0x12345678
    assert await board.read("CTRL") == 0b1100 and await board.read("GIE") == 0
    assert await board.read("BATCH_EVENTS") == 0


@cocotb.test()
async def reads_and_writes_at_once(dut):
    """Back-pressure and gaps on all five channels, reads and writes under way together: none is lost or mixed up."""
    board = Board(dut, seed=5, pauses=0.5)
    await board.reset()
    scratch = board.registers["SCRATCH"].offset

    async def read_constants():
        for _ in range(60):
            register = board.random.choice(board.registers.group("Discovery"))
            assert await board.read_word(register.offset) == register.reset

    reading = cocotb.start_soon(read_constants())
    for _ in range(60):
        word = board.random.getrandbits(32)
        await board.write_word(scratch, word)
        assert await board.read_word(scratch) == word
    await reading
