"""Files of a true motion, told apart by what is in them.

- Text of numbers, with or without a line of names and units (``t_us, vx_px_per_s, vy_px_per_s``; ``t [s] wx [deg/s]``):
  ``t vx vy``, the image's velocity; ``t wx wy wz`` or ``t ax ay az gx gy gz``, a gyroscope or an IMU;
  ``t px py pz qx qy qz qw``, poses. Without names the number of columns tells which.
- What :mod:`.fields` reads: the flow of every pixel.
- What :mod:`.pieces` reads: a recording with ``/ground_truth/motion``, or a ``.truth.csv``.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ..errors import RecordingError
from ..events.textlines import split_line
from ..events.units import POWER, find_unit
from .fields import DATASETS, is_field, read_field
from .pieces import COLUMNS, Signal, read_truth, read_truth_csv

VELOCITY, GYROSCOPE, POSES, FIELD = "velocity", "gyroscope", "poses", "flow field"

#: ``{column: names that it goes by}``.
_NAMES = {
    "t": ("t", "ts", "time", "timestamp", "timestamps"),
    "vx": ("vx",), "vy": ("vy",),
    **{f"w{axis}": (f"w{axis}", f"g{axis}", f"gyro_{axis}", f"omega_{axis}", f"angular_velocity_{axis}",
                   f"w_rs_s_{axis}") for axis in "xyz"},
    **{f"p{axis}": (f"p{axis}", f"t{axis}", f"position_{axis}", f"p_rs_r_{axis}", axis) for axis in "xyz"},
    **{f"q{axis}": (f"q{axis}", f"orientation_{axis}", f"q_rs_{axis}") for axis in "xyzw"},
}  # fmt: skip
_COLUMN_OF = {alias: column for column, aliases in _NAMES.items() for alias in aliases}

#: ``{kind: its columns}``.
_KINDS = {
    VELOCITY: ("t", "vx", "vy"),
    GYROSCOPE: ("t", "wx", "wy", "wz"),
    POSES: ("t", "px", "py", "pz", "qx", "qy", "qz", "qw"),
}

#: ``{number of columns: their names}`` of a file that does not name them.
_UNNAMED = {
    3: _KINDS[VELOCITY],
    4: _KINDS[GYROSCOPE],
    7: ("t", "ax", "ay", "az", "wx", "wy", "wz"),
    8: _KINDS[POSES],
}

#: ``{first letter of a column: {unit: factor to px/s, rad/s, m}}``; the first is that without a unit.
_UNITS = {
    "v": {"px/s": 1.0},
    "w": {"rad/s": 1.0, "deg/s": math.pi / 180},
    "p": {"m": 1.0, "mm": 1e-3},
    "q": {},
}
_NAME = re.compile(r"([a-z]\w*)(?:\s*[\[(]\s*([^\])]*?)\s*[\])])?")
_ENDING = re.compile(r"(\w+?)_(px_per_s|rad_per_s|deg_per_s|px/s|rad/s|deg/s|s|ms|us|µs|ns|m|mm)")

#: A file has no more.
_MOST_BYTES = 1 << 28
_TELLING = "t vx vy; t wx wy wz; t ax ay az gx gy gz; or t px py pz qx qy qz qw"


@dataclass(frozen=True, eq=False)
class Known:
    """A true motion over time.

    Of the ``kind`` :data:`VELOCITY` the ``signal`` has (vx, vy) in px/s. :data:`GYROSCOPE`: the camera's angular
    velocity about its x (right), y (down) and z (forward), rad/s. :data:`POSES`: this, and behind it its velocity along
    these, m/s. :data:`FIELD`: a :class:`FlowField <cmfpga.truth.fields.FlowField>`.
    """

    name: str  # of its file, as the rows
    kind: str
    signal: Signal
    rows: int

    @property
    def text(self):
        """What it is, for people."""
        return f"{self.name}: {self.kind}, {self.rows:,} rows, {self._range}"

    @property
    def _range(self):
        first, last = self.signal.first / 1e6, self.signal.last / 1e6
        return f"{first:.6f} s to {f'{last:.6f} s' if math.isfinite(last) else 'the end'}"

    def apart(self, first, last):
        """The :exc:`RecordingError` of events from ``first`` to ``last``, µs, of which it says nothing."""
        return RecordingError(
            f"{self.name}: {self._range}; the events lie at {first / 1e6:.6f} s to {last / 1e6:.6f} s: no time in "
            "common (--delay, --truth-unit)"
        )


def read_known(path, unit=None):
    """The :class:`Known` of a file. Raises :exc:`RecordingError` where it is none of these, or of no use; one line.

    ``unit``, one of s, ms, us and ns, is that of a text's times. By default what its names say; else s, if one has a
    fraction, and µs if none has.
    """
    path = Path(path)
    hdf5 = path.is_file() and h5py.is_hdf5(path)
    if hdf5 and (found := read_truth(path)):
        return of_pieces(found, path)
    if is_field(path):
        field = read_field(path)
        return Known(str(path), FIELD, field, len(field.times))
    if hdf5:
        needed = f"/ground_truth/motion, a flow ({', '.join(DATASETS)}), or a text ({_TELLING})"
        raise RecordingError(f"{path}: no true motion; {needed}, is needed")
    lines = _lines(path)
    table = _table(path, lines)
    names = _header(path, lines, table.shape[1])
    if names and {*COLUMNS} <= {name for name, *_ in names} and unit in (None, "us"):
        return of_pieces(read_truth_csv(path), path)
    columns = [column for _, column, _ in names] if names else _UNNAMED.get(table.shape[1], ())
    kind = next((kind for kind, needed in _KINDS.items() if {*needed} <= {*columns}), None)
    if kind is None:
        told = f"columns {', '.join(columns)[:60]}" if columns else f"{table.shape[1]} columns"
        raise RecordingError(f"{path}: {told}: of no known kind; {_TELLING} is needed")
    units = dict(zip(columns, [told for _, _, told in names] if names else [None] * len(columns), strict=True))
    picked = [_scaled(path, name, table[:, columns.index(name)], units[name]) for name in _KINDS[kind][1:]]
    times = table[:, columns.index("t")]
    unit = unit or _time_unit(path, units["t"]) or ("s" if (times % 1).any() else "us")
    return _known(path, kind, times * 10.0 ** POWER[unit], np.stack(picked, axis=1))


def of_pieces(found, path):
    """The :class:`Known` of a :class:`Truth`; its last piece has no end."""
    signal = Signal(found.times, found.velocities, end=math.inf)
    return Known(str(path), VELOCITY, signal, len(found.times))


def _known(path, kind, times, values):
    if len(times) < 2:
        raise RecordingError(f"{path}: {len(times)} row{'s' * (len(times) != 1)}; two or more are needed")
    if (back := np.diff(times) <= 0).any():
        row = int(back.argmax()) + 2
        raise RecordingError(f"{path}, row {row}: its time is not after that of the row before; it must increase")
    if kind != POSES:
        return Known(str(path), kind, Signal(times, values), len(times))
    length = np.linalg.norm(values[:, 3:], axis=1)
    if (off := np.abs(length - 1) > 0.05).any():
        k = int(off.argmax())
        raise RecordingError(f"{path}, row {k + 1}: qx qy qz qw are no rotation: of length {length[k]:.3g}, not 1")
    return Known(str(path), kind, Signal(times[:-1], _rates(times, values), end=times[-1]), len(times))


def _rates(times, poses):
    """Between poses: angular velocity, rad/s, and velocity, m/s, along the camera's axes, float64 [n − 1, 6]."""
    place, q = poses[:, :3], poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1)[:, None]
    seconds = np.diff(times)[:, None] / 1e6
    back, w = -q[:-1, :3], q[:-1, 3:]
    turn = w * q[1:, :3] + q[1:, 3:] * back + np.cross(back, q[1:, :3])  # of the inverse of one, times the next
    cosine = w[:, 0] * q[1:, 3] - (back * q[1:, :3]).sum(axis=1)
    sine = np.linalg.norm(turn, axis=1)
    angle = 2 * np.arctan2(sine, np.abs(cosine)) * np.where(cosine < 0, -1, 1)
    turn = turn * (angle / np.where(sine > 1e-12, sine, 1))[:, None]
    middle = q[:-1] + q[1:] * np.where(cosine < 0, -1, 1)[:, None]
    middle /= np.linalg.norm(middle, axis=1)[:, None]
    step, axis = np.diff(place, axis=0), -middle[:, :3]
    across = np.cross(axis, step)
    moved = step + 2 * (middle[:, 3:] * across + np.cross(axis, across))
    return np.concatenate([turn, moved], axis=1) / seconds


def _lines(path):
    """``[(number, bytes)]`` of the lines that are not empty."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise RecordingError(f"{path}: larger than {_MOST_BYTES >> 20} MB; a text of fewer rows is needed")
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise RecordingError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if b"\0" in content[:4096]:
        raise RecordingError(f"{path}: no text; {_TELLING} is needed")
    lines = enumerate(content.removeprefix(b"\xef\xbb\xbf").split(b"\n"), 1)
    return [(number, line.strip()) for number, line in lines if line.strip()]


def _header(path, lines, width):
    """``[(name, column, unit or None)]`` of the last line of so many names before the numbers; None without one."""
    found = None
    for _, line in lines:
        if (fields := split_line(line)) and _is_number(fields[0]):
            break
        names = []
        for name, bracketed in _NAME.findall(line.decode("utf-8", "replace").lstrip("#% ").lower()):
            ending = _ENDING.fullmatch(name)
            stem, unit = ending.groups() if ending else (name, None)
            names.append((name, _COLUMN_OF.get(stem, stem), bracketed or unit))
        found = names if len(names) == width else found
    if found and len({column for _, column, _ in found}) < width:
        raise RecordingError(f"{path}: a column is named twice in {', '.join(name for name, *_ in found)[:80]}")
    return found


def _is_number(text):
    try:
        return float(text) is not None
    except ValueError:
        return False


def _table(path, lines):
    """The numbers, float64 [n, columns]."""
    rows, width, begun = [], None, False
    for number, line in lines:
        if not (fields := split_line(line)):
            continue
        if not begun and not _is_number(fields[0]):
            continue  # names
        begun, width = True, width or len(fields)
        try:
            row = [*map(float, fields)]
        except ValueError:
            row = []
        if len(row) != width or len(row) < 3:
            raise RecordingError(f"{path}, line {number}: {max(width, 3)} numbers are needed ({_TELLING})")
        if not all(map(math.isfinite, row)):
            raise RecordingError(f"{path}, line {number}: finite numbers are needed, no NaN")
        rows.append(row)
    if not rows:
        raise RecordingError(f"{path}: no rows of numbers; {_TELLING} is needed")
    return np.array(rows)


def _scaled(path, name, values, unit):
    units = _UNITS[name[0]]
    if not unit or not units:
        return values
    unit = unit.replace("_per_", "/").replace(" s^-1", "/s").replace("°", "deg")
    if unit not in units:
        raise RecordingError(f"{path}: {name} in {unit[:20]!r}: {' or '.join(units)} is needed")
    return values * units[unit]


def _time_unit(path, text):
    if not text:
        return None
    unit = find_unit(text)
    if unit is None:
        raise RecordingError(f"{path}: t in {text[:20]!r}: one of {', '.join(POWER)} is needed")
    return unit
