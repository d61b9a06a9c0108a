"""A batch for programs that are not ours: register writes, event words, and the registers of the result."""

import json

from ..protocol.registers import register_map
from ..protocol.results import fields_of
from ..protocol.shapes import leaves
from ..protocol.words import encode
from .control import Control
from .golden import expected_result, golden_batch, golden_regions, settings_of

#: Of the event words.
FORM = "EVT21"


class _Recorder:
    """A back end that keeps what is written."""

    name = "bench"

    def __init__(self):
        self.writes = []

    def read32(self, offset):
        return 0

    def write32(self, offset, word):
        self.writes.append((offset, int(word)))


def setting_writes(config):
    """``[(offset, word)]``: the golden batch's settings and tables, which ends with TLAST."""
    recorder = _Recorder()
    control, (_, roi) = Control(recorder, config), golden_batch(config)
    if config.regions:
        control.table.replace(golden_regions(config, roi))
    control.write_settings(settings_of(config, roi), {"duration": 0, "by_tlast": 1})
    return recorder.writes


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
