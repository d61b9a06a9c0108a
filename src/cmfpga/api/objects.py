"""One of the objects that the command ``track`` follows: its files, and its part of the summary."""

import collections
import math
from array import array
from dataclasses import dataclass, field

import numpy as np

from ..errors import ConfigError, naming
from ..imaging.camera import Camera
from ..protocol.flags import Flag
from ..show.export import exported
from ..show.gallery import Gallery
from ..tracking.fit import FittedCutter
from ..tracking.kept import Kept
from ..tracking.loop import CsvConsumer
from ..tracking.verdict import Verdict, judged_columns


@dataclass(kw_only=True)
class TrackedObject:
    """What was asked for, what follows from it, and what was found; a consumer of the object's batches."""

    name: str  # of its files: track-NAME.csv; empty: track.csv
    roi: tuple | None  # left column and top row, px; None until it is chosen (auto)
    proposal: object = None  # what was chosen, a Proposal
    config: object = None
    cutter: object = None
    batches: int = 0
    warned: int = 0
    events: int = 0
    seen: int = 0  # ROI events of all batches
    stride: int = 1  # the largest of a region
    dropped: dict = field(default_factory=dict)  # events, by what they were dropped as
    cycles: array = field(default_factory=lambda: array("q"))
    #: Of each batch what the verdict needs: a stream may have no end.
    numbers: dict = field(default_factory=lambda: collections.defaultdict(lambda: array("d")))
    flags: array = field(default_factory=lambda: array("i"))
    roi_next: tuple | None = None
    consumers: list = field(default_factory=list)  # take its batches beside the object itself: what makes its files
    accuracy: object = None  # compares its batches with a true motion, an Accuracy
    files: list = field(default_factory=list)  # the CSV from the begin; the others once finish has written them
    _writers: list = field(default_factory=list)  # take the object: a reference to it would be a circle

    def named(self, what):
        """``what``, or ``what-NAME``."""
        return f"{what}-{self.name}" if self.name else what

    def add(self, batch):
        """Take a tracked batch; its arrays are not kept."""
        result = batch.result
        self.batches += 1
        self.warned += bool(result.flags.warnings)
        self.events += len(batch.events)
        self.seen += result.roi_events + result.overflow + result.thinned
        self.stride = max(self.stride, batch.thinning if self.config.regions else 1)
        for what in ("hot", "noise") if batch.marks else ():
            self.dropped[what] = self.dropped.get(what, 0) + getattr(result, what)
        self.roi_next = batch.roi_next
        for name in judged_columns(self.config.motion, self.config.slides):
            self.numbers[name].append(math.nan if (value := batch.values[name]) is None else value)
        self.flags.append(batch.flags)
        if result.cycles is not None:
            self.cycles.append(result.cycles)

    def collect(self, stack, folder, *, recording, motion, engine, pictures, exports, report_mhz, wave):
        """Begin to collect what the object's files show, in ``folder``; ``stack`` closes the CSV, and the exports.

        ``recording`` is its name, ``motion`` the true one where it is known. Of several objects each adds its name to
        the paths of ``pictures`` and ``exports``. ``report_mhz`` is the assumed clock of the report, MHz (None: no
        report), ``wave`` the number of the batch whose waveforms are written.
        """
        if pictures:
            gallery = Gallery(self.config, recording, motion)

            def draw(one):
                for path in pictures:
                    gallery.save(one._file(path.parent, path.stem, path.suffix), verdict=one.verdict.title)

            self._later(gallery, draw)
        if report_mhz is not None:
            from ..show.report import check_config, plotly_script, write_page

            check_config(self.config)
            plotly_script()  # if it is missing, that is told before the work
            kept = Kept(self.config, engine, recording, motion)

            def report(one):
                kept.save(one._file(folder, "track", ".npz"))
                write_page(kept, one._file(folder, "report", ".html"), clock_mhz=report_mhz)

            self._later(kept, report)
        if wave is not None:
            from ..show.wave import WaveTaker, write_waves

            taker = WaveTaker(self.config, engine, wave)
            name = self.named(f"batch-{wave}")
            self._later(taker, lambda one: one.files.extend(write_waves(taker.record(), folder, name)))
        if self.accuracy:
            self._later(self.accuracy, lambda one: one.accuracy.save(one._file(folder, "accuracy", ".csv")))
        path = self._file(folder, "track", ".csv")
        stack.enter_context(naming(path))
        file = stack.enter_context(path.open("w", newline=""))
        self.consumers.append(CsvConsumer(file, self.config))
        for path in exports:
            path = self._file(path.parent, path.stem, path.suffix)
            self.consumers.append(stack.enter_context(exported(path, self.config)))

    def _later(self, consumer, write):
        self.consumers.append(consumer)
        self._writers.append(write)

    def _file(self, folder, what, suffix):
        self.files.append(folder / f"{self.named(what)}{suffix}")
        return self.files[-1]

    def check(self):
        """Raises :exc:`ConfigError` where there was no batch, or never an event in the ROI."""
        if self.events < 2:  # one alone shows no motion
            raise self.cutter.too_few()
        if not self.seen:
            raise ConfigError(
                f"ROI at {self.roi[0]},{self.roi[1]}: none of the events is in it, in {self.batches} batches; an ROI "
                "with an object is needed"
            )

    def finish(self):
        """Write the files beside the CSV; raises :exc:`RecordingError` where the truth tells of none of the batches."""
        if self.accuracy:
            self.accuracy.finish()
        for write in self._writers:
            write(self)

    @property
    def verdict(self):
        """Of the batches so far."""
        return Verdict(lambda name: np.array(self.numbers[name]), [*map(Flag, self.flags)], self.config)

    @property
    def dropped_text(self):
        """What the filters dropped, for people; empty without filters."""
        return self.dropped and "{hot} events of hot pixels dropped, {noise} of background activity".format(
            **self.dropped
        )

    @property
    def image_text(self):
        """Which image ROI and v are in, for people; empty without a camera."""
        image = self.config.image
        return image and f"ROI and velocity are in the {image} image: {Camera(*self.config.calibration)}"

    @property
    def remarks(self):
        """Warnings and notes on the whole track: ``(kind, sentence)``."""
        found, fitted = self.verdict, isinstance(self.cutter, FittedCutter)
        notes = found.notes(fitted)
        if self.stride > 1:
            notes.append(f"one of {self.stride} events in the ROI was stored, so that buffer_events hold them")
        return [("warning", text) for text in found.warnings()] + [("note", text) for text in notes]

    def summary(self):
        """The object's part of the command's summary, JSON-ready."""
        entry = {
            "batches": self.batches,
            "events_left_over": self.cutter.leftover,
            "batches_with_warnings": self.warned,
            **self.verdict.summary(),
            "cycles": sum(self.cycles) if self.cycles else None,
            **({"dropped": self.dropped} if self.dropped else {}),
            **({"image": self.config.image} if self.config.image else {}),
            **({"accuracy": self.accuracy.summary()} if self.accuracy else {}),
            "roi_next": list(self.roi_next),
            "files": [str(path) for path in self.files],
        }
        if self.name:
            entry = {"name": self.name, "roi": list(self.roi), **entry}
        if self.proposal:
            entry["roi"] = list(self.roi)
            entry["batch_events"] = self.proposal.batch_events if isinstance(self.cutter, FittedCutter) else None
            entry["start_event"] = self.proposal.start_event
            entry["fields"] = self.proposal.fields
        return entry
