"""What can go wrong between software and hardware."""

from ..errors import UserError


class DeviceError(UserError):
    """The hardware, or what leads to it, does not do what it should. One line: what, and what to look at."""


class WrongHardware(DeviceError):
    """What answers is not the accelerator, of another version, or of another configuration."""


class DeviceTimeout(DeviceError, TimeoutError):
    """Something did not come in time."""
