"""Frames of the serial link, from the host's side."""

import numpy as np

from cmfpga.protocol import link


def test_frames_come_back_in_pieces_of_any_size(rng):
    signs = np.array([link.END, link.ESCAPE, link.ESCAPED_END, link.ESCAPED_ESCAPE, *b"ab"], np.uint8)
    payloads = [bytes(rng.choice(signs, rng.integers(1, 40))) for _ in range(50)]
    wire = b"".join(map(link.frame, payloads))
    reader, found = link.FrameReader(), []
    while wire:
        cut = int(rng.integers(1, 9))
        found += reader.read(wire[:cut])
        wire = wire[cut:]
    assert found == payloads and reader.bad == 0


def test_garbage_costs_no_frame_but_those_it_hits():
    good = link.frame(b"hello")
    reader = link.FrameReader()
    damaged = bytearray(link.frame(b"world"))
    damaged[2] ^= 1
    assert reader.read(b"noise" + good + bytes(damaged) + good[:-3] + good) == [b"hello", b"hello"]
    # The noise, the damaged frame, and the one whose end is missing, which the next one's END closes.
    assert reader.bad == 3
    assert reader.read(bytes([link.END, link.ESCAPE, 7, 1, 2, 3, link.END])) == [] and reader.bad == 4


def test_a_line_without_an_end_is_not_kept():
    reader, good = link.FrameReader(), link.frame(b"hello")
    assert reader.read(b"x" * link.LONGEST) == [] and reader.read(b"x" * 1000) == [] == reader.read(b"x")
    assert len(reader._waiting) <= link.LONGEST + 1 and reader.read(good) == [b"hello"] and reader.bad == 1
    longest = bytes([link.END]) * (8 * link.FRAME_BEATS + 2)
    assert reader.read(link.frame(longest)) == [longest]


def test_the_links_registers_are_beyond_those_of_the_shell():
    assert link.BASE >= 0x1000 and link.REGISTERS["LINK_ID"].reset == link.ID
    assert link.FRAME_WORDS <= link.BUFFER_WORDS // 2
