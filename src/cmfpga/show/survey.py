"""The events of a whole recording, and the proposed ROIs, as text and as a picture."""

import numpy as np

from ..errors import naming

_SHADES = " .:-=+*#%@"
_FRAME_COLUMNS = 78


def _levels(survey):
    """Events per pixel on a scale of 0 to 1, on which hot pixels are no brighter than busy ones."""
    counts = np.sqrt(survey.counts)
    busy = counts[counts > 0]
    return np.minimum(counts / max(np.percentile(busy, 99), 1), 1)


def frame(survey, config, proposals):
    """Lines of text that show all events, and the corners of the ROIs."""
    levels = _levels(survey)
    rows, columns = levels.shape
    width = min(_FRAME_COLUMNS, columns)
    step = columns / width
    height = max(round(rows / step / 2), 1)  # a sign is about twice as high as wide
    at_y, at_x = np.arange(rows) * height // rows, np.arange(columns) * width // columns
    sums, sizes = np.zeros((height, width)), np.zeros((height, width))
    np.add.at(sums, (at_y[:, None], at_x[None, :]), levels)
    np.add.at(sizes, (at_y[:, None], at_x[None, :]), 1)
    mean = sums / sizes
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
    for line in signs:
        yield "|" + "".join(line) + "|"


def draw(path, survey, config, proposals):
    """Write a picture, PNG: events, hot pixels and ROIs; below, the rate over time."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    figure = Figure(figsize=(10, 8), layout="constrained", dpi=110)
    above, below = figure.subplots(2, 1, height_ratios=(4, 1))
    above.imshow(_levels(survey), cmap="gray", interpolation="nearest")
    hot = survey.hot_pixels()
    if hot:
        x, y, _ = zip(*hot, strict=True)
        above.plot(x, y, "o", markerfacecolor="none", color="tab:orange", label="hot pixel")
        figure.legend(loc="outside upper right")
    for k, found in enumerate(proposals):
        corner = np.subtract(found.roi, 0.5)
        above.add_patch(
            Rectangle(corner, config.roi_width, config.roi_height, fill=False, edgecolor="tab:red", linewidth=1.5)
        )
        above.annotate(f"ROI {k}", corner, color="tab:red", va="bottom")
    above.set(title="events of the whole recording (square root)", xlabel="x [px]", ylabel="y [px]")
    bin_us, rate = survey.rate()
    below.step(np.arange(len(rate)) * bin_us / 1e6, rate / 1e3, where="post")
    below.set(xlabel="time [s]", ylabel="rate [1000 events/s]", ylim=(0, None))
    with naming(path):
        figure.savefig(path, format="png")
