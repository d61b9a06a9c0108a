"""The C examples: compiled without a warning, played on the emitted Verilog, and by UIO's mmap on files."""

import ctypes
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cmfpga.driver.golden import FORM, expected_result, golden_batch, setting_writes
from cmfpga.protocol.registers.documents import c_header
from cmfpga.protocol.words import encode
from support.board import Board
from support.driving import CONFIG, REGISTERS, top

__all__ = ["top"]

C = Path(__file__).parents[2] / "examples" / "c"
#: Where the event words lie.
EVENTS = 0x8_0000_0000
WORDS = encode(golden_batch(CONFIG)[0], FORM)
#: The bare-metal example, with a simulated board behind its accesses.
HOOKED = """\
#include <stdint.h>
uint32_t (*look)(uint64_t);
void (*put)(uint64_t, uint32_t);
#define CMFPGA_READ(base, offset) look((uintptr_t)(base) + (offset))
#define CMFPGA_WRITE(base, offset, word) put((uintptr_t)(base) + (offset), word)
#include "bare_metal.c"
"""


@pytest.fixture(scope="module")
def gcc(tmp_path_factory):
    """``gcc(source, *options)``: the file that is made of it, in a folder of its own beside the header."""
    program = shutil.which("gcc") or pytest.skip("gcc is not installed (Debian package gcc)")
    folder = tmp_path_factory.mktemp("c")
    (folder / "cmfpga_registers.h").write_text(c_header(REGISTERS, setting_writes(CONFIG)))

    def gcc(source, *options):
        made = folder / Path(source).with_suffix(".out").name
        warnings = "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"
        command = [program, "-std=c99", "-O1", *warnings, f"-I{folder}", f"-I{C}", *options, "-o", made, source]
        done = subprocess.run(command, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        return made

    return gcc


class Result(ctypes.Structure):
    """``struct cmfpga_result``."""

    _fields_ = [(name, ctypes.c_int32) for name in ("v_x", "v_y")] + [
        (name, ctypes.c_uint32) for name in ("flags", "events", "roi_next")
    ]


def play(library, board):
    """``(status, result)`` of the bare-metal example on a board."""
    board.memory.add(EVENTS, WORDS.copy())
    hooks = {
        "look": ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint64)(board.read),
        "put": ctypes.CFUNCTYPE(None, ctypes.c_uint64, ctypes.c_uint32)(board.write),
    }
    for name, hook in hooks.items():
        ctypes.c_void_p.in_dll(library, name).value = ctypes.cast(hook, ctypes.c_void_p).value
    result = Result()
    return library.cmfpga_batch(ctypes.c_uint64(EVENTS), WORDS.nbytes, ctypes.byref(result)), result


def test_on_the_emitted_verilog(gcc, top, tmp_path):
    (tmp_path / "hooked.c").write_text(HOOKED)
    library = ctypes.CDLL(str(gcc(tmp_path / "hooked.c", "-shared", "-fPIC")))
    assert play(library, Board(top, overrides={REGISTERS["ID"].offset: 0}))[0] == -1
    status, result = play(library, Board(top))
    expected, _ = expected_result(CONFIG)
    v = [raw / 2**CONFIG.formats.v.f for raw in (result.v_x, result.v_y)]
    assert (status, v, result.events) == (0, expected["v"], expected["events"])
    assert (result.roi_next & 0xFFFF, result.roi_next >> 16) == tuple(expected["roi_next"])
    by_uio(gcc, top, tmp_path, v, expected)


def by_uio(gcc, top, folder, v, expected):
    """Devices are files with the registers as they stand; what is written there stays."""
    core = np.zeros(0x4000, "<u4")
    for register in REGISTERS:
        for k in range(register.count):
            core[register.offset // 4 + k] = top.read32(register.offset + 4 * k)
    for offset, _ in setting_writes(CONFIG):
        core[offset // 4] = 0
    core[REGISTERS["ISR"].offset // 4] = REGISTERS["ISR"]["DONE"].mask
    files = [folder / name for name in ("core", "dma", "buffer")]
    for path, content in zip(files, (core.tobytes(), bytes(0x10000), bytes(0x10000)), strict=True):
        path.write_bytes(content)
    command = [gcc(C / "linux_uio.c"), *files, hex(EVENTS)]
    done = subprocess.run(command, input=WORDS.tobytes(), capture_output=True)
    said = f"v = {v[0]:g}, {v[1]:g} px per half batch; flags {int(expected['flags']):#x}; {expected['events']} events\n"
    assert (done.returncode, done.stdout.decode()) == (0, said)
    written = np.fromfile(files[0], "<u4")
    assert all(written[offset // 4] == word for offset, word in setting_writes(CONFIG))
    assert written[REGISTERS["CTRL"].offset // 4] == REGISTERS["CTRL"].pack(START=1)
    assert struct.unpack_from("<3I", files[1].read_bytes(), 0x18)[:2] == (EVENTS & 0xFFFFFFFF, EVENTS >> 32)
    assert struct.unpack_from("<I", files[1].read_bytes(), 0x28) == (WORDS.nbytes,)
    assert files[2].read_bytes()[: WORDS.nbytes] == WORDS.tobytes()
    files[0].write_bytes(bytes(0x10000))
    done = subprocess.run(command, input=b"", capture_output=True)
    assert done.returncode == 1 and b"not the core that cmfpga_registers.h is of" in done.stderr
