"""The bridge: requests to register accesses and words, replies, packets; what is lost is counted."""

import numpy as np
import pytest

from cmfpga.protocol import link
from cmfpga.rtl.uart.bridge import Bridge
from support.bench import played_by, simulate

BUFFER_WORDS = 64


class Host:
    """Drives a bridge's bytes, faster than a line would, and stands for the shell at its other side.

    Registers of the shell read as ``0xAB000000 + address`` until they are written. Beats are taken while ``taking``.
    """

    def __init__(self, script):
        self.written, self.beats, self.packets, self.replies = [], [], [], []
        self.taking, self.reading = True, True
        self._reader, self._block, self._number, self._offer = link.FrameReader(), Bridge(BUFFER_WORDS), 0, []
        self._over = False

        async def run(ctx):
            self._ctx = ctx
            await script(self)
            await self.rest(60)
            self._over = True

        simulate(self._block, run, self._shell, self._line)
        assert self._reader.bad == 0

    async def _shell(self, ctx):
        block, values, cycle = self._block, {}, 0
        while not self._over:
            ctx.set(block.words.ready, int(self.taking))
            ctx.set(block.packets.valid, int(bool(self._offer)))
            if self._offer:
                ctx.set(block.packets.payload.data, self._offer[0][0])
                ctx.set(block.packets.payload.last, self._offer[0][1])
            if ctx.get(block.packets.ready) and self._offer:
                self._offer.pop(0)
            if self.taking and ctx.get(block.words.valid):
                beat = ctx.get(block.words.payload)
                self.beats.append((beat.data, beat.keep, beat.last))
            cycle += 1
            ctx.set(block.bus.write.ready, int(cycle % 3 == 0))
            if ctx.get(block.bus.write.valid) and cycle % 3 == 0:
                write = ctx.get(block.bus.write.payload)
                assert write.strobe == 15
                values[write.address] = write.data
                self.written.append((write.address, write.data))
            address = ctx.get(block.bus.read_address)
            answer = values.get(address, 0xAB000000 + address) if ctx.get(block.bus.read) else 0
            await ctx.tick()
            ctx.set(block.bus.read_data, answer)

    async def _line(self, ctx):
        while not self._over:
            ctx.set(self._block.sent.ready, int(self.reading))
            if self.reading and ctx.get(self._block.sent.valid):
                for payload in self._reader.read(bytes([ctx.get(self._block.sent.payload)])):
                    (self.packets if payload[0] == link.PACKET else self.replies).append(payload[1:])
            await ctx.tick()

    async def rest(self, cycles):
        await self._ctx.tick().repeat(cycles)

    async def wire(self, content, lost=()):
        """Bytes; those at the places ``lost`` have no stop bit."""
        for place, byte in enumerate(content):
            self._ctx.set(self._block.received.payload, byte)
            self._ctx.set(self._block.error if place in lost else self._block.received.valid, 1)
            await self._ctx.tick()
            self._ctx.set(self._block.received.valid, 0)
            self._ctx.set(self._block.error, 0)
            await self.rest(3)

    async def request(self, command, arguments=b"", number=None):
        """(status, word) of the reply; None where none comes."""
        self._number = (self._number + 1) % 256 if number is None else number
        await self.wire(link.frame(bytes([self._number, command]) + arguments))
        return await self.reply()

    async def reply(self):
        for _ in range(100):
            await self.rest(10)
            if self.replies:
                reply = self.replies.pop(0)
                assert reply[0] == self._number and len(reply) in (2, 6)
                return reply[1], int.from_bytes(reply[2:], "little")
        return None

    async def read(self, address):
        return (await self.request(link.READ, address.to_bytes(2, "little")))[1]

    async def write(self, address, value, **how):
        return await self.request(link.WRITE, address.to_bytes(2, "little") + value.to_bytes(4, "little"), **how)

    async def events(self, words, last=False, **how):
        content = np.asarray(words, "<u4").tobytes()
        return (await self.request(link.EVENTS_LAST if last else link.EVENTS, content, **how))[0]

    async def counters(self):
        offsets = {name: link.REGISTERS[f"COUNT_{name.upper()}"].offset for name in link.COUNTERS}
        found = {name: await self.read(link.BASE + offset) for name, offset in offsets.items()}
        return {name: value for name, value in found.items() if value}

    def offer(self, beats):
        self._offer += [(beat, k == len(beats) - 1) for k, beat in enumerate(beats)]


def as_beats(words, last):
    words = list(words)
    found = []
    for k in range(0, len(words), 2):
        pair = [*words[k : k + 2], 0xFFFFFFFF]
        found.append([pair[1] << 32 | pair[0], 0xFF if k + 1 < len(words) else 0x0F, 0])
    if last and len(words) % 2:
        found[-1][2] = 1
    elif last:
        found.append([0xFFFFFFFF_FFFFFFFF, 0, 1])
    return [tuple(beat) for beat in found]


@played_by(Host)
async def test_registers(host):
    assert await host.request(link.HELLO) == (link.DONE, 0)
    assert await host.read(0x010) == 0xAB000004
    assert await host.write(0x204, 0xC0DBDCDD) == (link.DONE, 0)
    assert await host.read(0x204) == 0xC0DBDCDD
    assert host.written == [(0x81, 0xC0DBDCDD)]
    assert await host.read(link.BASE) == link.ID
    assert await host.read(0x5000) == 0  # nobody's
    await host.write(0x5000, 1)
    await host.write(link.BASE + 4, 0b1011)
    assert await host.read(link.BASE + 4) == 0b1011
    assert host.written == [(0x81, 0xC0DBDCDD)] and await host.counters() == {}


@played_by(Host)
async def test_words_of_any_number_with_and_without_an_end(host, rng):
    expected = []
    for size, last in ((1, False), (2, True), (3, True), (4, False), (0, True), (17, True), (54, True)):
        words = rng.integers(0, 1 << 32, size).tolist()
        assert await host.events(words, last) == link.DONE
        expected += as_beats(words, last)
    await host.rest(300)
    assert host.beats == expected
    assert await host.counters() == {}


@played_by(Host)
async def test_a_damaged_frame_leaves_no_word_and_no_reply(host, rng):
    good = link.frame(bytes([9, link.EVENTS_LAST]) + bytes(range(16)))
    damaged = bytearray(good)
    damaged[9] ^= 4
    for wire, lost in ((damaged, ()), (good[:-4], ()), (b"garbage", ()), (good, {6})):
        await host.wire(wire, lost)
        await host.wire([link.END])
        assert await host.reply() is None
    assert await host.events([1, 2]) == link.DONE
    assert await host.counters() == {"bad_frames": 4, "byte_errors": 1}
    assert host.beats == as_beats([1, 2], False)


@played_by(Host)
async def test_a_request_that_comes_again_is_answered_and_not_carried_out(host):
    for _ in range(2):
        assert await host.write(0x40, 5, number=7) == (link.DONE, 0)
        assert await host.events([1, 2], number=8) == link.DONE
        assert await host.events([1, 2], number=8) == link.DONE
    assert len(host.written) == 2 and host.beats == 2 * as_beats([1, 2], False)
    # Another host may begin with any number.
    assert await host.write(0x40, 6, number=8) == (link.DONE, 0)
    assert await host.request(link.HELLO, number=8) == (link.DONE, 0)
    assert await host.write(0x40, 7, number=8) == (link.DONE, 0)
    assert [value for _, value in host.written] == [5, 5, 7]
    assert (await host.counters())["repeats"] == 3


@played_by(Host)
async def test_what_does_not_fit_is_refused_whole_and_fits_later(host, rng):
    host.taking = False
    frames = [rng.integers(0, 1 << 32, 10).tolist() for _ in range(6)]
    assert [await host.events(words, True) for words in frames] == [link.DONE] * 5 + [link.BUSY]
    waiting = await host.read(link.BASE + link.REGISTERS["LINK_WAITING"].offset)
    assert waiting & 0xFFFF == 5 * 12 - 2  # and a beat is on its way
    host.taking = True
    await host.rest(300)
    assert await host.events(frames[-1], True) == link.DONE
    await host.rest(100)
    assert host.beats == [beat for words in frames for beat in as_beats(words, True)]
    assert await host.counters() == {"busy": 1}


@played_by(Host)
async def test_flush_forgets_what_waits(host):
    host.taking = False
    await host.events(range(40), True)
    await host.write(link.BASE + link.REGISTERS["LINK_FLUSH"].offset, 1)
    assert (await host.read(link.BASE + link.REGISTERS["LINK_WAITING"].offset)) & 0xFFFF == 0
    await host.events([7, 8], True)
    host.taking = True
    await host.rest(100)
    assert host.beats == as_beats([0, 1], False) + as_beats([7, 8], True)  # one beat was offered already


@pytest.mark.parametrize("arguments", [(9, b""), (link.READ, b"\0"), (link.WRITE, b"\0" * 7), (link.EVENTS, b"\0" * 6)])
@played_by(Host)
async def test_what_is_no_request_is_refused(host, arguments):
    assert await host.request(*arguments) == (link.REFUSED, 0)
    assert await host.counters() == {"bad_frames": 1}
    assert host.beats == [] and host.written == []


@played_by(Host)
async def test_a_request_before_the_last_reply_has_gone_is_counted(host):
    host.reading = False
    await host.write(0x40, 1, number=1)
    await host.write(0x40, 2, number=2)
    host.reading = True
    host._number = 1
    assert await host.reply() == (link.DONE, 0)
    assert host.written == [(0x10, 1)] and await host.counters() == {"overruns": 1}


@played_by(Host)
async def test_packets_and_replies_share_the_line(host, rng):
    beats = rng.integers(0, 1 << 63, 2 * link.FRAME_BEATS + 3).tolist()
    host.offer(beats[:3])
    host.offer(beats)
    await host.rest(20)
    assert await host.read(0x08) == 0xAB000002
    await host.rest(3000)
    assert [len(packet) // 8 for packet in host.packets] == [3, link.FRAME_BEATS, link.FRAME_BEATS, 3]
    assert [packet[-1] for packet in host.packets] == [1, 0, 0, 1]
    got = b"".join(packet[:-1] for packet in host.packets)
    assert np.frombuffer(got, "<u8").tolist() == beats[:3] + beats


@played_by(Host)
async def test_a_packet_without_its_rest_holds_up_no_reply(host):
    host._offer.append((1, 0))
    await host.rest(200)
    assert await host.read(0x08) == 0xAB000002
    host._offer.append((2, 1))
    await host.rest(200)
    assert host.packets == [b"\1" + bytes(8), b"\2" + bytes(7) + b"\1"]
