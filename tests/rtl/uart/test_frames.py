"""Frames from bytes and bytes of frames, as :mod:`cmfpga.protocol.link` makes and reads them."""

import pytest

from cmfpga.protocol import link
from cmfpga.rtl.uart.frames import FrameReader, FrameWriter
from support.axi_streams import FLOWS, pass_through
from support.bench import play

PAYLOADS = [b"\x01", b"ab", bytes([link.END, link.ESCAPE]), bytes(range(256)), bytes([link.ESCAPE] * 5), b"xyz"]


def read(wire, gaps=(0,), errors=()):
    """Payloads, and how many frames were bad; ``errors`` are bytes with which one was lost."""
    block, script, watch = FrameReader(), [], ("o.valid", "o.payload", "end", "bad")
    for k, byte in enumerate(wire):
        script += [{}] * gaps[k % len(gaps)] + [{"i.valid": 1, "i.payload": byte, "error": int(k in errors)}]
    recording = play(block, [*script, {}, {}], watch=watch)
    found, payload, bad = [], b"", 0
    for valid, byte, end, is_bad in zip(*(recording.watch[name] for name in watch), strict=True):
        if valid:
            payload += bytes([byte])
        if end:
            found.append(payload)
        if end or is_bad:
            payload, bad = b"", bad + is_bad
    return found, bad


@pytest.mark.parametrize("gaps", [(0,), (3,), (0, 1, 5)])
def test_frames_are_read(gaps):
    assert read(b"".join(map(link.frame, PAYLOADS)), gaps) == (PAYLOADS, 0)


def test_damage_costs_the_frame_it_is_in():
    good = link.frame(b"hello")
    for place in range(1, len(good) - 1):
        damaged = bytearray(good)
        damaged[place] ^= 0x10
        found, bad = read(good + bytes(damaged) + good)
        assert found == [b"hello", b"hello"] and bad >= 1
    assert read(b"noise" + good + bytes([link.ESCAPE, link.END]) + good) == ([b"hello"] * 2, 2)
    assert read(good[:-3] + good) == ([b"hello"], 1)
    assert read(bytes([link.END, link.ESCAPE, 7]) + good) == ([b"hello"], 1)  # an escape that is none


def test_a_lost_byte_costs_its_frame():
    """Even where the CRC cannot tell, as of a byte lost behind it."""
    good = link.frame(b"hello")
    assert read(good + good, errors={len(good) - 2}) == ([b"hello"], 1)


@pytest.mark.parametrize("flow", FLOWS)
def test_frames_are_written(flow, rng):
    items = [{"byte": byte, "last": k == len(p) - 1} for p in PAYLOADS for k, byte in enumerate(p)]
    expected = b"".join(map(link.frame, PAYLOADS))
    assert bytes(pass_through(FrameWriter(), items, flow, rng, expect=len(expected)).values) == expected
