"""Cameras: their calibration, and what it makes of an event's position."""

from .calibration import Calibration, calibration_of, camera_fields, read_calibration
from .camera import Camera
from .motion import RATES, extent, flow, parameters, rates
from .undistortion import nearest, node_table, node_writes, seen, undistort

__all__ = [
    "RATES",
    "Calibration",
    "Camera",
    "calibration_of",
    "camera_fields",
    "extent",
    "flow",
    "nearest",
    "node_table",
    "node_writes",
    "parameters",
    "rates",
    "read_calibration",
    "seen",
    "undistort",
]
