"""Named layouts of what travels between the blocks of the shell, and in and out of it."""

from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from ...protocol.settings import settings_of
from ...protocol.word_format import VECTORS
from .. import payloads as core
from ..payloads import layout

DATA_BITS = 64
#: Columns of a vector word of EVT 3.0, at most.
VECTOR_BITS = max(VECTORS.values())
KEEP_BITS = DATA_BITS // 8


def beat():
    """A transfer on AXI4-Stream."""
    return layout(data=DATA_BITS, keep=KEEP_BITS, last=1, user=1)


def token(config):
    """What a decoder makes of words: an event, the end of a packet (TLAST), or both.

    ``x`` and ``y`` are as in the word, perhaps outside the sensor; ``known`` says that ``t`` is. With EVT 3.0
    bit k of ``vector`` is an event in column ``x`` + k; at least one is set where there is an event.
    """
    return layout(t=config.time_bits, x=16, y=16, known=1, event=1, end=1, **_vector(config))


def _vector(config):
    return {"vector": VECTOR_BITS} if config.evt3 else {}


def gated_token(config):
    """A token whose events, if it has any, lie on the sensor."""
    columns, rows = config.geometry.sensor_x_bits, config.geometry.sensor_y_bits
    return layout(t=config.time_bits, x=columns, y=rows, event=1, end=1, **_vector(config))


def sensor_token(config):
    """The same, as batches are made of it; its events may be so many, all known to lie ``outside`` the ROI."""
    more = {"outside": 1, "events": range(VECTOR_BITS + 1)} if config.skips else {}
    return layout(**gated_token(config).members, **more)


def counted(config):
    """What the input path counts: how many in this cycle."""
    events = bits_for(VECTOR_BITS) if config.evt3 else 1
    many = dict.fromkeys(("events_in", "before_time", "out_of_sensor"), events)
    return layout(**dict.fromkeys(("format_errors", "other_words", "time_high_back"), 1), **many)


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
