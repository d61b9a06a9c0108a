"""Cameras: their calibration, and what it makes of an event's position."""

from .calibration import Calibration, calibration_of, camera_fields, read_calibration
from .camera import Camera
from .undistortion import nearest, node_table, node_writes, seen, undistort

__all__ = [
    "Calibration",
    "Camera",
    "calibration_of",
    "camera_fields",
    "nearest",
    "node_table",
    "node_writes",
    "read_calibration",
    "seen",
    "undistort",
]
