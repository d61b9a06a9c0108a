"""Cameras: their calibration, and what it makes of an event's position."""

from .calibration import Calibration, read_calibration
from .camera import Camera
from .undistortion import node_table, node_writes, seen, undistort

__all__ = ["Calibration", "Camera", "node_table", "node_writes", "read_calibration", "seen", "undistort"]
