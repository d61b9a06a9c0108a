"""Checks of single fields of a configuration; each raises :exc:`ConfigError`, which says what is allowed."""

import numbers

from ..errors import ConfigError


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


def check_real(config, name, fmt):
    """A real number against its format."""
    value = getattr(config, name)
    low, high = fmt.real(fmt.min), fmt.real(fmt.max)
    if not low <= value <= high:
        raise ConfigError(f"{name} = {value!r}: {low:g} to {high:g} is needed ({fmt})")
    if value and not fmt.raw(value):
        raise ConfigError(f"{name} = {value!r}: smaller than the step {fmt.step:g} of its format {fmt}")
