"""Prophesee RAW: lines ``% key value``, then words of EVT 2.0, 2.1 or 3.0. Files here, streams in :mod:`~.live`.

Both are decoded by :class:`~.evt.EvtDecoder`. The header names the version, ``% evt 2.1`` or ``% format EVT21;…``;
where there is no header, the caller does (``--format``). EVT 2.1 comes with the upper half of each word last, or first
where the format says ``endianness=legacy``.

Sensor: a line ``% geometry WxH`` or ``% format …;width=W`` tells its size. Of files without it the sensor's name, its
generation or the camera's plugin does. Where nothing does, it is not known.

Format: https://docs.prophesee.ai/stable/data/file_formats/raw.html.
"""

import re

from ..errors import RecordingError
from .evt import EvtDecoder
from .recording import Format
from .streamed import StreamedRecording, Truncated

#: Versions of words without a header, by what ``--format`` calls them.
FORMS = {"evt2": "2.0", "evt21": "2.1", "evt21-legacy": "2.1 legacy", "evt3": "3.0"}

#: More bytes than any header has.
HEADER_BYTES = 1 << 16

_VERSIONS = {"2": "2.0", "2.0": "2.0", "EVT2": "2.0", "2.1": "2.1", "EVT21": "2.1",
             "3": "3.0", "3.0": "3.0", "EVT3": "3.0"}  # fmt: skip
# Sensors by name, generation, or the plugin that wrote a file of old: hal_plugin_gen3_fx3, hal_plugin_gen41_evk3, …
_SENSORS = (
    ("genx320", (320, 320)), ("gen320", (320, 320)), ("gen3", (640, 480)), ("gen4", (1280, 720)),
    ("imx636", (1280, 720)), ("imx646", (1280, 720)),
)  # fmt: skip
_SENSOR_KEYS = ("sensor_name", "sensor_generation", "generation", "plugin_name", "camera_integrator_name")
_MAX_HEADER_LINES = 200
_BEGINS = (b"% ", b"%\n")
# Decoded at a time: 32,768 words of EVT 3.0, of up to 12 events each, or 8,192 of EVT 2.1, of up to 32.
_PIECE_BYTES = 1 << 16


def prophesee_header(head):
    """``({key: value}, bytes of it)`` of the lines ``% key value`` at the begin of a file (bytes)."""
    fields, at = {}, 0
    for _ in range(_MAX_HEADER_LINES):
        end = head.find(b"\n", at)
        if not head.startswith(b"%", at) or end < 0:
            break
        key, _, value = head[at + 1 : end].decode("latin-1").strip().partition(" ")
        fields[key.lower()] = value.strip()
        at = end + 1
        if key.lower() == "end":
            break
    return fields, at


def evt_version(fields, form, where, begin=b""):
    """The version of the words, a key of :data:`~.evt.WORD_BYTES`, by a header's ``fields``.

    ``form``, a key of :data:`FORMS` or None, counts where there is no header. Where neither says the version, or it is
    another one, :exc:`RecordingError` starts with ``where``, and shows the ``begin`` of the file.
    """
    name, *options = fields.get("format", "").split(";")
    version = _VERSIONS.get(name.upper()) or _VERSIONS.get(fields.get("evt", ""))
    order = dict(option.partition("=")[::2] for option in options).get("endianness", "little")
    if version and order not in ("little", "legacy"):
        raise RecordingError(f"{where}: EVT {version} of endianness {order[:40]!r}; little or legacy is needed")
    if version == "2.1" and order == "legacy":
        return FORMS["evt21-legacy"]
    if version or (not fields and form):
        return version or FORMS[form]
    said = fields.get("format") or fields.get("evt")
    if said:
        found, needed = f"Prophesee RAW of version {said[:40]!r}", "'% evt' or '% format' of EVT 2.0, 2.1 or 3.0"
    else:
        found = "begins with '%', but names no version of EVT" if fields else f"begins with {begin[:16]!r}"
        needed = f"a header of EVT 2.0, 2.1 or 3.0, or --format {', '.join(FORMS)} for words without one,"
    raise RecordingError(f"{where}: {found}; {needed} is needed")


def raw_sensor(fields):
    """``(width, height)`` in pixels that a header's fields tell; None if they do not."""
    size = re.fullmatch(r"(\d+)x(\d+)", fields.get("geometry", ""))
    told = dict(re.findall(r";(width|height)=(\d+)", fields.get("format", "")))
    if size or len(told) == 2:
        width, height = size.groups() if size else (told["width"], told["height"])
        return int(width), int(height)
    for key in _SENSOR_KEYS:
        said = ("gen" if "generation" in key else "") + fields.get(key, "").lower()
        for name, sensor in _SENSORS:
            if name in said:
                return sensor
    return None


class RawRecording(StreamedRecording):
    """Events of a RAW file; ``form`` is a key of :data:`FORMS`, of a file without a header."""

    def __init__(self, path, *, time_unit=None, sensor=None, form=None):
        with path.open("rb") as file:
            head = file.read(HEADER_BYTES)
        fields, self._begin = prophesee_header(head)
        self._version = evt_version(fields, form, path, head)
        name = f"Prophesee RAW (EVT {self._version.replace(' legacy', ', legacy order')})"
        super().__init__(path, name, sensor=sensor or raw_sensor(fields), time_unit=time_unit)
        self._require_events()

    def _stored(self):
        decoder = EvtDecoder(self._version)
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while content := file.read(_PIECE_BYTES):
                columns = decoder(content)
                self._early = decoder.early
                yield columns
        if decoder.rest:
            raise Truncated(f"{len(decoder.rest)} of {decoder.word_bytes} bytes of the last word are there")


def is_dat(head, path):
    """Whether it is a Prophesee DAT file."""
    fields, _ = prophesee_header(head)
    named = "evt" not in fields and "format" not in fields and ("version" in fields or "data" in fields)
    return head.startswith(_BEGINS) and named


FORMAT = Format(
    "Prophesee RAW", (".raw",), lambda head, path: head.startswith(_BEGINS) and not is_dat(head, path), RawRecording,
    forms=(*FORMS,),
)  # fmt: skip
