"""The PYNQ back end: PyPI's pynq binds our class to a hand-made overlay, over the simulated board."""

import dataclasses
import warnings
import weakref
from types import SimpleNamespace

import numpy as np
import pytest

from cmfpga.boards import DEFAULT
from cmfpga.driver import Accelerator, DeviceError, DeviceTimeout
from support.board import Board, Interrupts
from support.driving import BEATS, CONFIG, REGISTERS, batch, within, works
from support.overlay import write_hwh

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of the processor, which PYNQ does not support, and of its dependencies
    pynq = pytest.importorskip("pynq", reason="pynq is missing: pip install --no-deps -r tests/driver/pynq.txt")
    from pynq import overlay as pynq_overlay
    from pynq.lib.dma import DMA
    from pynqmetadata.frontends import Metadata
    from pynqmetadata.views.runtime import RuntimeMetadataParser

    from cmfpga.driver.pynq import CmfpgaIP, PynqBackend


class Memory(np.ndarray):
    """A buffer of the simulated device, as :class:`pynq.buffer.PynqBuffer` behaves; it keeps what was told."""

    def __array_finalize__(self, made_from):
        if made_from is not None:
            self.told = getattr(made_from, "told", None)

    def flush(self):
        self.told.append(("flush", self.nbytes))

    def invalidate(self):
        self.told.append(("invalidate", self.nbytes))

    def freebuffer(self):
        self.told.append(("free", self.nbytes))


class Device:
    """What PYNQ needs of a device: registers by address, and memory."""

    def __init__(self, board, capability="MEMORY_MAPPED"):
        self.board, self.told, self.capability = board, [], capability
        self.next_address = 0x8_0000_0000

    def has_capability(self, capability):
        return capability == self.capability

    def read_registers(self, address, length):
        assert length == 4
        return self.board.read(address).to_bytes(4, "little")

    def write_registers(self, address, data):
        assert len(data) == 4
        self.board.write(address, int.from_bytes(data, "little"))

    def mmap(self, base, length):
        assert length == 0x10000
        return self.board.words(base)

    def allocate(self, shape, dtype, **_):
        made = np.zeros(shape, dtype).view(Memory)
        made.told, made.device_address = self.told, self.next_address
        self.board.memory.add(self.next_address, made)
        self.next_address += (made.nbytes + 0xFFF) & ~0xFFF
        return made


class Overlay:
    """An overlay of PYNQ's, as far as it is when the bitstream is there: its IPs by their names."""

    def __init__(self, top, folder, *, vlnv=DEFAULT.vlnv, overrides=(), **options):
        self.board = Board(top, overrides=overrides)
        self.device = Device(self.board, **options)
        declared = [register for register in REGISTERS if register.count == 1]
        path = folder / "cmfpga.hwh"
        write_hwh(path, vlnv=vlnv, registers_address=Board.REGISTERS, dma_address=Board.DMA, registers=declared)
        parser = RuntimeMetadataParser(Metadata(input=str(path)))
        self.description = pynq_overlay._complete_description(
            parser.ip_dict, parser.hierarchy_dict, False, {}, self.device, None
        )
        self._ips = pynq_overlay._IPMap(self.description)

    def __getattr__(self, name):
        return getattr(self._ips, name)


@pytest.fixture
def overlay(top, tmp_path):
    return Overlay(top, tmp_path)


def small(overlay):
    board = dataclasses.replace(DEFAULT, buffer_events_size=0x4000, buffer_results_size=0x1000)
    return PynqBackend(overlay.cmfpga, overlay.dma, board=board)


class Controller:
    """As :class:`pynq.uio.UioController`, of which PYNQ's interrupts hold a weak reference."""

    def __init__(self, uio):
        self.uio = uio


def with_interrupt(overlay, **options):
    """The UIO device that PYNQ waits on, in place of the one that needs its whole board."""
    interrupts = Interrupts(overlay.board, **options)
    controller = Controller(open(interrupts.file, "r+b", buffering=0))
    overlay.cmfpga.irq = SimpleNamespace(parent=weakref.ref(controller))
    return controller


@pytest.mark.parametrize("vlnv", [DEFAULT.vlnv, DEFAULT.module_vlnv])
def test_pynq_binds_the_class(top, tmp_path, vlnv):
    overlay = Overlay(top, tmp_path, vlnv=vlnv)
    assert overlay.description["ip"]["cmfpga"]["driver"] is CmfpgaIP
    assert type(overlay.cmfpga) is CmfpgaIP and type(overlay.dma) is DMA
    assert overlay.cmfpga.mmio.base_addr == Board.REGISTERS and isinstance(overlay.cmfpga.mmio, pynq.MMIO)


def test_another_version_of_the_ip_is_not_bound(top, tmp_path):
    with pytest.warns(UserWarning, match="cmfpga.org:ip:cmfpga:7.0 and driver found for"):
        overlay = Overlay(top, tmp_path, vlnv="cmfpga.org:ip:cmfpga:7.0")
    assert type(overlay.cmfpga) is pynq.DefaultIP


def test_registers_by_name(top, tmp_path):
    """PYNQ's own way to them works too, with what the hand-off says of them."""
    overlay = Overlay(top, tmp_path, capability="REGISTER_RW")  # it wants a real buffer, or this
    registers = overlay.cmfpga.register_map
    assert registers.ID.MAGIC == 0x434D4158 and registers.CTRL.IDLE == 1
    registers.SCRATCH.VALUE = 0x12345678
    assert overlay.cmfpga.read(0xFFC) == 0x12345678


@pytest.mark.parametrize("interrupt", [False, True])
def test_batches_equal_the_model(overlay, rng, interrupt):
    controller = with_interrupt(overlay) if interrupt else None
    accelerator = overlay.cmfpga.accelerator(overlay.dma, CONFIG)
    assert accelerator.interrupt == interrupt and accelerator.backend.max_words == 0x200000
    works(accelerator, rng, rng.integers(2, 300, 3))
    assert ("came" in accelerator.self_test()["interrupt"]) == interrupt
    accelerator.close()
    accelerator.close()
    if controller:
        controller.uio.close()


def test_the_caches_are_told(overlay, rng):
    with Accelerator(small(overlay), CONFIG) as accelerator:
        overlay.device.told.clear()
        accelerator.run(batch(rng, 100), roi=(8, 4))
    assert overlay.device.told == [("flush", 800), ("invalidate", 8 * BEATS), ("free", 0x4000), ("free", 0x1000)]


def test_hardware_of_another_version_is_refused(top, tmp_path, capsys):
    """PYNQ says which, and gives the IP its default class."""
    overlay = Overlay(top, tmp_path, overrides={REGISTERS["VERSION"].offset: 0x09080007})
    with pytest.warns(UserWarning, match=r"not supported: .*made by cmfpga 9\.8\.7, this driver is"):
        ip = overlay.cmfpga
    assert type(ip) is pynq.DefaultIP


def test_what_goes_wrong(overlay, rng):
    controller = with_interrupt(overlay, broken=True)
    with Accelerator(small(overlay), CONFIG) as accelerator:
        overlay.board.dma.stuck_after = 40
        with within(5), pytest.raises(DeviceTimeout, match=r"^PYNQ: no result within 0\.2 s .*: 40 words taken"):
            accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.2)
        overlay.board.dma.stuck_after = -1
        with within(5), pytest.raises(DeviceTimeout, match="the result came, but no interrupt"):
            accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.2)
        accelerator.interrupt = False
        with pytest.raises(DeviceError, match="one transfer of PYNQ has at most 2048"):
            accelerator.run(batch(rng, 2049), roi=(8, 4))
        works(accelerator, rng)
    controller.uio.close()
