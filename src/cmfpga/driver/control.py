"""The AXI top's registers, by their names; and whether what answers fits this driver, by its discovery registers."""

import contextlib
import dataclasses
import time

from .. import __version__
from ..config import PRESETS, Config
from ..config.windows import check_lengths
from ..errors import ConfigError, DeviceError, DeviceTimeout, WrongHardware
from ..imaging.camera import node_writes
from ..protocol.regions import RegionTable
from ..protocol.registers import FORMATS, ID, MAP_VERSION, check, formats_of, register_map
from ..protocol.settings import LENGTHS, schedule_table, settings_values
from ..protocol.tables import mask_writes, window_words
from ..protocol.words import setting_words


def identify(backend, config=None):
    """The configuration of the hardware, of which only registers are read.

    ``config`` is what it should be; by default what the back end knows, or else whichever preset it is. Raises
    :exc:`WrongHardware`: not the accelerator; another version of the package or of the register map; another
    configuration.
    """
    check_version(backend)
    build = _field(backend, "BUILD", "HASH")
    config = config or backend.config
    presets = wrapped_presets()
    names = [name for name, preset in presets.items() if _hash(preset) == build]
    if config is None and names:
        return presets[names[0]]
    if config is None:
        raise WrongHardware(
            f"{backend.name}: the hardware has the configuration {build:08x}, which is none of the presets "
            f"{', '.join(presets)}; give config=, from the build-info.json beside its Verilog"
        )
    if _hash(config) != build:
        is_preset = f" (preset {', '.join(names)})" if names else ""
        raise WrongHardware(
            f"{backend.name}: the hardware has the configuration {build:08x}{is_preset}, "
            f"not {_hash(config):08x}, which was asked for"
        )
    return config


def wrapped_presets():
    """``{name: Config}`` of the presets that the AXI top can be made with."""
    found = {}
    for name, config in PRESETS.items():
        with contextlib.suppress(ConfigError):
            check(config)
            found[name] = config
    return found


def check_version(backend):
    """Raise :exc:`WrongHardware` unless it is an accelerator that this version of the package made."""
    magic, map_version = _field(backend, "ID", "MAGIC"), _field(backend, "CAPS", "MAP")
    version = ".".join(str(_field(backend, "VERSION", part)) for part in ("MAJOR", "MINOR", "PATCH"))
    if magic != ID:
        why = f"ID reads {magic:#010x}, not {ID:#010x}; is the bitstream loaded, and is the address right?"
        why = f"{why} {backend.hint()}".rstrip()
    elif map_version != MAP_VERSION:
        why = f"the hardware has version {map_version} of the register map, this driver {MAP_VERSION}"
    elif version != ".".join(__version__.split(".")[:3]):
        why = f"the hardware was made by cmfpga {version}, this driver is {__version__}; "
        why += f"install cmfpga {version}, or build the hardware anew"
    else:
        return
    raise WrongHardware(f"{backend.name}: {why}")


def _hash(config):
    return register_map(config)["BUILD"]["HASH"].reset


def _field(backend, register, field):
    """A discovery register's field; these are at the same place in every configuration."""
    declared = register_map(Config())[register]
    return declared[field].unpack(backend.read32(declared.offset))


class Control:
    """Registers of one AXI top with this configuration; ``table`` is its :class:`RegionTable`, or None."""

    def __init__(self, backend, config):
        self.backend = backend
        self.config = config
        self.registers = register_map(config)
        self.table = RegionTable(config) if config.regions else None
        self._written = {}  # settings as they stand: offset to word
        self._camera = self._mask = None  # those that stand in the tables; None: nobody knows

    def read(self, name):
        """``{field: value}`` of a register."""
        register = self.registers[name]
        return register.unpack(self.backend.read32(register.offset))

    def write(self, name, **fields):
        """Write a register; fields that are not named are 0."""
        register = self.registers[name]
        self.backend.write32(register.offset, register.pack(**fields))

    def status(self, name):
        """A field of STATUS."""
        return self.read("STATUS")[name]

    def counters(self):
        return {
            register.name.removeprefix("COUNT_").lower(): self.read(register.name)["VALUE"]
            for register in self.registers.group("Counters")
        }

    def clear_interrupts(self):
        """Clear all states of ISR."""
        self.write("ISR", **{f.name: 1 for f in self.registers["ISR"].fields})

    def usual_state(self, *, interrupt):
        """After a soft reset, which leaves these as they were: results come as packets, and perhaps an interrupt."""
        self.write("SETTINGS_LOCK")
        self.write("RESULT_HOLD")
        self.write("OUTPUT", STREAM_RESULTS=1)
        self.clear_interrupts()
        if interrupt:
            self.write("IER", DONE=1)
            self.write("GIE", ENABLE=1)
        self._written.clear()
        self._forget_tables()

    # ---------------------------------------------------------------- settings

    def check_form(self, form):
        """Raise :exc:`ValueError` unless the hardware decodes such words."""
        if form not in (forms := formats_of(self.config)):
            more = "" if self.config.evt3 else "; hardware with evt3 = 1 has EVT30"
            raise ValueError(f"format {form!r}: one of {', '.join(forms)} is needed{more}")

    def write_input(self, form, swap, timeout):
        """What comes on ``s_axis``; waits until that is so. Times of EVT 3.0 begin anew, which another format does."""
        self.check_form(form)
        register = self.registers["INPUT"]
        if form == "EVT30" and self.read("INPUT")["FORMAT"] == FORMATS[form]:
            self.write_input("PACKED", False, timeout)
        self._write_once(register, register.pack(FORMAT=form, SWAP=int(swap)))
        deadline = time.monotonic() + timeout
        while self.status("INPUT_PENDING"):
            if time.monotonic() > deadline:
                why = f"the kind of input does not change within {timeout:g} s: {self.diagnosis()}"
                raise DeviceTimeout(f"{self.backend.name}: {why}")

    def write_settings(self, settings, ends):
        """:class:`BatchSettings` of the batches that begin from now on, or where windows slide of the next run.

        ``ends`` says what the shell does, by the links of the registers' fields: what ends a batch, ``every``.
        """
        if self.config.slides:
            check_lengths(self.config, settings)
        rows, schedule = (), schedule_table(self.config, settings)
        if self.table:
            if not self.table.regions:
                raise ConfigError("the table of regions is empty: write_regions() with one region or more is needed")
            if ends.get("batch_roi_events"):
                raise ConfigError("batches by ROI events: the hardware has many regions; another end is needed")
            rows, schedule = self.table.changes(settings)
            settings = dataclasses.replace(settings, rows=len(self.table.regions))
        values = settings_values(self.config, settings) | {name: int(value) for name, value in ends.items()}
        load = values.pop("roi_load")  # a command, which clears itself
        for name, word in setting_words(self.registers, values).items():
            self._write_once(self.registers[name], word)
        if "SCHEDULE" in self.registers:
            declared = self.registers["SCHEDULE"]
            names = [f.name for f in declared.fields]
            for k, entry in enumerate(schedule):
                self._write_once(declared, declared.pack(**dict(zip(names, entry, strict=True))), 4 * k)
        self._write_tables(rows, settings)
        if "ROI_LOAD" in self.registers:
            self.write("ROI_LOAD", LOAD=load)

    def write_lengths(self, settings):
        """How long windows and hops are from the next hop on, while no event waits."""
        check_lengths(self.config, settings)
        values = settings_values(self.config, settings)
        for name, word in setting_words(self.registers, {one: values[one] for one in LENGTHS}).items():
            self._write_once(self.registers[name], word)

    def _write_tables(self, rows, settings):
        """Rows of the table of regions, a camera's nodes and hot pixels, while no batch is under way."""
        camera, mask = settings.camera, settings.hot_mask
        rows = [("row", dict(zip(self.table.names, row, strict=True))) for row in rows]
        if camera and camera != self._camera:
            nodes = node_writes(self.config, camera)
            rows += [("node", dict(zip(("column", "row", "x", "y"), node, strict=True))) for node in nodes]
        if mask and mask != self._mask:
            words = mask_writes(self.config, mask, self._mask)
            rows += [("mask", dict(zip(("column", "row", "bits"), word, strict=True))) for word in words]
        if not rows:
            return
        try:
            before = self.read("TABLES")
            for name, values in rows:
                self.write_row(name, values)
            after = self.read("TABLES")
            if after["PENDING"] or after["REFUSED"] != before["REFUSED"]:
                raise DeviceError(f"{self.backend.name}: rows of a table were not taken (TABLES: {after})")
        except BaseException:  # nobody knows what was written
            self._forget_tables()
            raise
        self._camera, self._mask = camera or self._camera, mask or self._mask

    def write_row(self, name, values):
        """A row of a table; with a batch under way it waits, and the next row of that table would be refused."""
        *parts, (last, word) = window_words(self.registers, name, values)
        for register, part in parts:
            self._write_once(register, part)
        self.backend.write32(last.offset, word)

    def _forget_tables(self):
        self._camera = self._mask = None
        if self.table:
            self.table.forget()

    def _write_once(self, register, word, offset=0):
        """Unless it is so already."""
        offset += register.offset
        if self._written.get(offset) != word:
            self._written.pop(offset, None)  # if the write fails, nobody knows
            self.backend.write32(offset, word)
            self._written[offset] = word

    # ---------------------------------------------------------------- messages

    def diagnosis(self):
        """The state in a few words."""
        count = self.counters()
        states = [name.lower() for name, value in self.read("STATUS").items() if value]
        return (
            f"{count['beats_in']} words taken, {count['events_taken']} events in batches, "
            f"{count['format_errors']} format errors, {count['before_time'] + count['out_of_sensor']} events dropped, "
            f"{count['batches']} results; status: {', '.join(states) or 'idle'}"
        )

    @property
    def hint(self):
        """The back end's, for the end of a message."""
        hint = self.backend.hint()
        return f". {hint}" if hint else ""
