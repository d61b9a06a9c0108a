"""Cameras: their calibration, and what it makes of an event's position."""

from .camera import Calibration, Camera, calibration_of, camera_fields, read_calibration
from .motion import RATES, extent, flow, nearest, node_table, node_writes, parameters, rates, seen, undistort

__all__ = [
    "RATES", "Calibration", "Camera", "calibration_of", "camera_fields", "extent", "flow", "nearest", "node_table",
    "node_writes", "parameters", "rates", "read_calibration", "seen", "undistort",
]  # fmt: skip
