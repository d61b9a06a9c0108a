"""The register map of the AXI top: declared once, and what is made of it."""

from .declaration import FORMATS, ID, MAP_VERSION, PACKET_BEATS, check, register_map
from .layout import ACCESS, Field, Register, RegisterMap

__all__ = [
    "ACCESS", "FORMATS", "ID", "MAP_VERSION", "PACKET_BEATS", "Field", "Register", "RegisterMap", "check",
    "register_map",
]  # fmt: skip
