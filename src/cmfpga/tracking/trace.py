"""Every intermediate of a tracked batch: computed again from its events, and checked against the engine's trace."""

from dataclasses import dataclass

import numpy as np
import torch

from ..config.schedule import used
from ..errors import ConfigError, RecordingError
from ..protocol.confidence import beside
from ..protocol.settings import BatchSettings
from ..reference import floating
from ..reference.float_core import FloatCore, newton_step
from ..reference.ingest import take_in
from ..reference.integer.ascent import newton
from ..reference.integer.core import IntegerCore, IntegerIteration
from ..reference.integer.event_path import dither, time_scaler
from ..reference.integer.image import warp
from ..reference.integer.motion import basis, flow


@dataclass(frozen=True, eq=False)
class IterationTrace:
    """One iteration, or one evaluation of a round: what the engine has between its blocks.

    Real numbers, float64. Those of the engines ``rtl`` and ``model`` are raw integers times the step of their format,
    so nothing is lost; ``raw`` holds the integers. Positions, images and derivatives are in the image's pixels. ``x``,
    ``y``: warped columns and rows of the events that the iteration uses (:func:`cmfpga.config.schedule.used`), relative
    to the ROI. ``v``, ``s`` and ``g`` have one member for each of the m parameters of the motion.
    """

    v: np.ndarray  # [m]: velocity that the iteration used, px per half batch
    v_next: np.ndarray  # [m]: the one that it, or its round, found
    level: int  # the image's pixels are 2^level px wide
    log2_step: int | None  # the step is 2^log2_step px per half batch; None for a constant η, and in rounds
    x: np.ndarray  # [n_k]
    y: np.ndarray  # [n_k]
    iwe: np.ndarray  # [rows, columns]: image of warped events I, events per pixel
    iwe_dx: np.ndarray  # [rows, columns]: ∂I/∂vx
    iwe_dy: np.ndarray  # [rows, columns]: ∂I/∂vy
    sum_i: float  # ΣI
    sum_d: np.ndarray  # [2]: ΣD
    s: np.ndarray  # [m]: S = Σ I·D
    g: np.ndarray  # [m]: G = P·S − ΣI·ΣD, of P pixels; of motions beyond translation G = S
    raw: dict | None  # the same names, int64, in the formats of ``Config``; None for the engine ``float``


class BatchTrace:
    """A batch, iteration by iteration: ``trace[k]`` is the :class:`IterationTrace` of iteration k, ``len(trace)`` is T.

    Rounds have four evaluations each: then ``trace[k]`` is evaluation k mod 4 of round k div 4, ``len(trace)`` is 4·T.

    All ``events`` of the batch are needed, the ``result`` and the name of its ``engine``, the recording's ``name`` for
    messages, and plan, thinning and marks of its :class:`~cmfpga.tracking.loop.TrackedBatch`.

    Attributes
    ----------
    v : float64 [len + 1, 2]
        Velocity that each iteration, or evaluation, used, then the result; px per half batch.
    levels : int64 [len]
        Level of each.
    t, x, y : int64 [n]
        Stored ROI events: µs since the batch's first event, column and row in the ROI, px; float64 where the hardware
        undistorts.
    x_dithered, y_dithered : float64 [n]
        The same positions as the iterations use them: with the dither, if the configuration has one.
    dt : float64 [n]
        Scaled times, −1 … 1.

    Raises
    ------
    ConfigError
        The engine, ``axi``, gives no trace.
    RecordingError
        The events are not those that the engine was given: the recording has changed.
    """

    def __init__(self, config, engine, events, result, *, plan, thinning, name, marks=None):
        if result.trace is None:
            raise ConfigError(f"trace: the {engine} engine gives only results; rtl, model or float is needed")
        self._each = config.ascent_rule.evaluations
        self.config, self.result, self.plan = config, result, tuple(one for one in plan for _ in range(self._each))
        self._real = engine == "float"
        self._name = name
        settings = BatchSettings.from_config(config.replace(thinning=thinning, thin_target=0))
        marks = marks or (False, False)
        if len(np.atleast_1d(marks[0])) not in (1, len(events)):
            raise self._changed()
        taken = {"roi": result.roi, "last_thinning": None, "dropped": marks}
        frac = config.formats.event_frac
        batch = take_in(config, events.t, events.x, events.y, settings, **taken)
        counted = {key: getattr(result, key) for key in batch.counts}
        if any(value not in (None, batch.counts[key]) for key, value in counted.items()):
            raise self._changed()
        self.t = batch.t.numpy()
        self.x, self.y = (axis.numpy() * 2.0**-frac if frac else axis.numpy() for axis in (batch.x, batch.y))
        self.levels = np.array([entry.level for entry in self.plan], np.int64)
        self._v = self._velocities()
        self.v = np.array(self._v, np.float64) * (1 if self._real else config.formats.v.step)
        self._settings = settings
        if self._real:
            self._events, steps = FloatCore(config).place(batch), (1, 1, 1)
        else:
            dt = time_scaler(config, batch.t, span=result.span) if result.span else torch.zeros_like(batch.t)
            self._events = (*dither(config, batch.x, batch.y), dt)
            steps = (2.0**-config.formats.dithered_frac, 2.0**-config.formats.dithered_frac, config.formats.dt.step)
        self.x_dithered, self.y_dithered, self.dt = (
            axis.numpy() * step for axis, step in zip(self._events, steps, strict=True)
        )

    def _velocities(self):
        """As the engine's trace has them, but with those of each evaluation of a round."""
        v = self.result.trace.v
        if self._each == 1:
            return v
        quarter = 0.25 if self._real else 1 << (self.config.v_frac - 2)
        rounds = zip(v.tolist(), self.plan[:: self._each], strict=False)
        return np.array([*(one for at, entry in rounds for one in beside(at, quarter * entry.distance)), v[-1]])

    def _changed(self):
        return RecordingError(f"{self._name}: the events are not those that were tracked; the recording has changed")

    def __len__(self):
        return len(self.plan)

    def __getitem__(self, k):
        if not -len(self) <= k < len(self):
            raise IndexError(f"iteration {k}: 0 to {len(self) - 1} is needed")
        k %= len(self)
        entry = self.plan[k]
        events = (axis[used(entry, k, len(axis))] for axis in self._events)
        done = (self._real_iteration if self._real else self._raw_iteration)(k, entry, *events)
        self._check(k, done)
        return done

    def _check(self, k, done):
        """What was computed here is what the engine found."""
        trace, mine = self.result.trace, done if self._real else done.raw
        mine = mine if isinstance(mine, dict) else vars(mine)
        pairs = [(self._v[k], mine["v"]), (trace.v[k // self._each + 1], mine["v_next"])]
        for name in ("sum_i", "sum_d", "s"):
            theirs = getattr(trace, name)
            theirs = theirs.reshape(-1, *theirs.shape[2:]) if self._each > 1 else theirs
            pairs.append((theirs[k], mine[name]))
        if not all(np.allclose(a, b, rtol=1e-9, atol=1e-9) if self._real else np.array_equal(a, b) for a, b in pairs):
            raise self._changed()

    def _raw_iteration(self, k, entry, x, y, dt):
        config, level = self.config, entry.level
        columns, rows = config.geometry.level_size(level)
        v = tuple(map(int, self._v[k]))
        b = basis(config, x, y, roi=self.result.roi, camera=self._settings.camera)
        core = IntegerCore(config)
        if self._each > 1:
            done = IntegerIteration(v, *core.evaluate(x, y, dt, v, level), v_next=self._step(k))
        else:
            done, _ = core.iterate(x, y, dt, v, eta=self._settings.eta, entry=entry, b=b)
        warped_x, warped_y = warp(config, x, y, dt, flow(config, v, b), level)
        step, position = config.formats.v.step, 2.0**-config.position_frac
        weight, derivative = 2.0**-config.weight_frac, 2.0**-config.derivative_frac
        product = weight * derivative * 2.0 ** -(config.motion_model.frac if b else 0)
        found = {  # integers, and the step of their format
            "v": (np.array(done.v, np.int64), step),
            "v_next": (np.array(done.v_next, np.int64), step),
            "x": (warped_x.numpy(), position),
            "y": (warped_y.numpy(), position),
            "iwe": (done.images.i.numpy()[:rows, :columns], weight),
            "iwe_dx": (done.images.dx.numpy()[:rows, :columns], derivative),
            "iwe_dy": (done.images.dy.numpy()[:rows, :columns], derivative),
            "sum_i": (done.sums.i, weight),
            "sum_d": (np.array([done.sums.dx, done.sums.dy], np.int64), derivative),
            "s": (np.array(done.sums.s, np.int64), product),
            "g": (np.array(done.g), product),  # may be wider than 64 bits
        }
        raw = {name: value for name, (value, _) in found.items()}
        real = {name: value * unit for name, (value, unit) in found.items()}
        return IterationTrace(**real, level=level, log2_step=getattr(entry, "log2_step", None), raw=raw)

    def _step(self, k):
        """Where an evaluation's round goes, from what the engine found in it."""
        config, number, entry = self.config, k // self._each, self.plan[k]
        s = config.geometry.pixels * self.result.trace.s[number]
        if not self._real:
            return newton(config, tuple(self.result.trace.v[number].tolist()), s.tolist(), entry)[0]
        return self.result.trace.v[number] + newton_step(s.tolist(), entry.distance / 4, entry.limit)

    def _real_iteration(self, k, entry, x, y, dt):
        config, level = self.config, entry.level
        columns, rows = config.geometry.level_size(level)
        size = {"width": config.roi_width, "height": config.roi_height, "border": config.border}
        now = floating.evaluate(x, y, dt, self.v[k], level=level, **size)
        warped = (floating.at_level(axis, level).numpy() for axis in floating.warp(x, y, dt, self.v[k]))
        images = (image.numpy()[:rows, :columns] for image in (now.image, now.derivative_x, now.derivative_y))
        pairs = (pair.numpy() for pair in (now.sum_d, now.s, now.g))
        found = self._step(k) if self._each > 1 else self.v[k + 1]
        log2_step = getattr(entry, "log2_step", None)
        return IterationTrace(self.v[k], found, level, log2_step, *warped, *images, float(now.sum_i), *pairs, raw=None)
