"""The UIO back end: on files, and with the simulated board behind them."""

import mmap
import os
import socket

import numpy as np
import pytest

from cmfpga.driver import Accelerator, DeviceError, DeviceTimeout, uio
from cmfpga.driver.uio import Mapping, UdmaBuffer, UioBackend, UioDevice
from cmfpga.engines.model import ModelEngine
from cmfpga.protocol.words import encode
from support.board import descriptors, uio_tree
from support.driving import BEATS, CONFIG, batch, streamed, within, works
from support.uio import BUFFERS, Linux


@pytest.fixture
def tree(tmp_path):
    return uio_tree(tmp_path, buffers=BUFFERS)


@pytest.fixture
def linux(tree, top, monkeypatch):
    return Linux(tree, top, monkeypatch)


def test_batches_equal_the_model(linux, rng):
    before = descriptors()
    with Accelerator(linux.backend(), CONFIG) as accelerator:
        works(accelerator, rng, rng.integers(2, 300, 4))
        assert accelerator.self_test()["interrupt"].startswith("came")
    accelerator.backend.close()
    assert descriptors() == before


def test_the_caches_are_told(linux, tree, rng, monkeypatch):
    """In the right order: cleaned behind the write and before the DMA reads; invalidated before software reads."""
    told, usual = [], UdmaBuffer._sync

    def sync(self, what, size, direction):
        usual(self, what, size, direction)
        told.append((self.name, what, size, direction))

    monkeypatch.setattr(UdmaBuffer, "_sync", sync)
    with Accelerator(linux.backend(), CONFIG) as accelerator:
        told.clear()
        accelerator.run(batch(rng, 100), roi=(8, 4))
    assert told == [("cmfpga-events", "sync_for_device", 800, 1), ("cmfpga-results", "sync_for_cpu", 8 * BEATS, 2)]
    folder = tree / "sys/class/u-dma-buf/cmfpga-results"
    wrote = {"sync_offset": "0", "sync_size": f"{8 * BEATS}", "sync_direction": "2", "sync_for_cpu": "1"}
    assert {name: (folder / name).read_text() for name in wrote} == wrote


def test_stream_larger_than_a_buffer(linux, rng):
    """The DMA ends every transfer with TLAST; batches that end by their number do not mind."""
    model = ModelEngine(CONFIG)
    with Accelerator(linux.backend(), CONFIG) as accelerator:
        assert accelerator.backend.max_words == 0x800
        events = batch(rng, 2500)
        accelerator.start(roi=(8, 4), events=700)
        words = encode(events, "PACKED")
        accelerator.send(words[:900])
        results = list(accelerator.results(1))
        accelerator.send(words[900:])  # in two transfers, while results come
        results += accelerator.results(2)
        accelerator.backend.wait_sent(5)
        results += accelerator.stop()
        assert [result.events for result in results] == [700, 700, 700, 400]
        streamed(model, results, events)
        with pytest.raises(DeviceError, match="a batch of 2500 words: one transfer of UIO has at most 2048"):
            accelerator.run(events)
        works(accelerator, rng)


@pytest.mark.parametrize("sent", [0, 37])
def test_dma_that_stops_in_the_middle_of_a_batch(linux, rng, sent):
    with Accelerator(linux.backend(), CONFIG) as accelerator:
        linux.board.dma.stuck_after = sent
        with within(5), pytest.raises(DeviceTimeout, match=rf"no result within 0\.2 s .*: {sent} words taken") as error:
            accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.2)
        assert str(error.value).endswith("To look at: grep cmfpga /proc/interrupts")
        linux.board.dma.stuck_after = -1
        accelerator.reset()
        works(accelerator, rng)


def test_dma_that_fails(linux, rng):
    with Accelerator(linux.backend(), CONFIG) as accelerator:
        linux.board.dma.dead = True
        with within(5), pytest.raises(DeviceTimeout, match="the DMA's reset did not end within 1 s"):
            accelerator.reset()
        linux.board.dma.dead = False
        accelerator.reset()
        accelerator.backend._receiving.begin(BUFFERS["cmfpga-results"][0], 64)  # less than a packet
        with within(5), pytest.raises(DeviceError, match=r"from the stream: internal error.*longer than the buffer"):
            accelerator.run(batch(rng, 100), roi=(8, 4))
        works(accelerator, rng)
        with pytest.raises(KeyError):  # of the model: no memory there
            accelerator.backend._sending.begin(0x1234, 64)


def test_dma_that_was_reset_by_somebody(linux, rng, monkeypatch):
    with Accelerator(linux.backend(), CONFIG) as accelerator:
        usual = accelerator.backend._receiving.begin

        def begin(address, length):
            usual(address, length)
            linux.board.dma._reset()

        monkeypatch.setattr(accelerator.backend._receiving, "begin", begin)
        with within(5), pytest.raises(DeviceError, match="stopped in the middle of a transfer"):
            accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.5)
        monkeypatch.undo()


def test_registers_are_words_of_a_mapping(tree):
    device = UioDevice("cmfpga", root=tree)
    assert device.size == 0x10000 and isinstance(device._words, Mapping)
    device.write32(0xFFC, 0x89ABCDEF)
    device.write32(0x10, -1)
    assert device.read32(0xFFC) == 0x89ABCDEF and device.read32(0x10) == 0xFFFFFFFF
    content = (tree / "dev/uio3").read_bytes()
    assert content[0xFFC:0x1000] == bytes.fromhex("efcdab89") and content[0x10:0x14] == b"\xff" * 4
    assert content.count(0) == len(content) - 8
    for offset in (2, 0xFFD, -4, 0x10000):
        with pytest.raises(ValueError, match="multiples of 4 below 0x10000"):
            device.read32(offset)
        with pytest.raises(ValueError, match="multiples of 4 below 0x10000"):
            device.write32(offset, 0)
    device.close()
    device.close()


def test_interrupt_of_a_device(tree, monkeypatch):
    """Unmasked by writing 1, in the processor's order of bytes; the count is read away."""
    mine, kernel = socket.socketpair()
    file = os.dup(mine.fileno())
    monkeypatch.setattr(uio, "_open", lambda path, question: file)
    monkeypatch.setattr(uio, "Mapping", lambda *_: mmap.mmap(-1, 4096))
    device = UioDevice("cmfpga", root=tree)
    with within(2):
        assert not device.wait_interrupt(0.05) and not device.wait_interrupt(0)
    assert kernel.recv(100) == b"\x01\0\0\0" * 2
    kernel.sendall(b"\x05\0\0\0")
    assert device.wait_interrupt(1) and not device.wait_interrupt(0)
    device.close(), mine.close(), kernel.close()


def test_buffers(tree):
    buffer = UdmaBuffer("cmfpga-events", root=tree)
    assert (buffer.address, buffer.size) == BUFFERS["cmfpga-events"]
    words = np.array([1, 2**63, 0x0102030405060708], np.uint64)
    buffer.write(words)
    assert (tree / "dev/cmfpga-events").read_bytes()[:24] == words.tobytes()
    assert buffer.read(3).tolist() == words.tolist() and buffer.read(0).size == 0
    folder = tree / "sys/class/u-dma-buf/cmfpga-events"
    assert (folder / "sync_for_device").read_text() == "1"
    (folder / "sync_for_device").unlink()
    buffer.close()
    (folder / "dma_coherent").write_text("1")
    coherent = UdmaBuffer("cmfpga-events", root=tree)
    coherent.write(words)
    assert not (folder / "sync_for_device").exists()
    buffer.close(), coherent.close()


def refused(tree, message):
    with pytest.raises(DeviceError, match=message) as error:
        UioBackend(root=tree)
    assert "\n" not in str(error.value)


def test_odd_entries_and_other_owners(tree):
    size, buffer = tree / "sys/class/uio/uio3/maps/map0/size", tree / "sys/class/u-dma-buf/cmfpga-results"
    for path in (size, buffer / "size", buffer / "phys_addr"):
        usual = path.read_text()
        for text in ("", "many", "-8", "0x3", "0xfffffffffffffffffff", "\N{LATIN SMALL LETTER E WITH ACUTE}"):
            path.write_text(text, encoding="latin-1")
            refused(tree, f"^{path}: ")
        path.write_text(usual)
    for path, device in ((size, "uio3"), (buffer / "size", "cmfpga-results")):
        usual = path.read_text()
        path.write_text("0x20000")
        refused(tree, f"dev/{device}: cannot be mapped: ")
        path.write_text(usual)
    (tree / "sys/class/uio/uio4/name").write_bytes(b"\xff")
    refused(tree, "no UIO device called cmfpga-dma")
    (tree / "sys/class/uio/uio4/name").write_text("cmfpga-dma")
    before = descriptors()
    for make, name, file in ((UioDevice, "cmfpga", "uio3"), (UdmaBuffer, "cmfpga-events", "cmfpga-events")):
        device = make(name, root=tree)
        refused(tree, f"dev/{file}: in use; close the program that has opened it$")
        device.close()
        assert descriptors() == before
    UioBackend(root=tree).close()


def test_what_is_missing_is_named(tree):
    before = descriptors()
    clock = tree / "sys/kernel/debug/clk/pl0_ref/clk_enable_count"
    clock.write_text("0\n")
    refused(tree, "clock pl0_ref is off, and an access to a register would hang the processor")
    clock.unlink()  # not root: nobody knows
    (tree / "dev/cmfpga-results").unlink()
    refused(tree, "dev/cmfpga-results: No such file or directory; is the module u-dma-buf loaded")
    (tree / "sys/class/u-dma-buf/cmfpga-events/phys_addr").unlink()
    refused(tree, "cmfpga-events/phys_addr: No such file or directory; is its module loaded")
    (tree / "sys/class/uio/uio4/name").write_text("other\n")
    refused(tree, r"no UIO device called cmfpga-dma \(cmfpga, other found\); is the overlay loaded")
    (tree / "dev/uio3").unlink()
    refused(tree, r"dev/uio3: No such file or directory; are you root")
    (tree / "dev/uio3").symlink_to("/dev/null")
    refused(tree, "dev/uio3: cannot be mapped")
    assert descriptors() == before
