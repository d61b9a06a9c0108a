"""Named layouts of everything that travels between blocks."""

from dataclasses import dataclass

from amaranth.hdl import Const, Shape, ShapeCastable, Value
from amaranth.lib import data, stream

from ..config.schedule import DISTANCES, STRIDES
from ..fixed import Q, bits_for, signed_bits_for
from ..protocol.results import curvature_shape, fields_of, squares_shape, sums_shape, trace_shape
from ..protocol.settings import schedule_highest, settings_of, velocity_shape

#: Width of a stride's logarithm.
STRIDE_BITS = bits_for(len(STRIDES) - 1)


@dataclass(frozen=True)
class Fixed(ShapeCastable):
    """The shape of a fixed-point number, which knows its format; a value of it is a plain one.

    Parameters
    ----------
    q : Q
    """

    q: Q

    def as_shape(self):
        return Shape(self.q.width, self.q.signed)

    def const(self, init):
        return Const(init or 0, self.as_shape())

    def from_bits(self, raw):
        return raw - (1 << self.q.width) if self.q.signed and raw >> (self.q.width - 1) else raw

    def __call__(self, target):
        value = Value.cast(target)
        return value if value.shape().signed == self.q.signed else value.as_signed()


def layout(**members):
    """A layout of members by their names."""
    return data.StructLayout(members)


def shaped(shape):
    """The layout, or the shape, of a :mod:`cmfpga.protocol.shapes` shape."""
    if isinstance(shape, Q):
        return Fixed(shape) if shape.f else Shape(shape.width, shape.signed)
    return data.StructLayout({name: shaped(part) for name, part in shape.items()})


def _shaped(shape_of):
    return lambda config: shaped(shape_of(config))


sums = _shaped(sums_shape)  # over the ROI
squares = _shaped(squares_shape)  # Σ I² over the ROI
curvature = _shaped(curvature_shape)  # how far the gradient falls between the probes
velocity = _shaped(velocity_shape)  # the parameters of the motion, raw; of a translation, px per half batch
trace = _shaped(trace_shape)  # one iteration, for verification: the velocity that it used and its sums


def flow(layout):
    """A stream that is never stalled: one item in every cycle in which ``valid`` is high."""
    return stream.Signature(layout, always_ready=True)


def event(config, skips=False):
    """An event as the camera sends it; ``last`` ends the batch. Polarity is not used.

    With ``skips`` it may be ``skip`` of them, 0 as well as 1, all outside the ROI.
    """
    more = {"skip": 4} if skips else {}
    columns, rows = config.geometry.sensor_x_bits, config.geometry.sensor_y_bits
    return layout(t=config.time_bits, x=columns, y=rows, last=1, **more)


def marked_event(config, *marks):
    """An event, and what it is dropped for: ``hot``, ``noise``; by default all that the hardware has."""
    marks = marks or [name for name, there in (("hot", config.hot_pixels), ("noise", config.background)) if there]
    return layout(**event(config).members, **dict.fromkeys(marks, 1))


def binned_event(config):
    """The same, with its place in the image that ROI and v are in."""
    geometry = config.geometry
    return layout(**{**marked_event(config).members, "x": geometry.x_bits, "y": geometry.y_bits})


def undistorted_event(config):
    """The same, as the ROI filter takes it. Where the hardware undistorts, its position has fraction bits, and half a
    pixel more than it is: the whole part is the nearest pixel, which need not lie on the sensor.
    """
    members, geometry, frac = binned_event(config).members, config.geometry, config.formats.event_frac
    if frac:
        members = {**members, "x": Fixed(Q(geometry.x_bits + 1, frac)), "y": Fixed(Q(geometry.y_bits + 1, frac))}
    return data.StructLayout(members)


def node_write(config):
    """A node of the table that undistorts: how far it moves what lies on it."""
    geometry, formats = config.geometry, config.formats
    place = {"column": range(geometry.node_columns), "row": range(geometry.node_rows)}
    return layout(**place, x=Fixed(formats.node_x), y=Fixed(formats.node_y))


def mask_write(config):
    """A word of the mask of hot pixels: bit k is the pixel 32·column + k."""
    geometry = config.geometry
    return layout(column=geometry.mask_column_bits, row=geometry.sensor_y_bits, bits=geometry.mask_pixels)


def roi_event(config, width=None, height=None):
    """An event in the ROI: µs since t_1, column and row in the ROI, as :func:`undistorted_event` has them.

    ``width`` and ``height`` are the ROI's, by default the configuration's.
    """
    columns, rows = bits_for((width or config.roi_width) - 1), bits_for((height or config.roi_height) - 1)
    frac = config.formats.event_frac
    x, y = (Fixed(Q(bits, frac, signed=False)) if frac else bits for bits in (columns, rows))
    return layout(t=config.span_bits, x=x, y=y)


def replayed_event(config):
    """An event out of the buffer; ``last`` is the iteration's last."""
    return layout(**roi_event(config).members, last=1)


def dithered_event(config):
    """An event out of the buffer, with ``dithered_frac`` fraction bits in its position.

    Where the hardware undistorts, it has still half a pixel more than it is.
    """
    members, formats = replayed_event(config).members, config.formats
    if config.dither_frac:
        last = 0 if formats.event_frac else 1  # with that half it may reach the pixel behind the last
        sizes = {"x": config.roi_width - last, "y": config.roi_height - last}
        places = {axis: Fixed(Q(bits_for(size), formats.dithered_frac)) for axis, size in sizes.items()}
        members = {**members, **places}
    return data.StructLayout(members)


def scaled_event(config):
    """An event with its scaled time."""
    members = dithered_event(config).members
    return layout(dt=Fixed(config.formats.dt), x=members["x"], y=members["y"], last=1, **with_basis(config))


def basis(config):
    """What the motion makes of an event's position."""
    return data.StructLayout({name: Fixed(q) for name, q in config.motion_model.basis.items()})


def middle(config):
    """Column and row of a region's middle in the image, in half pixels."""
    x, y = config.geometry.middle
    return layout(x=bits_for(2 * x), y=bits_for(2 * y))


def with_middle(config, member=lambda layout: layout):
    """The member ``middle``, where p and q are counted from that of a region."""
    return {"middle": member(middle(config))} if config.motion_model.of_pixels and config.regions else {}


def with_basis(config, member=lambda layout: layout):
    """The member ``basis`` of what travels with an event, where the motion has one."""
    return {"basis": member(basis(config))} if config.motion_model.basis else {}


def with_moments(config):
    """The same of what travels behind the warp: the basis for the moments.

    ``cell``: p and q of an event's upper left pixel, 2^level px wide, and whether its column and row are odd, where the
    moments are those of pixels.
    """
    if not config.motion_model.of_pixels:
        return with_basis(config)
    more = {"odd_column": 1, "odd_row": 1, "level": bits_for(config.max_level)}
    return {"cell": layout(**basis(config).members, **more)}


def displacement(config):
    """How far an event moves along x and y in half a batch."""
    return data.StructLayout(dict.fromkeys(("x", "y"), Fixed(config.formats.flow)))


def growth(config):
    """What an event adds to Σ I·D along an axis."""
    return of_width(signed_bits_for(config.widths.growth_max), config.weight_frac + config.derivative_frac)


def moments(config):
    """S of each parameter of the motion."""
    return of_parameters(config, sums(config)["sx"].shape)


def warped_event(config):
    """An event moved to t_ref."""
    return layout(
        dt=Fixed(config.formats.dt),
        x=Fixed(config.formats.position_x),
        y=Fixed(config.formats.position_y),
        last=1,
        **({} if config.motion_model.of_pixels else with_basis(config)),
    )


def votes(config):
    """One event's votes, sorted by parity bank: bank 2·(row % 2) + (column % 2)."""
    vote = layout(
        valid=1,
        address=config.geometry.bank_address_bits,
        i=Fixed(Q(1, config.weight_frac, signed=False)),
        **dict.fromkeys(("dx", "dy"), Fixed(Q(1, config.derivative_frac))),
    )
    return layout(banks=data.ArrayLayout(vote, 4), last=1, **with_moments(config))


def pixel(config):
    """One pixel of the three images."""
    derivative = of_width(config.widths.derivative_image_bits, config.derivative_frac)
    i = of_width(config.widths.image_bits, config.weight_frac, signed=False)
    return layout(i=i, dx=derivative, dy=derivative)


def sweep_address(config):
    """One address of all banks, for the reader that clears behind itself."""
    return layout(address=votes(config)["banks"].shape.elem_shape["address"].shape, first=1, last=1)


def tagged_operation(config):
    """What a tagged bank is asked to do: add to a word, which is zero unless it carries this tag."""
    vote = votes(config)["banks"].shape.elem_shape
    add = {name: vote[name].shape for name in pixel(config).members}
    return layout(address=config.geometry.bank_address_bits, tag=config.tag_bits, add=data.StructLayout(add))


def tagged_step(config):
    """What a tagged bank did: I before, what was added, and the pixel after."""
    return layout(valid=1, i=pixel(config)["i"].shape, add=tagged_operation(config)["add"].shape, total=pixel(config))


def of_width(width, fraction, signed=True):
    """A fixed-point number of so many bits, ``fraction`` of them behind the point."""
    return Fixed(Q(width - fraction - int(signed), fraction, signed))


def of_parameters(config, shape):
    """A number of this shape for each parameter of the motion."""
    return data.StructLayout(dict.fromkeys(config.motion_model.names, shape))


def gradient(config):
    """G = P·S − ΣI·ΣD of each parameter of the motion; S, where ΣD = 0."""
    return of_parameters(config, of_width(config.widths.g_bits, config.widths.s_frac))


def roi_corner(config):
    """Left column and top row of the ROI in whole pixels."""
    return layout(x=bits_for(config.geometry.roi_x_max), y=bits_for(config.geometry.roi_y_max))


def settings(config):
    """Run-time inputs, taken over when a batch's first event is offered (:data:`cmfpga.protocol.settings.SETTINGS`)."""
    members = {setting.name: shaped(setting.shape_of(config)) for setting in settings_of(config, "core")}
    return data.StructLayout(members)


def schedule_entry(config):
    """One iteration: what :func:`~cmfpga.protocol.settings.schedule_highest` names."""
    return data.StructLayout({name: bits_for(high) for name, high in schedule_highest(config).items()})


def distance(config):
    """How far beside the centre a round evaluates: the number of one of :data:`DISTANCES`; more counts as the last."""
    return Shape(bits_for(len(DISTANCES) - 1))


def subset(config):
    """The stored events that a replay uses: one in 2^stride, from the one with the number ``first`` on."""
    return layout(stride=STRIDE_BITS, first=bits_for(STRIDES[-1] - 1))


def schedule_write(config):
    """An entry for the table; only while no batch is under way."""
    return layout(address=range(config.schedule_entries), entry=schedule_entry(config))


def thinning_used(config):
    """One ROI event in so many is stored."""
    return shaped(next(f.shape(config) for f in fields_of("region") if f.name == "thinning_used"))


def batch(config):
    """All that is known of a batch when it has been taken in; the names are those of :func:`result`."""
    members = {f.name: shaped(f.shape(config)) for f in fields_of("batch", "region", config=config) if f.taken_in}
    return layout(settings=settings(config), cut=1, clamped=1, **members)


def result(config):
    """One batch's result (:data:`cmfpga.protocol.results.RESULTS`).

    ``events = roi_events + outside + overflow + thinned + time_back + time_span + hot + noise``: no event is lost
    without being counted.
    """
    return data.StructLayout({f.name: shaped(f.shape(config)) for f in fields_of("batch", "region", config=config)})
