"""What the strict model of Vivado hands out: named objects with properties that are known, or an error."""


class VivadoError(Exception):
    """What Vivado, or a strict reading of its manuals, would refuse."""


class Thing:
    """One object of Vivado: a kind, a name, and properties.

    Parameters
    ----------
    kind, name : str
        ``cell`` and ``/dma``; the handle that Tcl sees is both, so that a name glued together by hand is no handle.
    properties : dict
        Value by name; a value that is a callable computes what is read. Only names in ``writable`` can be set.
    """

    def __init__(self, kind, name, properties=None, writable=()):
        self.kind, self.name = kind, name
        self.properties = {"NAME": name, **(properties or {})}
        self.writable = set(writable)

    @property
    def handle(self):
        return f"{self.kind}:{self.name}"

    def read(self, name):
        if name not in self.properties:
            raise VivadoError(f"{self.handle} has no property {name}")
        value = self.properties[name]
        return value() if callable(value) else value

    def write(self, name, value):
        if name not in self.writable:
            raise VivadoError(f"{self.handle}: property {name} does not exist or is read-only")
        self.properties[name] = value


class Store:
    """All objects, by handle."""

    def __init__(self):
        self.things = {}

    def add(self, thing):
        if thing.handle in self.things:
            raise VivadoError(f"{thing.handle} exists already")
        self.things[thing.handle] = thing
        return thing

    def remove(self, thing):
        del self.things[thing.handle]

    def get(self, handle, *kinds):
        """The object of a handle, which must be of one of ``kinds``, if any are given."""
        thing = self.things.get(handle)
        if thing is None:
            raise VivadoError(f"{handle!r} is not an object: get it by a get_… command")
        if kinds and thing.kind not in kinds:
            raise VivadoError(f"{handle} is a {thing.kind}, expected {' or '.join(kinds)}")
        return thing

    def of_kind(self, kind):
        return [thing for thing in self.things.values() if thing.kind == kind]


def number(text):
    """An integer as Vivado reads it: decimal, ``0x…``, or with K, M, G."""
    scale = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30}.get(str(text)[-1:], 1)
    try:
        return int(str(text)[:-1] if scale > 1 else str(text), 0) * scale
    except ValueError:
        raise VivadoError(f"{text!r} is not a number") from None


def check_usage(usage, words):
    """Split a command's words by its usage: ``({option: value or True}, [positional])``.

    ``usage`` is a line like ``-force -part= name folder?``: flags, options that take a value, positional words;
    ``?`` marks an optional one, ``...`` any number. What it does not name is an error.
    """
    tokens = usage.split()
    flags = {token for token in tokens if token.startswith("-") and not token.endswith("=")}
    valued = {token[:-1] for token in tokens if token.startswith("-") and token.endswith("=")}
    names = [token for token in tokens if not token.startswith("-")]
    options, rest, words = {}, [], list(words)
    while words:
        word = words.pop(0)
        if word in flags:
            options[word] = True
        elif word in valued:
            if not words:
                raise VivadoError(f"option {word} wants a value")
            options[word] = words.pop(0)
        elif word.startswith("-") and not word[1:2].isdigit():
            raise VivadoError(f"unknown option {word}")
        else:
            rest.append(word)
    least = sum(not name.endswith(("?", "...")) for name in names)
    most = len(rest) if any(name.endswith("...") for name in names) else len(names)
    if not least <= len(rest) <= most:
        raise VivadoError(f"expected {' '.join(names) or 'no words'}, got {len(rest)}: {rest}")
    return options, rest
