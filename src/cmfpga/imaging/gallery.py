"""The picture of a track: event frames with the ROI, the image before and after, velocity over time."""

from pathlib import Path

import numpy as np

from ..errors import naming
from ..protocol.flags import Flag
from .iwe import image_of_warped_events, scaled_roi_events

FRAMES = 4
DPI = 110


class Gallery:
    """Collects what the picture shows, in bounded memory, while batches go by.

    Parameters
    ----------
    config : Config
        Sizes.
    name : str
        Of the recording.
    motion : Motion, optional
        The true motion, where it is known.
    """

    def __init__(self, config, name, motion=None):
        self.config = config
        self.name = name
        self.motion = motion
        self._frames = []  # (batch, event frame) of every stride-th batch
        self._stride = 1
        self._sharpest = None  # of the batch whose contrast grew most: growth, index, v, images before and after
        self._times, self._speeds, self._truths, self._doubtful, self._corners = [], [], [], [], []

    def add(self, batch):
        """Take one :class:`~cmfpga.tracking.loop.TrackedBatch`."""
        self._corners.append(batch.result.roi)
        if batch.v_px_per_s is not None:
            self._times.append(batch.t_ref)
            self._speeds.append(batch.v_px_per_s)
            self._truths.append(batch.true_px_per_s(self.motion))
            self._doubtful.append(Flag.DOUBTFUL in batch.flags)
            self._keep_sharpest(batch)
        if batch.index % self._stride == 0 and len(batch.events):
            self._frames.append((batch.index, batch.result.roi, self._frame(batch.events)))
            if len(self._frames) >= 4 * FRAMES:
                self._frames = self._frames[::2]
                self._stride *= 2

    def _frame(self, events):
        """Events per pixel of the whole sensor."""
        frame = np.zeros((self.config.sensor_height, self.config.sensor_width), np.uint16)
        np.add.at(frame, (events.y, events.x), 1)
        return frame

    def _keep_sharpest(self, batch):
        thinned = bool(batch.result.thinned)
        events = scaled_roi_events(self.config, batch.events, batch.result.roi, thinned=thinned)
        size = {"width": self.config.roi_width, "height": self.config.roi_height}
        still = image_of_warped_events(*events, (0, 0), **size)
        gain = batch.contrast - still.var()
        if self._sharpest is None or gain > self._sharpest[0]:
            moved = image_of_warped_events(*events, batch.result.v, **size)
            self._sharpest = (gain, batch.index, batch.result.v, still, moved)

    def save(self, path, verdict=""):
        """Write the picture (PNG, or what the suffix says)."""
        with naming(path):
            self.figure(verdict).savefig(path, dpi=DPI)

    def figure(self, verdict=""):
        """The picture as a Matplotlib ``Figure``; ``verdict`` stands in its title."""
        from matplotlib.figure import Figure  # Matplotlib takes a second to import; no window, so no pyplot

        figure = Figure(figsize=(14, 8.4), layout="constrained", dpi=DPI)
        top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1.6))
        chosen = np.unique(np.linspace(0, len(self._frames) - 1, FRAMES).round().astype(int)) if self._frames else []
        for axis, k in zip(np.atleast_1d(top.subplots(1, max(1, len(chosen)))), chosen, strict=False):
            self._draw_frame(axis, *self._frames[k])
        left, right = bottom.subfigures(1, 2, width_ratios=(1.15, 1))
        if self._sharpest:
            self._draw_images(left, *self._sharpest[1:])
            self._draw_speed(right.subplots())
        shown = self._corners[: max((self._frames[k][0] for k in chosen), default=0) + 1]
        trail = " (cyan: trail of the ROI's centre)" if len(set(shown)) > 1 else ""
        figure.suptitle(f"{_plain(self.name)}: {verdict or f'{len(self._corners)} batches'}{trail}")
        return figure

    def _draw_frame(self, axis, index, roi, frame):
        from matplotlib.patches import Rectangle

        axis.imshow(np.minimum(frame, 2), cmap="gray", interpolation="nearest")
        centre = (self.config.roi_width / 2, self.config.roi_height / 2)
        axis.plot(*np.add(self._corners[: index + 1], centre).T, color="tab:cyan", linewidth=2)
        size = (self.config.roi_width, self.config.roi_height)
        axis.add_patch(Rectangle(np.subtract(roi, 0.5), *size, fill=False, edgecolor="tab:red", linewidth=1.5))
        axis.set(title=f"batch {index}: events, ROI", xlabel="x [px]", ylabel="y [px]")

    def _draw_images(self, figure, index, v, still, moved):
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        top = np.percentile(moved, 99.8)
        for axis, image, title in (
            (axes[0], still, f"batch {index}: IWE at v = 0\ncontrast {still.var():.2f}"),
            (axes[1], moved, f"IWE at v = ({v[0]:.2f}, {v[1]:.2f}) px/half batch\ncontrast {moved.var():.2f}"),
        ):
            shown = axis.imshow(image, cmap="magma", vmin=0, vmax=max(top, 1), interpolation="nearest")
            axis.set(title=title, xlabel="x in ROI [px]", ylabel="y in ROI [px]")
        figure.colorbar(shown, ax=axes, label="events per pixel", shrink=0.7)

    def _draw_speed(self, axis):
        seconds, doubtful = (np.array(self._times) - self._times[0]) / 1e6, np.array(self._doubtful)
        for k, (name, colour) in enumerate((("vx", "tab:blue"), ("vy", "tab:orange"))):
            speed = np.array(self._speeds)[:, k]
            axis.plot(seconds, speed, "o-", color=colour, markersize=4, label=f"{name} found", markevery=~doubtful)
            if doubtful.any():
                axis.plot(seconds[doubtful], speed[doubtful], "o", color=colour, markerfacecolor="none", markersize=4)
            if self.motion:
                style = "--" if len(seconds) > 1 else "x"  # of one point there is no line
                axis.plot(seconds, np.array(self._truths)[:, k], style, color=colour, label=f"{name} true")
        axis.axhline(0, color="gray", linewidth=0.5)
        axis.set(
            title="velocity of the object" + " (hollow: doubtful)" * bool(doubtful.any()),
            xlabel="time [s]",
            ylabel="velocity [px/s]",
        )
        axis.legend()
        axis.grid(alpha=0.3)


def _plain(path):
    """A file's name as Matplotlib can show it: no formulas, and only signs that its own font has."""
    name = Path(path).name.encode("latin-1", "replace").decode("latin-1")
    return "".join(sign if sign.isprintable() else "?" for sign in name).replace("$", r"\$")
