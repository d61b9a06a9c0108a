"""The register map of the AXI top: declared once, and what is made of it."""

from .declaration import FORMATS, ID, MAP_VERSION, check, formats_of, register_map
from .layout import ACCESS, Field, Register, RegisterMap

__all__ = [
    "ACCESS", "FORMATS", "ID", "MAP_VERSION", "Field", "Register", "RegisterMap", "check", "formats_of", "register_map",
]  # fmt: skip
