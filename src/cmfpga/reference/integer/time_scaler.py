"""Model of :mod:`cmfpga.rtl.ingest.reciprocal` and :mod:`cmfpga.rtl.image.time_scaler`."""

from ...fixed import round_half_up, saturate


def reciprocal(config, span):
    """``(shift, mantissa)`` for the range ``span`` = t_N − t_1 > 0: 1/span = mantissa · 2^shift / 2^(…), floored.

    ``span << shift`` has its top bit set, so the mantissa lies in 2^(reciprocal_bits−1) … 2^reciprocal_bits.
    """
    shift = config.span_bits - int(span).bit_length()
    return shift, (1 << (config.span_bits - 1 + config.reciprocal_bits)) // (int(span) << shift)


def time_scaler(config, t, *, span):
    """Raw ``config.formats.dt`` of events at ``t`` µs after t_1: (2t − span)/span, −1 … 1 (Eqs. t_ref and dt).

    In windows that slide ``span`` is known before the events are: later ones count as at its end. Times before t_1,
    such as the last window's t_ref, are limited to −2, from −2 itself on, which a floored mantissa would not reach.
    """
    shift, mantissa = reciprocal(config, span)
    numerator = (2 * t - span) << shift
    scaled = round_half_up(numerator * mantissa, config.span_bits - 1 + config.reciprocal_bits - config.dt_frac)
    beyond = (2 * t <= -span) * (4 << config.dt_frac)
    return saturate(scaled - beyond, config.formats.dt.min, 1 << config.dt_frac)
