"""A track in plain words: what moved, where to, how fast, and whether the hardware would keep up."""

import functools
import math
from types import SimpleNamespace

import numpy as np

from ..config.windows import HOPS
from ..imaging.iwe import gain
from ..protocol.flags import Flag
from ..protocol.settings import BatchSettings
from ..rtl.core import Core
from ..rtl.regions.regions import Regions
from ..rtl.sliding.core import SlidingCore
from ..tracking.course import Replay
from ..tracking.verdict import Verdict

#: From the right, clockwise on the screen (y points down), in steps of 45°.
DIRECTIONS = (
    "to the right", "down and to the right", "down", "down and to the left",
    "to the left", "up and to the left", "up", "up and to the right",
)  # fmt: skip

#: A path is told leg by leg if it has no more of them.
MAX_LEGS = 4

#: Where velocities are right, contrast grows at least so many times; the demo's noisy scene reaches 1.2.
SHARPER = 1.1


def direction(dx, dy):
    """The nearest of :data:`DIRECTIONS`."""
    return DIRECTIONS[round(math.atan2(dy, dx) / (math.pi / 4)) % 8]


def corners(points, tolerance):
    """Indices of the points that a path can be simplified to: none of the others is farther from it than ``tolerance``.

    By halving at the farthest point (Ramer 1972; Douglas and Peucker 1973).
    """
    found, left = [0], [(0, len(points) - 1)]
    while left:
        begin, end = left.pop()
        part, along = points[begin : end + 1] - points[begin], points[end] - points[begin]
        share = np.clip(part @ along / max(along @ along, 1e-12), 0, 1)
        distance = np.hypot(*(part - share[:, None] * along).T)
        far = begin + int(distance.argmax())
        if distance[far - begin] <= tolerance:
            found.append(end)
        else:
            left += [(far, end), (begin, far)]
    return found


class Story:
    """Sentences about a :class:`~cmfpga.tracking.kept.Kept` track, and the assumed clock of the hardware.

    Arrays of the B batches are float64 [B]; NaN where there is no value.
    """

    def __init__(self, kept, clock_mhz):
        self.kept, self.clock_mhz = kept, clock_mhz
        #: Clock cycles; of an engine without a clock those that the formula gives.
        self.cycles, self.by_formula = _hardware_cycles(kept)
        self.compute_us = self.cycles / clock_mhz
        #: Time until the next result may be due, µs: that of the batch, or of a hop, a share of its window.
        self.lasts, config = np.array(kept.spans, np.float64), kept.config
        with np.errstate(invalid="ignore", divide="ignore"):
            if config.slides:
                hop = config.hop_events / kept.numbers("roi_events") if config.hop_events else 1 / HOPS
                self.lasts = np.fmin(self.lasts * hop, config.hop_us or np.inf)
            #: How many times as long as computing takes this is.
            self.margin = np.where((self.lasts > 0) & (self.compute_us > 0), self.lasts / self.compute_us, np.nan)

    @functools.cached_property
    def flags(self):
        """Of each batch."""
        return [Flag.parse(text) for text in self.kept.column("flags")]

    @functools.cached_property
    def verdict(self):
        """How far the batches are to be trusted."""
        return Verdict(self.kept.numbers, self.flags, self.kept.config)

    @property
    def lead(self):
        """The answer in one sentence."""
        sentence = f"{self._motion()} {self._hardware()}"
        return sentence if self.fits else f"Doubtful, see the remarks: {sentence[0].lower()}{sentence[1:]}"

    @property
    def measured(self):
        """Which batches measured a velocity: bool [B]."""
        return ~np.isnan(self.kept.numbers("vx_px_per_s"))

    def _motion(self):
        kept = self.kept
        if not self.measured.any():
            return f"Nothing could be measured: no {kept.config.noun} had enough events in the ROI (the orange frame);"
        begin, end = kept.numbers("t_ref_us")[self.measured][[0, -1]]
        seconds = (end - begin + np.array(kept.spans)[self.measured][[0, -1]].sum() / 2) / 1e6
        if not self.verdict.px_per_s:
            none = f"None of the {len(self.flags)} {kept.config.nouns} is to be trusted"
            return f"{none}: what moves in the orange frame is not known;"
        if kept.config.motion == "rotation":
            speed = np.linalg.norm([*self.verdict.rates.values()], axis=0)
            fastest = f", up to {speed.max():.3g} rad/s" if speed.max() > 1.3 * np.median(speed) else ""
            return f"The camera turned for {seconds:.2f} s, at about {np.median(speed):.3g} rad/s{fastest};"
        _, median, highest = self.verdict.px_per_s
        fastest = f", up to {highest:.0f} px/s" if highest > 1.3 * median else ""
        last = int(np.flatnonzero(self.measured)[-1])
        lost = "" if last + 1 == len(self.measured) else f", until it was lost after {kept.config.noun} {last}"
        way = f"{self._path()} within {seconds:.2f} s, at about {median:.0f} px/s{fastest}{lost}"
        return f"The object in the orange frame {way};"

    def _path(self):
        points = np.array([*zip(self.kept.numbers("roi_x"), self.kept.numbers("roi_y"), strict=True)])
        points = np.vstack([points, self.kept.roi_next])
        extent = np.hypot(*np.ptp(points, axis=0))
        if extent < 2:
            return "stayed where it was"
        legs = np.diff(points[corners(points, max(3.0, 0.1 * extent))], axis=0)
        if len(legs) <= MAX_LEGS:
            return "moved " + ", then ".join(f"{np.hypot(*leg):.0f} px {direction(*leg)}" for leg in legs)
        length, whole = np.hypot(*legs.T).sum(), points[-1] - points[0]
        end = f"{np.hypot(*whole):.0f} px {direction(*whole)} from" if np.hypot(*whole) >= 1 else "at"
        return f"moved along a path of about {length:.0f} px that ends {end} where it began,"

    def _hardware(self):
        timed = ~np.isnan(self.margin)
        if not timed.any():
            return "so there is nothing to say about the hardware's speed."
        clock = f"at an assumed clock of {self.clock_mhz:g} MHz"
        worst, config = int(np.nanargmin(self.margin)), self.kept.config
        span, took, margin = self.lasts[worst] / 1e3, self.compute_us[worst] / 1e3, self.margin[worst]
        due = "its hop" if config.slides else "it"
        slow = int((self.margin[timed] < 1).sum())
        if slow:
            return (
                f"the hardware would not keep up {clock}: {slow} of {timed.sum()} {config.nouns} take longer to "
                f"compute than {'their hops' if config.slides else 'they'} last, {config.noun} {worst} "
                f"{number(took)} ms for {number(span)} ms."
            )
        return (
            f"the hardware would keep up: {clock} even the tightest {config.noun}, number {worst}, is computed "
            f"in {number(took)} ms, and {due} lasts {number(span)} ms, {number(margin)} times as long."
        )

    @property
    def notes(self):
        """Further sentences, each by itself: how far to trust the first."""
        verdict, sharper = self.verdict, self.gain
        sentences = filter(None, (verdict.share, verdict.velocity, *verdict.warnings(), *verdict.notes(fitted=True)))
        found = [f"{text[0].upper()}{text[1:]}." for text in sentences]
        if self.kept.left_out:
            found.insert(0, f"{self.kept.left_out:,} {self.kept.config.nouns} after these are left out.")
        if motion := verdict.motion_text:
            found.insert(0, f"{motion[0].upper()}{motion[1:]}." if motion[0] != "ω" else f"{motion}.")
        if image := self.kept.config.image:
            found.insert(0, f"ROI, velocity and pictures are in the {image} image.")
        if sharper is not None:
            found.append(
                f"Moved back by the velocities found, the events make an image of {sharper:.2f} times the contrast "
                f"that they have as they came (dithered; median over the {self.kept.config.nouns})"
                + (": the velocities fit." if self.fits else ". That is hardly more: do not trust the velocities.")
            )
        truths = np.array(self.kept.truths)
        if not np.isnan(truths).all():
            found_v = np.stack([self.kept.numbers("vx_px_per_s"), self.kept.numbers("vy_px_per_s")], axis=1)
            error = np.hypot(*(found_v - truths)[self.measured].T)
            if len(error):
                found.append(
                    f"The true motion of this recording is known: the velocities are {np.median(error):.0f} px/s off "
                    f"in the median, {error.max():.0f} px/s at worst."
                )
        nouns = self.kept.config.nouns
        total, warned = len(self.flags), [flags.warnings for flags in self.flags if flags.warnings]
        if warned:
            counts = {flag.text: sum(flag in flags for flags in warned) for flag in Flag}
            which = ", ".join(f"{name} in {count}" for name, count in counts.items() if count)
            found.append(f"{len(warned)} of {total} {nouns} have warnings: {which}.")
        else:
            found.append(f"None of the {total} {nouns} has a warning: nothing unusual happened.")
        if thinned := sum(Flag.THINNED in flags for flags in self.flags):
            found.append(f"In {thinned} of {total} {nouns} events were left out evenly, to keep their number down.")
        return found

    @property
    def fits(self):
        """Whether the velocities found make the image sharper, as they should; True where nothing was measured."""
        return self.gain is None or self.gain > SHARPER

    @functools.cached_property
    def gain(self):
        """How many times the contrast at v = 0 that at the found v is, in the median; None if nothing was measured."""
        config, ratios = self.kept.config, []
        places = np.stack([self.kept.numbers(name) for name in ("roi_x", "roi_y")], axis=1)
        for detail in self.kept.details:
            span = self.kept.spans[detail.batch]
            if not len(detail.levels) or not span:
                continue
            dt = (2 * detail.since.astype(np.float64) - span) / span
            roi = places[detail.batch]
            ratios.append(gain(config, *self.kept.places(detail), dt, detail.v[-1], roi))
        return float(np.median(ratios)) if ratios else None


def number(value):
    """Three significant digits, without an exponent."""
    digits = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:,.{digits}f}"


def _hardware_cycles(kept):
    """Clock cycles of each batch, NaN for a degenerate one; and whether they are those of the formula."""
    counted = kept.numbers("cycles")
    if not np.isnan(counted).all():
        return counted, False
    core = (SlidingCore if kept.config.slides else Regions if kept.config.regions else Core)(kept.config)
    return np.array([core.cycles(**size, iterations=plan) if plan else np.nan for size, plan in _batches(kept)]), True


def _batches(kept):
    """Of each batch its events, those in the ROI, and its schedule, empty if it is degenerate."""
    names = ("events", "roi_events", "iterations")
    unknown = {"thinned": 0, "overflow": 0}  # not in track.csv; they decide the thinning, which is not asked for here
    columns = [[int(number) for number in kept.numbers(name)] for name in names]
    replay, rule = Replay(kept.config), kept.config.ascent_rule
    warm = len(rule.plan(BatchSettings.from_config(kept.config), True))
    for *batch, flags in zip(*columns, kept.column("flags"), strict=True):
        result = SimpleNamespace(**dict(zip(names, batch, strict=True)), **unknown, flags=Flag.parse(flags))
        result.restarted = result.iterations != warm  # or it began cold for another reason
        plan, _ = replay.settings_of(result)
        yield {"events": result.events, "roi_events": result.roi_events}, plan
