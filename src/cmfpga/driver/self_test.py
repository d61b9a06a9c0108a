"""What :meth:`cmfpga.driver.Accelerator.self_test` does."""

from ..errors import DeviceError
from .golden import expected_result, golden_batch, golden_regions, settings_of, values_of
from .identity import identify

PATTERNS = (0x00000000, 0xFFFFFFFF, 0xA5A55A5A, 0x12345678)


def self_test(accelerator):
    """``{check: what was found}``; :exc:`DeviceError` at the first that fails."""
    identify(accelerator.backend, accelerator.config)
    found = {"identity": f"as built, configuration {accelerator.config.hardware_hash[:8]}"}
    found["scratch"] = _scratch(accelerator.backend, accelerator.registers)
    accelerator.reset()
    if accelerator.interrupt and accelerator.backend.wait_interrupt(0):
        raise DeviceError(f"{accelerator.backend.name}: the interrupt is there before a batch: is the line stuck?")
    expected, source = expected_result(accelerator.config)
    events, roi = golden_batch(accelerator.config)
    if accelerator.config.regions:
        accelerator.write_regions(golden_regions(accelerator.config, roi))
    results = accelerator.run(events, settings=settings_of(accelerator.config, roi))  # ends with the interrupt
    results = results if accelerator.config.slides else [results]
    result = results[-1]
    found["interrupt"] = _interrupt(accelerator)
    if expected is None:
        found["golden batch"] = f"ran, but was not compared: {source}"
    else:
        expected, came = _flat(expected), _flat(values_of(accelerator.config, result))
        wrong = [name for name, value in expected.items() if came[name] != value]
        if wrong:
            name = wrong[0]
            raise DeviceError(
                f"{accelerator.backend.name}: the golden batch's {name} is {came[name]}; {source} says "
                f"{expected[name]} (different: {', '.join(wrong)})"
            )
        regions = accelerator.config.regions
        cycles = f"{len(result.regions)} regions" if regions else f"{result.cycles} cycles"
        found["golden batch"] = f"{result.events} events, {cycles}, all {len(expected)} values as {source}"
    count = accelerator.counters()
    if count["events_in"] != len(events) or count["batches"] != len(results):
        raise DeviceError(
            f"{accelerator.backend.name}: {count['events_in']} events and {count['batches']} batches are counted after "
            f"one batch of {len(events)}"
        )
    found["counters"] = f"{count['events_in']} events in, {count['batches']} result"
    accelerator.reset()
    return found


def _flat(values):
    """The values of each region beside those of the batch: ``regions[1].v``."""
    regions = enumerate(values.get("regions", ()))
    more = {f"regions[{k}].{name}": value for k, region in regions for name, value in region.items()}
    return {name: value for name, value in values.items() if name != "regions"} | more


def _scratch(backend, registers):
    offset = registers["SCRATCH"].offset
    for pattern in PATTERNS:
        backend.write32(offset, pattern)
        value = backend.read32(offset)
        if value != pattern:
            raise DeviceError(f"{backend.name}: SCRATCH reads {value:#010x} after {pattern:#010x} was written")
    return f"{len(PATTERNS)} patterns"


def _interrupt(accelerator):
    """It came, or the batch would have failed; now it must be gone."""
    if not accelerator.interrupt:
        return "not used"
    if accelerator.backend.wait_interrupt(0):
        raise DeviceError(f"{accelerator.backend.name}: the interrupt stays although ISR was cleared")
    return "came, and went when it was cleared"
