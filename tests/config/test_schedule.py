"""Schedules as text."""

import re

import pytest

from cmfpga.config import preset
from cmfpga.config.schedule import MEASURED, Round, parse_schedule
from cmfpga.errors import ConfigError
from cmfpga.fixed import Q

FORM = "LEVEL:H:LIMIT*COUNT is needed, *COUNT if not 1; H and LIMIT such as 1 or 3/4"
NEEDED = "LEVEL:LOG2STEP/STRIDE*COUNT is needed, /STRIDE and *COUNT if not 1"
ROUNDS = {"name": "cold", "max_level": 2, "v": Q(5, 6), "entries": 16}
LIMITS = ROUNDS | {"motion": "similarity"}


def test_entries_and_counts():
    assert parse_schedule("2:1/4*2 2:1*1 1:0/2  0:-6", **LIMITS) == (
        (2, 1, 4), (2, 1, 4), (2, 1, 1), (1, 0, 2), (0, -6, 1),
    )  # fmt: skip
    assert len(parse_schedule("0:4*16", **LIMITS)) == 16


@pytest.mark.parametrize("limits, text, message", [
    *((limits, "", "cold: 0 iterations: 1 to 16 are needed (schedule_entries)") for limits in (ROUNDS, LIMITS)),
    *((LIMITS, *case) for case in (
        ("3:0", "cold: '3:0': level 0 to 2 is needed (max_level)"),
        ("0:5", "cold: '0:5': a log2 step of -6 to 4 is needed (Q5.6)"),
        ("0:-7", "cold: '0:-7': a log2 step of -6 to 4 is needed (Q5.6)"),
        ("0:0/3", "cold: '0:0/3': a stride of 1, 2, 4 is needed"),
        ("0:0*0", "cold: '0:0*0': a count of 1 to 16 is needed (schedule_entries)"),
        ("0:0*9 0:0*9", "cold: 18 iterations: 1 to 16 are needed (schedule_entries)"),
        ("0:0*999999999", "cold: '0:0*999999999': a count of 1 to 16 is needed (schedule_entries)"),
        ("0:0*" + "9" * 5000, f"cold: '0:0*{'9' * 5000}': {NEEDED}"),
        ("0,0", f"cold: '0,0': {NEEDED}"),
        ("0:0 x", f"cold: 'x': {NEEDED}"),
        ("-1:0", f"cold: '-1:0': {NEEDED}"),
    )),
    *((ROUNDS, *case) for case in (
        ("3:1:1", "cold: '3:1:1': level 0 to 2 is needed (max_level)"),
        ("0:1/2:1", "cold: '0:1/2:1': a distance of 3/4, 1, 3/2, 2, 3 is needed"),
        ("0:0:1", "cold: '0:0:1': a distance of 3/4, 1, 3/2, 2, 3 is needed"),
        *((f"0:1:{limit}", f"cold: '0:1:{limit}': a limit of 2^k or 3·2^k is needed, 1/64 to 16 (Q5.6)")
          for limit in ("0", "5/4", "1/3", "1/128", "3/128", "24", "32", "7")),
        ("0:1:1*0", "cold: '0:1:1*0': a count of 1 to 16 is needed (schedule_entries)"),
        ("0:1:1*9 0:1:1*9", "cold: 18 iterations: 1 to 16 are needed (schedule_entries)"),
        *((text, f"cold: '{text}': {FORM}")
          for text in ("0:1", "1:-1", "0:1:1/0", "0:0.75:1", "0:1:-1", "0:1:1/4*", "0:1:1:1")),
    )),
])  # fmt: skip
def test_refusals(limits, text, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        parse_schedule(text, **limits)


def test_auto_is_what_was_measured_as_far_as_the_hardware_goes():
    best = preset("similarity")
    assert (best.cold, best.warm) == ("auto", "auto")
    assert best.schedules.warm == parse_schedule(MEASURED["similarity"]["warm"], **LIMITS)
    flat = best.replace(max_level=0)
    assert flat.schedules.cold == tuple((0, step, stride) for _, step, stride in best.schedules.cold)
    narrow = best.replace(max_level=1, v_int=1, v_frac=2)
    assert narrow.schedules.cold == tuple(
        (min(level, 1), max(-2, min(step, 0)), stride) for level, step, stride in best.schedules.cold
    )


def test_the_fast_preset_has_five_cold_and_three_warm_rounds():
    config = preset("fast")
    assert (len(config.schedules.cold), len(config.schedules.warm)) == (5, 3)
    with pytest.raises(ConfigError, match=r"^warm: "):
        config.replace(warm="0:9")


def test_rounds():
    found = parse_schedule("2:3:4 1:3/2:3/2*2  0:3/4:1/16 0:1:3/64 0:6/3:16", **ROUNDS)
    assert found == (
        (2, 12, 4.0), (1, 6, 1.5), (1, 6, 1.5), (0, 3, 0.0625), (0, 4, 3 / 64), (0, 8, 16.0),
    )  # fmt: skip
    assert all(type(entry) is Round and entry.stride == 1 for entry in found)


def test_a_limit_has_a_code_that_gives_its_raw_value_back():
    codes = set()
    for fmt in (Q(5, 6), Q(1, 2), Q(3, 16)):
        for power in range(-fmt.f, fmt.i):
            for limit in (2.0**power, 1.5 * 2.0**power):
                raw = limit * (1 << fmt.f)
                if raw == int(raw) and limit <= 1 << fmt.i - 1:
                    code = Round(0, 3, limit).code(fmt)
                    assert ((2 + code % 2) << code // 2) >> 1 == raw
                    assert code <= 2 * (fmt.width - 2)
                    codes.add(code)
    assert codes == {0, *range(2, 37)}


def test_auto_of_rounds_goes_as_far_as_the_hardware():
    best = preset("fast")
    assert best.schedules.warm == parse_schedule(MEASURED["translation"]["warm"], **ROUNDS)
    narrow = best.replace(max_level=1, v_int=1, v_frac=2, dither_frac=4, dt_frac=8)
    assert narrow.schedules.cold == tuple(
        (min(level, 1), distance, max(0.25, min(limit, 1.0))) for level, distance, limit in best.schedules.cold
    )
