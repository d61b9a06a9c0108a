"""What a track amounts to, and how far it is to be trusted: for terminal, JSON, picture, report and Python."""

import functools
import itertools

import numpy as np

from ..config import Config
from ..imaging.camera import RATES
from ..protocol.confidence import OVERESTIMATED, SHORT_PX
from ..protocol.flags import Flag
from .ambiguity import UNTRUSTED, WORDS, Ambiguity
from .columns import DEVIATIONS, columns
from .fit import LOST_BATCHES

#: Where it moves less, it stands still, or hot pixels are all that is seen to be sharp.
STILL_PX = 0.5

#: What is told of motions beyond translation: columns, their names for people, and units.
_TOLD = {
    "translation": (),
    "similarity": (("zoom_per_s", "zoom", "/s"), ("roll_rad_per_s", "roll", "rad/s")),
    "rotation": tuple((f"w{axis}_rad_per_s", f"ω{axis}", "rad/s") for axis in "xyz"),
}

_RUNS = 3  # that are told one by one
_USUAL = Config()


def judged_columns(motion, slides):
    """Names of the columns that a verdict needs, beside the flags."""
    spreads = (f"{name}_sd" for name in DEVIATIONS[motion])
    names = ("confidence", "trusted", "ambiguity", "vx_px_per_s", "vy_px_per_s", "vx", "vy", "t_ref_us")
    return (*names, *spreads, *RATES[motion], *["window_us"] * slides)


class Verdict:
    """The batches of a track in few numbers and sentences.

    Velocities are those of the trusted batches; where the confidence was not measured, of all that measured one.

    ``numbers(name)``: a column of ``track.csv``, float64 [batches], NaN where it is empty. ``flags``: of each batch.
    """

    def __init__(self, numbers, flags, config=_USUAL):
        self.config, self.one, self.many = config, config.noun, config.nouns
        self.judged = ~np.isnan(numbers("confidence"))  # bool [batches], as the next: whose confidence was measured
        measured = ~np.isnan(numbers("vx_px_per_s"))
        self.trusted = numbers("trusted") > 0
        found = numbers("ambiguity").astype(np.int64)
        #: ``{Ambiguity: number of batches}`` whose events leave that open.
        self.ambiguous = {one: int(np.count_nonzero(found & one)) for one in Ambiguity}
        # These were not lost: no batch started cold because of them.
        sharp = np.array([Flag.DOUBTFUL not in one for one in flags], bool)
        self._held = self.trusted | (((found & UNTRUSTED) > 0) & sharp)
        size = np.hypot(numbers("vx"), numbers("vy"))
        used = self.trusted if self.judged.any() else measured
        self.speeds = np.stack([numbers("vx_px_per_s"), numbers("vy_px_per_s")], axis=1)[used]  # px/s
        #: float64 [used]; NaN where there is none.
        self.rates = {name: numbers(name)[used] for name in RATES[config.motion]}
        #: Which were judged and move so little that v is found too large.
        self.short = np.array([Flag.SHORT in flag for flag in flags], bool) & self.judged
        self._least = size[self.short].min(initial=np.inf) / config.pixel
        #: Standard deviation of one batch in physical units, in the median; None where there is none.
        self.spreads = {name: _extent(numbers(f"{name}_sd")[used])[1] for name in DEVIATIONS[config.motion]}
        _, self.px, _ = _extent(size[used if used.any() else measured])  # |v|, px per half batch, in the median
        self._times = numbers("t_ref_us")
        self._lengths = numbers("window_us") if config.slides else None
        #: First and last batch of each stretch of :data:`~cmfpga.tracking.fit.LOST_BATCHES` or more, all of them
        #: doubtful; of windows that overlap, of so many of their lengths. Empty where the confidence was not measured.
        self.lost = self._lost() if self.judged.any() else []

    @classmethod
    def of(cls, values, config=_USUAL):
        """Of a list of :attr:`TrackedBatch.values <cmfpga.tracking.loop.TrackedBatch.values>`."""
        declared = columns(config.motion, config.slides)

        def numbers(name):
            return declared[name].array([batch[name] for batch in values]).astype(np.float64)

        return cls(numbers, [Flag.parse(batch["flags"]) for batch in values], config)

    def _with_spread(self, value, name, form):
        """A value, and after it its standard deviation, in words."""
        spread = self.spreads.get(name)
        return f"{value:{form}}" if spread is None else f"{value:{form}} ± {spread:.2g}"

    def _lost(self):
        runs = itertools.groupby(range(len(self._held)), key=lambda k: bool(self._held[k]))
        found = [[*run] for held, run in runs if not held]
        return [(run[0], run[-1]) for run in found if len(run) >= LOST_BATCHES and self._is_long(run)]

    def _is_long(self, run):
        """Whether windows that overlap cover as much time as batches of their length would."""
        if self._lengths is None:
            return True
        lengths = self._lengths[self._lengths > 0]
        times = self._times[run][~np.isnan(self._times[run])]
        return bool(len(times)) and np.ptp(times) >= (LOST_BATCHES - 1) * np.median(lengths)

    @functools.cached_property
    def px_per_s(self):
        """|velocity|: smallest, median and largest, px/s; None where there is none."""
        return _extent(np.hypot(*self.speeds.T)) if len(self.speeds) else None

    @property
    def share(self):
        """How many batches are to be trusted, in words; empty where that was not measured."""
        if not self.judged.any():
            return ""
        open_ = {one: count for one, count in self.ambiguous.items() if count and one in UNTRUSTED}
        left = "; ".join(f"in {count}, {WORDS[one]}" for one, count in open_.items())
        return f"{self.trusted.sum()} of {len(self.trusted)} {self.many} are to be trusted" + f" ({left})" * bool(left)

    @property
    def velocity(self):
        """The velocity, in words; empty where there is none."""
        if not self.px_per_s:
            return ""
        low, median, high = self.px_per_s
        vx, vy = np.median(self.speeds, axis=0)
        where = " at the principal point" * (self.config.motion == "rotation")
        return (
            f"velocity{where} {median:,.0f} px/s in the median, {low:,.0f} to {high:,.0f} "
            f"(vx {self._with_spread(vx, 'vx_px_per_s', ',.0f')}, vy {self._with_spread(vy, 'vy_px_per_s', ',.0f')}); "
            f"{self.px:.1f} px per half {self.one}"
        )

    def __str__(self):
        told = (self.share, self.velocity, self.motion_text, *self.warnings())
        return ". ".join(text[0].upper() + text[1:] for text in told if text) + "."

    @property
    def title(self):
        """What stands above the picture: all of this, in lines; empty where the confidence was not measured."""
        lost = f"lost in {self._when_lost}" if self.lost else ""
        return "\n".join(filter(None, (self.share, self.velocity, lost))) if self.share else ""

    @property
    def motion_text(self):
        """The motion beside the velocity, in physical units, in words; empty where there is none."""
        shown = [
            f"{title} {found}" for name, title, unit in _TOLD[self.config.motion] if (found := self._told(name, unit))
        ]
        if self.time_to_contact:
            shown.append(f"time to contact {self.time_to_contact:.3g} s at this zoom")
        return "; ".join(shown)

    @functools.cached_property
    def time_to_contact(self):
        """Of the zoom in the median, s; None of what does not come nearer."""
        _, zoom, _ = _extent(self.rates.get("zoom_per_s", np.zeros(0)))
        return 1 / zoom if zoom is not None and zoom > 0 else None

    def _told(self, name, unit):
        low, middle, high = _extent(self.rates[name])
        if middle is None:
            return ""
        return f"{self._with_spread(middle, name, '.3g')} {unit} in the median, {low:.3g} to {high:.3g}"

    def warnings(self):
        """Sentences about what went wrong."""
        if not self.lost:
            return []
        then = "the ROI followed them all the same"
        if self.config.roi_stays:
            then = f"each next batch started cold, and after {LOST_BATCHES} of them the ROI stayed"
        return [f"the object was lost in {self._when_lost}: none of these is to be trusted; {then}"]

    @property
    def _when_lost(self):
        told = [f"{first} to {last}{self._when(first, last)}" for first, last in self.lost[:_RUNS]]
        more = f", and {len(self.lost) - _RUNS} times more" if len(self.lost) > _RUNS else ""
        return f"{self.many} {', '.join(told)}{more}"

    def _when(self, first, last):
        times = self._times[first : last + 1] / 1e6
        times = times[~np.isnan(times)]
        return f" ({times[0]:.3f} to {times[-1]:.3f} s)" if len(times) else ""

    @property
    def _short_text(self):
        least = self.config.pixel * SHORT_PX
        what = f"short: {self.short.sum()} of {len(self.short)} {self.many} move by less than {least:g} px per half"
        if self.config.motion != "translation":
            return f"{what} {self.one} at the edge, are overestimated, and not to be trusted"
        most = next((share for limit, share in OVERESTIMATED if self._least < limit), 0.0)
        trusted = int((self.short & self.trusted).sum())
        return f"{what} {self.one}: overestimated by up to {100 * most:.0f} %; {trusted} of these are to be trusted"

    def notes(self, fitted=False):
        """Sentences about what could be measured better; ``fitted``: the lengths of batches were chosen."""
        if not self.judged.any():
            return []
        found = [self._short_text] if self.short.any() else []
        # Some windows of one motion look like that, too.
        if 2 * (doubled := self.ambiguous[Ambiguity.TWO_MOTIONS]) > len(self.trusted):
            found.append(
                f"{doubled} of {len(self.trusted)} {self.many} look as if two motions were in the ROI, or a turn or "
                "dense texture: v may be neither's"
            )
        if self.px is not None and self.px < (still := self.config.pixel * STILL_PX):
            found.append(
                f"what moves by less than {still:g} px stands still, or it is hot pixels that are seen to stand "
                "still: info tells where there are some, --hot-pixels auto drops them"
            )
        if not fitted and (found or self.trusted.mean() < 0.5 or self.short.mean() > 0.5):
            found.append(
                "without a batch option, batches are as long as suits the motion: "
                f"{3 * self.config.pixel} to {5 * self.config.pixel} px per half batch"
            )
        return found

    def summary(self):
        """The same, JSON-ready."""
        judged = self.judged.any()
        vx, vy = np.median(self.speeds, axis=0).tolist() if len(self.speeds) else (None, None)
        motion = self.config.motion
        extents = {"px_per_s": np.hypot(*self.speeds.T), **{name: self.rates[name] for name, *_ in _TOLD[motion]}}
        ambiguous = {one.name.lower(): count for one, count in self.ambiguous.items()}
        return {
            "trusted_batches": int(self.trusted.sum()) if judged else None,
            "lost_batches": [list(run) for run in self.lost],
            "short_batches": int(self.short.sum()) if judged else None,
            "ambiguous_batches": ambiguous if judged else None,
            "median_px_per_half_batch": self.px,
            "vx_px_per_s": vx,
            "vy_px_per_s": vy,
            "standard_deviation": self.spreads,
            **{k: dict(zip(("lowest", "median", "highest"), _extent(v), strict=True)) for k, v in extents.items()},
            **({"time_to_contact_s": self.time_to_contact} if motion == "similarity" else {}),
        }


def _extent(values):
    """Smallest, median and largest of what is no NaN; None, thrice, where all is."""
    values = values[~np.isnan(values)]
    return tuple(float(of(values)) for of in (np.min, np.median, np.max)) if len(values) else (None,) * 3
