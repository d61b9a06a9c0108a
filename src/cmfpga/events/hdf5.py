"""HDF5 recordings: reading the common layouts, writing our own.

Read, in this order (names of the columns: see ``columns.NAMES``):

- ``events/{t,x,y,p}``, ours and the common one; a scalar ``t_offset`` at the root is added to t (DSEC);
- ``events`` as a compound data set, or of N×4 with columns t, x, y, p;
- ``{t,x,y,p}`` at the root;
- ``CD/events`` as a compound data set (Prophesee, in µs; its compression, ECF, is decoded in :mod:`~.ecf`);
- ``davis/left/events`` of N×4 with columns x, y, t, p (MVSEC, 346×260 px);
- the only other group of t, x, y, p, or compound data set of them, wherever it lies; or the one that the caller names.

Attributes, of the data set, its group or the root: ``unit``, ``units`` or ``time_unit`` (of t; of groups only
``time_unit``), ``sensor_width`` and ``sensor_height``, ``width`` and ``height``, ``sensor_resolution`` as (height,
width), or ``geometry`` as ``"WxH"``. A file with ``t_offset`` and ``ms_to_idx`` is of DSEC, 640×480 px.
"""

import contextlib
import math
import os
import re
from pathlib import Path

import h5py
import numpy as np

from ..errors import RecordingError
from .columns import NAMES, Columns, ColumnsRecording, match_names, one_line, readable, require_names
from .ecf import EcfDataset, EcfError, is_compressed
from .recording import CHUNK_EVENTS, Format, check_sensor
from .units import parse_unit

_READ_ERRORS = (OSError, RuntimeError, KeyError, EcfError, MemoryError)
_MAGIC = b"\x89HDF\r\n\x1a\n"
_MVSEC, _PROPHESEE = "davis/left/events", "CD/events"
# Registered numbers of filters that HDF5 does not bring itself.
_FILTERS = {
    307: "bzip2", 32000: "LZF", 32001: "Blosc", 32004: "LZ4", 32008: "Bitshuffle", 32013: "ZFP", 32015: "Zstandard",
    32026: "Blosc2",
}  # fmt: skip
# Classes of types of attributes that are read.
_PLAIN = (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING, h5py.h5t.ENUM)
# Data sets that a message names.
_SHOWN = 8
_DSEC_SENSOR = (640, 480)
_MVSEC_SENSOR = (346, 260)

# HDF5 reads chunks whole, and we a number of events; in files of cameras that is some 100 kB.
_MOST_PIECE = 1 << 26

# Events per stored chunk: small enough to read little around a batch, large enough to compress.
_STORED_CHUNK = 1 << 14


class Hdf5Recording(ColumnsRecording):
    """Events of an HDF5 file; see the module for the layouts. Chunks are read from the file as they are asked for.

    ``dataset`` is the path of a data set or of a group; ``columns`` the names of the columns of N×4.
    """

    def __init__(self, path, *, time_unit=None, sensor=None, columns=None, dataset=None):
        errors = (*_READ_ERRORS, ValueError, TypeError)
        with readable(f"{path}: not a readable HDF5 file", errors), contextlib.ExitStack() as opened:
            self._file = opened.enter_context(h5py.File(path, "r"))
            source, order, holders = _find_events(self._file, path, dataset)
            offset = self._file.get("t_offset")
            dsec = offset is not None and "ms_to_idx" in self._file
            layout_sensor = _MVSEC_SENSOR if order else _DSEC_SENSOR if dsec else None
            found = Columns(source, str(path), columns or order)
            unit = _unit(holders, path) or ("us" if holders[0].name == f"/{_PROPHESEE}" else None)
            super().__init__(
                lambda: found, path=path, format="HDF5", sensor=sensor or _sensor(holders, path) or layout_sensor,
                time_unit=time_unit, file_unit=unit, read_errors=_READ_ERRORS,
                t_offset=None if offset is None else _single(offset, f"{path}: t_offset"),
            )  # fmt: skip
            opened.pop_all()


def _node_of_events(file, path, dataset):
    """The data set, or the group, that holds the events."""
    if dataset is not None:
        if (node := file.get(dataset)) is None:
            raise RecordingError(f"{path}: no data set {dataset!r}; it holds {_contents(file)}")
        return node
    for name in (_MVSEC, _PROPHESEE, "events"):
        if isinstance(node := file.get(name), h5py.Dataset):
            return node
    groups = [group for group in (file.get("events"), file) if group is not None]
    group = max(groups, key=lambda group: len(match_names(group)))  # the first of equals
    if match_names(group):
        return group
    elsewhere = []
    file.visititems(lambda _, node: elsewhere.append(node) if _has_columns(node) else None)
    if len(elsewhere) != 1:
        what = f"events in {' and '.join(node.name for node in elsewhere)}" if elsewhere else "no events found"
        raise RecordingError(f"{path}: {what}; it holds {_contents(file)}; --dataset PATH (dataset=) says which it is")
    return elsewhere[0]


def _has_columns(node):
    """Whether it is a group, or a compound data set, of t, x, y and p."""
    names = node.dtype.names or () if isinstance(node, h5py.Dataset) else node.keys()
    return len(match_names(names)) == len(NAMES)


def _contents(file):
    """The data sets of a file, for people."""
    found = []
    file.visititems(lambda name, node: found.append((name, node)) if isinstance(node, h5py.Dataset) else None)
    shown = [
        f"{name} ({'×'.join(map(str, node.shape or ())) or 'one'} {'compound' if node.dtype.names else node.dtype})"
        for name, node in found[:_SHOWN]
    ]
    more = [f"{len(found) - _SHOWN} more"] if len(found) > _SHOWN else []
    return ", ".join(shown + more) or "no data sets"


def _single(dataset, where):
    """A number that a data set holds, as an array of one."""
    if not isinstance(dataset, h5py.Dataset) or dataset.size != 1 or dataset.dtype.kind not in "iuf":
        raise RecordingError(f"{where}: a number is needed")
    return np.reshape(dataset[()], (1,))


def _require_events(dataset, path):
    """Raises :exc:`RecordingError` where the file does not hold all that is declared: HDF5 gives zeros, without end."""
    shape, chunk, stored = dataset.shape or (), dataset.chunks, dataset.id.get_storage_size()
    if dataset.is_virtual:
        raise RecordingError(f"{path}: {dataset.name} refers to other files; a copy of its events is needed")
    piece = dataset.dtype.itemsize * max(math.prod(chunk or (1,)), CHUNK_EVENTS)
    if piece > _MOST_PIECE:
        raise RecordingError(f"{path}: {dataset.name}: pieces of {piece:,} bytes are needed at a time; too large")
    if chunk:
        chunks = math.prod(-(-size // step) for size, step in zip(shape, chunk, strict=True))
        short = dataset.id.get_num_chunks() < chunks
    else:
        short = stored < math.prod(shape) * dataset.dtype.itemsize
    if short or stored > os.path.getsize(dataset.file.filename):
        size = "×".join(map(str, shape))
        raise RecordingError(f"{path}: {dataset.name} (truncated or damaged): it declares {size}, and holds less")


def _require_filters(dataset, path):
    """Raises :exc:`RecordingError` where the data set cannot be read without a filter that is not installed."""
    made = dataset.id.get_create_plist()
    filters = {number: said for number, _, _, said in map(made.get_filter, range(made.get_nfilters()))}
    cure = "pip install hdf5plugin"
    if not all(map(h5py.h5z.filter_avail, filters)):
        with contextlib.suppress(ImportError):
            import hdf5plugin  # noqa: F401 registers its filters

            cure = "hdf5plugin does not bring it; a copy without it is needed"
    for number, said in filters.items():
        if not h5py.h5z.filter_avail(number):
            with contextlib.suppress(OSError):  # an optional filter that was not used
                return dataset[:1]
            name = _FILTERS.get(number) or said.decode("latin-1")[:40]
            which = f"{f'{name} ' * bool(name)}(id {number})"
            raise RecordingError(f"{path}: {dataset.name} needs the HDF5 filter {which}, which is missing: {cure}")


def _find_events(file, path, dataset):
    """Source and order of the columns for :class:`Columns`, and the objects whose attributes count, nearest first."""
    node = _node_of_events(file, path, dataset)
    if isinstance(node, h5py.Dataset):
        _require_events(node, path)
        if not is_compressed(node):
            _require_filters(node, path)
        source = EcfDataset(node) if is_compressed(node) else node
        return source, "xytp" if node.name == f"/{_MVSEC}" else None, (node, node.parent, file)
    names = require_names(node, path if node == file else f"{path}: {node.name.strip('/')}")
    source = {column: node[name] for column, name in names.items()}
    for column, dataset in source.items():
        if not isinstance(dataset, h5py.Dataset):
            raise RecordingError(f"{path}: {dataset.name} is a group; {column} needs to be a data set")
        _require_events(dataset, path)
        _require_filters(dataset, path)
    return source, None, (source["t"], node, file)


def _attribute(holder, name, path):
    """An attribute's value. Raises :exc:`RecordingError` where it is neither text nor numbers.

    Of a type of variable length HDF5 would follow damaged addresses out of the memory, and end the process.
    """
    if holder.attrs.get_id(name).get_type().get_class() not in _PLAIN:
        raise RecordingError(f"{path}: attribute {name} of {holder.name}: text or numbers are needed")
    return holder.attrs[name]


def _unit(holders, path):
    """Unit that the attributes name, or None."""
    for k, holder in enumerate(holders):
        for name in ("time_unit", "unit", "units") if k == 0 else ("time_unit",):
            if name in holder.attrs:
                where = f"{path}: attribute {name} of {holder.name}"
                return parse_unit(_attribute(holder, name, path), where)
    return None


def _sensor(holders, path):
    """(width, height) that the attributes name, or None."""
    for holder in holders:
        for pair in (("sensor_width", "sensor_height"), ("width", "height")):
            if all(name in holder.attrs for name in pair):
                sizes = [_scalar(_attribute(holder, name, path)) for name in pair]
                return check_sensor(sizes, f"{path}: attributes {' and '.join(pair)}")
        if "sensor_resolution" in holder.attrs:
            height_width = np.ravel(_attribute(holder, "sensor_resolution", path))[:2]
            return check_sensor(list(map(_scalar, height_width))[::-1], f"{path}: attribute sensor_resolution")
        geometry = _attribute(holder, "geometry", path) if "geometry" in holder.attrs else None
        geometry = geometry.decode("latin-1") if isinstance(geometry, bytes) else geometry
        if isinstance(geometry, str) and (size := re.fullmatch(r"(\d+)x(\d+)", geometry)):
            return check_sensor(map(int, size.groups()), f"{path}: attribute geometry")
    return None


def _scalar(value):
    """An attribute's number: whole floats and arrays of one element (as MATLAB writes them) are integers too."""
    value = np.ravel(value)
    if value.dtype.kind == "f" and (value == np.floor(value)).all() and (abs(value) < 1 << 53).all():
        value = value.astype(np.int64)
    return value[0] if len(value) == 1 else value


class Hdf5Writer:
    """Writes a recording piece by piece, in bounded memory; a context manager. An existing file is replaced.

    Layout: ``/events/t`` int64 µs, ``/events/x`` and ``/events/y`` uint16, ``/events/p`` uint8, compressed; root
    attributes ``sensor_width`` and ``sensor_height``, px, ``num_events``, ``t_first_us``, ``t_last_us``. Raises
    :exc:`RecordingError` where the sensor's size is not allowed, the file cannot be written, or there were no events.
    """

    def __init__(self, path, width, height):
        self.path = Path(path)
        self._sensor = check_sensor((width, height), path)
        self._file = self._first = self._last = None
        self._count = 0

    def __enter__(self):
        with self._errors():
            self._file = h5py.File(self.path, "w")
        return self

    def __exit__(self, kind, *_):
        with self._errors():
            if kind is None and self._count:
                width, height = self._sensor
                self._file.attrs.update(
                    sensor_width=width, sensor_height=height, num_events=self._count, t_first_us=self._first,
                    t_last_us=self._last,
                )  # fmt: skip
            self._file.close()
        if kind is None and not self._count:
            raise RecordingError(f"{self.path}: no events to write")

    @contextlib.contextmanager
    def _errors(self):
        try:
            yield
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno else one_line(error)  # HDF5's own text is long
            raise RecordingError(f"{self.path}: cannot be written: {reason}") from None

    def write(self, events):
        """Append :class:`Events`, which follow the last ones in time."""
        if not len(events):
            return
        with self._errors():
            for name in NAMES:
                values = getattr(events, name)
                if not self._count:
                    # Small recordings keep small chunks; a chunk is never larger than the first piece.
                    self._file.create_dataset(
                        f"events/{name}", data=values, maxshape=(None,), chunks=(min(len(values), _STORED_CHUNK),),
                        compression="gzip", shuffle=True,
                    )  # fmt: skip
                    continue
                column = self._file[f"events/{name}"]
                column.resize(self._count + len(events), axis=0)
                column[self._count :] = values
            self._file["events/t"].attrs["unit"] = "microseconds"
        self._first = int(events.t[0]) if self._first is None else self._first
        self._last = int(events.t[-1])
        self._count += len(events)

    def attributes(self, **attrs):
        """Further root attributes: strings, numbers, arrays of numbers."""
        with self._errors():
            self._file.attrs.update(attrs)

    def calibration(self, numbers):
        """The camera: ``fx fy cx cy k1 k2 p1 p2 k3``, as ``/camera_calibration``."""
        with self._errors():
            self._file.create_dataset("camera_calibration", data=numbers).attrs["order"] = "fx fy cx cy k1 k2 p1 p2 k3"

    def ground_truth(self, times, velocities, start):
        """The true motion, constant piece by piece, as ``/ground_truth/motion/t``, ``velocity`` and ``start``.

        ``times`` [N], µs, begin each piece, of ``velocities`` [N, 2], px/s; at the first of them the object's centre is
        at ``start`` [2], px.
        """
        with self._errors():
            group = self._file.create_group("ground_truth/motion")
            for name, values, unit in (("t", times, "us"), ("velocity", velocities, "px/s"), ("start", start, "px")):
                group.create_dataset(name, data=values).attrs["unit"] = unit


def write_hdf5(path, events, width, height, **attrs):
    """Writes :class:`Events`, at least one, as a recording that :func:`open_recording` reads back unchanged.

    See :class:`Hdf5Writer`; ``attrs`` are further root attributes: strings, numbers, arrays of numbers.
    """
    if not len(events):
        raise RecordingError(f"{path}: no events to write")
    with Hdf5Writer(path, width, height) as writer:
        writer.write(events)
        writer.attributes(**attrs)


def _matches(head, path):
    # The signature may also stand after a user block, at 512, 1024, 2048 … bytes.
    return head.startswith(_MAGIC) or any(head[at : at + 8] == _MAGIC for at in (512, 1024, 2048))


FORMATS = (Format("HDF5", (".h5", ".hdf5", ".hdf"), _matches, Hdf5Recording, ("columns", "dataset")),)
