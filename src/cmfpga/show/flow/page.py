"""The page of a run: all windows, or as many as it can hold, in one HTML file that needs no network."""

import html
import zlib

import numpy as np

from ...dense.window import TABLE
from ...errors import write_text
from ...tracking.kept import BUDGET, FRAME_SIZE
from ..page import asset, fill, shown_name
from .pictures import EMPTY, colours, tile_colours, top_speed

#: Levels of grey of an image.
_GREYS = 255

#: Ways between whose colours the wheel's are linear, all around.
_CORNERS = np.stack([np.cos(np.arange(7) * np.pi / 3), np.sin(np.arange(7) * np.pi / 3)], axis=1)


class Page:
    """Collects windows while they go by, in bounded memory; where they are too many, every second, fourth … of them."""

    def __init__(self):
        self._kept, self._stride, self._size = [], 1, 0

    def add(self, window, field=None):
        """Take a :class:`~.window.Window`, and what was fitted to it: ``{name: value}``."""
        if window.index % self._stride:
            return
        images = [_binned(image) for image in window.images()]
        top = max(float(np.percentile(images[1], 99.7)), 1.0)
        shown = [np.minimum(image * (_GREYS / top), _GREYS).astype(np.uint8) for image in images]
        told = {
            "window": window.index,
            "t": window.t_ref,
            "events": len(window.events),
            "moved": window.moved,
            "contrast": [round(float(image.var()), 4) for image in window.images()],
            "most": top_speed(window),
            "tiles": [row[6:11] for row in window.rows()],
            "colours": _hex(tile_colours(window, top_speed(window))),
            "trusted": window.trusted.astype(int).tolist(),
            "fit": field,
        }
        told["tiles"] = [[int(count), *rest] for count, *rest in told["tiles"]]
        self._kept.append((told, shown, sum(len(zlib.compress(image.tobytes(), 6)) for image in shown)))
        while len(self._kept) > 1 and sum(size for *_, size in self._kept) > BUDGET:
            self._stride *= 2
            self._kept = [one for one in self._kept if one[0]["window"] % self._stride == 0]

    def save(self, path, flow):
        """Write the page of a :class:`~cmfpga.api.flow_result.Flow`."""
        write_text(path, self.render(flow))

    def render(self, flow):
        """The page's text."""
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
        parts = {
            "title": html.escape(f"Flow of {shown_name(flow.recording)}"),
            "lead": html.escape(lead),
            "notes": "".join(f"<li>{html.escape(note)}</li>" for note in notes),
            "style": asset("page.css", __package__),
            "state": '<p class="value" id="fit"></p>',
            "library": "",
            "script": asset("page.js", __package__),
        }
        blob = b"".join(image.tobytes() for _, images, _ in self._kept for image in images)
        return fill(asset("page.html", __package__), parts, head, zlib.compress(blob, 6), one="window")


def _hex(shades):
    """Colours of [n, 3], each 0 to 1, as a page names them."""
    return [f"#{bytes(shade).hex()}" for shade in np.rint(255 * shades).astype(np.uint8)]


def _binned(image):
    """An image of a large sensor with pixels of 2×2, 3×3 …"""
    side = -(-max(image.shape) // FRAME_SIZE)
    rows, columns = (-(-size // side) for size in image.shape)
    padded = np.pad(image, ((0, rows * side - image.shape[0]), (0, columns * side - image.shape[1])))
    return padded.reshape(rows, side, columns, side).sum(axis=(1, 3))
