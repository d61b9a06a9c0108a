"""The way of a batch, and what is kept between batches, such as the ROI's position: in raw or in real numbers."""

from abc import ABC, abstractmethod

from ..fixed import saturate
from ..protocol.confidence import is_short
from ..protocol.flags import Flag
from ..protocol.results import BatchResult, not_judged
from ..protocol.trace import Trace
from .ingest import take_in
from .integer.filters import NoiseFilter


def move_within(position, step, limits):
    """``position + step``, each axis limited to 0 … limit; and whether a limit was met."""
    target = tuple(p + s for p, s in zip(position, step, strict=True))
    moved = tuple(saturate(p, 0 * limit, limit) for p, limit in zip(target, limits, strict=True))
    return moved, moved != target


def corner_of(position, pixel):
    """The nearest corner, px, of a position in units of which ``pixel`` are one."""
    return tuple(int((p + pixel / 2) // pixel) for p in position)


class RoiFollower:
    """The ROI's position between batches (Eq. roi_update), as :mod:`cmfpga.rtl.ascent.roi_updater` keeps it.

    With one event buffer a batch is cropped where the position is. With two, it is cropped before the move of the
    batch ahead of it is known: where the position would be if the last known move were repeated.

    ``position`` is the ROI's left and top edge. ``pixel`` is one pixel in its unit: a power of two for raw integers,
    1.0 for px.
    """

    def __init__(self, config, pixel):
        self.buffers = config.buffers
        self.limits = (config.geometry.roi_x_max * pixel, config.geometry.roi_y_max * pixel)
        self.pixel = pixel
        self.position = (0 * pixel, 0 * pixel)
        self._still = self.position
        self._last_step = self._still  # the move that led to the position
        self._coming_step = None  # with two buffers: the last batch's, which follows when the next batch is cropped

    def crop(self, roi=None):
        """Corner of the batch that begins, px, and whether it was limited to the sensor; ``roi`` loads another."""
        if roi is not None:
            wanted = tuple(axis * self.pixel for axis in roi)
            self.position, limited = move_within(wanted, self._still, self.limits)
            self._last_step = self._coming_step = self._still
            return corner_of(self.position, self.pixel), limited
        position, limited = self._next()
        if self._coming_step is not None:
            self.position, _ = move_within(self.position, self._coming_step, self.limits)
            self._last_step = self._coming_step
        return corner_of(position, self.pixel), limited

    def move(self, step):
        """Follow by ``step``, None for a batch that measured nothing; whether the sensor limited that at once."""
        if self.buffers == 2:
            self._coming_step = self._still if step is None else step
            return False
        if step is None:
            return False
        self.position, limited = move_within(self.position, step, self.limits)
        return limited

    @property
    def next_corner(self):
        """Corner of the next batch, px, unless it loads another."""
        return corner_of(self._next()[0], self.pixel)

    def _next(self):
        if self.buffers == 1:
            return self.position, False
        return move_within(self.position, self._last_step, self.limits)


class Sequence(ABC):
    """Batches in, velocities and a moving ROI out: crop, take in, plan, ascend, follow.

    ``pixel`` is as of :class:`RoiFollower`. ``plan`` has the iterations of the last batch.
    """

    def __init__(self, config, pixel):
        self.config = config
        #: Velocity of the last batch, the parameters of its motion.
        self.v = (self.number(config.formats.v, 0),) * len(config.motion_model.names)
        #: Whether ``v`` is that of an object that is being followed. A new ROI, a degenerate batch or a reset ends it.
        self.followed = False
        self.doubtful = False  #: whether the last batch was flagged so
        self.follower = RoiFollower(config, pixel)
        self.noise_filter = NoiseFilter(config)
        self.thinning = None  #: the factor that would have brought the last batch down to its target

    def run(self, t, x, y, settings, *, cut=False):
        """Process one batch, integer arrays [N]: :class:`BatchResult`. ``cut``: it reached ``max_batch_events``."""
        rule = self.config.ascent_rule
        roi, limited = self.follower.crop(settings.roi)
        dropped = self.noise_filter.judge(t, x, y, settings)
        batch = take_in(self.config, t, x, y, settings, roi=roi, last_thinning=self.thinning, dropped=dropped)
        self.thinning = batch.next_thinning
        flags = batch.flags | (Flag.CUT if cut else Flag(0))
        source = self if rule.warm(settings, self.followed and settings.roi is None) else None
        found = self.measure(self, source, batch, settings, lambda warm: rule.plan(settings, warm), roi, flags)
        step = self.step(settings) if self.followed else None
        limited |= self.follower.move(step)
        found["flags"] |= Flag.ROI_CLAMPED if limited else Flag(0)
        return BatchResult(**batch.counts, roi=roi, roi_next=self.follower.next_corner, **found)

    def measure(self, state, source, batch, settings, plan, roi, flags, middle=None):
        """Ascend over a :class:`~.ingest.TakenIn`, if it is enough: fields of the result, ``flags`` among them.

        ``state`` has, and keeps, ``v``, ``followed``, ``doubtful`` and ``plan``. ``source`` is the one whose v the
        ascent begins with, None for that of the settings; ``plan(warm)`` says what is done then. ``roi`` and ``middle``
        are as of :meth:`ascend`.
        """
        config = self.config
        restarted = bool(source and source.doubtful and settings.cold_after_doubtful)
        warm, judged = source is not None and not restarted, not_judged(config)
        state.plan = tuple(plan(warm)) if batch.enough(settings) else ()
        state.followed = bool(state.plan)
        if state.followed:
            self.v = source.v if warm else tuple(self.number(config.formats.v, axis) for axis in settings.v_start)
            trace, found, fields = self.ascend(batch, settings, state.plan, roi, middle)
            judged |= fields | ({"restarted": int(restarted)} if config.confidence else {})
            self.v = state.v = tuple(trace.v[-1].tolist())
            flags |= found | self.short
        else:
            self.v = state.v
            trace = Trace.without_iterations(config, state.v)
            flags |= Flag.DEGENERATE
        state.doubtful = Flag.DOUBTFUL in flags
        return {"v": self.velocity, "iterations": len(trace.sum_i), "flags": flags, "trace": trace, **judged}

    def step(self, settings):
        """How far what has moved by v takes its ROI, along x and y."""
        gain = self.number(self.config.formats.roi_gain, settings.roi_gain)
        moved = {p.moves_roi: v for p, v in zip(self.config.motion_model.parameters, self.v, strict=True)}
        return tuple(gain * moved.get(axis, 0 * gain) for axis in ("x", "y"))

    @property
    def short(self):
        """The flag ``SHORT``, where ``v`` has it and the hardware tells."""
        return Flag.SHORT if self.config.confidence and is_short(self.velocity) else Flag(0)

    @property
    @abstractmethod
    def velocity(self):
        """``v`` in px per half batch."""

    @abstractmethod
    def number(self, fmt, raw):
        """A raw value of a format, as this model computes with it."""

    @abstractmethod
    def ascend(self, batch, settings, plan, roi, middle=None):
        """``(Trace, flags, fields)`` of the iterations over a :class:`~.ingest.TakenIn`, from ``v`` on.

        ``roi`` is the corner of the batch, px; ``middle`` that of its region, as :meth:`Region.middle
        <cmfpga.protocol.regions.Region.middle>` gives it, by default the ROI's.
        ``fields`` of the result tell how sure v is, where the hardware can.
        """
