"""Model of :mod:`cmfpga.rtl.ingest.thinner`."""

from ...config.widths import Widths


def next_thinning(count, target):
    """The factor that would have brought ``count`` events down to ``target``, at least 1; None without a target."""
    return min(Widths.thinning_max, max(1, -(-count // target))) if target else None


def thinner(events, factor):
    """The first of every ``factor`` events: a slice of each of ``events``, tensors of one length."""
    return tuple(axis[::factor] for axis in events)
