"""What a track keeps for its report: every batch's row, and the events of as many batches as a page can hold."""

import functools
import json
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..config import Config
from ..errors import ConfigError, naming
from ..events.numpy_files import NPZ_ERRORS, Member
from ..forms import Array, FormError, Number, Text, check
from ..imaging.camera import nearest
from ..imaging.iwe import scaled_roi_events
from .columns import columns

#: Name of the file in the folder of a track.
FILE = "track.npz"

#: Of the file's layout; another one is refused.
VERSION = 4

#: Compressed bytes of details. Base64 makes them 4/3 as many, and plotly.js has 4.8 MB: the page stays below 10 MB.
BUDGET = 3_500_000

#: Bytes of details as they are count as so many compressed ones, which bounds memory where frames are empty.
_DENSEST = 16

#: Rows of a page; of a longer track, such as that of a stream, the first ones.
MOST_ROWS = 10_000

#: A file has no more, uncompressed.
MOST_BYTES = 1 << 28

#: Columns and rows of an event frame are binned to at most so many.
FRAME_SIZE = 400


@dataclass(frozen=True, eq=False)
class Detail:
    """What is drawn of one batch.

    ``x``, ``y``: columns and rows of its ROI's events in the ROI, px; of an undistorted image, with
    :attr:`Kept.fraction` bits behind the point and half a pixel more. ``v``: the motion's parameters that each
    iteration used, then the result, px per half batch; the result alone, [1, P], where the engine gives no trace.
    """

    batch: int  # its number
    frame: np.ndarray  # uint8 [rows, columns]: events, at most 255, of frame_bin × frame_bin pixels of the sensor each
    x: np.ndarray  # uint16 [n]
    y: np.ndarray  # uint16 [n]
    since: np.ndarray  # uint32 [n]: their time since the batch's first event, µs
    v: np.ndarray  # float64 [T + 1, P]
    levels: np.ndarray  # uint8 [T]: level of each iteration

    @functools.cached_property
    def size(self):
        """Compressed bytes, about, and no fewer than a share of those that they are."""
        arrays = (self.frame, self.x, self.y, np.diff(self.since, prepend=np.uint32(0)))
        return sum(max(len(zlib.compress(array.tobytes(), 6)), array.nbytes // _DENSEST) for array in arrays)


class Kept:
    """Collects while batches go by, in bounded memory: at most :data:`MOST_ROWS` of them.

    Where the details of all batches would be too much, those of every second, fourth … batch are kept. ``engine`` and
    ``recording`` are names, of a path its last part; ``motion`` is the true one, where it is known.
    """

    def __init__(self, config, engine, recording, motion=None):
        self.config, self.engine, self.recording = config, engine, Path(recording).name
        self.rows = []  # of each batch, as in track.csv
        self.spans = []  # t_N − t_1 of each batch, µs
        self.truths = []  # true mean velocity of each batch, px/s; NaN where it is not known
        self.details = []
        self.roi_next = 0, 0  # after the last batch
        self.left_out = 0  # batches after the last row
        self._motion = motion
        self._stride = 1

    @property
    def frame_bin(self):
        """Pixels along one side of an element of an event frame."""
        return -(-max(self.config.sensor_width, self.config.sensor_height) // FRAME_SIZE)

    @property
    def fraction(self):
        """Fraction bits of the positions of details: those that 16 bits leave room for."""
        side = max(self.config.roi_width, self.config.roi_height)
        return min(self.config.formats.event_frac, 16 - side.bit_length()) if self.config.image else 0

    def places(self, detail):
        """Columns and rows of a :class:`Detail`'s events in the ROI, px, float64 [2, n]."""
        return np.stack([detail.x, detail.y]) * 2.0**-self.fraction - 0.5 * bool(self.config.image)

    def column(self, name):
        """Text of a column of ``track.csv``, one per batch."""
        at = list(columns(self.config.motion, self.config.slides)).index(name)
        return [row[at] for row in self.rows]

    def numbers(self, name):
        """The same as float64; NaN where it is empty."""
        return np.array([float(text or "nan") for text in self.column(name)])

    def add(self, batch):
        """Take one :class:`~cmfpga.tracking.loop.TrackedBatch`, which follows the last one."""
        if len(self.rows) == MOST_ROWS:
            self.left_out += 1
            return
        self.rows.append(batch.row())
        self.spans.append(batch.result.span)
        self.roi_next = batch.roi_next
        self.truths.append(batch.true_px_per_s(self._motion) or (np.nan, np.nan))
        if batch.index % self._stride:
            return
        self.details.append(self._detail(batch))
        while len(self.details) > 1 and sum(detail.size for detail in self.details) > BUDGET:
            self._stride *= 2
            self.details = [detail for detail in self.details if detail.batch % self._stride == 0]

    def _detail(self, batch):
        config, result = self.config, batch.result
        side = self.frame_bin
        frame = np.zeros((-(-config.sensor_height // side), -(-config.sensor_width // side)), np.int64)
        x, y, shown = nearest(config, batch.seen.x, batch.seen.y)
        np.add.at(frame, (y[shown] // side, x[shown] // side), 1)
        *places, dt = scaled_roi_events(config, batch.seen, result.roi, **batch.which)
        half = 0.5 * bool(config.image)
        x, y = (np.minimum((axis + half) * 2.0**self.fraction, 65535) for axis in places)
        since = np.rint((dt + 1) * result.span / 2)
        path = [result.v]
        if result.trace is not None:
            path = np.array(result.trace.v, np.float64) * (1.0 if self.engine == "float" else config.formats.v.step)
        events = x.astype(np.uint16), y.astype(np.uint16), since.astype(np.uint32)
        levels = np.array([entry.level for entry in batch.plan], np.uint8)
        return Detail(batch.index, np.minimum(frame, 255).astype(np.uint8), *events, np.array(path, np.float64), levels)

    def save(self, path):
        """Write everything as ``.npz``."""
        head = {"version": VERSION, "config": self.config.to_dict()}
        head |= {name: getattr(self, name) for name in ("engine", "recording", "left_out")}
        details, lists = self.details, ("x", "y", "since", "v", "levels")
        with naming(path):
            np.savez_compressed(
                path,
                head=json.dumps(head),
                **{name: getattr(self, name) for name in ("rows", "spans", "truths", "roi_next")},
                batches=[detail.batch for detail in details],
                counts=[len(detail.x) for detail in details],
                iterations=[len(detail.levels) for detail in details],
                velocities=[len(detail.v) for detail in details],
                frames=[detail.frame for detail in details],
                **{name: np.concatenate([getattr(detail, name) for detail in details]) for name in lists},
            )

    @classmethod
    def load(cls, path):
        """What :meth:`save` wrote. Raises :exc:`ConfigError` for anything else, in bounded time and memory."""
        if not Path(path).is_file():
            raise ConfigError(f"{path}: no regular file")
        try:
            with open(path, "rb") as raw, zipfile.ZipFile(raw) as archive:
                return cls._of(functools.partial(_array, archive, {}, []))
        except NPZ_ERRORS as error:  # FormError and Config's are ValueErrors
            why = f" ({error})" if isinstance(error, FormError | ConfigError) else ""
            raise ConfigError(f"{path}: damaged, or not written by track --report{why}") from None

    @classmethod
    def _of(cls, array):
        """From ``array(name, **lengths)``, which reads and checks."""
        head = json.loads(str(array("head")))
        if isinstance(head, dict) and head.get("version", VERSION) != VERSION:
            raise ConfigError(f"version {str(head['version'])[:20]}: {VERSION} is needed; track again with --report")
        check(head, _HEAD, "head")
        kept = cls(Config(**head["config"]), head["engine"], head["recording"])
        config, declared = kept.config, columns(kept.config.motion, kept.config.slides)
        rows, side = array("rows", C=len(declared)).tolist(), kept.frame_bin
        for k, row in enumerate(rows):
            for (name, column), text in zip(declared.items(), row, strict=True):
                column.form.read(text, f"row {k}: {name}")
        kept.rows = [tuple(row) for row in rows]
        kept.left_out = head["left_out"]
        kept.spans, kept.truths = array("spans").tolist(), [tuple(pair) for pair in array("truths").tolist()]
        kept.roi_next = tuple(array("roi_next").tolist())
        batches = array("batches")
        if (np.diff(batches) <= 0).any() or batches[-1] >= len(rows):
            raise FormError("batches: numbers of rows, ascending, are needed")
        size = {"h": -(-config.sensor_height // side), "w": -(-config.sensor_width // side)}

        def split(counts, *names):
            ends = array(counts)
            for name in names:
                whole = array(name, P=len(config.motion_model.names))
                if ends.sum() != len(whole):
                    raise FormError(f"{name}: as many as {counts} say are needed")
                yield np.split(whole, np.cumsum(ends)[:-1])

        parts = (*split("counts", "x", "y", "since"), *split("velocities", "v"), *split("iterations", "levels"))
        kept.details = [Detail(*each) for each in zip(batches.tolist(), array("frames", **size), *parts, strict=True)]
        return kept


#: What a file's head is; its configuration checks itself.
_HEAD = {
    "version": Number(int), "engine": Text(), "recording": Text(), "left_out": Number(int, low=0), "config": dict,
}  # fmt: skip

#: The arrays: B batches with C columns, D of them with details, of frames h by w, N events, V velocities, L levels.
_ARRAYS = {
    "head": Array("U", width=1 << 22),
    "rows": Array("U", ("B", "C"), width=1 << 10),
    "spans": Array("i", ("B",), low=0, high=1 << 40),
    "truths": Array("f", ("B", 2), low=-1e12, high=1e12, gaps=True),
    "roi_next": Array("i", (2,), low=0, high=1 << 16),
    "batches": Array("i", ("D",), low=0),
    "counts": Array("i", ("D",), low=0, high=1 << 32),
    "iterations": Array("i", ("D",), low=0, high=1 << 32),
    "velocities": Array("i", ("D",), low=1, high=1 << 32),
    "frames": Array("u", ("D", "h", "w"), width=1),
    "x": Array("u", ("N",), width=2),
    "y": Array("u", ("N",), width=2),
    "since": Array("u", ("N",), width=4),
    "v": Array("f", ("V", "P"), low=-(1 << 12), high=1 << 12),
    "levels": Array("u", ("L",), width=1, high=3),
}


def _array(archive, lengths, sizes, name, **more):
    """An array of an archive, checked; ``lengths`` and ``sizes`` are those of all before it."""
    member, form = Member(archive, f"{name}.npy"), _ARRAYS[name]
    lengths.update(more)
    sizes.append(form.head(member, name, lengths))
    if sum(sizes) > MOST_BYTES:
        raise FormError(f"{name}: larger than tracks are")
    found = member.all()
    member.close()
    form.check(found, name)
    return found
