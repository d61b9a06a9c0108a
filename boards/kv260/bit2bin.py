#!/usr/bin/env python3
"""Converts Vivado's .bit into the .bit.bin that Linux's FPGA manager loads.

    python boards/kv260/bit2bin.py build/cmfpga.bit                  # writes build/cmfpga.bit.bin
    python boards/kv260/bit2bin.py build/cmfpga.bit -o other.bin --json

The header goes, and the bytes of each 32-bit word are turned round: what
``bootgen -arch zynqmp -process_bitstream bin`` makes of it, byte for byte (tests/boards/test_bit2bin.py).
The header's fields are those that Vivado writes: each a letter, a length and a text; ``e`` is the configuration data.
Needs Python 3.11 and nothing else.
"""

import argparse
import json
import sys
from pathlib import Path

MAGIC = bytes.fromhex("0009 0ff00ff00ff00ff000 0001")  # what a .bit begins with, length first
FIELDS = {"a": "design", "b": "part", "c": "date", "d": "time"}
SYNC_WORD = bytes.fromhex("aa995566")


class BitError(ValueError):
    """The file is not a .bit that can be converted; the message says where and why."""


def parse(bit):
    """``(fields, data)`` of a .bit: the header's texts by name, and the configuration data as in the file."""
    if not bit.startswith(MAGIC):
        raise BitError("does not begin like a .bit of Vivado (is it already a .bin?)")
    fields, at = {}, len(MAGIC)
    while True:
        key = chr(bit[at]) if at < len(bit) else "end of file"
        if key == "e":
            size, start = int.from_bytes(bit[at + 1 : at + 5], "big"), at + 5
            break
        if key not in FIELDS:
            raise BitError(f"header, byte {at}: expected one of a, b, c, d, e; found {key!r}")
        size = int.from_bytes(bit[at + 1 : at + 3], "big")
        fields[FIELDS[key]] = bit[at + 3 : at + 3 + size].rstrip(b"\0").decode("latin-1")
        at += 3 + size
    data = bit[start:]
    if len(data) != size:
        raise BitError(f"header says {size} bytes of data, the file has {len(data)}: a copy that was cut short?")
    if size % 4:
        raise BitError(f"{size} bytes of data are not whole 32-bit words")
    if SYNC_WORD not in data[:1024]:
        raise BitError("no synchronisation word AA995566 near the beginning of the data")
    return fields, data


def convert(bit):
    """``(fields, bytes of the .bit.bin)``."""
    fields, data = parse(bit)
    words = bytearray(len(data))
    for lane in range(4):
        words[lane::4] = data[3 - lane :: 4]
    return fields, bytes(words)


def plain_part(name):
    """A part's name for comparison; for older families Vivado leaves out the leading "xc"."""
    return name.lower().removeprefix("xc")


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description="Convert Vivado's .bit into the .bit.bin that Linux loads.",
        epilog="example: python boards/kv260/bit2bin.py build/cmfpga.bit",
    )
    parser.add_argument("bit", type=Path, help="the .bit")
    parser.add_argument("-o", "--out", type=Path, help="where to write (default: beside the .bit, with .bin added)")
    parser.add_argument("--part", help="refuse a bitstream for another part than this one")
    parser.add_argument("--json", action="store_true", help="print the header's fields as JSON")
    options = parser.parse_args(arguments)
    out = options.out or Path(f"{options.bit}.bin")
    try:
        fields, data = convert(options.bit.read_bytes())
        if options.part and plain_part(fields.get("part", "")) != plain_part(options.part):
            raise BitError(f"is for part {fields.get('part', '(none named)')}, not for {options.part}")
        out.write_bytes(data)
    except (OSError, BitError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        print(f"error: {options.bit}: {reason}", file=sys.stderr)
        return 2
    if options.json:
        print(json.dumps({**fields, "bytes": len(data), "out": str(out)}))
    else:
        print(f"{out}: {len(data)} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
