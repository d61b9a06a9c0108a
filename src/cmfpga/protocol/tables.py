"""Tables that are written at run time: through a window of registers, a row at a time; and the mask of hot pixels.

Each window has the members of what fills the hardware's table: :func:`cmfpga.rtl.regions.payloads.row_write`,
:func:`cmfpga.rtl.payloads.node_write`, :func:`cmfpga.rtl.payloads.mask_write`. The last register says which row it is;
a write to it writes the row.
"""

from .regions import ROW
from .settings import Setting, with_hot_pixels, with_regions, with_undistortion
from .shapes import Place, whole

#: A node of the table that undistorts.
NODE = (
    Setting(name="x", shape=lambda c: c.formats.node_x, unit="px", doc="columns that a node moves what lies on it, raw",
            places=(Place(word=8, register="NODE_X"),)),
    Setting(name="y", shape=lambda c: c.formats.node_y, unit="px", doc="rows that it moves it, raw",
            places=(Place(word=9, register="NODE_Y"),)),
    Setting(name="column", high=lambda c: c.geometry.node_columns - 1, doc="column of the node",
            places=(Place(word=10, register="NODE_WRITE", field="COLUMN", width=16,
                          register_doc="write the other registers' node into the table"),)),
    Setting(name="row", high=lambda c: c.geometry.node_rows - 1, doc="row of the node",
            places=(Place(word=10, register="NODE_WRITE", field="ROW", lsb=16, width=16),)),
)  # fmt: skip

#: A word of the mask of hot pixels.
MASK = (
    Setting(name="bits", shape=lambda c: whole(c.geometry.mask_pixels), doc="bit k: pixel 32·COLUMN + k is hot",
            places=(Place(word=11, register="MASK_BITS"),)),
    Setting(name="column", high=lambda c: c.geometry.mask_columns - 1, doc="column of the word",
            places=(Place(word=12, register="MASK_WRITE", field="COLUMN", width=16,
                          register_doc="write the word of MASK_BITS into the mask of hot pixels"),)),
    Setting(name="row", high=lambda c: c.sensor_height - 1, doc="row of the word, of the sensor",
            places=(Place(word=12, register="MASK_WRITE", field="ROW", lsb=16, width=16),)),
)  # fmt: skip

#: ``{name: (when, what a row has)}``; registers are called after it.
TABLES = {"row": (with_regions, ROW), "node": (with_undistortion, NODE), "mask": (with_hot_pixels, MASK)}


def tables_of(config):
    """``{name: what a row has}`` of the tables in a configuration's hardware."""
    return {name: declared for name, (when, declared) in TABLES.items() if when(config)}


def window_of(registers, name):
    """The registers of a table, the one that writes the row last."""
    return [register for register in registers.group("Tables") if register.name.startswith(f"{name.upper()}_")]


def window_words(registers, name, values):
    """``[(register, word)]`` that write a row of the table ``name``, in order; ``values`` by the fields' links, all."""
    return [
        (register, register.pack(**{f.name: values[f.link] for f in register.fields}))
        for register in window_of(registers, name)
    ]


def mask_words(config, pixels):
    """The mask of hot pixels as the hardware holds it: ``{(column // 32, row): word}``, of words that are not 0."""
    words = {}
    for column, row in pixels:
        at = column // config.geometry.mask_pixels, row
        words[at] = words.get(at, 0) | 1 << column % config.geometry.mask_pixels
    return words


def mask_writes(config, pixels, before=None):
    """What has to be written to mark ``pixels``: [(column, row, word)].

    ``before`` are those that are marked now; None: nobody knows, so all words are written.
    """
    words, columns = mask_words(config, pixels), config.geometry.mask_columns
    if before is None:
        places = [(column, row) for row in range(config.sensor_height) for column in range(columns)]
    else:
        known = mask_words(config, before)
        places = sorted(at for at in {*words, *known} if words.get(at) != known.get(at))
    return [(*at, words.get(at, 0)) for at in places]
