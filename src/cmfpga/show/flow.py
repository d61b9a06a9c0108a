"""Flow as a picture of each window, and as a page of all windows, or as many as it can hold."""

import zlib

import numpy as np

from ..dense.window import TABLE
from ..errors import naming
from ..tracking.kept import BUDGET, FRAME_SIZE
from .gallery import DPI, check_suffix
from .page import fill, shown_name

#: What a picture can be written as.
SUFFIXES = (".png", ".pdf", ".svg")
#: Colours of tiles without a colour of the wheel.
DOUBTFUL, EMPTY = (0.62, 0.62, 0.62), (0.28, 0.28, 0.28)


def colours(v, most):
    """Colours of flow: float64 [..., 3]. The hue is the direction, white stands still, ``most`` is saturated."""
    turn = np.arctan2(v[..., 1], v[..., 0]) / (2 * np.pi) % 1
    full = np.clip(np.abs((turn[..., None] * 6 + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    strength = np.clip(np.hypot(v[..., 0], v[..., 1]) / max(most, 1e-9), 0, 1)[..., None]
    return 1 - strength * (1 - full)


def top_speed(window):
    """The speed that has the full colour, px/s: a round number, above which are few of the trusted tiles."""
    speeds = np.hypot(*window.px_per_s[window.trusted].T)
    if not len(speeds):
        return 1.0
    wanted = max(float(np.percentile(speeds, 95)), 1e-6)
    scale = 10.0 ** np.floor(np.log10(wanted))
    return float(scale * next(step for step in (1, 1.5, 2, 3, 5, 7, 10) if step * scale >= wanted * 0.999))


def tile_colours(window, most):
    """The flow of each tile in colours, [n, 3]; doubtful and degenerate tiles in grey."""
    shown = colours(np.nan_to_num(window.px_per_s), most)
    measured = np.isfinite(window.px_per_s[:, 0])
    shown[~window.trusted] = DOUBTFUL
    shown[~measured] = EMPTY
    return shown


def field(window, most):
    """The same of each pixel, [rows, columns, 3]."""
    pixels, _ = window.tiles.of_pixels(window.config.sensor_width, window.config.sensor_height)
    return tile_colours(window, most)[pixels]


def save(window, path, title):
    """Write the picture of a :class:`~.window.Window` as what the suffix says: one of :data:`SUFFIXES`."""
    with naming(check_suffix(path, SUFFIXES)):
        figure(window, title).savefig(path, dpi=DPI)


def figure(window, title):
    """The picture as a Matplotlib ``Figure``."""
    from matplotlib.colors import LogNorm  # takes a second to import; no window, so no pyplot
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    config, most = window.config, top_speed(window)
    made = Figure(figsize=(13, 8.8), layout="constrained")
    pictures = made.subplot_mosaic([["raw", "flow", "wheel"], ["sharp", "sure", "bar"]], width_ratios=(1, 1, 0.2))
    raw, flow, sharp, sure = (pictures[name] for name in ("raw", "flow", "sharp", "sure"))
    still, moved = window.images()
    most_events = max(float(np.percentile(moved, 99.5)), 1.0)
    limits = {"cmap": "gray", "vmin": 0, "vmax": most_events, "interpolation": "nearest"}
    raw.imshow(still, **limits)
    raw.set_title(f"events as they came: contrast {still.var():.3f}")
    sharp.imshow(moved, **limits)
    sharp.set_title(f"moved back by the flow: contrast {moved.var():.3f}")
    arrows(raw, window, most)
    flow.imshow(field(window, most), interpolation="nearest")
    flow.set_title("flow of each tile")
    handles = [Patch(facecolor=DOUBTFUL, label="doubtful"), Patch(facecolor=EMPTY, label="too few events")]
    made.legend(handles=handles, loc="outside lower center", ncols=2)
    wheel(pictures["wheel"], most)
    kappa = np.where(np.isfinite(window.kappa), np.maximum(window.kappa, 1.0), np.nan)
    tiles, _ = window.tiles.of_pixels(config.sensor_width, config.sensor_height)
    shown = sure.imshow(kappa[tiles], cmap="viridis", norm=LogNorm(1, 1000), interpolation="nearest")
    pictures["bar"].set_axis_off()
    made.colorbar(shown, cax=pictures["bar"].inset_axes((0, 0, 0.12, 1)), label="confidence [1/px²]")
    sure.set_title(f"confidence; doubtful below {config.confidence_limit:g}")
    where = f", {config.image}" * bool(config.image)
    for axis in (raw, flow, sharp, sure):
        axis.set(xlabel=f"x{where} [px]", ylabel=f"y{where} [px]")
    made.suptitle(title.encode("latin-1", "replace").decode("latin-1").replace("$", r"\$"))
    return made


def arrows(axis, window, most, colour="tab:orange"):
    """Draw the flow of trusted tiles as arrows; ``most`` px/s are as long as a step of the grid."""
    tiles = window.tiles
    step = max(np.diff(tiles.columns).max(initial=1), tiles.width // 2)
    middle = (np.array(tiles.corners) + (np.array([tiles.width, tiles.height]) - 1) / 2)[window.trusted]
    way = window.px_per_s[window.trusted] * (step / most)
    if len(middle):
        axis.quiver(
            *middle.T, *way.T, angles="xy", scale_units="xy", scale=1, color=colour, width=0.003, headwidth=4
        )  # fmt: skip


def wheel(axis, most):
    """The legend of the colours."""
    at = np.linspace(-1, 1, 101)
    way = np.stack(np.meshgrid(at, at), axis=-1)
    shown = np.dstack([colours(way, 1.0), np.hypot(*np.moveaxis(way, -1, 0)) <= 1])
    axis.imshow(shown, extent=(-1, 1, 1, -1))
    axis.text(0, 1.05, f"{most:g} px/s", ha="center", va="top")
    axis.set_axis_off()


#: Levels of grey of an image.
_GREYS = 255

#: Ways between whose colours the wheel's are linear, all around.
_CORNERS = np.stack([np.cos(np.arange(7) * np.pi / 3), np.sin(np.arange(7) * np.pi / 3)], axis=1)


class Page:
    """Collects windows while they go by, in bounded memory; where they are too many, every second, fourth … of them."""

    def __init__(self):
        self._kept, self._stride = [], 1

    def add(self, window, field=None):
        """Take a :class:`~.window.Window`, and what was fitted to it: ``{name: value}``."""
        if window.index % self._stride:
            return
        raw = window.images()
        images = [_binned(image) for image in raw]
        top = max(float(np.percentile(images[1], 99.7)), 1.0)
        shown = [np.minimum(image * (_GREYS / top), _GREYS).astype(np.uint8) for image in images]
        told = {
            "window": window.index,
            "t": window.t_ref,
            "events": len(window.events),
            "moved": window.moved,
            "contrast": [round(float(image.var()), 4) for image in raw],
            "most": (most := top_speed(window)),
            "tiles": [[int(row[6]), *row[7:11]] for row in window.rows()],
            "colours": _hex(tile_colours(window, most)),
            "trusted": window.trusted.astype(int).tolist(),
            "fit": field,
        }
        self._kept.append((told, shown, sum(len(zlib.compress(image.tobytes(), 6)) for image in shown)))
        while len(self._kept) > 1 and sum(size for *_, size in self._kept) > BUDGET:
            self._stride *= 2
            self._kept = [one for one in self._kept if one[0]["window"] % self._stride == 0]

    def render(self, flow):
        """The page's text, of a :class:`~cmfpga.api.flow.Flow`."""
        config, tiles, told = flow.config, flow.tiles, flow.summary()
        speed = told["speed_px_per_s"]
        lead = f"{told['trusted']:,} of {told['measured']:,} tiles are to be trusted, in {told['windows']} windows."
        if speed:
            lead += f" The flow is {speed[0]:.0f} px/s in the median, and {speed[1]:.0f} px/s where it is fast."
        notes = [
            f"{told['events']:,} events in the windows, {told['leftover']:,} left over, {told['outside']:,} off the "
            f"image, {told['dropped']:,} dropped.",
            f"Tiles of {tiles.width} px; {flow.engine} engine; x and y are in the {told['image']} image.",
        ]
        if self._stride > 1:
            notes.append(f"The page shows one window of {self._stride}; {len(flow)} are in flow.csv.")
        head = {
            "columns": [*TABLE][6:],
            "sensor": [config.sensor_width, config.sensor_height],
            "frame": [*(self._kept[0][1][0].shape[::-1] if self._kept else (0, 0))],
            "tile": [tiles.width, tiles.height],
            "corners": tiles.corners,
            "wheel": _hex(colours(_CORNERS, 1.0)),
            "empty": _hex(np.array([EMPTY]))[0],
            "grid": [list(tiles.columns), list(tiles.rows)],
            "windows": [one for one, *_ in self._kept],
        }
        blob = b"".join(image.tobytes() for _, images, _ in self._kept for image in images)
        return fill(
            "flow", head, blob, one="window", title=f"Flow of {shown_name(flow.recording)}", lead=lead, notes=notes,
            scripts=["flow.js"], state='<p class="value" id="fit"></p>', library="",
        )  # fmt: skip


def _hex(shades):
    """Colours of [n, 3], each 0 to 1, as a page names them."""
    return [f"#{bytes(shade).hex()}" for shade in np.rint(255 * shades).astype(np.uint8)]


def _binned(image):
    """An image of a large sensor with pixels of 2×2, 3×3 …"""
    side = -(-max(image.shape) // FRAME_SIZE)
    rows, columns = (np.arange(0, size, side) for size in image.shape)
    return np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
