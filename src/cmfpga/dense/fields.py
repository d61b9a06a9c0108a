"""One motion for the whole field of flow: robust least squares over the tiles without doubt; a scene with a known one.

Each tile counts as its information says, so that an edge counts across itself and not along itself. Residuals that are
large for that, such as those of what moves on its own, count less: the loss is 2·(√(1 + r²) − 1), r in standard
deviations, by iteratively reweighted least squares. The loss is convex: there is one solution.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from ..events import generate
from ..imaging.camera import Camera

#: ``{model: names of its parameters, in physical units}``. Position 0 of slopes is the middle of the sensor.
MODELS = {
    "translation": ("vx_px_per_s", "vy_px_per_s"),
    "similarity": ("vx_px_per_s", "vy_px_per_s", "zoom_per_s", "roll_rad_per_s"),
    "affine": ("vx_px_per_s", "vy_px_per_s", "dvx_dx_per_s", "dvx_dy_per_s", "dvy_dx_per_s", "dvy_dy_per_s"),
    "rotation": ("wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"),
}

_OF_ITS_OWN_PX = 0.05  # standard deviation that no tile is better than, px per half window
_ROUNDS, _SETTLED = 50, 1e-6
_OUTLIER = 3.0  # standard deviations
_NORMAL = 1.1774  # median length of a normal vector in the plane, in standard deviations


@dataclass(frozen=True)
class Field:
    """The motion fitted to one window."""

    values: np.ndarray  # float64 [p]: of the parameters of :data:`MODELS`; NaN where too few tiles are trusted
    errors: np.ndarray  # float64 [p]: their standard deviations
    tiles: int  # trusted ones, which it is fitted to
    agree: float  # share of them within three standard deviations; NaN without a fit


def check(model, config):
    """Raise :exc:`ConfigError` where ``model`` cannot be fitted with this configuration."""
    if model not in MODELS:
        raise ConfigError(f"fit = {model!r}: one of {', '.join(MODELS)} is needed")
    if model == "rotation" and not config.lens:
        raise ConfigError("fit = rotation: a calibration is needed; the recording holds none: --camera FILE, camera=")


def basis(model, config, at):
    """Flow in px/s per unit of each parameter: float64 [2, p, n], at ``at`` [n, 2], px."""
    if model == "rotation":
        camera = Camera(*config.lens[:4])  # of the undistorted image
        return camera.rotation(*camera.rays(*at.T)) * np.array([camera.fx, camera.fy])[:, None, None]
    x, y = at.T - (np.array([[config.sensor_width], [config.sensor_height]]) - 1) / 2
    one, zero = np.ones_like(x), np.zeros_like(x)
    members = {
        "translation": ([one, zero], [zero, one]),
        "similarity": ([one, zero, x, -y], [zero, one, y, x]),
        "affine": ([one, zero, x, y, zero, zero], [zero, one, zero, zero, x, y]),
    }
    return np.array(members[model])


def fit_field(model, window):
    """The :class:`Field` of a :class:`~.window.Window`."""
    # Short tiles, too: without what is slow of a field, its fit would be worse.
    used = window.sure & np.isfinite(window.uncertainty).all(axis=1)
    count, size = int(used.sum()), len(MODELS[model])
    none = Field(*np.full((2, size), np.nan), count, math.nan)
    if 2 * count < size + 2:
        return none
    b = np.moveaxis(basis(model, window.config, window.centres[used]), 2, 0)  # [n, 2, p]
    xx, yy, xy = window.uncertainty[used].T
    own = (_OF_ITS_OWN_PX / window.half_s) ** 2
    xx, yy = xx + own, yy + own
    # Cholesky of the covariance's inverse: rows in standard deviations.
    inverse = np.linalg.inv(np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1))
    white = np.linalg.cholesky(inverse).transpose(0, 2, 1)
    b, v = white @ b, (white @ window.px_per_s[used, :, None])[..., 0]
    scale = np.sqrt((b**2).sum(axis=(0, 1)))
    if np.linalg.matrix_rank((b / np.maximum(scale, 1e-300)).reshape(-1, size), tol=1e-6) < size:
        return none
    theta, weight, spread = np.zeros(size), np.ones(count), 1.0
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        system = (b * root[..., None] / scale).reshape(-1, size)
        found = np.linalg.lstsq(system, (v * root).ravel(), rcond=None)[0] / scale
        away = np.hypot(*(v - b @ found).T)
        spread = max(1.0, float(np.median(away)) / _NORMAL)
        weight = 1 / np.sqrt(1 + (away / spread) ** 2)
        change, theta = np.abs((found - theta) * scale).max(), found
        if change < _SETTLED * np.abs(found * scale).max(initial=1e-300):
            break
    errors = np.sqrt(np.diag(np.linalg.inv(system.T @ system))) / scale * spread
    return Field(theta, errors, count, float((away < _OUTLIER * spread).mean()))


#: The scene that is measured without a recording: a camera turns in front of bars, so that the flow is known.
CAMERA = Camera(200.0, 200.0, 119.5, 89.5)
ROTATION = (0.3, -0.8, 0.4)


def scene(width=240, height=180):
    """The :class:`~cmfpga.events.Synthetic` recording; a larger sensor sees as wide an angle."""
    scale = width / 240
    camera = Camera(200.0 * scale, 200.0 * scale, (width - 1) / 2, (height - 1) / 2)
    return generate(
        seed=1, texture="lines", bars=40, size=(round(380 * scale), round(300 * scale)), velocity=(0.0, 0.0),
        rotation=ROTATION, camera=camera, duration_us=90_000, noise=0.05, width=width, height=height,
    )  # fmt: skip


def demo_errors(window):
    """How far the flow of each trusted tile is from the true one where its events are, px per half window: [k]."""
    rays = CAMERA.rays(*window.centres[window.trusted].T)
    true = np.einsum("akn,k->na", CAMERA.rotation(*rays), ROTATION) * (CAMERA.fx, CAMERA.fy)
    return np.hypot(*(window.px_per_s[window.trusted] - true).T) * window.half_s
