"""Pictures: of a track, also as it moves, and of a whole recording with the proposed ROIs, also as text.

A track's shows event frames with the ROI, the image before and after, and the velocity over time.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ConfigError, naming
from ..imaging.camera import flow, nearest
from ..imaging.iwe import image_of_warped_events, scaled_roi_events
from ..protocol.flags import Flag

_DOTS = 100  # points of a line that has dots
FRAMES = 4
DPI = 110

#: What a picture can be written as; the last one moves.
SUFFIXES = (".png", ".pdf", ".svg", ".gif")

# Event frames that are kept, at most, all of them for the GIF.
_KEPT = 64
_GIF_FPS = 6
_COLOURS = {"OFF (darker)": (0.36, 0.55, 0.94), "ON (brighter)": (1.0, 1.0, 1.0)}
_ROI, _TRAIL, _V = "tab:red", "tab:cyan", "gold"
_REACH = 0.7  # of the ROI's size, that the longest arrow of v has at most
_SURE = 5.991  # squared distance, in standard deviations, within which 95 % of a plane's normal distribution lie
_LINES = ("tab:blue", "tab:orange", "tab:green")

#: Charts over time by the motion: title, label, and names of what is drawn.
SPEED = {"vx": "vx", "vy": "vy"}
CHARTS = {
    "translation": (("velocity of the object", "velocity [px/s]", SPEED),),
    "similarity": (
        ("velocity of the object", "velocity [px/s]", SPEED),
        ("zoom and roll", "zoom [1/s], roll [rad/s]", {"zoom_per_s": "zoom", "roll_rad_per_s": "roll"}),
    ),
    "rotation": (
        ("angular velocity of the camera", "angular velocity [rad/s]", {f"w{a}_rad_per_s": f"ω{a}" for a in "xyz"}),
    ),
}


@dataclass(frozen=True, eq=False)
class _Frame:
    """What is drawn of one batch: time in µs, pixels that are mostly OFF, and ON, as packed bits; image at v.

    v in px/s with its covariance, None where it is not sure.
    """

    index: int
    t_ref: float
    roi: tuple
    packed: np.ndarray
    moved: np.ndarray
    v: tuple | None
    spread: np.ndarray | None

    def rgb(self, width):
        """The frame in colour, [rows, columns, 3]."""
        off, on = np.unpackbits(self.packed, axis=2, count=width)
        return np.array([(0.0, 0.0, 0.0), *_COLOURS.values()])[off + 2 * on]


class Gallery:
    """Collects what the picture shows, in bounded memory, while batches go by.

    ``name`` is the recording's, ``motion`` the true motion where it is known.
    """

    def __init__(self, config, name, motion=None):
        self.config, self.name, self.motion = config, name, motion
        self._where = f", {config.image}" * bool(config.image)
        self._frames = []  # of every stride-th batch
        self._stride = 1
        self._sharpest = None  # of the batch whose contrast grew most: growth, index, v, images before and after
        self._times, self._values, self._truths, self._doubtful, self._corners = [], [], [], [], []

    def add(self, batch):
        """Take one :class:`~cmfpga.tracking.loop.TrackedBatch`."""
        self._corners.append(batch.roi)
        if batch.v_px_per_s is not None:
            self._times.append(batch.t_ref)
            self._values.append({**dict(zip(SPEED, batch.v_px_per_s, strict=True)), **batch.rates})
            self._truths.append(batch.true_px_per_s(self.motion))
            self._doubtful.append(Flag.DOUBTFUL in batch.flags)
            still = self._image(batch, (0,) * len(batch.result.v))
            gain = batch.contrast - still.var()
            if self._sharpest is None or gain > self._sharpest[0]:
                self._sharpest = (gain, batch.index, batch.v, still, self._image(batch, batch.result.v))
        if batch.index % self._stride == 0 and len(batch.events):
            self._frames.append(self._frame(batch))
            if len(self._frames) >= _KEPT:
                self._frames = self._frames[::2]
                self._stride *= 2

    def _frame(self, batch):
        signs = np.zeros(self.config.geometry.size[::-1], np.int32)
        x, y, shown = nearest(self.config, batch.seen.x, batch.seen.y)
        at = y[shown], x[shown]
        np.add.at(signs, at, 2 * batch.events.p[shown].astype(np.int32) - 1)
        there = np.zeros(signs.shape, bool)
        there[at] = True
        events = np.stack([there & (signs < 0), there & (signs >= 0)])
        moved = self._image(batch, batch.result.v).astype(np.float32)
        v, spread = None if Flag.DOUBTFUL in batch.flags else batch.v_px_per_s, batch.covariance
        if spread is not None:
            xx, yy, xy = spread
            spread = np.array([[xx, xy], [xy, yy]]) / batch.half_s**2
        return _Frame(batch.index, batch.t_ref, batch.roi, np.packbits(events, axis=2), moved, v, spread)

    def _image(self, batch, v):
        """Image of warped events of the ROI at v."""
        x, y, dt = scaled_roi_events(self.config, batch.seen, batch.result.roi, **batch.which)
        v = flow(self.config, v, x, y, batch.result.roi)
        return image_of_warped_events(x, y, dt, v, width=self.config.roi_width, height=self.config.roi_height)

    def save(self, path, figure=None, verdict=""):
        """Write the picture as what the suffix says: one of :data:`SUFFIXES`; ``.gif`` shows the object as it moves."""
        animated = check_suffix(path).suffix.lower() == ".gif"
        with naming(path):
            self._animate(path) if animated else (figure or self.figure(verdict)).savefig(path, dpi=DPI)

    def _animate(self, path):
        """Write all frames that are kept, and beside each the object as it is at v."""
        from matplotlib.animation import PillowWriter
        from matplotlib.figure import Figure

        if not self._frames:
            raise ConfigError(f"picture {path}: no batch has events")
        figure = Figure(figsize=(10, 4.6), layout="constrained", dpi=80)
        left, right = figure.subplots(1, 2, width_ratios=(1.4, 1))
        figure.legend(handles=self._handles(trail=True), loc="outside lower center", ncols=5)
        most = np.median([frame.moved.max() for frame in self._frames])
        writer = PillowWriter(fps=_GIF_FPS)
        with writer.saving(figure, str(path), 80):
            for frame in self._frames:
                left.clear()
                right.clear()
                self._draw_frame(left, frame)
                self._show(right, frame.moved, cmap="magma", vmin=0, vmax=max(most, 1))
                right.set(title="its events, moved back at v", xlabel="x in ROI [px]", ylabel="y in ROI [px]")
                writer.grab_frame()

    def figure(self, verdict=""):
        """The picture as a Matplotlib ``Figure``; ``verdict`` stands in its title, in three lines at most."""
        from matplotlib.figure import Figure  # Matplotlib takes a second to import; no window, so no pyplot

        figure = Figure(figsize=(14, 8.4), layout="constrained", dpi=DPI)
        top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1.6))
        chosen = np.unique(np.linspace(0, len(self._frames) - 1, FRAMES).round().astype(int)) if self._frames else []
        for axis, k in zip(np.atleast_1d(top.subplots(1, max(1, len(chosen)))), chosen, strict=False):
            self._draw_frame(axis, self._frames[k])
        moves = len(chosen) and len(set(self._corners[: self._frames[chosen[-1]].index + 1])) > 1
        figure.legend(handles=self._handles(trail=moves), loc="outside lower center", ncols=5)
        left, right = bottom.subfigures(1, 2, width_ratios=(1.15, 1))
        if self._sharpest:
            self._draw_images(left, *self._sharpest[1:])
            self._draw_motion(right)
        title = f"{_plain(self.name)}: {verdict or f'{len(self._corners)} {self.config.nouns}'}"
        figure.suptitle(title, fontsize=12 - title.count("\n"))
        return figure

    def _handles(self, trail):
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        events = [Patch(facecolor=colour, edgecolor="gray", label=name) for name, colour in _COLOURS.items()]
        roi = Patch(fill=False, edgecolor=_ROI, linewidth=1.5, label="ROI")
        lines = [Line2D([], [], color=_TRAIL, linewidth=2, label="trail of its centre")] * bool(trail)
        if seconds := self._arrow_s:
            named = f"v: the way in {seconds:g} s, and where it ends with 95 %"
            lines.append(Line2D([], [], color=_V, marker=">", markevery=[-1], label=named))
        return [*events, roi, *lines]

    @property
    def _arrow_s(self):
        """Time of the arrows' way: 1, 2 or 5 times a power of ten, s; None without an arrow."""
        speeds = [np.hypot(*frame.v) for frame in self._frames if frame.v is not None]
        if not speeds or not max(speeds):
            return None
        most = _REACH * min(self.config.roi_px) / max(speeds)
        power = 10.0 ** np.floor(np.log10(most))
        return power * next(k for k in (5, 2, 1) if k * power <= most or k == 1)

    def _draw_v(self, axis, frame, centre):
        """The arrow of v, and at its tip the ellipse of its covariance."""
        from matplotlib.patches import Ellipse

        tip = np.add(centre, np.multiply(frame.v, self._arrow_s))
        shape = {"arrowstyle": "-|>", "color": _V, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
        axis.annotate("", tip, centre, arrowprops=shape)
        if frame.spread is not None:
            sizes, axes = np.linalg.eigh(frame.spread)
            across = 2 * self._arrow_s * np.sqrt(_SURE * sizes)
            angle = np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))
            axis.add_patch(Ellipse(tip, *across, angle=angle, fill=False, edgecolor=_V, linewidth=1))

    def _show(self, axis, image, **how):
        """An image, on axes of the sensor's pixels."""
        right, bottom = (side * self.config.pixel - 0.5 for side in image.shape[1::-1])
        return axis.imshow(image, interpolation="nearest", extent=(-0.5, right, bottom, -0.5), **how)

    def _draw_frame(self, axis, frame):
        self._show(axis, frame.rgb(self.config.geometry.width))
        centre = tuple(side / 2 for side in self.config.roi_px)
        axis.plot(*np.add(self._corners[: frame.index + 1], centre).T, color=_TRAIL, linewidth=2)
        axis.add_patch(_box(frame.roi, self.config.roi_px))
        if frame.v is not None and self._arrow_s:
            self._draw_v(axis, frame, np.add(frame.roi, centre))
        title = f"{self.config.noun} {frame.index}, {frame.t_ref / 1e6:.3f} s"
        axis.set(title=title, xlabel=f"x{self._where} [px]", ylabel=f"y{self._where} [px]")

    def _draw_images(self, figure, index, v, still, moved):
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        found = ("\n" if len(v) > 2 else " ") + f"({', '.join(f'{one:.2f}' for one in v)})"
        top = np.percentile(moved, 99.8)
        for axis, image, title in (
            (axes[0], still, f"{self.config.noun} {index}: IWE at v = 0\ncontrast {still.var():.2f}"),
            (axes[1], moved, f"IWE at v ={found} px/half {self.config.noun}\ncontrast {moved.var():.2f}"),
        ):
            shown = self._show(axis, image, cmap="magma", vmin=0, vmax=max(top, 1))
            axis.set(xlabel="x in ROI [px]", ylabel="y in ROI [px]")
            axis.set_title(title, fontsize=10)
        binned = f" of {self.config.pixel}×{self.config.pixel} px" * bool(self.config.binning)
        figure.colorbar(shown, ax=axes, label=f"events per pixel{binned}", shrink=0.7)

    def _draw_motion(self, figure):
        """Velocity over time; of motions beyond translation what they are in physical units, beside it or instead."""
        charts = CHARTS[self.config.motion]
        for axis, (title, label, lines) in zip(figure.subplots(len(charts), squeeze=False)[:, 0], charts, strict=True):
            self._draw_chart(axis, lines)
            doubtful = " (hollow: doubtful)" * any(self._doubtful)
            axis.set(xlabel="recording's clock [s]", ylabel=label)
            axis.set_title(title + doubtful, loc="left")
            axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)  # beside the title
            axis.grid(alpha=0.3)

    def _draw_chart(self, axis, lines):
        seconds, doubtful = np.array(self._times) / 1e6, np.array(self._doubtful)
        size = 4 if len(seconds) <= _DOTS else 0  # more would hide the line, and the truth
        for k, (colour, (name, shown)) in enumerate(zip(_LINES, lines.items(), strict=False)):
            found = np.array([values[name] for values in self._values], np.float64)
            axis.plot(seconds, found, "o-", color=colour, markersize=size, label=f"{shown} found", markevery=~doubtful)
            if doubtful.any():
                axis.plot(seconds[doubtful], found[doubtful], "o", color=colour, markerfacecolor="none", markersize=4)
            if self.motion and name in SPEED:
                style = "--" if len(seconds) > 1 else "x"  # of one point there is no line
                axis.plot(seconds, np.array(self._truths)[:, k], style, color=colour, label=f"{shown} true")
        axis.axhline(0, color="gray", linewidth=0.5)


def _box(corner, size):
    from matplotlib.patches import Rectangle

    return Rectangle(np.subtract(corner, 0.5), *size, fill=False, edgecolor=_ROI, linewidth=1.5)


def check_suffix(path, suffixes=SUFFIXES):
    """``path`` as a :class:`Path`; :exc:`ConfigError` unless it has one of ``suffixes``."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise ConfigError(f"picture {path}: a name that ends in {', '.join(suffixes)} is needed")
    return path


def picture_path(text, suffixes=SUFFIXES):
    """The same of a picture that is to be written later: its folder must be there now."""
    path = check_suffix(text, suffixes)
    if not path.parent.is_dir():
        raise ConfigError(f"{text!r}: no such folder")
    return path


def _plain(path):
    """A file's name as Matplotlib can show it: no formulas, only signs that its own font has, and not too long."""
    name = Path(path).name.encode("latin-1", "replace").decode("latin-1")
    name = name if len(name) <= 80 else f"{name[:60]}...{name[-17:]}"
    return "".join(sign if sign.isprintable() else "?" for sign in name).replace("$", r"\$")


_SHADES = " .:-=+*#%@"
_FRAME_COLUMNS = 78


def _levels(survey):
    """Events per pixel on a scale of 0 to 1, on which hot pixels are no brighter than busy ones."""
    counts = np.sqrt(survey.counts)
    busy = counts[counts > 0]
    return np.minimum(counts / max(np.percentile(busy, 99), 1), 1)


def survey_lines(survey, config, proposals):
    """Lines of text that show all events, and the corners of the ROIs."""
    levels = _levels(survey)
    rows, columns = levels.shape
    width = min(_FRAME_COLUMNS, columns)
    step = columns / width
    height = max(round(rows / step / 2), 1)  # a sign is about twice as high as wide
    at_y, at_x = np.arange(rows) * height // rows, np.arange(columns) * width // columns
    cells = (at_y[:, None] * width + at_x).ravel()
    mean = (np.bincount(cells, levels.ravel()) / np.bincount(cells)).reshape(height, width)
    mean /= max(mean.max(), 1e-12)
    signs = [[_SHADES[int(value * (len(_SHADES) - 1) + 0.5)] for value in line] for line in mean]
    for k, found in enumerate(proposals):
        x0, y0 = found.roi
        x1, y1 = min(x0 + config.roi_width, columns) - 1, min(y0 + config.roi_height, rows) - 1
        for x, y, sign in ((x0, y0, "┌"), (x1, y0, "┐"), (x0, y1, "└"), (x1, y1, "┘")):
            if x < columns and y < rows:
                signs[at_y[y]][at_x[x]] = sign
        if len(proposals) > 1:
            signs[at_y[y0]][min(at_x[x0] + 1, width - 1)] = str(k)
    yield f"events of the whole recording, {columns}×{rows} px" + ("; corners: ROI" if proposals else "")
    yield from (f"|{''.join(line)}|" for line in signs)


def draw_survey(path, survey, config, proposals):
    """Write a picture, PNG: events, hot pixels and ROIs; below, the rate over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 8), layout="constrained", dpi=110)
    above, below = figure.subplots(2, 1, height_ratios=(4, 1))
    above.imshow(_levels(survey), cmap="gray", interpolation="nearest")
    if hot := survey.hot_pixels():
        x, y, _ = zip(*hot, strict=True)
        above.plot(x, y, "o", markerfacecolor="none", color="tab:orange", label="hot pixel")
        figure.legend(loc="outside upper right")
    for k, found in enumerate(proposals):
        above.add_patch(_box(found.roi, (config.roi_width, config.roi_height)))
        above.annotate(f"ROI {k}", np.subtract(found.roi, 0.5), color=_ROI, va="bottom")
    above.set(title="events of the whole recording (square root)", xlabel="x [px]", ylabel="y [px]")
    bin_us, rate = survey.rate()
    below.step(np.arange(len(rate)) * bin_us / 1e6, rate / 1e3, where="post")
    below.set(xlabel="time [s]", ylabel="rate [1000 events/s]", ylim=(0, None))
    with naming(path):
        figure.savefig(path, format="png")
