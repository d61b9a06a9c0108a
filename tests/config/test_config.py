"""The configuration: what it refuses and how it says so, and what shapes the hardware."""

import dataclasses
import json
import re

import numpy as np
import pytest

from cmfpga.config import ASCENTS, GRADIENTS, PRESETS, RAM_STYLES, START_MODES, Config, preset, unread
from cmfpga.errors import ConfigError, UserError

FIELDS = {field.name: field for field in dataclasses.fields(Config)}
BOUNDED = [name for name, field in FIELDS.items() if field.type is int and not field.metadata["choices"]]
REAL = [name for name, field in FIELDS.items() if field.type is float and name != "confidence_limit"]
TEXT = {name for name, field in FIELDS.items() if field.type is str}
RUNTIME = {
    "min_roi_events", "thinning", "thin_target", "iterations", "eta", "start", "v_start_x", "v_start_y", "roi_gain",
    "cold", "warm", "judge", "confidence_limit", "cold_after_doubtful", "hot_mask", "background_us", "camera",
    *("window_events", "window_us", "hop_events", "hop_us", "follow", "after"),
}  # fmt: skip

# Everything as small as it may be: here each field can be set to its own lowest value without breaking another's rule.
LEAST = {
    "sensor_width": 4, "sensor_height": 4, "roi_width": 2, "roi_height": 2, "buffer_events": 1, "max_batch_events": 1,
    "time_bits": 8, "span_bits": 4, "iterations": 1, "max_iterations": 1, "eta": 0.0, "roi_gain": 0.0, "dt_frac": 2,
    "v_int": 1, "v_frac": 1, "position_frac": 1, "weight_frac": 1, "derivative_frac": 1, "reciprocal_bits": 4,
    "gradient_int": 1, "gradient_frac": 4, "eta_int": 0, "eta_frac": 1, "roi_gain_int": 1, "roi_gain_frac": 0,
}  # fmt: skip
# What a field's largest value needs of others.
ROOM = {
    "sensor_width": {}, "roi_width": {"sensor_width": 4096}, "roi_height": {"sensor_height": 4096},
    "span_bits": {"time_bits": 48}, "dither_frac": {"dt_frac": 12}, "undistortion_frac": {"dt_frac": 12},
    "iterations": {"max_iterations": 65535},
    "min_roi_events": {"buffer_events": 1 << 17}, "thin_target": {"buffer_events": 1 << 17},
    **{name: {"window_events": 1 << 17, "buffer_events": 1 << 17} for name in ("window_events", "hop_events")},
    **{name: {"time_bits": 48, "span_bits": 32} for name in ("window_us", "hop_us")},
    "background_us": {"time_bits": 48, "span_bits": 32}, "slices": {"max_batch_events": 16},
    "binning": {"sensor_width": 16, "sensor_height": 16},
}  # fmt: skip
# What reads a field that the defaults do not.
ROUNDS = {"gradient": "one_pass", "ascent": "newton", "border": "whole", "v_frac": 2, "max_iterations": 20}
SURE = ROUNDS | {"confidence": 1}
MANY = ROUNDS | {"buffers": 2}
WINDOWS = ROUNDS | {"windows": "sliding", "hop_us": 0}
SIGNS = {"gradient": "one_pass", "ascent": "sign", "border": "whole", "motion": "similarity", "schedule_entries": 64}
READER = {
    "tag_bits": {"gradient": "one_pass"}, "schedule_entries": {**ROUNDS, "cold": "0:1:1", "warm": "0:1:1"},
    **dict.fromkeys(("judge", "confidence_limit", "cold_after_doubtful"), SURE), "confidence": ROUNDS,
    **{name: {"undistortion": "on", "undistortion_frac": 1} for name in ("undistortion_cell", "camera")},
    "undistortion_frac": {"undistortion": "on"},
    **dict.fromkeys(("window_events", "window_us", "hop_events", "hop_us"), WINDOWS),
    "regions": MANY, **{name: {**MANY, "regions": 2} for name in ("units", "slices", "bin_bits")},
    "hot_mask": {"hot_pixels": 1}, "background_cell": {"background": 1}, "background_us": {"background": 1},
}  # fmt: skip


def refusal(**changes):
    with pytest.raises(ConfigError) as caught:
        Config(**changes)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_defaults_are_the_presets_and_no_limit_is_missing():
    assert PRESETS["paper"] == Config() == preset("paper")
    assert all(FIELDS[name].metadata["low"] is not None and FIELDS[name].metadata["high"] for name in BOUNDED)
    assert set(BOUNDED) | set(REAL) | TEXT | {"confidence_limit", "evaluators"} == set(FIELDS)
    for field in FIELDS.values():
        assert len(field.metadata["doc"]) > 5


@pytest.mark.parametrize("name", BOUNDED)
def test_each_integer_at_and_beyond_its_limits(name):
    low, high = FIELDS[name].metadata["low"], FIELDS[name].metadata["high"]
    for value, others in ((low, LEAST), (high, {**LEAST, **ROOM.get(name, {})})):
        fields = Config().to_dict() | others | READER.get(name, {}) | {name: value}
        idle = unread(fields)
        assert getattr(Config(**{key: fields[key] for key in fields if key not in idle}), name) == value
    for value in (low - 1, high + 1, -(10**30), 10**30):
        assert refusal(**{name: value}) == f"{name} = {value}: {low} to {high} is needed"


@pytest.mark.parametrize("name", BOUNDED)
@pytest.mark.parametrize("value", [2.0, "2", True, None, float("nan"), [2]], ids=repr)
def test_integers_are_integers(name, value):
    assert refusal(**{name: value}) == f"{name} = {value!r}: an integer is needed"


@pytest.mark.parametrize("name", REAL)
@pytest.mark.parametrize("value", ["1", False, None, 1j], ids=repr)
def test_numbers_are_numbers(name, value):
    assert refusal(**{name: value}) == f"{name} = {value!r}: a number is needed"


def test_numbers_of_numpy_are_taken():
    config = Config(roi_width=np.int64(32), eta=np.float32(0.5), v_start_x=np.uint8(2))
    assert config == Config(roi_width=32, eta=0.5, v_start_x=2.0) and json.loads(json.dumps(config.to_dict()))
    assert type(Config(**ROUNDS, evaluators=np.int64(4)).evaluators) is int
    assert refusal(roi_width=np.int64(1)) == "roi_width = np.int64(1): 2 to 4096 is needed"


@pytest.mark.parametrize("name", REAL)
def test_each_number_fits_its_format(name):
    config = Config()
    fmt = {"eta": config.formats.eta, "roi_gain": config.formats.roi_gain}.get(name, config.formats.v)
    largest = fmt.real(fmt.max)
    for value in (fmt.real(fmt.min), 0, -0.0, largest, fmt.step, int(largest)):
        assert getattr(Config(**{name: value}), name) == value
    low = f"{fmt.real(fmt.min):g}"
    for value in (largest + fmt.step / 4, 10**30, float("inf"), 10**400):
        assert refusal(**{name: value}) == f"{name} = {value!r}: {low} to {largest:g} is needed ({fmt})"
    for value in (float("-inf"), float("nan"), fmt.real(fmt.min) - fmt.step):
        assert refusal(**{name: value}).startswith(f"{name} = {value!r}: ")
    assert refusal(**{name: fmt.step / 3}) == (
        f"{name} = {fmt.step / 3!r}: smaller than the step {fmt.step:g} of its format {fmt}"
    )


@pytest.mark.parametrize("name, choices", [
    ("start", START_MODES), ("gradient", GRADIENTS), ("ascent", ASCENTS), ("ram_style", RAM_STYLES),
])  # fmt: skip
def test_choices(name, choices):
    for choice in choices:
        needed = {"newton": ROUNDS, "sign": SIGNS}.get(choice, {})
        assert getattr(Config(**{"max_level": 2, **needed, name: choice}), name) == choice
    for value in ("", "LAST", " sweep", 1, None, ["last"]):
        assert refusal(**{name: value}) == f"{name} = {value!r}: one of {', '.join(choices)} is needed"


@pytest.mark.parametrize("changes, message", [
    ({"roi_width": 242}, "roi_width = 242: at most 240 is allowed (sensor_width)"),
    ({"sensor_height": 62}, "roi_height = 64: at most 62 is allowed (sensor_height)"),
    ({"roi_width": 63}, "roi_width = 63: an even number of pixels is needed by the sweep"),
    ({"roi_height": 3}, "roi_height = 3: an even number of pixels is needed by the sweep"),
    ({"span_bits": 32}, "span_bits = 32: less than time_bits = 32 is needed, "),
    ({"time_bits": 24}, "span_bits = 24: less than time_bits = 24 is needed, "),
    ({"iterations": 1024}, "iterations = 1024: at most 1023 is allowed (max_iterations)"),
    ({"max_iterations": 99}, "iterations = 100: at most 99 is allowed (max_iterations)"),
    ({"min_roi_events": 2049}, "min_roi_events = 2049: at most 2048 is allowed (buffer_events)"),
    ({"thin_target": 2049}, "thin_target = 2049: at most 2048 is allowed (buffer_events)"),
    ({"dither_frac": 8, "dt_frac": 2, "v_frac": 1}, "dither_frac = 8: at most dt_frac + v_frac = 3 is allowed"),
    ({"undistortion": "on", "dt_frac": 2, "v_frac": 1}, "undistortion_frac = 4: at most dt_frac + v_frac = 3 is al"),
    ({"ascent": "sign"}, "ascent = sign: motion = similarity or rotation is needed"),
    ({**ROUNDS, "cold": "2:2:1"}, "cold: '2:2:1': level 0 to 0 is needed (max_level)"),
    ({**ROUNDS, "max_iterations": 4}, "cold: 5 iterations; at most 4 are allowed (max_"),
    ({**ROUNDS, "max_iterations": 2, "cold": "0:1:1"}, "warm: 3 iterations; at most 2 are allowed "),
    ({**WINDOWS, "ascent": "constant"}, "windows = sliding: ascent = newton is needed"),
    ({**WINDOWS, "window_events": 2049}, "window_events = 2049: at most 2048 is allowed (buffer_events)"),
    ({**WINDOWS, "hop_events": 1001}, "hop_events = 1001: at most 1000 is allowed (window_events)"),
    ({**WINDOWS, "window_us": (1 << 23) + 1}, "window_us = 8388609: at most 8388608 is allowed (half of what span_"),
    ({**WINDOWS, "window_us": 5000, "hop_us": 5001}, "hop_us = 5001: at most 5000 is allowed (window_us)"),
    ({**WINDOWS, "after": "0:1:1*2"}, "after: 2 iterations: at most one is allowed"),
    ({**WINDOWS, "cold": "0:1:1*28"}, "cold and warm and follow and after: 28 + 3 + 1 + 1 iterations; at most 32 "),
    ({"window_events": 5}, "window_events = 5: windows = sliding is needed; windows = batches ignores it"),
    ({"gradient": "one_pass", "tag_bits": 5}, "tag_bits = 5: (2^tag_bits − 1) · 20 idle cycles an iteration = 620, "),
    ({**preset("fast").to_dict(), "tag_bits": 6},
     "tag_bits = 6: (2^tag_bits − 1) · 52 idle cycles an iteration = 3276, at least the 4096 words of a bank "),
    ({**ROUNDS, "max_iterations": 30, "cold": "0:1:1*30"}, "cold and warm: 30 + 3 iterations; at most 32 are "),
    ({"buffer_events": 1 << 17}, "G = P·S − ΣI·ΣD needs 64 bits, more than the 63 that the exact integer model"),
    ({"gradient_int": 20, "gradient_frac": 32}, "gradient · gain needs 78 bits, more than the 63 "),
])  # fmt: skip
def test_fields_that_do_not_go_together(changes, message):
    assert refusal(**changes).startswith(message)


@pytest.mark.parametrize("changes, message", [
    *((ROUNDS | changes, f"ascent = newton: {message}") for changes, message in (
        ({"border": "corners"}, "border = whole is needed"),
        ({"gradient": "sweep"}, "gradient = one_pass is needed"),
        ({"motion": "similarity"}, "motion = translation is needed"),
        ({"v_frac": 1}, "v_frac = 1: 2 or more is needed for what lies ¾ px beside v"),
    )),
    (SURE | {"gradient": "sweep"}, "confidence = 1: gradient = one_pass is needed; gradient = sweep ignores it"),
    (SURE | {"ascent": "constant"}, "confidence = 1: ascent = newton is needed; ascent = constant ignores it"),
    ({**SIGNS, "v_frac": 1, "confidence": 1},
     "ascent = sign: v_frac = 1: 2 or more is needed for what lies ¾ px beside v"),
    ({**SIGNS, "cold": "0:1/2", "confidence": 1},
     "confidence = 1: the last iteration of cold has stride 2: it needs all events, as the probes"),
    ({**ROUNDS, "evaluators": 2}, "evaluators = 2: one of 1, 4 is needed"),
    ({"evaluators": 4}, "evaluators = 4: ascent = newton is needed; ascent = constant ignores it"),
    ({"v_start_x": 20.0, "v_int": 4}, "v_start_x = 20.0: -16 to 15.9998 is needed (Q4.12)"),
    ({"eta": 0.01, "eta_frac": 4}, "eta = 0.01: smaller than the step 0.0625 of its format UQ6.4"),
    ({"roi_gain": 2.0, "roi_gain_int": 1}, "roi_gain = 2.0: 0 to 1.9375 is needed (UQ1.4)"),
    ({"background": 1, "span_bits": 10, "background_us": 512},
     "background_us = 512: at most 511 is allowed (span_bits)"),
    ({"background_us": 5}, "background_us = 5: background = 1 is needed; background = 0 ignores it"),
    *(({"confidence_limit": value}, f"confidence_limit = {value!r}: 1.0 to 341.0 is needed")
      for value in (0.9, 341.1, float("nan"), -1)),
    *(({"hot_pixels": 1, "hot_mask": text}, f"hot_mask: {message}") for text, message in (
        ("3", "'3': X,Y of a pixel is needed, pixels separated by ';'"),
        ("3,4,5", "'3,4,5': X,Y of a pixel is needed, pixels separated by ';'"),
        ("-1,4", "'-1,4': X,Y of a pixel is needed, pixels separated by ';'"),
        ("1,2;240,4", "pixel 240,4: 0,0 to 239,179 is needed"),
        ("²,4", "'²,4': X,Y of a pixel is needed, pixels separated by ';'"),
    )),
    ({"units": 3}, "units = 3: regions of 1 or more are needed"),
    ({"store_style": "ultra"}, "store_style = ultra: regions of 1 or more are needed"),
    ({"regions": 2}, "regions = 2: gradient = one_pass is needed"),
    (ROUNDS | {"regions": 2}, "regions = 2: buffers = 2 is needed"),
    ({**MANY, "regions": 2, "thinning": 2}, "regions = 2: thinning: each region has a stride of its own instead"),
    ({**MANY, "regions": 2, "max_batch_events": 300000},
     "max_batch_events = 300000: at most 262144 are allowed, for the store holds them all"),
    (preset("rotation").to_dict() | {"regions": 2},
     "regions = 2: motion = rotation: a region sees too little of the field to tell a turn from a shift; "
     "cmfpga flow --fit rotation finds it from all regions of a translation"),
])  # fmt: skip
def test_refusals_word_by_word(changes, message):
    assert refusal(**changes) == message


@pytest.mark.parametrize("changes", [
    {"roi_width": 240, "roi_height": 180}, {"span_bits": 31}, {"iterations": 1023}, {"min_roi_events": 2048},
    {"thin_target": 2048}, {"sensor_width": 64, "sensor_height": 64}, {"gradient": "one_pass", "tag_bits": 6},
    {**ROUNDS, "max_iterations": 5}, SURE, {**SIGNS, "v_frac": 1}, {"v_start_x": 20.0},
    {**ROUNDS, "evaluators": 1}, {"background": 1, "span_bits": 10, "background_us": 511},
], ids=str)  # fmt: skip
def test_the_last_combination_that_is_allowed(changes):
    config = Config(**changes)
    assert {name: getattr(config, name) for name in changes} == changes


@pytest.mark.parametrize("name, field, value, message", [
    ("fast", "eta", 1.0, "eta = 1.0: ascent = constant is needed; ascent = newton ignores it"),  # it is the default
    ("fast", "iterations", 1, "iterations = 1: ascent = constant is needed; ascent = newton ignores it"),
    ("fast", "eta_frac", 9, "eta_frac = 9: ascent = constant is needed; ascent = newton ignores it"),
    ("paper", "cold", "0:0", "cold = '0:0': ascent = newton is needed; ascent = constant ignores it"),
    ("paper", "schedule_entries", 9, "schedule_entries = 9: ascent = newton is needed; ascent = constant ignores it"),
    ("paper", "judge", 0, "judge = 0: confidence = 1 is needed; confidence = 0 ignores it"),
    ("paper", "tag_bits", 9, "tag_bits = 9: gradient = one_pass is needed; gradient = sweep ignores it"),
])  # fmt: skip
def test_a_field_that_is_not_read_cannot_be_set(name, field, value, message):
    with pytest.raises(ConfigError, match=f"^{message}$"):
        preset(name).replace(**{field: value})
    if value != FIELDS[field].default:
        assert refusal(**preset(name).to_dict() | {field: value}) == message


def test_a_choice_that_there_is_not_goes_before_what_it_would_read():
    for name, field, value in (("ascent", "eta", 2.0), ("gradient", "tag_bits", 9)):
        with pytest.raises(ConfigError, match=f"^{name} = 'x': one of "):
            Config().replace(**{name: "x", field: value})


def test_a_field_that_is_no_longer_read_goes_back_to_its_default():
    assert Config(eta=4.0, eta_frac=9, iterations=7).replace(**ROUNDS) == Config(**ROUNDS)
    plain = {"gradient": "sweep", "ascent": "constant"}
    assert preset("fast").replace(**plain).tag_bits == Config().tag_bits != preset("fast").tag_bits
    assert preset("fast").replace(ascent="constant", eta=4.0).eta == 4.0
    assert preset("fast").replace(confidence_limit=45.0).replace(ascent="constant").confidence_limit == 30.0


def test_the_limit_of_63_bits_is_exact():
    """Growing one field bit by bit, the first refusal comes with the first width of more than 63."""
    accepted = []
    for frac in range(4, 33):
        try:
            accepted.append(max(Config(gradient_frac=frac, eta_frac=16).widths.exact.values()))
        except ConfigError as error:
            assert accepted[-1] == 63 and "needs 64 bits" in str(error)
            break
    else:
        pytest.fail("never refused")


def test_frozen_and_by_keyword():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().roi_width = 32
    with pytest.raises(TypeError):
        Config(240)


def test_replace_checks_again_and_leaves_the_original():
    config = Config()
    assert config.hardware_hash and config.replace(roi_width=32).roi_width == 32
    assert config.roi_width == 64
    assert config.replace() == config
    with pytest.raises(ConfigError, match=r"^roi_width = 0: 2 to 4096 is needed$"):
        config.replace(roi_width=0)
    with pytest.raises(ConfigError, match=r"^'roi_size': no such field; .*`cmfpga build --list-fields` prints all$"):
        config.replace(roi_size=3)


def test_parse_gives_each_field_its_type():
    changes = Config.parse(["roi_width=32", "eta=0.5", "start=zero", "eta=1e-1", "v_start_x= -3 "])
    assert changes == {"roi_width": 32, "eta": 0.1, "start": "zero", "v_start_x": -3.0}
    assert [type(value) for value in changes.values()] == [int, float, str, float]
    assert Config.parse([]) == {}


@pytest.mark.parametrize("text, message", [
    ("eta", "'eta': FIELD=VALUE is needed"),
    ("", "'': FIELD=VALUE is needed"),
    ("=1", "'': no such field; `cmfpga build --list-fields` prints all"),
    ("Eta=1", "'Eta': no such field; did you mean 'eta'? `cmfpga build --list-fields` prints all"),
    ("window_event=1", "'window_event': no such field; did you mean 'window_events'? "),
    ("hardware_hash=1", "'hardware_hash': no such field; "),
    ("iterations=1.0", "iterations = '1.0': an integer is needed"),
    ("iterations=", "iterations = '': an integer is needed"),
    ("iterations=0x10", "iterations = '0x10': an integer is needed"),
    ("eta=1,5", "eta = '1,5': a number is needed"),
    ("eta=1=2", "eta = '1=2': a number is needed"),
])  # fmt: skip
def test_parse_refuses(text, message):
    with pytest.raises(ConfigError) as caught:
        Config.parse(["roi_width=32", text])
    assert str(caught.value).startswith(message)


def test_presets_by_name():
    with pytest.raises(ConfigError, match=r"^preset 'Paper': did you mean 'paper'\? One of paper, fast, .* is needed$"):
        preset("Paper")
    assert issubclass(ConfigError, UserError) and issubclass(UserError, ValueError)


def test_runtime_fields_do_not_shape_the_hardware():
    assert {name for name, field in FIELDS.items() if field.metadata["runtime"]} == RUNTIME
    changes = dict(
        min_roi_events=5, thinning=3, thin_target=700, start="given", v_start_x=1.0, v_start_y=-1.0, roi_gain=1.0,
    )  # fmt: skip
    judged = {"cold": "0:1:1", "warm": "0:2:1", "judge": 0, "confidence_limit": 45.0, "cold_after_doubtful": 0}
    for base, more in ((Config(), {"iterations": 7, "eta": 0.5}), (Config(**SURE), judged)):
        changed = base.replace(**changes, **more)
        assert all(getattr(changed, name) != getattr(base, name) for name in (*changes, *more))
        assert changed.hardware_hash == base.hardware_hash != Config(roi_width=32).hardware_hash
        assert not RUNTIME & set(changed.hardware_fields)
        assert changes.keys() | more.keys() < RUNTIME


@pytest.mark.parametrize("name", sorted(set(BOUNDED) - RUNTIME))
def test_every_hardware_field_does(name):
    base = Config(roi_width=32, roi_height=32, roi_gain=1.0, **READER.get(name, {}))
    step = 2 if name.startswith("roi_") and not name.startswith("roi_gain") else 1
    changed = base.replace(**{name: getattr(base, name) + step})
    assert changed.hardware_hash != base.hardware_hash
    assert changed.replace(**{name: getattr(base, name)}).hardware_hash == base.hardware_hash
    assert re.fullmatch("[0-9a-f]{64}", changed.hardware_hash)


def test_a_camera_is_nine_numbers():
    on = {"undistortion": "on"}
    assert Config(**on).lens == Config().lens == ()
    assert Config(**on, camera="200,201,120,90").lens == (200.0, 201.0, 120.0, 90.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert Config(**on, camera=" 200 201 120 90 -.3 .1 1e-3 0 ").lens[4:] == (-0.3, 0.1, 0.001, 0.0, 0.0)
    for text in ("200,201,120", "200,201,120,90,-0.3", "a,b,c,d", "200,201,120,nan"):
        shown = " ".join(text.replace(",", " ").split())
        assert refusal(**on, camera=text) == f"camera: '{shown}': fx fy cx cy k1 k2 p1 p2 k3 is needed, nine numbers"
    text = "camera: fx = 200, fy = -1: focal lengths above 0 px are needed"
    assert refusal(**on, camera="200,-1,120,90") == text
    assert refusal(camera="200,200,120,90").startswith("camera = '200,200,120,90': undistortion = on is needed; ")


def test_a_mask_of_hot_pixels_is_read_once():
    mask = Config(hot_pixels=1, hot_mask="7,5; 3,4;7,5;;239,179")
    assert mask.hot == ((3, 4), (7, 5), (239, 179)) and Config().hot == ()
