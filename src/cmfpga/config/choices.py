"""What the hardware can be built with or without, how v ascends, and the fields that only each choice reads.

The hardware's blocks are in :mod:`cmfpga.rtl.ascent`, the models' steps in :mod:`cmfpga.reference`. ``settings`` below
is a :class:`~cmfpga.protocol.settings.BatchSettings`.
"""

from .schedule import ScheduleEntry


class ConstantAscent:
    """v ← v + η·∂C/∂v, as in the article: at full resolution, T times.

    Attributes
    ----------
    settings : tuple of str
        The settings of a batch that only this ascent reads.
    fields : tuple of str
        The fields of the configuration that only it reads, the settings among them.
    has_table : bool
        Whether a table of schedules says what each iteration does.
    evaluations : int
        Of the image in an iteration.
    strides : bool
        Whether an iteration may leave out events.
    needs : tuple of (str, values)
        Fields of the configuration, and the values without which it does not work.
    """

    settings = ("iterations", "eta")
    fields = (*settings, "eta_int", "eta_frac")
    has_table, strides = False, False
    evaluations = 1
    needs = ()

    def latency(self, config):
        """Clock cycles from a gradient, or from a round's last, to the new v."""
        return 5

    def warm(self, settings, followed):
        """Whether a batch starts from the last v; ``followed``: the last batch measured it, and the ROI was not set."""
        return settings.start_last

    def plan(self, settings, warm):
        """One :class:`~cmfpga.config.schedule.ScheduleEntry` an iteration; ``log2_step`` is None without schedules."""
        return (ScheduleEntry(0, None),) * settings.iterations


class SignAscent:
    """v ← v ± a step of a schedule, coarse to fine; see :class:`ConstantAscent` for attributes and methods.

    For motions beyond translation, of which no round is known.
    """

    settings = ("cold", "warm")
    fields = (*settings, "schedule_entries", "confidence")
    has_table, strides = True, True
    evaluations = 1
    needs = (("motion", ("similarity", "rotation")),)

    def latency(self, config):
        return 2

    def warm(self, settings, followed):
        return settings.start_last and followed

    def plan(self, settings, warm):
        return settings.warm if warm else settings.cold


class NewtonAscent(SignAscent):
    """v ← v + M⁻¹·g of four evaluations beside v, in rounds of a schedule."""

    fields = (*SignAscent.fields, "evaluators")
    strides = False
    evaluations = 4
    # Only then an event's derivatives are opposite, and the sums are the gradient.
    needs = (("gradient", ("one_pass",)), ("border", ("whole",)), ("motion", ("translation",)))

    def latency(self, config):
        return len(config.widths.round_shifts) + config.v_frac + 20


ASCENTS = {"constant": ConstantAscent(), "newton": NewtonAscent(), "sign": SignAscent()}


#: Gradient architectures.
GRADIENTS = {"sweep": (), "one_pass": ("tag_bits", "confidence")}
#: Whether positions are undistorted.
UNDISTORTION = {"off": (), "on": ("undistortion_cell", "undistortion_frac", "camera")}
#: What is evaluated: batches out of event buffers, or a ring's newest events again and again.
WINDOWS = {
    "batches": ("buffers", "when_full", "thin_target", "start", "cold_after_doubtful"),
    "sliding": ("window_events", "window_us", "hop_events", "hop_us", "follow", "after"),
}

#: ``{field: {its value: the fields that only this value reads}}``.
CHOICES = {
    "gradient": GRADIENTS,
    "ascent": {name: rule.fields for name, rule in ASCENTS.items()},
    "confidence": {0: (), 1: ("judge", "confidence_limit", "cold_after_doubtful")},
    "windows": WINDOWS,
    "undistortion": UNDISTORTION,
    "hot_pixels": {0: (), 1: ("hot_mask",)},
    "background": {0: (), 1: ("background_cell", "background_us")},
}
