"""Named layouts of what travels between the blocks of the shell, and in and out of it."""

from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ...protocol.settings import settings_of
from .. import payloads as core
from ..payloads import layout

DATA_BITS = 64
KEEP_BITS = DATA_BITS // 8


def beat():
    """A transfer on AXI4-Stream."""
    return layout(data=DATA_BITS, keep=KEEP_BITS, last=1, user=1)


def token(config):
    """What a decoder makes of words: an event, the end of a packet (TLAST), or both.

    ``x`` and ``y`` are as in the word, perhaps outside the sensor; ``known`` says that ``t`` is.
    """
    return layout(t=config.time_bits, x=16, y=16, known=1, event=1, end=1)


def sensor_token(config):
    """A token whose event, if it has one, lies on the sensor."""
    return layout(t=config.time_bits, x=config.geometry.x_bits, y=config.geometry.y_bits, event=1, end=1)


def settings(config):
    """The core's settings, and where batches end."""
    return layout(core=core.settings(config), end=end_settings(config))


def end_settings(config):
    """Where batches end: after so many events, before an event so much later than the first, with TLAST; 0: not."""
    return data.StructLayout(
        {setting.name: core.shaped(setting.shape_of(config)) for setting in settings_of(config, "shell")}
    )


def write():
    """A write to a register: word address in the map, data, and which bytes count."""
    return layout(address=10, data=32, strobe=4)


def register_bus():
    """Signature of the register bus, for who asks.

    A write takes place when it is ready. ``read_data`` are there in the cycle of ``read_address``; ``read`` says that
    they are wanted in this one, otherwise they may be wrong. Behind a reset nothing is read before a write is ready.
    """
    return wiring.Signature(
        {
            "write": Out(stream.Signature(write())),
            "read": Out(1),
            "read_address": Out(write()["address"].shape),
            "read_data": In(32),
        }
    )
