"""Dense flow: tiles of a scene whose flow is known, and of real recordings, one window each.

The truth of a tile is the scene's flow; of a turning camera that of the rotation that maximises the contrast of all
events; else the best contrast of the tile itself, by a search that knows nothing of the tiles around it. Errors are px
per half window.
"""

from contextlib import closing
from pathlib import Path

import numpy as np

from cmfpga import cli
from cmfpga.api.flow import configure
from cmfpga.dense import fit_field
from cmfpga.dense.fields import CAMERA, ROTATION, basis, scene
from cmfpga.dense.tiles import TILE
from cmfpga.dense.window import Run
from cmfpga.engines import make_engine
from cmfpga.events import Events, MemoryRecording, open_recording
from cmfpga.imaging.camera import Camera
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.reference.global_search import rotation, search

from .table import percent
from .yardstick import best_contrast

#: Recordings of one window, and whether the camera turns in front of what is far away.
WINDOWS = {
    "davis240c_poster_rotation_0.6s.h5": True,
    "davis240c_boxes_translation_18.6s.h5": False,
    "davis240c_dynamic_translation_32.9s.h5": False,
}
#: What is measured beside them: name, share of the window's events, size of the tiles.
VARIANTS = (("first half", 0.5, TILE), ("tiles of 24 px", 1.0, 24))
FEWEST = 60  # events of a tile that is looked at
HEADS = (
    "window", f"tiles with {FEWEST} events", "trusted, %", "median error of all, px", "all < 1 px, %",
    "trusted < 0.5 px, %", "fitted rotation off by, deg/s",
)  # fmt: skip


def turned(window, omega):
    """Flow of a still scene before the camera that turns by ``omega`` rad/s, px per half window: float64 [n, 2]."""
    return np.einsum("akn,k->na", basis("rotation", window.config, window.centres), omega) * window.half_s


def searched(window, chosen, progress):
    """The best v of each chosen tile, px per half window: float64 [n, 2]; NaN of others."""
    dt = 2 * (window.events.t - window.events.t[0]) / window.result.span - 1
    found = np.full((len(window.tiles), 2), np.nan)
    for k in progress(np.flatnonzero(chosen)):
        region = window.tiles.regions[k - len(window.tiles)]
        inside, x, y = events_in_roi(window.seen, (region.x, region.y), region.width, region.height)
        across, down = region.corner(window.config)
        found[k], _ = best_contrast(x + across, y + down, dt[inside], rounds=2)
    return found


def run_dense(options, _, report):
    """Print the suite; of the scene alone without a folder of recordings."""
    given = {"camera": CAMERA.text}
    rows = [_row(options, "synthetic, the camera turns", scene().recording(), report, omega=ROTATION, **given)]
    for variant in ((), *VARIANTS) if options.data is not None else ():
        for file, turns in WINDOWS.items():
            name = ", ".join((file, *variant[:1]))
            with open_recording(Path(options.data) / file) as recording:
                rows.append(_row(options, name, recording, report, *variant[1:], omega=None if turns else ()))
    report.table(f"Dense flow, tiles of {TILE} px every {TILE // 2} px, {options.engine}", HEADS, rows)


def _row(options, name, recording, report, share=1.0, tile=TILE, *, omega, **given):
    config, tiles, _ = configure(recording, options.preset, given | cli.config_changes(options), tile, None, str)
    events = Events.concatenate(recording.chunks())[: config.max_batch_events]
    events = events[: int(len(events) * share)]
    recording = MemoryRecording(events, config.sensor_width, config.sensor_height)
    with closing(make_engine(options.engine, config)) as engine:
        (window,) = Run(recording, engine, tiles, window_events=len(events), windows=1)
    held = np.array([one.roi_events + one.thinned + one.overflow for one in tiles.of(window.result)])
    chosen = (held >= FEWEST) & np.isfinite(window.v[:, 0])
    if omega is None:
        omega = search(rotation(Camera(*config.lens), events.x, events.y), events.t).at_middle
    true = turned(window, omega) if len(omega) else searched(window, chosen, report.progress)
    errors = np.hypot(*(window.v - true)[chosen].T)
    trusted = window.trusted[chosen]
    scores = {
        "tiles": int(chosen.sum()), "trusted": float(trusted.mean()), "median_px": float(np.median(errors)),
        "below_1_px": float((errors < 1).mean()),
        "trusted_below_0.5_px": float(np.mean(errors[trusted] < 0.5)) if trusted.any() else None,
        "degenerate": int(((held >= FEWEST) & ~chosen).sum()),
    }  # fmt: skip
    off = "-"
    if len(omega):
        away = float(np.degrees(np.linalg.norm(fit_field("rotation", window).values - omega)))
        scores["rotation_off_deg_per_s"] = away
        off = f"{away:.2f} of {np.degrees(np.linalg.norm(omega)):.1f}"
    report.keep(f"flow, {name}", errors, scores)
    shares = (percent(scores[key]) for key in ("below_1_px", "trusted_below_0.5_px"))
    return name, scores["tiles"], percent(scores["trusted"]), f"{scores['median_px']:.3f}", *shares, off
