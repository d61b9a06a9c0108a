"""Checks of a configuration's fields, and what their texts say; each raises :exc:`ConfigError`: what is allowed."""

import math
import numbers

from ..errors import ConfigError
from .choices import UNDISTORTION

#: Focal lengths and principal point, px; radial (k) and tangential (p) distortion, the model "plumb_bob".
CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def check_field(config, field, value):
    """A field's type, range or choices; a value that is as good in its own type becomes that."""
    meta = field.metadata
    if meta["choices"]:
        if value not in meta["choices"] or (field.type is int and not _is(int, value)):
            allowed = ", ".join(map(str, meta["choices"]))
            raise ConfigError(f"{field.name} = {value!r}: one of {allowed} is needed")
        object.__setattr__(config, field.name, field.type(value))
        return
    if field.type is str:
        if not isinstance(value, str):
            raise ConfigError(f"{field.name} = {value!r}: text is needed")
        return
    if not _is(field.type, value):
        raise ConfigError(f"{field.name} = {value!r}: {'an integer' if field.type is int else 'a number'} is needed")
    low, high = meta["low"], meta["high"]
    if value != value or (low is not None and value < low) or (high is not None and value > high):
        allowed = f"{low} to {high}" if high is not None else f"{low} or more" if low is not None else "a number"
        raise ConfigError(f"{field.name} = {value!r}: {allowed} is needed")
    if not isinstance(value, (int, float)):
        object.__setattr__(config, field.name, field.type(value))


def _is(kind, value):
    """Whether it is a number of this kind, NumPy's included."""
    return isinstance(value, numbers.Integral if kind is int else numbers.Real) and not isinstance(value, bool)


def check_size(config, name, limit):
    """One field against another."""
    if getattr(config, name) > getattr(config, limit):
        raise ConfigError(f"{name} = {getattr(config, name)}: at most {getattr(config, limit)} is allowed ({limit})")


def check_side(config, side):
    """The ROI's ``width`` or ``height`` against that of the image that it lies in, and the sweep."""
    roi = getattr(config, f"roi_{side}")
    if config.binning:
        sensor, most = getattr(config, f"sensor_{side}"), getattr(config.geometry, side)
        if roi > most:
            why = f"sensor_{side} = {sensor} by binning = {config.binning}"
            raise ConfigError(f"roi_{side} = {roi}: at most {most} is allowed ({why})")
    else:
        check_size(config, f"roi_{side}", f"sensor_{side}")
    if config.gradient == "sweep" and roi % 2:
        raise ConfigError(f"roi_{side} = {roi}: an even number of pixels is needed by the sweep")


def check_times(config):
    """Times are told apart, and held."""
    if config.span_bits >= config.time_bits:
        raise ConfigError(
            f"span_bits = {config.span_bits}: less than time_bits = {config.time_bits} is needed, "
            "or a step back in time could not be told from a long batch"
        )
    if config.background_us > (most := config.widths.background_us_max):
        raise ConfigError(f"background_us = {config.background_us}: at most {most} is allowed (span_bits)")


def check_widths(config):
    """Fractions of positions, and what the integer model holds."""
    most = config.dt_frac + config.v_frac
    for name in ("dither_frac", *UNDISTORTION[config.undistortion][1:2]):
        if getattr(config, name) > most:
            raise ConfigError(f"{name} = {getattr(config, name)}: at most dt_frac + v_frac = {most} is allowed")
    for what, width in config.widths.exact.items():
        if width > 63:
            raise ConfigError(
                f"{what} needs {width} bits, more than the 63 that the exact integer model has: "
                "a smaller buffer_events, ROI, or fraction width is needed"
            )


def check_real(config, name, fmt):
    """A real number against its format."""
    value = getattr(config, name)
    low, high = fmt.real(fmt.min), fmt.real(fmt.max)
    if not low <= value <= high:
        raise ConfigError(f"{name} = {value!r}: {low:g} to {high:g} is needed ({fmt})")
    if value and not fmt.raw(value):
        raise ConfigError(f"{name} = {value!r}: smaller than the step {fmt.step:g} of its format {fmt}")


def check_confidence(config):
    """Raise :exc:`ConfigError` unless the last iteration's sums can be compared with those beside v."""
    for name in ("cold", "warm"):
        if (stride := getattr(config.schedules, name)[-1].stride) > 1:
            raise ConfigError(
                f"confidence = 1: the last iteration of {name} has stride {stride}: it needs all events, as the probes"
            )


def check_ascent(config):
    """What the ascent needs: fields, velocities ¾ px beside v that can be written, and a schedule."""
    for name, values in config.ascent_rule.needs:
        if getattr(config, name) not in values:
            raise ConfigError(f"ascent = {config.ascent}: {name} = {' or '.join(values)} is needed")
    if (config.confidence or config.ascent_rule.evaluations > 1) and config.v_frac < 2:
        raise ConfigError(
            f"ascent = {config.ascent}: v_frac = {config.v_frac}: 2 or more is needed for what lies ¾ px beside v"
        )
    if config.ascent_rule.has_table:
        config.schedules.check()
    else:
        check_size(config, "iterations", "max_iterations")


def parse_pixels(text, config):
    """The pixels of ``x,y;x,y;…``: tuple of (column, row), sorted, each once.

    Raises :exc:`ConfigError` where the text is malformed, or a pixel lies outside the sensor.
    """
    found = set()
    for word in filter(None, text.replace(" ", "").split(";")):
        column, comma, row = word.partition(",")
        if not (comma and column.isdecimal() and row.isdecimal() and len(word) < 20):
            raise ConfigError(f"hot_mask: {word[:40]!r}: X,Y of a pixel is needed, pixels separated by ';'")
        pixel = int(column), int(row)
        if pixel[0] >= config.sensor_width or pixel[1] >= config.sensor_height:
            raise ConfigError(
                f"hot_mask: pixel {word}: 0,0 to {config.sensor_width - 1},{config.sensor_height - 1} is needed"
            )
        found.add(pixel)
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
