"""Named layouts of everything that travels between blocks."""

from amaranth.hdl import signed
from amaranth.lib import data, stream

from ..fixed import bits_for
from ..protocol.batch import Flag

CYCLE_BITS = 32
THINNING_BITS = 8


def flow(layout):
    """A stream that is never stalled: one item in every cycle in which ``valid`` is high."""
    return stream.Signature(layout, always_ready=True)


def event(config):
    """An event as the camera sends it; ``last`` ends the batch. Polarity is not used."""
    return data.StructLayout(
        {"t": config.time_bits, "x": config.geometry.x_bits, "y": config.geometry.y_bits, "last": 1}
    )


def roi_event(config):
    """An event in the ROI: µs since t_1, column and row in the ROI."""
    return data.StructLayout(
        {"t": config.span_bits, "x": bits_for(config.roi_width - 1), "y": bits_for(config.roi_height - 1)}
    )


def replayed_event(config):
    """An event out of the buffer; ``last`` is the iteration's last."""
    return data.StructLayout({**roi_event(config).members, "last": 1})


def dithered_event(config):
    """An event out of the buffer, with ``dither_frac`` fraction bits in its position."""
    members = replayed_event(config).members
    if config.dither_frac:
        members = {
            **members,
            **{axis: signed(members[axis] + config.dither_frac + 1) for axis in ("x", "y")},
        }
    return data.StructLayout(members)


def scaled_event(config):
    """An event with its scaled time."""
    members = dithered_event(config).members
    return data.StructLayout({"dt": signed(config.formats.dt.width), "x": members["x"], "y": members["y"], "last": 1})


def warped_event(config):
    """An event moved to t_ref."""
    return data.StructLayout(
        {
            "dt": signed(config.formats.dt.width),
            "x": signed(config.formats.position_x.width),
            "y": signed(config.formats.position_y.width),
            "last": 1,
        }
    )


def votes(config):
    """One event's votes, sorted by parity bank: bank 2·(row % 2) + (column % 2)."""
    vote = data.StructLayout(
        {
            "valid": 1,
            "address": config.geometry.bank_column_bits + bits_for(config.geometry.bank_rows - 1),
            "i": config.weight_frac + 1,
            **of_parameters(config, config.derivative_frac + 2, prefix="d"),
        }
    )
    return data.StructLayout({"banks": data.ArrayLayout(vote, 4), "last": 1})


def pixel(config):
    """One pixel of the three images."""
    return data.StructLayout(
        {
            "i": config.widths.image_bits,
            **of_parameters(config, config.widths.derivative_image_bits, prefix="d"),
        }
    )


def sweep_address(config):
    """One address of all banks, for the reader that clears behind itself."""
    return data.StructLayout(
        {"address": votes(config)["banks"].shape.elem_shape["address"].shape, "first": 1, "last": 1}
    )


def tagged_operation(config):
    """What a tagged bank is asked to do: add to a word, which is zero unless it carries this tag."""
    vote = votes(config)["banks"].shape.elem_shape
    add = {name: vote[name].shape for name in pixel(config).members}
    return data.StructLayout({"address": vote["address"].shape, "tag": config.tag_bits, "add": data.StructLayout(add)})


def tagged_step(config):
    """What a tagged bank did: I before, what was added, and the pixel after."""
    return data.StructLayout(
        {
            "valid": 1,
            "i": config.widths.image_bits,
            "add": tagged_operation(config)["add"].shape,
            "total": pixel(config),
        }
    )


def sums(config):
    """Sums over the ROI."""
    return data.StructLayout(
        {
            "i": config.widths.sum_i_bits,
            **of_parameters(config, config.widths.sum_d_bits, prefix="d"),
            **of_parameters(config, config.widths.s_bits, prefix="s"),
        }
    )


def of_parameters(config, width, prefix=""):
    """Members of a layout: a signed number of this width for each parameter of the motion."""
    return {prefix + name: signed(width) for name in config.motion.names}


def vector(config, width):
    """A signed number of this width for each parameter of the motion."""
    return data.StructLayout(of_parameters(config, width))


def velocity(config):
    """The parameters of the motion, raw ``config.formats.v``; of a translation, pixels per half batch."""
    return data.StructLayout({parameter.name: signed(parameter.bits) for parameter in config.motion.parameters})


def roi_corner(config):
    """Left column and top row of the ROI in whole pixels."""
    return data.StructLayout({"x": bits_for(config.geometry.roi_x_max), "y": bits_for(config.geometry.roi_y_max)})


def settings(config):
    """Run-time inputs, taken over when a batch's first event is offered (``BatchSettings``)."""
    return data.StructLayout(
        {
            "roi_load": 1,
            "roi_x": config.geometry.x_bits,
            "roi_y": config.geometry.y_bits,
            "batch_events": bits_for(config.max_batch_events),
            "batch_roi_events": bits_for(config.buffer_events),
            "thinning": THINNING_BITS,
            "thin_target": bits_for(config.buffer_events),
            "iterations": bits_for(config.max_iterations),
            "eta": config.formats.eta.width,
            "roi_gain": config.formats.roi_gain.width,
            "start_last": 1,
            "v_start": velocity(config),
            "min_roi_events": bits_for(config.buffer_events),
            **({name: plan(config) for name in ("cold", "warm")} if config.ascent == "sign" else {}),
        }
    )


def plan(config):
    """A part of the schedule's table: the first entry and the number of entries."""
    return data.StructLayout({"first": range(config.schedule_entries), "count": range(config.schedule_entries + 1)})


def schedule_entry(config):
    """One iteration of the sign ascent: pixels 2^level px wide, v moves by 2^shift raw units."""
    return data.StructLayout({"level": bits_for(config.max_level), "shift": bits_for(config.formats.v.width - 2)})


def schedule_write(config):
    """An entry for the table; only while no batch is under way."""
    return data.StructLayout({"address": range(config.schedule_entries), "entry": schedule_entry(config)})


def batch(config):
    """All that is known of a batch when it has been taken in; the names are those of :func:`result`."""
    members = result(config).members
    names = (
        "t_first",
        "span",
        "events",
        "roi_events",
        "outside",
        "overflow",
        "thinned",
        "time_back",
        "time_span",
        "roi",
        "roi_next",
    )
    return data.StructLayout(
        {"settings": settings(config), "cut": 1, "clamped": 1, **{name: members[name] for name in names}}
    )


def result(config):
    """One batch's result (see :class:`cmfpga.protocol.batch.BatchResult`).

    ``events = roi_events + outside + overflow + thinned + time_back + time_span``: no event is lost without being
    counted.
    """
    count = bits_for(config.max_batch_events)
    return data.StructLayout(
        {
            "v": velocity(config),
            "t_first": config.time_bits,
            "span": config.span_bits,
            "events": count,
            "roi_events": bits_for(config.buffer_events),
            "outside": count,
            "overflow": count,
            "thinned": count,
            "time_back": count,
            "time_span": count,
            "roi": roi_corner(config),
            "roi_next": roi_corner(config),
            "iterations": config.iteration_bits,
            "sums": sums(config),
            "cycles": CYCLE_BITS,
            "flags": len(Flag),
        }
    )


def trace(config):
    """One iteration, for verification: the velocity that it used and its sums."""
    return data.StructLayout({"v": velocity(config), "sums": sums(config)})
