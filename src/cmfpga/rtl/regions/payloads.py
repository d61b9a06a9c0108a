"""Named layouts of what travels between the store, the table of regions and the units."""

from ...config.regions import PAGE_EVENTS
from ...fixed import Q, bits_for
from ...protocol.regions import row_shape
from ...protocol.results import fields_of
from ..payloads import Fixed, layout, roi_event, settings, shaped, trace, velocity, with_middle


def stored_event(config):
    """An event on the sensor: µs since t_1, column and row, as :func:`~cmfpga.rtl.payloads.undistorted_event`."""
    return roi_event(config, *config.geometry.size)


def bin_entry(config):
    """What the store knows of a bin: how many events it has, and the page that the last one lies on.

    The count's lowest bits are a place on a page, all of which an address needs, however few events there are.
    """
    return layout(count=bits_for(max(config.max_batch_events, PAGE_EVENTS - 1)), page=bits_for(config.store.pages - 1))


def row(config):
    """A row of the table of regions (:func:`cmfpga.protocol.regions.row_shape`)."""
    return shaped(row_shape(config))


def row_write(config):
    """A row for the table; ``fresh``: forget what is kept of that region. Only while no batch is under way."""
    return layout(number=config.store.number_bits, fresh=1, row=row(config))


def region_trace(config):
    """An iteration of a region, for verification."""
    return layout(region=config.store.number_bits, **trace(config).members)


def state(config):
    """What is kept of a region between batches; ``turn`` is that of the last batch that it was measured in.

    ``position``: left column and top row, with the fraction bits that make its moves exact.
    """
    geometry, frac = config.geometry, config.v_frac + config.roi_gain_frac
    x, y = (Fixed(Q(bits, frac, signed=False)) for bits in (geometry.x_bits, geometry.y_bits))
    flags = dict.fromkeys(("followed", "doubtful", "turn"), 1)
    return layout(position=layout(x=x, y=y), v=velocity(config), **flags)


def times(config):
    """How the times of a batch are scaled."""
    return layout(span=config.span_bits, shift=bits_for(config.span_bits - 1), mantissa=config.reciprocal_bits + 1)


def job(config):
    """What a unit has to do: in its settings, ``cold`` and ``v_start`` are those of this region and batch."""
    return layout(
        number=config.store.number_bits,
        found=bits_for(config.max_batch_events),  # events in the region
        stride=row(config)["stride"].shape,
        restarted=1,
        turn=1,  # of its batch
        settings=settings(config),
        **with_middle(config),
    )


#: Fields of a region's outcome that a unit does not know.
_OUTSIDE_UNITS = ("roi", "roi_next")


def outcome(config):
    """What a unit says of a region."""
    known = [f for f in fields_of("region", config=config) if f.name not in _OUTSIDE_UNITS]
    found = {f.name: shaped(f.shape(config)) for f in known}
    return layout(number=config.store.number_bits, turn=1, degenerate=1, **found)


def region_result(config):
    """One region's result, and what is known of its batch; ``last`` ends the batch."""
    fields = {f.name: shaped(f.shape(config)) for f in fields_of("batch", "region", config=config)}
    return layout(region=config.store.number_bits, last=1, **fields)
