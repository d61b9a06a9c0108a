"""The table of regions: what each row says, and as what the hardware holds it."""

from dataclasses import dataclass

from ..errors import ConfigError
from .settings import Setting, plan_high, plan_places, table_entry
from .shapes import Place, leaves, whole

#: Largest log2 of a region's stride.
MOST_STRIDE = 7
#: Where a region's v starts: at the settings' start velocity, its own last, or another region's of the same batch.
STARTS = ("given", "last", "parent")


@dataclass(frozen=True, kw_only=True)
class Region:
    """One row of the table: which events, and how their motion is looked for.

    Parameters
    ----------
    x, y : int
        Left column and top row of the region on the sensor, px; in the undistorted image, where there is a camera.
    width, height : int
        Its size, px; events are those whose nearest pixel lies in it. It may hang over the sensor's right and lower
        edge.
    margin : (int, int), optional
        Columns and rows of the image to the left of it and above it, where votes of its events may go as well; by
        default it lies in the image's middle.
    start : str
        One of :data:`STARTS`: of that which was measured, and was not degenerate. Else the region begins cold.
    parent : int
        Number of the region whose v is taken with ``start="parent"``; smaller than its own.
    cold, warm : tuple of ScheduleEntry, optional
        Iterations from the start velocity, and from another v; by default those of the batch's settings.
    stride : int
        Every so many of its events are stored: a power of two, up to 2^:data:`MOST_STRIDE`.
    moves : bool
        The region moves by roi_gain·v after each batch, within the sensor.
    """

    x: int
    y: int
    width: int
    height: int
    margin: tuple[int, int] | None = None
    start: str = "given"
    parent: int = 0
    cold: tuple | None = None
    warm: tuple | None = None
    stride: int = 1
    moves: bool = False

    @classmethod
    def roi(cls, config, place, stride=1):
        """A row that is an ROI as a core has it: as large as the image, it begins at its last v, and moves by it."""
        size = {"width": config.roi_width, "height": config.roi_height}
        start = "last" if config.start == "last" else "given"
        return cls(x=place[0], y=place[1], **size, start=start, stride=stride, moves=True)

    def corner(self, config):
        """Column and row of the image in which the region begins."""
        if self.margin is not None:
            return self.margin
        return (config.roi_width - self.width) // 2, (config.roi_height - self.height) // 2

    def middle(self, config):
        """Column and row of the region's middle in the image, in half pixels."""
        size = self.width, self.height
        return tuple(2 * at + side - 1 for at, side in zip(self.corner(config), size, strict=True))

    def check(self, config, number):
        """Raise :exc:`ConfigError` unless row ``number`` of the hardware's table can hold it."""
        where, frame = f"region {number}", (config.roi_width, config.roi_height)
        if number >= config.regions:
            raise ConfigError(f"{where}: at most {config.regions} regions are allowed (regions)")
        places, sizes, sensor = (self.x, self.y), (self.width, self.height), config.geometry.size
        axes = zip("xy", places, sizes, self.corner(config), frame, sensor, strict=True)
        for name, place, side, at, most, end in axes:
            if side < 1 or at < 0 or at + side > most:
                allowed = f"at most {most} px are allowed (roi_width, roi_height)"
                raise ConfigError(f"{where}: {side} px along {name} from {at} of the image on: {allowed}")
            if not 0 <= place < end:
                raise ConfigError(f"{where}: {name} = {place}: 0 to {end - 1} is allowed")
        if self.start not in STARTS:
            raise ConfigError(f"{where}: start = {self.start!r}: one of {', '.join(STARTS)} is needed")
        if self.start == "parent" and not 0 <= self.parent < number:
            raise ConfigError(f"{where}: parent = {self.parent}: 0 to {number - 1} is needed, a row before it")
        for name in ("cold", "warm"):
            plan = getattr(self, name)
            if config.confidence and plan and plan[-1].stride > 1:
                raise ConfigError(f"{where}: the last iteration of {name} needs all events, as the probes: stride 1")
        if self.stride not in [1 << k for k in range(MOST_STRIDE + 1)]:
            raise ConfigError(f"{where}: stride = {self.stride}: a power of two up to {1 << MOST_STRIDE} is needed")


def _row(name, *, word=None, **more):
    places = more.pop("places", None) or (Place(word=word, register="ROW_HOW", **more.pop("at")),)
    return Setting(name=f"row_{name}", places=places, **more)


def _pixel(word, what):
    return tuple(
        Place(word=word, part=f"_{axis}", field=axis.upper(), lsb=16 * k, width=16, doc=f"{name} of {what}", unit="px")
        for k, (axis, name) in enumerate((("x", "column"), ("y", "row")))
    )


#: What the registers of a row hold, in the order of :func:`row_shape`, and which row it is, in the last one.
ROW = (
    _row("place", high=lambda c: {axis: size - 1 for axis, size in zip("xy", c.geometry.size, strict=True)},
         places=_pixel(0, "the sensor"), doc="where the region begins; of a fresh row"),
    _row("begin", high=lambda c: {"x": c.roi_width - 1, "y": c.roi_height - 1},
         places=_pixel(1, "the image"), doc="where it begins in the image"),
    _row("end", high=lambda c: {"x": c.roi_width, "y": c.roi_height},
         places=_pixel(2, "the image"), doc="the first place behind it, more than ROW_BEGIN"),
    _row("start", high=lambda c: len(STARTS) - 1, word=5, at={"field": "START", "width": 8},
         doc="where v starts: " + ", ".join(f"{k} {name}" for k, name in enumerate(STARTS))),
    _row("parent", shape=lambda c: whole(c.store.number_bits), high=lambda c: c.regions - 1, word=5,
         at={"field": "PARENT", "lsb": 16, "width": 16}, doc="row whose v is taken then; before this one"),
    _row("cold", high=plan_high, places=plan_places(3, "schedule of the region without another v"), doc="schedule"),
    _row("warm", high=plan_high, places=plan_places(4, "schedule of the region with another v"), doc="schedule"),
    _row("stride", high=lambda c: MOST_STRIDE, word=5, at={"field": "STRIDE", "lsb": 8, "width": 4},
         doc="one of 2^STRIDE events is stored"),
    _row("moves", shape=lambda c: whole(1), word=5, at={"field": "MOVES", "lsb": 12, "width": 1},
         doc="1: moves by ROI_GAIN·v after each batch"),
    Setting(name="number", shape=lambda c: whole(c.store.number_bits), high=lambda c: c.regions - 1,
            places=(Place(word=6, register="ROW_WRITE", field="NUMBER", width=16,
                          register_doc="write the other registers' row into the table"),),
            doc="which row; at most the number of those that are known"),
    Setting(name="fresh", shape=lambda c: whole(1),
            places=(Place(word=6, register="ROW_WRITE", field="FRESH", lsb=31, width=1),),
            doc="1: forget what was measured and where the region moved to"),
)  # fmt: skip


def row_shape(config):
    """A row of the table, as it is written."""
    rows = (part for part in ROW if part.name.startswith("row_"))
    return {part.name.removeprefix("row_"): part.shape_of(config) for part in rows}


class RegionTable:
    """A table of ``regions`` that is replaced between batches, and what of it the hardware does not hold yet."""

    #: Of a row to be written, in the order of :meth:`changes`.
    names = ("number", "fresh")

    def __init__(self, config):
        self.config, self.regions, self._rows = config, [], []
        self.names += tuple(leaves("row", row_shape(config)))

    def forget(self):
        """The hardware holds nothing: all rows will be written, fresh."""
        self._rows = [None] * len(self.regions)

    def replace(self, regions, anew=()):
        """Another table. A row that changes, or is one of ``anew``, forgets what was measured. :exc:`ConfigError`."""
        regions = list(regions)
        for number, region in enumerate(regions):
            region.check(self.config, number)
        known = zip(range(len(regions)), self.regions, self._rows, regions, strict=False)
        kept = [row if old == new and number not in anew else None for number, old, row, new in known]
        self.regions, self._rows = regions, kept + [None] * (len(regions) - len(kept))

    def changes(self, settings):
        """``(rows, schedule)``: those that are new, or whose schedules lie elsewhere now; and all of the schedule.

        Rows are tuples in the order of :attr:`names`; they count as written. Raises :exc:`ConfigError`.
        """
        rows, schedule = tables(self.config, self.regions, settings)
        changed = [
            (number, int(before is None), *row)
            for number, (before, row) in enumerate(zip(self._rows, rows, strict=True))
            if row != before
        ]
        self._rows = rows
        return changed, schedule


def tables(config, regions, settings):
    """What the hardware's tables hold for ``regions``: (rows, schedule).

    Rows are lists of the leaves of :func:`row_shape`; the schedule a list of :func:`~.settings.table_entry`, in which
    every plan lies once. Raises :exc:`ConfigError` where a region cannot be held, or the plans exceed the table.
    """
    places, entries = {}, []

    def plan(own, common):
        wanted = tuple(common if own is None else own)
        if wanted not in places:
            places[wanted] = len(entries)
            entries.extend(wanted)
        return places[wanted], len(wanted)

    rows = []
    for number, region in enumerate(regions):
        region.check(config, number)
        begin = region.corner(config)
        rows.append([
            region.x, region.y, *begin, begin[0] + region.width, begin[1] + region.height,
            STARTS.index(region.start), region.parent, *plan(region.cold, settings.cold),
            *plan(region.warm, settings.warm), region.stride.bit_length() - 1, int(region.moves),
        ])  # fmt: skip
    if len(entries) > config.schedule_entries:
        most = f"at most {config.schedule_entries} are allowed (schedule_entries)"
        raise ConfigError(f"schedules of the regions: {len(entries)} iterations; {most}")
    return rows, [table_entry(config, entry) for entry in entries]
