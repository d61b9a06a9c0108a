"""What the hardware can be built with or without, how v ascends, and the fields that only each choice reads.

The hardware's blocks are in :mod:`cmfpga.rtl.ascent`, the models' steps in :mod:`cmfpga.reference`. ``settings`` below
is a :class:`~cmfpga.protocol.settings.BatchSettings`.
"""

from dataclasses import dataclass

from .schedule import ScheduleEntry


@dataclass(frozen=True, kw_only=True)
class AscentRule:
    """How v ascends."""

    settings: tuple  # of a batch, that only this ascent reads
    fields: tuple  # of the configuration, that only it reads, the settings among them
    cycles: int  # from a gradient to the new v, of the clock; of rounds those that do not depend on the formats
    needs: tuple = ()  # ((field of the configuration, values), …) without which it does not work
    has_table: bool = True  # a table of schedules says what each iteration does
    evaluations: int = 1  # of the image in an iteration
    strides: bool = False  # an iteration may leave out events

    def latency(self, config):
        """Clock cycles from a gradient, or from a round's last, to the new v."""
        return self.cycles + (len(config.widths.round_shifts) + config.v_frac if self.evaluations > 1 else 0)

    def warm(self, settings, followed):
        """Whether a batch starts from the last v; ``followed``: the last batch measured it, and the ROI was not set."""
        return settings.start_last and (followed or not self.has_table)

    def plan(self, settings, warm):
        """One :class:`~cmfpga.config.schedule.ScheduleEntry` an iteration; ``log2_step`` is None without schedules."""
        if not self.has_table:
            return (ScheduleEntry(0, None),) * settings.iterations
        return settings.warm if warm else settings.cold


ASCENTS = {
    # v ← v + η·∂C/∂v, as in the article: at full resolution, T times.
    "constant": AscentRule(
        settings=("iterations", "eta"), fields=("iterations", "eta", "eta_int", "eta_frac"), cycles=5, has_table=False,
    ),
    # v ← v + M⁻¹·g of four evaluations beside v, in rounds of a schedule. Only with these needs are an event's
    # derivatives opposite, and the sums the gradient.
    "newton": AscentRule(
        settings=("cold", "warm"), fields=("cold", "warm", "schedule_entries", "confidence", "evaluators"),
        cycles=20, evaluations=4,
        needs=(("gradient", ("one_pass",)), ("border", ("whole",)), ("motion", ("translation",))),
    ),
    # v ← v ± a step of a schedule, coarse to fine. For motions beyond translation, of which no round is known.
    "sign": AscentRule(
        settings=("cold", "warm"), fields=("cold", "warm", "schedule_entries", "confidence"), cycles=2, strides=True,
        needs=(("motion", ("similarity", "rotation")),),
    ),
}  # fmt: skip


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
