"""One batch whose result is known, for the self-test.

Where torch is installed the integer model computes the result. A board does without: ``golden.json`` holds it for the
presets. After a change of the presets or of the arithmetic:

    python -m cmfpga.driver.golden
"""

import json
from importlib import resources
from pathlib import Path

import numpy as np

from ..config import PRESETS
from ..config.windows import hop_of
from ..engines import make_engine
from ..events.arrays import Events
from ..protocol.regions import Region
from ..protocol.results import fields_of
from ..protocol.settings import BatchSettings, clamp_roi, with_rotation
from .identity import wrapped_presets

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
        config, ((config.sensor_width - config.roi_width) // 2, (config.sensor_height - config.roi_height) // 2)
    )
    start = [(random.below(config.roi_width), random.below(config.roi_height)) for _ in range(POINTS)]
    x, y = [], []
    for k in range(number):
        column, row = start[random.below(POINTS)]
        column, row = roi[0] + column + (6 * k - 3 * number) // number, roi[1] + row - (4 * k - 2 * number) // number
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
    found = _kept(config)
    return found, FILE if found else "torch is not installed, and only the presets' results are kept"


def _kept(config):
    """The kept result of this hardware, or None."""
    kept = json.loads(resources.files(__package__).joinpath(FILE).read_text(encoding="utf-8"))
    return next((entry["result"] for entry in kept.values() if entry["hardware"] == config.hardware_hash), None)


def make():
    """Content of the file, from the integer model: of the presets that a driver can meet."""
    return {
        name: {"hardware": config.hardware_hash, "result": model_result(config)}
        for name, config in wrapped_presets().items()
    }


if __name__ == "__main__":
    path = Path(__file__).with_name(FILE)
    lines = [f"{json.dumps(name)}: {json.dumps(entry)}" for name, entry in make().items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    print(f"wrote {path}")
