"""What a sweep has to do: every object of every recording with every configuration, in a fixed order."""

import hashlib
import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path

from ..config import Config, preset, unread
from ..config.windows import needs_batches
from ..engines import check_roi
from ..errors import ConfigError, UserError
from ..events import open_recording
from ..imaging.survey import Survey, usual_survey, without_hot_pixels
from ..tracking.source import rotation_fields, sensor_fields, unit_note, whole_sensor
from ..truth import Truth, read_truth
from .task import Task, version

#: Stands among the fields that vary for the configuration that is begun with.
PRESET = "preset"

_WITH_ROI = re.compile(r"(.+)@(-?\d+),(-?\d+)", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Subject:
    """An object of a recording.

    ``sensor`` is what the file, or the options, say; or else what holds its events, if that is not the configuration's.
    """

    name: str  # the recording as it was given, without its ROI
    path: Path  # absolute
    roi: tuple[int, int] | None  # as given; None: at the object's start
    digest: str = ""  # SHA-256 of the file
    sensor: tuple[int, int] | None = None
    first_us: int = 0  # time of the first event that is tracked
    truth: Truth | None = None
    survey: Survey | None = field(default=None, compare=False, repr=False)  # whose hot pixels are dropped by default
    note: str | None = None  # where the unit of its time is a guess
    size_note: str | None = None  # where the size of its sensor is one
    problem: str = ""  # why it cannot be tracked

    @property
    def width(self):
        """Of the sensor, px, or None; with :attr:`height`, as of an event source."""
        return self.sensor and self.sensor[0]

    @property
    def height(self):
        return self.sensor and self.sensor[1]

    def require_roi(self):
        """Raise :exc:`ConfigError` unless it is known where the object is."""
        if not self.problem and self.roi is None and (self.truth is None or self.truth.start is None):
            raise ConfigError(
                f"{self.name}: an ROI is needed, as {self.name}@X,Y, or --roi X,Y for all; the recording does not say "
                "where its object is"
            )

    def roi_for(self, config):
        """The first batch's ROI; without one the whole sensor, of a rotation, or around the object's true place."""
        roi = whole_sensor(config) if self.roi is None else self.roi
        if roi is not None:
            return roi
        self.require_roi()
        centre = self.truth.motion.position(self.first_us)
        most = config.geometry.roi_x_max * config.pixel, config.geometry.roi_y_max * config.pixel
        axes = zip(centre, config.roi_px, most, strict=True)
        return tuple(min(max(round(at - (size - 1) / 2), 0), last) for at, size, last in axes)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One configuration of a sweep, before a recording's sensor is known."""

    number: int  # from 0
    varied: dict  # values of the fields that vary, by name
    preset: str
    changes: dict  # all fields that differ from the preset's

    @property
    def label(self):
        """The values that vary, for people."""
        return ", ".join(f"{name} = {value}" for name, value in self.varied.items()) or "as given"

    @property
    def motion(self):
        """What is looked for."""
        return self.changes.get("motion", preset(self.preset).motion)

    def config(self, subject):
        """The :class:`Config` for a recording; of a rotation with its calibration. Raises :exc:`ConfigError`."""
        given = self._fields(subject)
        own = rotation_fields(subject, self.motion, given, "--set camera=fx,fy,cx,cy,k1,k2,p1,p2,k3")
        config = preset(self.preset).replace(**own | given)
        needs_batches(config, "sweep")
        return self._without_hot_pixels(config, subject)[0]

    def hot_note(self, subject):
        """Which hot pixels of a recording are dropped because nobody says otherwise; None where none are."""
        try:
            return self._without_hot_pixels(preset(self.preset).replace(**self._fields(subject)), subject)[1]
        except ConfigError:
            return None

    def _without_hot_pixels(self, config, subject):
        told = {"hot_pixels", "hot_mask"} & {*self.changes}
        return without_hot_pixels(config, None if told else subject.survey, "--set hot_pixels=0")

    def fields(self, subject):
        """All fields for a recording, whether or not they go together."""
        try:
            return self.config(subject).to_dict()
        except ConfigError:
            return preset(self.preset).to_dict() | self._fields(subject)

    def _fields(self, subject):
        sensor = subject.sensor
        size = {} if sensor is None else {"sensor_width": sensor[0], "sensor_height": sensor[1]}
        return size | self.changes


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of the results: what to run, or why it cannot be."""

    subject: Subject
    choice: Choice
    roi: tuple[int, int] | None = None
    task: Task | None = None
    problem: str = ""


def choices(base, assignments, varied):
    """A :class:`Choice` of each combination of the values of ``varied``, the last field changing fastest.

    ``varied`` are texts ``FIELD=A,B,…``, ``assignments`` texts ``FIELD=VALUE``, ``base`` is a preset's name. Returns
    also why each of the other combinations is skipped: it names a field that its gradient or ascent does not read.
    Raises :exc:`ConfigError` where a field or a value is not allowed, or stands twice; or no combination is left.
    """
    fixed = Config.parse(assignments)
    axes = {}
    for text in varied:
        name, equals, values = text.partition("=")
        if not equals or not values:
            raise ConfigError(f"--vary {text}: FIELD=VALUE,VALUE,… is needed")
        if name in axes or name in fixed:
            raise ConfigError(f"--vary {text}: {name} is set twice")
        axes[name] = [_value(name, value.strip()) for value in values.split(",")]
        for value in axes[name]:
            if axes[name].count(value) > 1:
                raise ConfigError(f"--vary {text}: {value} stands twice")
    preset(base)
    found, skipped = [], []
    for values in itertools.product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        changes = fixed | {name: value for name, value in chosen.items() if name != PRESET}
        name = chosen.get(PRESET, base)
        idle = unread(preset(name).to_dict() | changes)
        if why := [idle[name] for name in changes if name in idle]:
            skipped += why[:1]
        else:
            found.append(Choice(number=len(found), varied=chosen, preset=name, changes=changes))
    if not found:
        raise ConfigError(skipped[0])
    return found, skipped


def _value(name, text):
    if name == PRESET:
        preset(text)
        return text
    return Config.parse([f"{name}={text}"])[name]


def subjects(arguments, roi, run):
    """A :class:`Subject` of each of ``RECORDING`` and ``RECORDING@X,Y``; ``roi`` is for those without one.

    What is wrong with a recording is its ``problem``, and does not raise.
    """
    found = []
    for argument in arguments:
        name, own = argument, roi
        match = _WITH_ROI.fullmatch(argument)
        if match and not Path(argument).exists():
            name, own = match[1], (int(match[2]), int(match[3]))
        if any((name, own) == (other.name, other.roi) for other in found):
            raise ConfigError(f"{argument}: stands twice")
        found.append(_subject(name, own, run))
    return found


def _subject(name, roi, run):
    path = Path(name)
    try:
        with open_recording(path, sensor=run.sensor, time_unit=run.time_unit) as recording:
            first = next(iter(recording.chunks(run.start_event, 1)), None)
            note = unit_note(recording, "--time-unit")
            size, size_note = sensor_fields(recording, {}, preset, "--sensor W,H")
            survey = usual_survey(recording, run.engine, {})
        truth = read_truth(path)
        digest = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    except (UserError, OSError) as error:
        return Subject(name=name, path=path, roi=roi, problem=" ".join(str(error).splitlines()))
    return Subject(
        name=name, path=path.resolve(), roi=roi, digest=digest.hexdigest(), sensor=tuple(size.values()) or None,
        first_us=int(first.t[0]) if first else 0, truth=truth, survey=survey, note=note, size_note=size_note,
    )  # fmt: skip


def rows(subjects, choices, run):
    """A :class:`Row` of each object and configuration, object by object.

    Raises :exc:`ConfigError` where a recording that can be read needs an ROI.
    """
    for subject in subjects:
        if any(choice.motion != "rotation" for choice in choices):
            subject.require_roi()
    return [_row(subject, choice, run) for subject in subjects for choice in choices]


def _row(subject, choice, run):
    roi = subject.roi
    try:
        if subject.problem:
            raise ConfigError(subject.problem)
        config = choice.config(subject)
        roi = subject.roi_for(config)
        check_roi(config, roi, config.pixel)
    except ConfigError as error:
        return Row(subject=subject, choice=choice, roi=roi, problem=str(error))
    task = Task(
        path=str(subject.path), digest=subject.digest, config=config, roi=roi, run=run, truth=subject.truth,
        version=version(),
    )  # fmt: skip
    return Row(subject=subject, choice=choice, roi=roi, task=task)
