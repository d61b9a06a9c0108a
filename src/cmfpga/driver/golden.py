"""One batch whose result is known: for the self-test, and for programs that are not ours.

Where torch is installed the integer model computes the result. A board does without: ``golden.json`` holds it for the
presets. After a change of the presets or of the arithmetic:

    python -m cmfpga.driver.golden
"""

import json
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ..config import PRESETS
from ..config.windows import hop_of
from ..engines import make_engine
from ..errors import DeviceError
from ..events.arrays import Events
from ..protocol.regions import Region
from ..protocol.registers import register_map
from ..protocol.results import fields_of
from ..protocol.settings import BatchSettings, clamp_roi, with_rotation
from ..protocol.shapes import leaves
from ..protocol.words import encode
from .control import Control, identify, wrapped_presets

FILE = "golden.json"

#: Events of the batch, if the hardware counts so far.
EVENTS = 1200
POINTS = 40


def golden_batch(config):
    """Events, and the ROI that they are cropped with: the same numbers with every version of NumPy.

    Points that move by about (3, −2) px per half batch inside the ROI, and half as many events all over the sensor.
    """
    number = min(EVENTS, config.max_batch_events)
    random = _Random(2026)
    roi, _ = clamp_roi(
        config, ((config.geometry.width - config.roi_width) // 2, (config.geometry.height - config.roi_height) // 2)
    )
    start = [(random.below(config.roi_width), random.below(config.roi_height)) for _ in range(POINTS)]
    x, y = [], []
    for k in range(number):
        column, row = start[random.below(POINTS)]
        column, row = roi[0] + column + (6 * k - 3 * number) // number, roi[1] + row - (4 * k - 2 * number) // number
        column, row = column << config.binning, row << config.binning
        if k % 3 == 1:
            column, row = random.below(config.sensor_width), random.below(config.sensor_height)
        x.append(min(max(column, 0), config.sensor_width - 1))
        y.append(min(max(row, 0), config.sensor_height - 1))
    step = max(1, min(20, ((1 << config.span_bits) - 1) // number))
    return Events(1000 + step * np.arange(number), x, y, np.arange(number) % 2), roi


def golden_regions(config, roi):
    """The table of regions for the batch: one as large as the image, at the ROI, and its quarters, which follow it."""
    wide, high = config.roi_width // 2, config.roi_height // 2
    places = [(x, y) for y in (roi[1], roi[1] + high) for x in (roi[0], roi[0] + wide)] if wide and high else []
    quarters = [Region(x=x, y=y, width=wide, height=high, start="parent", moves=True) for x, y in places]
    whole = Region(x=roi[0], y=roi[1], width=config.roi_width, height=config.roi_height, start="last")
    return [whole, *quarters][: config.regions]


class _Random:
    """A linear congruential generator (constants of Knuth's MMIX)."""

    def __init__(self, state):
        self.state = state

    def below(self, limit):
        self.state = (self.state * 6364136223846793005 + 1442695040888963407) % (1 << 64)
        return (self.state >> 33) % limit


def settings_of(config, roi):
    """The golden batch's settings: of the preset, if it is this hardware, else those of ``config``.

    A rotation is seen by a camera of a long focal length, in which it hardly differs from a translation.
    """
    same = (preset for preset in PRESETS.values() if preset.hardware_hash == config.hardware_hash)
    config = next(same, config)
    if config.slides:  # so that windows follow one another
        most = min(EVENTS // 3, config.buffer_events)
        config = config.replace(window_events=most, hop_events=hop_of(most), window_us=0, hop_us=0)
    if with_rotation(config):
        width, height = config.sensor_width, config.sensor_height
        config = config.replace(camera=f"{4 * width},{4 * width},{width // 2},{height // 2},-0.5,0,0,0,0")
    return BatchSettings.from_config(config, roi)


def model_result(config):
    """What the integer model makes of the golden batch, JSON-ready; of its last hop. Needs torch."""
    (events, roi), model = golden_batch(config), make_engine("model", config)
    if config.regions:
        model.write(golden_regions(config, roi))
    *_, result = model.run(events, settings_of(config, roi))
    return values_of(config, result)


def values_of(config, result):
    """All of a result that the model knows, JSON-ready; with a table of regions, a list of each region's under that."""

    def values(of, *scopes):
        found = {f.name: getattr(of, f.name) for f in fields_of(*scopes, config=config) if f.name != "cycles"}
        return {name: list(value) if isinstance(value, tuple) else int(value) for name, value in found.items()}

    if not config.regions:
        return values(result, "batch", "region")
    return values(result, "batch") | {"regions": [values(region, "region") for region in result.regions]}


def expected_result(config):
    """``(values, source)`` of the golden batch, as of :func:`values_of`; ``(None, reason)`` where there are none."""
    try:
        return model_result(config), "the integer model"
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
    kept = json.loads(resources.files(__package__).joinpath(FILE).read_text(encoding="utf-8"))
    for entry in kept.values():
        if entry["hardware"] == config.hardware_hash:
            return entry["result"], FILE
    return None, "torch is not installed, and only the presets' results are kept"


def make():
    """Content of the file, from the integer model: of the presets that a driver can meet."""
    return {
        name: {"hardware": config.hardware_hash, "result": model_result(config)}
        for name, config in wrapped_presets().items()
    }


PATTERNS = (0x00000000, 0xFFFFFFFF, 0xA5A55A5A, 0x12345678)


def self_test(accelerator):
    """``{check: what was found}``; :exc:`DeviceError` at the first that fails."""
    backend, config = accelerator.backend, accelerator.config
    identify(backend, config)
    found = {"identity": f"as built, configuration {config.hardware_hash[:8]}"}
    found["scratch"] = _scratch(backend, accelerator.registers)
    accelerator.reset()
    if accelerator.interrupt and backend.wait_interrupt(0):
        raise DeviceError(f"{backend.name}: the interrupt is there before a batch: is the line stuck?")
    expected, source = expected_result(config)
    events, roi = golden_batch(config)
    if config.regions:
        accelerator.write_regions(golden_regions(config, roi))
    results = accelerator.engine.run(events, settings_of(config, roi))  # ends with the interrupt
    result = results[-1]
    found["interrupt"] = _interrupt(accelerator)
    if expected is None:
        found["golden batch"] = f"ran, but was not compared: {source}"
    else:
        expected, came = _flat(expected), _flat(values_of(config, result))
        if wrong := [name for name, value in expected.items() if came[name] != value]:
            first = f"{wrong[0]} is {came[wrong[0]]}; {source} says {expected[wrong[0]]}"
            raise DeviceError(f"{backend.name}: the golden batch's {first} (different: {', '.join(wrong)})")
        cycles = f"{len(result.regions)} regions" if config.regions else f"{result.cycles} cycles"
        found["golden batch"] = f"{result.events} events, {cycles}, all {len(expected)} values as {source}"
    count = accelerator.counters()
    if count["events_in"] != len(events) or count["batches"] != len(results):
        counted = f"{count['events_in']} events and {count['batches']} batches are counted"
        raise DeviceError(f"{backend.name}: {counted} after one batch of {len(events)}")
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


#: Of the event words.
FORM = "EVT21"


def setting_writes(config):
    """``[(offset, word)]``: the golden batch's settings and tables, which ends with TLAST."""
    writes = []
    recorder = SimpleNamespace(
        name="bench", read32=lambda offset: 0, write32=lambda offset, word: writes.append((offset, int(word)))
    )
    control, (_, roi) = Control(recorder, config), golden_batch(config)
    if config.regions:
        control.table.replace(golden_regions(config, roi))
    control.write_settings(settings_of(config, roi), {"duration": 0, "by_tlast": 1})
    return writes


def result_words(config, values):
    """``{offset: (mask, word)}`` of the result registers that ``values``, of one region, decide."""
    raw = {}
    for field in fields_of("batch", "region", config=config):
        if field.name in values:
            value = values[field.name]
            parts = value if isinstance(value, (tuple, list)) else [value]
            for (leaf, q), part in zip(leaves(field.name, field.shape(config)).items(), parts, strict=True):
                raw[leaf] = q.raw(part) if isinstance(part, float) else int(part)
    words = {}
    for link, places in register_map(config).linked("Result").items():
        for register, f in places if link in raw else ():
            mask, word = words.get(register.offset, (0, 0))
            bits = raw[link] >> f.link_lsb << f.lsb & f.mask
            words[register.offset] = mask | f.mask, word | bits
    return words


def batch_file(config, top):
    """Text of ``….json``, which ``cocotb_bench.py`` plays; ``expected`` is empty where no model is installed."""
    registers = register_map(config)
    values, source = expected_result(config)
    shared = {name: value for name, value in (values or {}).items() if name != "regions"}
    records = [shared | region for region in values.get("regions", [{}])] if values else []
    first = registers.group("Result")[0].offset
    return json.dumps({
        "top": top,
        "source": source,
        "writes": [*setting_writes(config), (registers["CTRL"].offset, registers["CTRL"].pack(START=1))],
        "words": [f"{word:#018x}" for word in encode(golden_batch(config)[0], FORM).tolist()],
        "beats": registers["RESULT_SIZE"].reset,
        "expected": [
            {(offset - first) // 4: pair for offset, pair in result_words(config, record).items()} for record in records
        ],
    }, indent=1) + "\n"  # fmt: skip


if __name__ == "__main__":
    path = Path(__file__).with_name(FILE)
    lines = [f"{json.dumps(name)}: {json.dumps(entry)}" for name, entry in make().items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    print(f"wrote {path}")
