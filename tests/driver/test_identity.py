"""Which hardware it is, and the self-test, on the emitted AXI top in Verilator."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.driver import Accelerator, DeviceError, WrongHardware
from cmfpga.errors import ConfigError
from support.driving import CONFIG, REGISTERS, batch, works


@pytest.mark.parametrize("register, fields, message", [
    ("ID", {"MAGIC": 0xFFFFFFFF}, r"ID reads 0xffffffff, not 0x434d4158; is the bitstream loaded"),
    ("ID", {"MAGIC": 0}, r"ID reads 0x00000000"),
    ("VERSION", {"MAJOR": 9, "MINOR": 8, "PATCH": 7}, r"made by cmfpga 9\.8\.7, this .*install cmfpga 9\.8\.7"),
    ("VERSION", {"PATCH": 9999}, r"made by cmfpga \d+\.\d+\.9999"),
    ("CAPS", {"MAP": 77}, r"version 77 of the register map, this driver 3"),
    ("BUILD", {"HASH": 0xDEADBEEF}, rf"configuration deadbeef, not {CONFIG.hardware_hash[:8]}"),
])  # fmt: skip
def test_wrong_hardware_is_refused_by_name(backend, register, fields, message):
    backend.override(register, **fields)
    with pytest.raises(WrongHardware, match=message) as error:
        Accelerator(backend)
    assert "\n" not in str(error.value)
    assert backend.top.read32(REGISTERS["COUNT_BATCHES"].offset) == 0


def test_configuration_is_found_among_the_presets(backend):
    for name in ("fast", "paper"):
        config = preset(name)
        backend.config = None
        backend.override("BUILD", HASH=int(config.hardware_hash[:8], 16))
        assert Accelerator(backend).config == config
        with pytest.raises(WrongHardware, match=rf"{config.hardware_hash[:8]} \(preset {name}\), not"):
            Accelerator(backend, CONFIG)
    backend.overrides.clear()
    with pytest.raises(WrongHardware, match="none of the presets paper, fast"):
        Accelerator(backend)
    other = CONFIG.replace(cold="0:1:1", start="zero")  # run-time fields are the user's
    assert Accelerator(backend, other).config == other
    with pytest.raises(ValueError, match="format 'EVT9'"):
        Accelerator(backend, CONFIG, form="EVT9")
    backend.has_interrupt = False
    with pytest.raises(DeviceError, match="there is no interrupt to wait for"):
        Accelerator(backend, CONFIG, interrupt=True)


@pytest.mark.parametrize("timeout", [float("nan"), float("inf"), -0.1])
def test_time_outs_that_never_end_are_refused(accelerator, backend, rng, timeout):
    events = batch(rng, 10)
    for wrong in (
        lambda: Accelerator(backend, timeout=timeout),
        lambda: accelerator.run(events, timeout=timeout),
        lambda: accelerator.send(np.zeros(1, np.uint64), timeout=timeout),
        lambda: next(accelerator.results(1, timeout=timeout)),
        lambda: accelerator.stop(timeout=timeout),
        lambda: accelerator.self_test(timeout=timeout),
    ):
        with pytest.raises(ConfigError, match=r"time-out .* s: 0 to 86400 s is allowed"):
            wrong()


def test_self_test(accelerator, rng):
    found = accelerator.self_test()
    assert list(found) == ["identity", "scratch", "interrupt", "golden batch", "counters"]
    assert found["interrupt"].startswith("came") and found["golden batch"].endswith("as the integer model")
    works(accelerator, rng)


def test_self_test_notices(accelerator, backend, monkeypatch):
    backend.override("SCRATCH", VALUE=0)
    with pytest.raises(DeviceError, match="SCRATCH reads 0x00000000 after 0xffffffff"):
        accelerator.self_test()
    backend.overrides.clear()
    backend.override("BUILD", HASH=1)
    with pytest.raises(WrongHardware, match="configuration 00000001"):
        accelerator.self_test()
    backend.overrides.clear()
    monkeypatch.setattr(backend, "wait_interrupt", lambda timeout: True)
    with pytest.raises(DeviceError, match="is the line stuck"):
        accelerator.self_test()
    monkeypatch.undo()
    usual, beat = (
        backend.receive,
        (REGISTERS["RESULT_CURVATURE_CROSS_LOW"].offset - REGISTERS["RESULT_BATCH"].offset) // 8,
    )

    def wrong(timeout):
        words = usual(timeout)
        words[beat] ^= np.uint64(1)
        return words

    monkeypatch.setattr(backend, "receive", wrong)
    with pytest.raises(DeviceError, match=r"golden batch's curvature is .*; the integer model says"):
        accelerator.self_test()
    monkeypatch.undo()
    assert accelerator.self_test()["counters"] == "1200 events in, 1 result"
