"""A camera's intrinsics: from pixels to rays and back, and how its own rotation moves the image.

A calibration stands in HDF5, in a ROS ``camera_info`` YAML, or in a plain text of nine numbers.
"""

import os
import re
import stat
from dataclasses import astuple, dataclass

import h5py
import numpy as np

from ...config.checks import CAMERA_NAMES, parse_camera
from ...errors import ConfigError, needs
from ...forms import FormError, Many, Text, check

#: Most rounds of the fixed point that undistorts, and what it has to settle within; event cameras' lenses take 20.
_ROUNDS, _SETTLED = 200, 1e-13
_ALLOWED_PX = 1e-3  # between a pixel and the ray that was found for it, seen again


@dataclass(frozen=True)
class Camera:
    """Pinhole and distortion of Brown and Conrady, in OpenCV's order: focal lengths f and principal point c, px; radial
    (k) and tangential (p) distortion.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __str__(self):
        distortion = ", ".join(f"{name} = {value:g}" for name, value in list(vars(self).items())[4:] if value)
        place = f"f = {self.fx:g}, {self.fy:g} px, centre {self.cx:g}, {self.cy:g} px"
        return f"{place}, {distortion or 'no distortion'}"

    @property
    def text(self):
        """The numbers as the field ``camera`` of a :class:`~cmfpga.config.Config` has them."""
        return ",".join(map(repr, map(float, astuple(self))))

    def _distort(self, x, y):
        _, _, _, _, k1, k2, p1, p2, k3 = astuple(self)
        r = x * x + y * y
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        return radial, 2 * p1 * x * y + p2 * (r + 2 * x * x), p1 * (r + 2 * y * y) + 2 * p2 * x * y

    def rays(self, column, row):
        """X/Z and Y/Z of what is seen at ``column`` and ``row``, px: float64 [2, n].

        OpenCV's iteration, until it has settled. Raises :exc:`ConfigError` where it does not.
        """
        seen = np.stack([(np.asarray(column) - self.cx) / self.fx, (np.asarray(row) - self.cy) / self.fy])
        found = seen
        with np.errstate(all="ignore"):  # where it does not settle
            for _ in range(_ROUNDS):
                radial, *shift = self._distort(*found)
                before, found = found, (seen - np.stack(shift)) / radial
                if np.abs(found - before).max(initial=0) < _SETTLED:
                    break
            again = self.pixels(*found)
        missed = ~(np.abs(again - np.stack([np.asarray(column), np.asarray(row)])).max(axis=0) < _ALLOWED_PX)
        if missed.any():
            k = int(np.flatnonzero(missed)[0])
            at = f"{np.ravel(column)[k]:g},{np.ravel(row)[k]:g}"
            raise ConfigError(f"camera: {self}: no ray is seen at {at} px; this distortion is no lens's there")
        return found

    def undistorted(self, column, row):
        """Where a camera without distortion, of the same focal lengths and centre, sees it: px, float64 [2, n]."""
        x, y = self.rays(column, row)
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy])

    def distorted(self, column, row):
        """The other way round: where this camera sees what that one sees there, px: float64 [2, n]."""
        return self.pixels((np.asarray(column) - self.cx) / self.fx, (np.asarray(row) - self.cy) / self.fy)

    def pixels(self, x, y):
        """Column and row, px, where a ray is seen: float64 [2, n]."""
        radial, *shift = self._distort(x, y)
        return np.stack([(x * radial + shift[0]) * self.fx + self.cx, (y * radial + shift[1]) * self.fy + self.cy])

    @staticmethod
    def rotation(x, y):
        """How rays at ``x``, ``y`` move per rad of the camera's rotation about its x, y, z: float64 [2, 3, n]."""
        return np.stack([[x * y, -(1 + x * x), y], [1 + y * y, -x * y, -x]])

    def speeds(self, omega, column, row, dt=1e-4):
        """(vx, vy) in px/s at ``column`` and ``row``, px, of a still scene, the camera turning by ``omega`` rad/s."""
        at = self.rays(column, row)
        step = np.einsum("akn,k->an", self.rotation(*at), np.asarray(omega, float)) * dt
        return (self.pixels(*(at + step)) - self.pixels(*(at - step))) / (2 * dt)


#: The data set of an HDF5 file: nine numbers in the order of :data:`~cmfpga.config.checks.CAMERA_NAMES`.
DATASET = "camera_calibration"

_MODEL = "plumb_bob"
_NUMBER = Text(parse=float)
_NUMBERS = re.compile(r"[-+.,eE\d\s]+")
_LARGEST = 1 << 16  # bytes of a text


@dataclass(frozen=True)
class Calibration:
    """A camera, and the size of its images where the file tells it: (width, height), px."""

    camera: Camera
    size: tuple[int, int] | None = None


def read_calibration(path):
    """The :class:`Calibration` of a file.

    - HDF5: the data set ``/camera_calibration``, nine numbers;
    - a ROS ``camera_info`` YAML (``camera_matrix``, ``distortion_coefficients``, ``distortion_model: plumb_bob``), as
      ROS's camera calibrator writes it, or the message (``K``, ``D``);
    - any other text: ``fx fy cx cy k1 k2 p1 p2 k3``; k3, or all distortion, may be left out.

    Raises :exc:`ConfigError`, in one line, where it cannot be read, holds no calibration, or one of another model.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise ConfigError(f"{path}: no readable calibration (not a regular file)")
        if h5py.is_hdf5(path):
            with h5py.File(path, "r") as file:
                found = calibration_of(file, path)
            if found is None:
                raise ConfigError(f"{path}: no calibration; the data set /{DATASET} is needed")
            return found
        with open(path, encoding="utf-8") as file:
            text = file.read(_LARGEST + 1)
    except ConfigError:  # which is a ValueError
        raise
    except (OSError, ValueError, RuntimeError) as error:  # ValueError: no UTF-8, or a NUL in the path
        raise ConfigError(f"{path}: no readable calibration ({getattr(error, 'strerror', None) or error})") from None
    if len(text) > _LARGEST:
        raise ConfigError(f"{path}: no calibration: larger than {_LARGEST >> 10} kB")
    lines = [line.partition("#")[0] for line in text.splitlines()]
    if not any(":" in line for line in lines):
        return Calibration(_camera(" ".join(lines), path))
    with needs("yaml", "", f"{path}, a YAML file"):
        import yaml

    class Plain(yaml.BaseLoader):
        """Texts, lists and mappings only; no aliases, of which a few lines fill any memory."""

        def compose_node(self, parent, index):
            if self.check_event(yaml.AliasEvent):
                raise yaml.MarkedYAMLError(problem="aliases are not read")
            return super().compose_node(parent, index)

    try:
        content = next(yaml.load_all(text, Plain), None)
    except RecursionError:
        raise ConfigError(f"{path}: no readable YAML (nested too deeply)") from None
    except yaml.YAMLError as error:
        why = " ".join(str(getattr(error, "problem", None) or "no YAML").split())
        raise ConfigError(f"{path}: no readable YAML ({why})") from None
    return _of_camera_info(content if isinstance(content, dict) else {}, path)


def calibration_of(file, path):
    """The :class:`Calibration` of an open HDF5 file, None without one. Raises :exc:`ConfigError`."""
    try:
        node = file.get(DATASET)
        if node is None:
            return None
        if not isinstance(node, h5py.Dataset) or node.dtype.kind not in "iuf" or node.shape != (len(CAMERA_NAMES),):
            raise ConfigError(f"{path}: /{DATASET}: {' '.join(CAMERA_NAMES)} is needed, nine numbers")
        numbers = node[()].astype(float).tolist()
    except (OSError, RuntimeError, KeyError, TypeError, MemoryError) as error:  # damaged
        raise ConfigError(f"{path}: /{DATASET}: not readable: {' '.join(str(error).split())}") from None
    return Calibration(_camera(" ".join(map(repr, numbers)), path))


def camera_fields(camera, source):
    """The fields of a configuration that undistort for ``camera``: a file, or what is in one, also nine numbers.

    A text of numbers is no file. Raises :exc:`ConfigError` as :func:`read_calibration` does; or where the sensor of
    ``source``, an EventSource, is not of the size that the file tells.
    """
    if isinstance(camera, Calibration | Camera):
        found = camera if isinstance(camera, Calibration) else Calibration(camera)
    elif isinstance(camera, os.PathLike) or (isinstance(camera, str) and not _NUMBERS.fullmatch(camera)):
        found = read_calibration(camera)
    else:
        try:
            text = camera if isinstance(camera, str) else " ".join(repr(float(one)) for one in camera)
        except (TypeError, ValueError):
            raise ConfigError(f"camera = {camera!r}: a file, or {' '.join(CAMERA_NAMES)}, is needed") from None
        found = Calibration(_camera(text, "camera"))
    sensor = source.width, source.height
    if found.size and source.width is not None and found.size != sensor:
        sizes = ("{}×{} px".format(*size) for size in (found.size, sensor))
        raise ConfigError("{}: a camera of {}; the sensor has {}".format(camera, *sizes))
    return {"undistortion": "on", "camera": found.camera.text}


def _camera(text, path):
    numbers = parse_camera(text, str(path))
    if not numbers:
        raise ConfigError(f"{path}: empty; {' '.join(CAMERA_NAMES)} is needed, a camera_info YAML, or HDF5")
    return Camera(*numbers)


def _of_camera_info(content, path):
    model = content.get("distortion_model", _MODEL)
    if model != _MODEL:
        raise ConfigError(f"{path}: distortion_model {str(model)[:40]!r}: {_MODEL} is needed")
    matrix = _numbers(content, ("camera_matrix", "K", "k"), (9,), path)
    if any(matrix[k] for k in (1, 3, 6, 7)) or matrix[8] != 1:
        raise ConfigError(f"{path}: camera_matrix: fx 0 cx, 0 fy cy, 0 0 1 is needed")
    distortion = _numbers(content, ("distortion_coefficients", "D", "d"), (0, 4, 5), path)
    numbers = matrix[0], matrix[4], matrix[2], matrix[5], *distortion
    sides = [str(content.get(f"image_{side}", content.get(side))) for side in ("width", "height")]
    whole = all(re.fullmatch(r"[1-9][0-9]{0,5}", side) for side in sides)
    return Calibration(_camera(" ".join(map(repr, numbers)), path), tuple(map(int, sides)) if whole else None)


def _numbers(content, names, counts, path):
    """The list of numbers under the first of these names that there is; ``data`` of a matrix."""
    value = next((content[name] for name in names if name in content), None)
    value = value.get("data") if isinstance(value, dict) else value
    try:
        check(value, Many(_NUMBER), names[0])
        found = [float(one) for one in value]
    except FormError:
        found = None
    if found is None or len(found) not in counts:
        raise ConfigError(f"{path}: {names[0]}: {' or '.join(map(str, counts))} numbers are needed, as in camera_info")
    return found
