"""Found motions beside the true one: errors, and the delay between both clocks.

A window's truth is the mean over its time range. An error is told in px per half window, as the contrast sees it; of a
rotation it is what moves at the image's centre or edge, as :func:`~cmfpga.imaging.camera.extent` has it.

Poses do not say how far away things are. So, without a depth, what is seen at a place may move along a ray: the image
velocity that the camera's turn makes, plus any positive share of that which its way makes. The error is the distance
from this ray: across the camera's way, as an epipolar line has it.
"""

import csv
import math

import numpy as np

from ..errors import ConfigError, RecordingError, naming
from ..imaging.camera import Camera, extent, nearest, parameters
from ..imaging.iwe import gain, scaled_roi_events
from ..protocol.confidence import is_judged
from ..protocol.flags import Flag
from .known import FIELD, GYROSCOPE, POSES

#: What is trusted and off by more than this is wrong, px per half window; and the errors whose shares are told.
WRONG_PX, SHARES_PX = 0.6, (0.6, 1.0, 3.0)

#: Delays that are tried, s: so far, in such steps, and then in finer ones.
REACH_S, _STEP_S, _FINE_S = 0.1, 1e-3, 5e-5

#: A delay is fitted to no fewer windows; what an error is never below, and never counts above, px.
_LEAST_WINDOWS, _FLOOR_PX, _CAP_PX = 8, 0.05, 3.0

#: A slower camera does not move but for its turn, m/s.
_STILL = 5e-3

_AXES = {True: ("wx", "wy", "wz"), False: ("vx", "vy")}


class Accuracy:
    """Compares what was found with a :class:`~.known.Known`; a consumer of a track's batches, or of windows of flow.

    Parameters
    ----------
    camera : Camera, optional
        Which sees the image; by default the configuration's. A gyroscope and poses need one, but for a rotation.
    delay : float, optional
        What happens at t of the recording stands at t + delay of the truth, s; by default it is fitted.
    depth : float, optional
        How far away is what is seen, m; of poses.

    Raises
    ------
    ConfigError
        The truth says nothing of such a motion; one line.
    """

    def __init__(self, known, config, *, camera=None, delay=None, depth=None):
        self._rotation = config.motion == "rotation"
        self.known, self._config, self._given, self._depth = known, config, delay, depth
        self._camera = Camera(*config.calibration[:4]) if config.lens else camera
        self.degenerate = 0  # windows, or tiles, that measured no motion
        self._rows, self._places, self._found, self._true = [], [], [], []
        turns = known.kind in (GYROSCOPE, POSES)
        if self._rotation and not turns:
            raise ConfigError(f"{known.name}: {known.kind}; a rotation is compared with a gyroscope or poses")
        self._by_camera = turns and not self._rotation
        if self._by_camera and self._camera is None:
            raise ConfigError(
                f"{known.name}: {known.kind}; a calibration is needed to compare velocities: --camera FILE"
            )
        if known.kind == FIELD and known.signal.shape != (config.sensor_height, config.sensor_width):
            flow, sensor = known.signal.shape[::-1], (config.sensor_width, config.sensor_height)
            raise ConfigError(
                f"{known.name}: flow of {flow[0]}×{flow[1]} px; the sensor has {sensor[0]}×{sensor[1]} px"
            )
        if depth is not None and (self._rotation or known.kind != POSES):
            raise ConfigError(f"depth = {depth:g}: poses, and a motion that is no rotation, are needed")

    def add(self, batch):
        """Take a :class:`~cmfpga.tracking.loop.TrackedBatch`."""
        result, config = batch.result, self._config
        if Flag.DEGENERATE in result.flags:
            self.degenerate += 1
            return
        x, y, dt = scaled_roi_events(config, batch.seen, result.roi, **batch.which)
        sharper = gain(config, x, y, dt, result.v, result.roi)
        start = float(batch.events.t[0])
        found = [batch.rates[f"{axis}_rad_per_s"] for axis in _AXES[True]] if self._rotation else batch.v_px_per_s
        self._rows.append((batch.index, 0, start, start + result.span, is_judged(result), batch.trusted, sharper))
        self._places.append([at + (side - 1) / 2 for at, side in zip(batch.roi, config.roi_px, strict=True)])
        self._found.append(found)

    def add_window(self, window):
        """Take a :class:`~cmfpga.dense.window.Window`, of which each tile counts."""
        measured = np.flatnonzero(np.isfinite(window.v[:, 0]))
        self.degenerate += len(window.v) - len(measured)
        if not len(measured):
            return
        start, (still, moved) = float(window.events.t[0]), window.images()
        sharper = float(moved.var() / max(still.var(), 1e-12))
        when = start, start + window.result.span
        judged = np.isfinite(window.kappa)
        self._rows += [(window.index, k, *when, judged[k], judged[k] and window.trusted[k], sharper) for k in measured]
        self._places += window.centres[measured].tolist()
        self._found += window.px_per_s[measured].tolist()
        if self.known.kind == FIELD:
            self._true += self._seen_in(window, *when)[measured].tolist()

    def _seen_in(self, window, begin, end):
        """Of a field the mean over each tile's events, px/s, float64 [n, 2]; NaN where fewer than half know it."""
        shift = (self._given or 0.0) * 1e6
        flow, at = self.known.signal.mean(begin + shift, end + shift), window.seen
        column, row, inside = nearest(window.config, at.x, at.y)
        seen = np.bincount((row * flow.shape[1] + column)[inside], minlength=flow[..., 0].size).reshape(flow.shape[:2])
        there = np.isfinite(flow).all(axis=2)
        weighted = (np.where(there, flow[..., k] * seen, 0.0) for k in (0, 1))
        every, few, *sums = window.tiles.sums(*(one.astype(np.float64) for one in (seen, seen * there, *weighted)))
        known = (2 * few >= every) & (few > 0.5)
        return np.where(known[:, None], np.transpose(sums) / np.maximum(few, 1)[:, None], np.nan)

    def finish(self):
        """Fit the delay and compute all errors. Raises :exc:`RecordingError` where there is nothing to compare."""
        if not self._rows:
            raise RecordingError(f"{self.known.name}: nothing to compare it with; no batch measured a motion")
        table = np.array(self._rows, np.float64).reshape(-1, 7)
        self.window, self.tile = table[:, 0].astype(int), table[:, 1].astype(int)
        self.t0, self.t1, self.fwl = table[:, 2], table[:, 3], table[:, 6]
        self.judged, self.trusted = table[:, 4] > 0, table[:, 5] > 0
        self.half_s, self.places = (self.t1 - self.t0) / 2e6, np.array(self._places).reshape(-1, 2)
        self.found = np.array(self._found, np.float64).reshape(len(table), -1)
        self._basis = self._image_basis() if self._by_camera else None
        fits = self._given is None and self.known.kind != FIELD
        self.delay, self.undelayed_px = self._fit() if fits else (self._given or 0.0, None)
        true, self.covered, self.along = self._expected(self.delay, slice(None))
        if not self.covered.any():
            raise self.known.apart(self.t0.min(), self.t1.max())
        self.true, self.error = true, self.found - true
        if self._rotation:
            each = zip(self.error.tolist(), (self.t1 - self.t0).tolist(), strict=True)
            moved = [extent(self._config, parameters(self._config, e, span), (0, 0)) for e, span in each]
            self.px = np.array(moved) * self._config.pixel
        else:
            self.px = np.hypot(*self.error.T) * self.half_s

    def _image_basis(self):
        """px/s at each place per rad/s about x, y, z, and per 1/s of way over depth: float64 [N, 2, 6]."""
        camera, dt = self._camera, 1e-4
        x, y = at = camera.rays(*self.places.T)
        one, none = np.ones_like(x), np.zeros_like(x)
        steps = np.concatenate([camera.rotation(x, y), [[-one, none, x], [none, -one, y]]], axis=1) * dt
        moved = [(camera.pixels(*(at + s)) - camera.pixels(*(at - s))) / (2 * dt) for s in np.moveaxis(steps, 1, 0)]
        return np.transpose(moved, (2, 1, 0))

    def _expected(self, delay, rows):
        """``(truth [N, axes], whether it is known [N], whether only its direction is)`` of some rows."""
        signal = self.known.signal
        if self.known.kind == FIELD:
            true = np.array(self._true)[rows]
            return true, np.isfinite(true[:, 0]), False
        t0, t1 = self.t0[rows] + delay * 1e6, self.t1[rows] + delay * 1e6
        covered, mean = signal.covers(t0, t1), signal.mean(t0, t1)
        if not self._by_camera:
            return mean[:, :3], covered, False  # of an image's velocity both
        basis = self._basis[rows]
        turn = np.einsum("nak,nk->na", basis[..., :3], mean[:, :3])
        if self.known.kind == GYROSCOPE:
            return turn, covered, False
        way = np.einsum("nak,nk->na", basis[..., 3:], mean[:, 3:])
        if self._depth is not None:
            return turn + way / self._depth, covered, False
        if np.median(np.linalg.norm(mean[covered, 3:], axis=1)) < _STILL if covered.any() else True:
            return turn, covered, False
        share = ((self.found[rows] - turn) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12)
        return turn + np.maximum(share, 0)[:, None] * way, covered, True

    def _fit(self):
        """``(delay in s, mean error without it in px or None where none was fitted)``."""
        rows = np.flatnonzero(self.trusted if self.judged.any() else np.ones(len(self.trusted), bool))
        focus = math.sqrt(self._config.calibration[0] * self._config.calibration[1]) if self._rotation else 1.0

        def cost(delay):
            """Mean square of capped errors, and how many are known."""
            true, covered, _ = self._expected(delay, rows)
            px = np.linalg.norm(self.found[rows] - true, axis=1) * self.half_s[rows] * focus
            px = np.minimum(px[covered], _CAP_PX)
            return (float((px**2).mean()) + _FLOOR_PX**2 if len(px) else math.inf), len(px)

        def best(delays):
            costs = [cost(delay) for delay in delays]
            most = max(count for _, count in costs)
            return min((c, abs(d), d) for d, (c, count) in zip(delays, costs, strict=True) if count >= 0.8 * most)

        count = len(np.unique(self.window[rows]))
        if count < _LEAST_WINDOWS:
            return 0.0, None
        steps = round(REACH_S / _STEP_S)
        _, _, near = best([k * _STEP_S for k in range(-steps, steps + 1)])
        fine = round(_STEP_S / _FINE_S)
        least, _, found = best([near + k * _FINE_S for k in range(-fine, fine + 1)])
        without = cost(0.0)[0]
        if not count * math.log(without / least) > math.log(count) + 4:  # no more than chance gives, or a still motion
            return 0.0, None
        return round(found, 6), math.sqrt(without - _FLOOR_PX**2) if math.isfinite(without) else None

    @property
    def axes(self):
        """Names of what is compared; ``("across",)`` where only the direction of the truth is known."""
        return ("across",) if self.along else _AXES[self._rotation]

    def _numbers(self, chosen):
        """What is told of some rows, JSON-ready; None of none."""
        count = int(chosen.sum())
        if not count:
            return None
        px, error, true = self.px[chosen], self.error[chosen], self.true[chosen]
        error = np.linalg.norm(error, axis=1)[:, None] if self.along else error
        size = np.linalg.norm(true, axis=1)
        peak = 0.0 if self.along else float(np.linalg.norm(self.true[self.covered], axis=1).max())
        rms = dict(zip(self.axes, np.sqrt((error**2).mean(axis=0)).tolist(), strict=True))
        share = np.linalg.norm(error, axis=1)[size > 0] / size[size > 0]
        return {
            "count": count,
            "aee_px": float(px.mean()),
            "aee_px_per_s": float((px / self.half_s[chosen]).mean()),
            "median_px": float(np.median(px)),
            "above": {f"{limit:g}": float((px > limit).mean()) for limit in SHARES_PX},
            "rms": rms,
            "peak": peak or None,
            "rms_percent_of_peak": {axis: 100 * value / peak if peak else None for axis, value in rms.items()},
            "relative": None if self.along or not len(share) else dict(
                zip(("median", "p90"), np.percentile(share, (50, 90)).tolist(), strict=True)
            ),
            "fwl": float(np.mean(self.fwl[chosen][np.unique(self.window[chosen], return_index=True)[1]])),
        }  # fmt: skip

    def summary(self):
        """All of it, JSON-ready: lengths in px per half window, RMS and peak in ``unit``."""
        trusted = self.covered & self.trusted
        return {
            "truth": {"file": self.known.name, "kind": self.known.kind, "rows": self.known.rows},
            "delay_s": self.delay,
            "delay_fitted": self.undelayed_px is not None,
            "compared": int(self.covered.sum()),
            "not_covered": int((~self.covered).sum()),
            "degenerate": self.degenerate,
            "judged": bool(self.judged.any()),
            "wrong": int((self.px[trusted] > WRONG_PX).sum()),
            "depth_unknown": self.along,
            "unit": "rad/s" if self._rotation else "px/s",
            "trusted": self._numbers(trusted),
            "all": self._numbers(self.covered),
        }

    def save(self, path):
        """Write a CSV: of each batch, or tile, what was found, what is true, and the error."""
        names = _AXES[self._rotation]
        head = ["window", "tile", "t_us", *(f"{what}_{axis}" for what in ("found", "true") for axis in names)]
        with naming(path), open(path, "w", newline="", encoding="utf-8") as file:
            write = csv.writer(file, lineterminator="\n").writerow
            write([*head, "error_px", "trusted"])
            for k in np.flatnonzero(self.covered):
                motions = [f"{value:.6g}" for value in (*self.found[k], *self.true[k])]
                middle = f"{(self.t0[k] + self.t1[k]) / 2:.1f}"
                write([self.window[k], self.tile[k], middle, *motions, f"{self.px[k]:.4f}", int(self.trusted[k])])
