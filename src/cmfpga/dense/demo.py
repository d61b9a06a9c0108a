"""The scene that is measured without a recording: a camera turns in front of bars, so that the flow is known."""

import numpy as np

from ..events import generate
from ..imaging.camera import Camera

CAMERA = Camera(200.0, 200.0, 119.5, 89.5)
ROTATION = (0.3, -0.8, 0.4)

#: What :func:`~cmfpga.events.generate` makes.
SCENE = {
    "seed": 1,
    "texture": "lines",
    "bars": 40,
    "size": (380, 300),
    "velocity": (0.0, 0.0),
    "rotation": ROTATION,
    "camera": CAMERA,
    "duration_us": 90_000,
    "noise": 0.05,
}


def scene():
    """The :class:`~cmfpga.events.Synthetic` recording."""
    return generate(**SCENE)


def errors(window):
    """How far the flow of each trusted tile is from the true one where its events are, px per half window: [k]."""
    rays = CAMERA.rays(*window.centres[window.trusted].T)
    true = np.einsum("akn,k->na", CAMERA.rotation(*rays), ROTATION) * (CAMERA.fx, CAMERA.fy)
    return np.hypot(*(window.px_per_s[window.trusted] - true).T) * window.half_s
