"""Checks of a configuration's fields, and what their texts say; each raises :exc:`ConfigError`: what is allowed."""

import dataclasses
import math
import numbers

from ..errors import ConfigError
from .choices import UNDISTORTION
from .motion import needs as motion_needs
from .regions import MOST_STORED
from .windows import window_events

#: Focal lengths and principal point, px; radial (k) and tangential (p) distortion, the model "plumb_bob".
CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def check_field(config, field, value):
    """A field's type, range or choices; a value that is as good in its own type becomes that."""
    choices, low, high = (field.metadata[name] for name in ("choices", "low", "high"))
    kind = {int: numbers.Integral, float: numbers.Real, str: str}[field.type]  # NumPy's numbers, too
    fits = isinstance(value, kind) and not isinstance(value, bool)
    needed = None
    if choices:
        needed = None if fits and value in choices else f"one of {', '.join(map(str, choices))}"
    elif not fits:
        needed = {str: "text", int: "an integer", float: "a number"}[field.type]
    elif value != value or (low is not None and value < low) or (high is not None and value > high):
        needed = f"{low} to {high}" if high is not None else f"{low} or more" if low is not None else "a number"
    if needed:
        raise ConfigError(f"{field.name} = {value!r}: {needed} is needed")
    object.__setattr__(config, field.name, value if isinstance(value, int | float) else field.type(value))


def _refuse(config, name, needed):
    raise ConfigError(f"{name} = {getattr(config, name)}: {needed}")


def _at_most(config, name, most, why):
    if getattr(config, name) > most:
        _refuse(config, name, f"at most {most} is allowed ({why})")


def _smaller(config, name, limit):
    """One field against another."""
    _at_most(config, name, getattr(config, limit), limit)


def _needs(config, name, needs):
    """Of ``((field, values), …)`` each field must have one of the values for the field ``name`` to be as it is."""
    for field, values in needs:
        if getattr(config, field) not in values:
            _refuse(config, name, f"{field} = {' or '.join(map(str, values))} is needed")


def check_together(config):
    """What a configuration's fields need of one another."""
    for side in ("width", "height"):
        _check_side(config, side)
    _check_times(config)
    config.hot, config.lens  # noqa: B018 - raise where the text is malformed
    _smaller(config, "min_roi_events", "buffer_events")
    _smaller(config, "thin_target", "buffer_events")
    if config.slides:
        _check_windows(config)
    q = config.formats
    for name, fmt in (("eta", q.eta), ("roi_gain", q.roi_gain), ("v_start_x", q.v), ("v_start_y", q.v)):
        _check_real(config, name, fmt)
    _check_regions(config)
    _check_ascent(config)
    if config.gradient == "one_pass":
        _check_tags(config)
    _needs(config, "motion", ((field, (value,)) for field, value in motion_needs(config.motion).items()))
    if config.motion != "translation" and max(config.roi_width, config.roi_height) < 16:
        _refuse(config, "motion", "an ROI of at least 16 px along one side is needed")
    for name in ("cold", "warm") if config.confidence else ():
        # The last iteration's sums are compared with those beside v.
        if (stride := getattr(config.schedules, name)[-1].stride) > 1:
            needs = "it needs all events, as the probes"
            _refuse(config, "confidence", f"the last iteration of {name} has stride {stride}: {needs}")
    _check_widths(config)


def _check_side(config, side):
    """The ROI's ``width`` or ``height`` against that of the image that it lies in, and the sweep."""
    name, sensor = f"roi_{side}", f"sensor_{side}"
    binned = f"{sensor} = {getattr(config, sensor)} by binning = {config.binning}"
    _at_most(config, name, getattr(config.geometry, side), binned if config.binning else sensor)
    if config.gradient == "sweep" and getattr(config, name) % 2:
        _refuse(config, name, "an even number of pixels is needed by the sweep")


def _check_times(config):
    """Times are told apart, and held."""
    if config.span_bits >= config.time_bits:
        why = "or a step back in time could not be told from a long batch"
        _refuse(config, "span_bits", f"less than time_bits = {config.time_bits} is needed, {why}")
    _at_most(config, "background_us", config.widths.background_us_max, "span_bits")


def _check_windows(config):
    """Windows that slide can be held and timed."""
    _needs(config, "windows", (("gradient", ("one_pass",)), ("ascent", ("newton",)), ("regions", (0,))))
    _smaller(config, "window_events", "buffer_events")
    _at_most(config, "hop_events", window_events(config), "window_events")
    longest = 1 << (config.span_bits - 1)
    _at_most(config, "window_us", longest, "half of what span_bits counts to")
    _at_most(config, "hop_us", config.window_us or longest, "window_us")


def _check_real(config, name, fmt):
    """A real number against its format."""
    value = getattr(config, name)
    low, high = fmt.real(fmt.min), fmt.real(fmt.max)
    if not low <= value <= high:
        raise ConfigError(f"{name} = {value!r}: {low:g} to {high:g} is needed ({fmt})")
    if value and not fmt.raw(value):
        raise ConfigError(f"{name} = {value!r}: smaller than the step {fmt.step:g} of its format {fmt}")


def _check_regions(config):
    """The hardware for regions can be built."""
    changed = [f.name for f in dataclasses.fields(config) if getattr(config, f.name) != f.default]
    if not config.regions:
        for name in ("units", "slices", "bin_bits", "store_style"):
            if name in changed:
                _refuse(config, name, "regions of 1 or more are needed")
        return
    _needs(config, "regions", (("gradient", ("one_pass",)), ("ascent", ("sign", "newton")), ("buffers", (2,))))
    if config.motion == "rotation":
        why = "a region sees too little of the field to tell a turn from a shift"
        cure = "cmfpga flow --fit rotation finds it from all regions of a translation"
        _refuse(config, "regions", f"motion = rotation: {why}; {cure}")
    for name in ("thinning", "thin_target"):
        if name in changed:
            _refuse(config, "regions", f"{name}: each region has a stride of its own instead")
    if config.slices > 1 and config.background:
        _refuse(config, "slices", "background = 0 is needed, or an event would support itself later")
    most = config.max_batch_events
    if config.slices > most:
        _refuse(config, "slices", f"at most max_batch_events = {most} are allowed")
    if most > MOST_STORED:
        _refuse(config, "max_batch_events", f"at most {MOST_STORED} are allowed, for the store holds them all")


def _check_ascent(config):
    """What the ascent needs: fields, velocities ¾ px beside v that can be written, and a schedule."""
    rule = config.ascent_rule
    _needs(config, "ascent", rule.needs)
    if (config.confidence or rule.evaluations > 1) and config.v_frac < 2:
        _refuse(config, "ascent", f"v_frac = {config.v_frac}: 2 or more is needed for what lies ¾ px beside v")
    if not rule.has_table:
        return _smaller(config, "iterations", "max_iterations")
    names = ("cold", "warm", *(("follow", "after") if config.slides else ()))
    lengths = {name: len(getattr(config.schedules, name)) for name in names}
    if lengths.get("after", 0) > 1:
        raise ConfigError(f"after: {lengths['after']} iterations: at most one is allowed")
    if sum(lengths.values()) > config.schedule_entries:
        found = f"{' and '.join(names)}: {' + '.join(map(str, lengths.values()))} iterations"
        raise ConfigError(f"{found}; at most {config.schedule_entries} are allowed in all (schedule_entries)")
    for name, iterations in lengths.items():
        if iterations > config.max_iterations:
            most = f"at most {config.max_iterations} are allowed (max_iterations)"
            raise ConfigError(f"{name}: {iterations} iterations; {most}")


def _check_tags(config):
    """There are tags enough for the sweep of the banks."""
    idle, tags, depth = config.one_pass.latency, (1 << config.tag_bits) - 1, config.geometry.bank_depth
    if idle < config.one_pass.fewest_idle_cycles:
        needed = (
            f"at least the {depth} words of a bank are needed: tag_bits = {config.one_pass.fewest_tag_bits} or more"
        )
        _refuse(config, "tag_bits", f"(2^tag_bits − 1) · {idle} idle cycles an iteration = {tags * idle}, {needed}")


def _check_widths(config):
    """Fractions of positions, and what the integer model holds."""
    most = config.dt_frac + config.v_frac
    for name in ("dither_frac", *UNDISTORTION[config.undistortion][1:2]):
        if getattr(config, name) > most:
            _refuse(config, name, f"at most dt_frac + v_frac = {most} is allowed")
    for what, width in config.widths.exact.items():
        if width > 63:
            cure = "a smaller buffer_events, ROI, or fraction width is needed"
            raise ConfigError(f"{what} needs {width} bits, more than the 63 that the exact integer model has: {cure}")


def parse_pixels(text, config):
    """Pixels of ``x,y;x,y;…``: tuple of (column, row), sorted, each once, on the sensor; or :exc:`ConfigError`."""
    found = set()
    for word in filter(None, text.replace(" ", "").split(";")):
        column, comma, row = word.partition(",")
        if not (comma and column.isdecimal() and row.isdecimal() and len(word) < 20):
            raise ConfigError(f"hot_mask: {word[:40]!r}: X,Y of a pixel is needed, pixels separated by ';'")
        found.add(pixel := (int(column), int(row)))
        if pixel[0] >= config.sensor_width or pixel[1] >= config.sensor_height:
            most = f"{config.sensor_width - 1},{config.sensor_height - 1}"
            raise ConfigError(f"hot_mask: pixel {word}: 0,0 to {most} is needed")
    return tuple(sorted(found))


def parse_camera(text, what="camera"):
    """The nine numbers of ``fx,fy,cx,cy,k1,k2,p1,p2,k3``, or of the same with spaces; () of an empty text.

    Distortion, or k3 alone, may be left out: it is 0. Raises :exc:`ConfigError`, which names ``what``.
    """
    words = text.replace(",", " ").split()
    if not words:
        return ()
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        numbers = ()
    if len(numbers) not in (4, 8, 9) or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{what}: {' '.join(words)[:60]!r}: {' '.join(CAMERA_NAMES)} is needed, nine numbers")
    if min(numbers[:2]) <= 0:
        raise ConfigError(f"{what}: fx = {numbers[0]:g}, fy = {numbers[1]:g}: focal lengths above 0 px are needed")
    return numbers + (0.0,) * (len(CAMERA_NAMES) - len(numbers))


def binned_camera(lens, binning):
    """The nine numbers of a camera whose pixels are 2^binning as wide: a middle of them lies between two old ones."""
    if not (lens and binning):
        return lens
    side = 1 << binning
    fx, fy, cx, cy = (number / side for number in lens[:4])
    shift = (side - 1) / (2 * side)
    return (fx, fy, cx - shift, cy - shift, *lens[4:])
