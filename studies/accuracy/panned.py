"""A camera that pans, tracked as a rotation, against its gyroscope.

The recording has no calibration. Its speed beside the gyroscope tells the focal length; the lens's distortion k1 is
told by its events alone: that under which the image that the lens makes, warped by a rotation, is sharpest.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from cmfpga.api.track import track
from cmfpga.config import preset
from cmfpga.imaging.camera import Camera

from .known import data, read

PANNED = "davis240c_translboxes_imu.h5"
GYRO_SCALE = np.pi / 180 / 32.8  # rad/s per count
PLAIN = Camera(245.0, 245.0, 119.5, 89.5)
#: Distortions that are tried, and the events of a window for it.
K1, WINDOW = (0.0, -0.1, -0.2, -0.25, -0.3, -0.35), 20_000
#: Events of a batch; None: as ``track`` chooses them.
BATCHES = (None, 15_000, 20_000)
HEADS = (
    "k1", "batches of", "by", "batches", "correlation", "ωy found / gyroscope's", "bias, rad/s",
    "from the search, deg/s",
)  # fmt: skip


def run_panned(options, config, report):
    """Print how sharp each distortion is, and how well ωy follows the gyroscope without one and with the sharpest."""
    path = Path(options.data) / PANNED
    events, sensor = read(path)
    times, gyroscope = data(path, "imu/t", "imu/gyro_raw")
    gyroscope = times, gyroscope[:, 1] * GYRO_SCALE
    lenses = [replace(PLAIN, k1=k1) for k1 in K1]
    sharp = [_contrast(lens, events, sensor) for lens in report.progress(lenses, "lens")]
    report.keep(f"{PANNED}, contrast", sharp, {"k1": list(K1)})
    rows = [(f"{lens.k1:g}", f"{contrast:.4f}") for lens, contrast in zip(lenses, sharp, strict=True)]
    report.table("Contrast of the image that the lens makes, mean of all windows", ("k1", "contrast"), rows)
    rows = []
    best = lenses[int(np.argmax(sharp))]
    for lens, size in report.progress([(lens, size) for lens in (PLAIN, best) for size in BATCHES], "track"):
        rows += _against(gyroscope, events, lens, size, options, config, report)
    report.table(f"{PANNED}: ωy against the gyroscope, averaged over each batch", HEADS, rows)


def _contrast(camera, events, sensor):
    """Mean over windows of the highest contrast that a rotation reaches, in the image as the lens makes it."""
    from cmfpga.reference.global_search import rotation_as_seen, search  # torch

    window = (-4, sensor[0] + 3, -4, sensor[1] + 3)
    parts = [events[first : first + WINDOW] for first in range(0, len(events) - WINDOW + 1, WINDOW)]
    found = [search(rotation_as_seen(camera, part.x, part.y), part.t, window=window) for part in parts]
    return float(np.mean([each.contrast for each in found]))


def _against(gyroscope, events, camera, size, options, config, report):
    """Rows of the engine and of a global search over the events of the same batches."""
    from cmfpga.reference.global_search import rotation, search  # torch

    t, turned = gyroscope
    own, fields = preset("rotation"), config.to_dict()
    changed = {name: value for name, value in fields.items() if getattr(own, name) != value}
    found = track(
        Path(options.data) / PANNED, preset="rotation", engine=options.engine, batch_events=size,
        **(changed | {"camera": camera.text, "hot_pixels": 0}),
    )  # fmt: skip
    spans = np.array([result.span for result in found.results])
    ends = [found.t_ref_us + way * spans / 2 for way in (-1, 1)]
    sums = np.concatenate([[0], np.cumsum(turned)])
    first, last = (np.searchsorted(t, end) for end in ends)
    mean = (sums[last] - sums[first]) / np.maximum(last - first, 1)
    parts = [events[slice(*np.searchsorted(events.t, pair))] for pair in zip(*ends, strict=True)]
    best = np.array([search(rotation(camera, part.x, part.y), part.t).at_middle[1] for part in parts])
    lot, rows = "own choice" if size is None else f"{size:,} events", []
    for who, omega in ((options.engine, found.wy_rad_per_s), ("global search", best)):
        correlation = float(np.corrcoef(omega, mean)[0, 1])
        scale, bias = np.polyfit(mean, omega, 1)
        apart = float(np.degrees(np.abs(omega - best)).max())
        scores = {"correlation": correlation, "scale": float(scale), "bias_rad_per_s": float(bias), "deg_per_s": apart}
        report.keep(f"{PANNED}, k1 = {camera.k1:g}, {lot}, {who}", omega, scores)
        cells = f"{correlation:.3f}", f"{scale:.3f}", f"{bias:.4f}", f"{apart:.2f}"
        rows.append((f"{camera.k1:g}", lot, who, len(found), *cells))
    return rows
