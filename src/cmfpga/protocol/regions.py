"""The table of regions: what each row says, and as what the hardware holds it.

Imports neither Amaranth nor NumPy.
"""

from dataclasses import dataclass

from ..errors import ConfigError
from .settings import plan_shape, table_entry
from .shapes import pair, up_to, whole

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

    def corner(self, config):
        """Column and row of the image in which the region begins."""
        if self.margin is not None:
            return self.margin
        return (config.roi_width - self.width) // 2, (config.roi_height - self.height) // 2

    def check(self, config, number):
        """Raise :exc:`ConfigError` unless row ``number`` of the hardware's table can hold it."""
        where, frame = f"region {number}", (config.roi_width, config.roi_height)
        size, sensor = (self.width, self.height), (config.sensor_width, config.sensor_height)
        if number >= config.regions:
            raise ConfigError(f"{where}: at most {config.regions} regions are allowed (regions)")
        for name, axis, side, at, most in zip("xy", (self.x, self.y), size, self.corner(config), frame, strict=True):
            if side < 1 or at < 0 or at + side > most:
                raise ConfigError(
                    f"{where}: {side} px along {name} from {at} of the image on: at most {most} px are allowed "
                    "(roi_width, roi_height)"
                )
            if not 0 <= axis < sensor["xy".index(name)]:
                raise ConfigError(f"{where}: {name} = {axis}: 0 to {sensor['xy'.index(name)] - 1} is allowed")
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


def row_shape(config):
    """A row of the table, as it is written."""
    geometry, plan = config.geometry, plan_shape(config)
    return {
        "place": pair(whole(geometry.x_bits), whole(geometry.y_bits)),
        "begin": pair(up_to(config.roi_width - 1), up_to(config.roi_height - 1)),
        "end": pair(up_to(config.roi_width), up_to(config.roi_height)),  # the first column and row behind it
        "start": up_to(len(STARTS) - 1),
        "parent": whole(config.store.number_bits),
        "cold": plan,
        "warm": plan,
        "stride": up_to(MOST_STRIDE),
        "moves": whole(1),
    }


def tables(config, regions, settings):
    """What the hardware's tables hold for ``regions``: (rows, schedule).

    Rows are lists of the leaves of :func:`row_shape`; the schedule a list of :func:`~.settings.table_entry`, in which
    every plan lies once.

    Raises
    ------
    ConfigError
        A region cannot be held, or the plans are longer than the table of schedules.
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
        rows.append(
            [
                region.x,
                region.y,
                *begin,
                begin[0] + region.width,
                begin[1] + region.height,
                STARTS.index(region.start),
                region.parent,
                *plan(region.cold, settings.cold),
                *plan(region.warm, settings.warm),
                region.stride.bit_length() - 1,
                int(region.moves),
            ]
        )
    if len(entries) > config.schedule_entries:
        raise ConfigError(
            f"schedules of the regions: {len(entries)} iterations; at most {config.schedule_entries} are allowed "
            "(schedule_entries)"
        )
    return rows, [table_entry(config, entry) for entry in entries]
