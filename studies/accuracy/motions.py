"""Motions beyond translation: synthetic batches of known rotation, zoom and roll, and real recordings of a rotation.

Synthetic: bars on a field that is larger than what is seen. The motion is drawn evenly; the error is that of the flow,
on a grid over the ROI. Then batches that are cut. Real, with a folder of recordings: two of a turning camera, each one
batch, against a global float search over all events; and a camera that pans, tracked, against its gyroscope.
"""

from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import numpy as np

from cmfpga.api.track import track
from cmfpga.config import preset
from cmfpga.config.presets import CLOCK_MHZ
from cmfpga.engines import make_engine
from cmfpga.errors import ConfigError
from cmfpga.events import generate
from cmfpga.imaging.camera import Camera, flow, rates, read_calibration
from cmfpga.protocol.confidence import confidence, deviations, is_trustworthy
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.global_search import rotation, rotation_as_seen, search
from cmfpga.rtl.core import Core

from .foreign import FOREIGN, find_rotation
from .judged import WRONG, judgement
from .known import data, read
from .table import ERRORS, decimal, heads_of, percent

MOTIONS = ("rotation", "similarity")

DURATION_US = 100_000
CAMERA = Camera(200.0, 200.0, 119.5, 89.5)
NOISE = 0.1
BARS = (10, 30)
#: Events to aim at, largest parameters in px per half batch, and the size of the field, px.
SCENES = {
    "rotation": ((12_000, 30_000), (6.0, 6.0, 3.0), (360, 270)),
    "similarity": ((3_000, 8_000), (4.0, 4.0, 4.0, 4.0), (150, 150)),
}
#: Batches that are cut, for each of the others; the longest and the shortest share of the time, and of the events.
CUTS, SHARES = 4, ((1 / 16, 1.0), (0.35, 1.0))
KINDS = ("rms over the ROI", "largest, at the edge")  # errors of the flow, and what is told of each
FLOW_ERRORS = {name: ERRORS[name] for name in ("batches", "below_0.3_px", "below_0.6_px")} | {
    "median": ("median, px", *ERRORS["median_px"][1:]),
    "largest": ("largest, px", *ERRORS["largest_px"][1:]),
}

PARTS = (1, 2, 4)  # into how many parts of equally many events they are cut

#: Of a turning camera, one batch each.
ROTATIONS = ("davis240c_poster_rotation_0.6s.h5", "davis240c_shapes_rotation_2.1s_gtflow.h5")

#: Of a camera that pans: radians a second per count of its gyroscope, its lens, and what k1 may be, by windows of so
#: many events; and events of a batch, None as ``track`` chooses them.
PANNED = "davis240c_translboxes_imu.h5"
GYRO_SCALE = np.pi / 180 / 32.8
PLAIN = Camera(245.0, 245.0, 119.5, 89.5)
K1, PAN_EVENTS = (0.0, -0.1, -0.2, -0.25, -0.3, -0.35), 20_000
PAN_BATCHES = (None, 15_000, 20_000)


def motion_config(kind, options_config):
    """The configuration that the suite runs: ``options_config``, for the scene's camera or sensor."""
    if options_config.motion != kind:
        raise ConfigError(f"--motion {kind}: --preset {kind} is needed, not motion = {options_config.motion}")
    if kind == "rotation":
        return options_config.replace(camera=CAMERA.text)
    return options_config.replace(sensor_width=options_config.roi_width, sensor_height=options_config.roi_height)


def scene(config, seed, index):
    """One batch: its :class:`~cmfpga.events.Events`, and the true parameters, px per half batch."""
    rng = np.random.default_rng([seed, index])
    events, most, size = SCENES[config.motion]
    v = rng.uniform(-1, 1, len(most)) * most
    told = rates(config, v, DURATION_US)
    drawn = {
        "seed": int(rng.integers(1 << 31)), "size": size, "bars": int(rng.integers(*BARS)), "noise": NOISE,
        "width": config.sensor_width, "height": config.sensor_height, "duration_us": DURATION_US,
    }  # fmt: skip
    if config.motion == "rotation":
        drawn |= {"camera": CAMERA, "rotation": tuple(told.values()), "velocity": (0.0, 0.0)}
    else:
        centre = (np.array([config.sensor_width, config.sensor_height]) - 1) / 2
        drawn |= {"zoom": told["zoom_per_s"], "roll": told["roll_rad_per_s"], "position": tuple(centre - v[:2])}
        drawn |= {"velocity": tuple(v[:2] / (DURATION_US / 2e6))}
    count = len(generate(**drawn).events)
    made = generate(**drawn, contrast=rng.uniform(*events) / max(count, 1)).events
    span = int(made.t[-1] - made.t[0])
    return made, v * span / DURATION_US


def cut(config, seed, index):
    """The same of a part of a scene: a shorter time, fewer events."""
    events, v = scene(config, seed, index)
    rng = np.random.default_rng([seed, index, 1])
    share, kept = (np.exp(rng.uniform(*np.log(shares))) for shares in SHARES)
    length = max(int(share * len(events)), 2)
    first = int(rng.uniform() * (len(events) - length))
    part = events[first + np.flatnonzero(rng.random(length) < kept)]
    return part, v * float(part.t[-1] - part.t[0]) / float(events.t[-1] - events.t[0])


def flow_errors(config, found, true):
    """Distance of two motions' displacements on a grid over the ROI, px per half batch: (rms, largest)."""
    columns, rows = np.meshgrid(*(np.linspace(0, size - 1, 9) for size in (config.roi_width, config.roi_height)))
    away = np.hypot(*flow(config, np.array(found) - true, columns.ravel(), rows.ravel(), (0, 0)))
    return float(np.sqrt((away**2).mean())), float(away.max())


def run_motion(options, config, report):
    """Print the suite of ``options.motion``; with a folder of recordings the real ones of a rotation, too."""
    kind = options.motion
    config = motion_config(kind, config)
    found = [flow_errors(config, result.v, true) for result, true in _drawn(scene, 1, options, config, report)]
    if config.confidence:
        _confidence(options, config, report)
    kinds = zip(KINDS, np.array(found).T, strict=True)
    rows = [(what, *report.cells(f"{kind}, {what}", FLOW_ERRORS, errors)) for what, errors in kinds]
    title = f"Synthetic batches, {kind}, cold, {options.engine}: px per half batch"
    report.table(title, ("error of the flow", *heads_of(FLOW_ERRORS)), rows)
    if options.data is not None and kind == "rotation":
        _real(options, config, report)


def _drawn(make, times, options, config, report):
    """``(result, true parameters)`` of what :func:`scene` or :func:`cut` makes, so many times the batches asked for."""
    cases = [(seed, index) for seed in options.seeds for index in range(times * options.batches)]
    return _found(options.engine, config, (make(config, *case) for case in report.progress(cases)))


def _found(engine, config, batches):
    """Yields ``(result, truth)`` of batches ``(events, truth)``, each of them cold."""
    settings = BatchSettings.from_config(config.replace(start="given"), roi=(0, 0))
    with closing(make_engine(engine, config)) as opened:
        for events, true in batches:
            yield opened.run(events, settings)[0], true


def _confidence(options, config, report):
    """Whether the confidence tells right batches from wrong ones, where some are too short."""
    told, off, rows = [], [], []
    for result, true in _drawn(cut, CUTS, options, config, report):
        if (kappa := confidence(config, result)) is not None:
            sure = is_trustworthy(config, result)
            told.append((*flow_errors(config, result.v, true), kappa, sure))
            off += [np.abs(result.v - true) / deviations(config, result)] if sure else []
    told = np.array(told, float).reshape(-1, 4)
    for k, what in enumerate(KINDS):
        values = told[:, [k, 2, 3]]
        scores = judgement(values) | {"right_trusted": float(values[values[:, 0] <= WRONG, 2].mean())}
        scores = {key: scores[key] for key in ("auc", "wrong", "trusted", "right_trusted", "wrong_of_trusted")}
        auc, *shares = report.keep(f"{config.motion}, confidence, {what}", values, scores).values()
        rows.append((what, len(told), decimal(auc, 3), *map(percent, shares)))
    held = [float((np.array(off) < limit).mean()) for limit in (0.674, 0.994, 1.96)] if off else []
    name = f"{config.motion}, parameters within 0.674, 0.994, 1.96 deviations (50, 68, 95 %)"
    report.keep(name, held, {"held": held})
    rows.append(("parameters in the 50, 68, 95 % interval", " / ".join(map(percent, held)), *[""] * 5))
    heads = ("wrong by this error", "batches", "AUC", "wrong, %", "trusted, %", "of the right, %", "of them wrong, %")
    report.table(f"Confidence, batches that are cut (wrong: by more than {WRONG} px)", heads, rows)


def _real(options, config, report):
    """Two recordings, whole and in slices, against a search over all of it; and the camera that pans."""
    rows, slices = [], []
    for name in report.progress(ROTATIONS, "recording"):
        events, sensor = read(Path(options.data) / name)
        camera = read_calibration(Path(options.data) / name).camera
        of_it = options, config.replace(camera=camera.text), report, name, events, camera
        rows += _whole(*of_it, sensor)
        slices += _slices(*of_it)
    heads = ("recording", "by", "events", "ω, rad/s", "global search", "apart, deg/s", "allowed, 2 deg/s + 3 %", "ms")
    title = f"(ms: cycles at {CLOCK_MHZ:g} MHz, assumed; of {FOREIGN} on this machine, all its threads)"
    report.table(f"Real batches against a global search over all events {title}", heads, rows)
    heads = (
        "recording", "slices", "trusted", "short", "trusted, beyond 3 sd", "beyond 5 deg/s + 5 %", "largest, deg/s",
        "in sd",
    )  # fmt: skip
    report.table("Slices of real recordings against a global search over all of it", heads, slices)
    run_panned(options, config, report)


def _whole(options, config, report, name, events, camera, sensor):
    """Rows of a recording as one batch: the engine's, and eventcv's."""
    best = search(rotation(camera, events.x, events.y), events.t).at_middle
    ((result, _),) = _found(options.engine, config, [(events, None)])
    size = {"events": result.events, "roi_events": result.roi_events}
    cycles = Core(config).cycles(**size, iterations=config.schedules.cold)
    found = {options.engine: (_omega(config, result.v, result), cycles / CLOCK_MHZ / 1000)}
    if options.eventcv:
        start = perf_counter()
        omega = find_rotation(camera, events, *sensor)
        found[FOREIGN] = omega, (perf_counter() - start) * 1000
    allowed = 2 + 0.03 * np.degrees(np.linalg.norm(best))
    for who, (omega, ms) in found.items():
        away = np.degrees(np.linalg.norm(omega - best))
        report.keep(f"{name}, {who}", omega, {"global_search": best.tolist(), "deg_per_s": away, "ms": ms})
        cells = (", ".join(f"{axis:.3f}" for axis in each) for each in (omega, best))
        yield name, who, len(events), *cells, f"{away:.1f}", f"{allowed:.1f}", f"{ms:.2f}"


def _slices(options, config, report, name, events, camera):
    """Rows of a recording whole, in halves and in quarters; ω is linear in time: what is trusted."""
    best = search(rotation(camera, events.x, events.y), events.t, linear=True)
    middle = (int(events.t[0]) + int(events.t[-1])) / 2
    for parts in PARTS:
        cuts = [events[slice(*ends)] for ends in pairwise(np.linspace(0, len(events), parts + 1).astype(int))]
        truths = [best.at(((int(cut.t[0]) + int(cut.t[-1])) / 2 - middle) * 1e-6) for cut in cuts]
        pairs = _found(options.engine, config, zip(cuts, truths, strict=True))
        found = np.array([_slice(config, *pair) for pair in pairs], float)
        sure = found[:, 0] > 0
        beyond = int((found[sure, 2] > 3).sum()), int((found[sure, 1] > found[sure, 3]).sum())
        report.keep(f"{name}, in {parts}", found, {"parts": parts, "trusted": int(sure.sum()), "beyond": beyond})
        largest = (f"{found[sure, k].max():.1f}" if sure.any() else "–" for k in (1, 2))
        yield name, parts, int(sure.sum()), int(found[:, 4].sum()), *beyond, *largest


def _omega(config, v, result):
    """Parameters of a rotation in rad/s, of those in px per half of a result's time."""
    return np.array([*rates(config, v, result.span).values()])


def _slice(config, result, true):
    """Trusted; deg/s off; the largest error in sd; deg/s allowed; short."""
    away, found = _omega(config, result.v, result) - true, deviations(config, result)
    stated = np.abs(_omega(config, found, result)) if found else np.full(3, np.nan)
    allowed = 5 + 0.05 * np.degrees(np.linalg.norm(true))
    off = np.degrees(np.linalg.norm(away))
    return is_trustworthy(config, result), off, np.max(np.abs(away) / stated), allowed, Flag.SHORT in result.flags


def run_panned(options, config, report):
    """Print how sharp each distortion is, and how well ωy follows the gyroscope without one and with the sharpest.

    The recording has no calibration. Its speed beside the gyroscope tells the focal length, its events alone k1: that
    under which the image that the lens makes, warped by a rotation, is sharpest.
    """
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
    for lens, size in report.progress([(lens, size) for lens in (PLAIN, best) for size in PAN_BATCHES], "track"):
        rows += _against(gyroscope, events, lens, size, options, config, report)
    heads = (
        "k1", "batches of", "by", "batches", "correlation", "ωy found / gyroscope's", "bias, rad/s",
        "from the search, deg/s",
    )  # fmt: skip
    report.table(f"{PANNED}: ωy against the gyroscope, averaged over each batch", heads, rows)


def _contrast(camera, events, sensor):
    """Mean over windows of the highest contrast that a rotation reaches, in the image as the lens makes it."""
    window = (-4, sensor[0] + 3, -4, sensor[1] + 3)
    parts = [events[first : first + PAN_EVENTS] for first in range(0, len(events) - PAN_EVENTS + 1, PAN_EVENTS)]
    found = [search(rotation_as_seen(camera, part.x, part.y), part.t, window=window) for part in parts]
    return float(np.mean([each.contrast for each in found]))


def _against(gyroscope, events, camera, size, options, config, report):
    """Rows of the engine and of a global search over the events of the same batches."""
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
