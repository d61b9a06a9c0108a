"""The article's equations, event by event and pixel by pixel, and what coarse levels make of them."""

from math import floor

import numpy as np


def transcription(x, y, dt, v, width, height, level=0):
    """I, Dx, Dy, C, ∇C; at a coarse level in the corner of an image of the ROI's size, derivatives by its pixels."""
    scale = 2**level
    columns, rows = -(-width // scale), -(-height // scale)
    image, d_x, d_y = images = np.zeros((3, height, width))
    for x_k, y_k, dt_k in zip(x, y, dt, strict=True):
        x_w = (x_k - dt_k * v[0] + 0.5) / scale - 0.5  # Eq. x'k
        y_w = (y_k - dt_k * v[1] + 0.5) / scale - 0.5
        i_k, j_k = floor(x_w), floor(y_w)
        dx, dy = x_w - i_k, y_w - j_k
        cases = {  # Eq. weights, ∂w/∂dx (Eq. w_dx_x), ∂w/∂dy
            (i_k, j_k): ((1 - dx) * (1 - dy), -(1 - dy), -(1 - dx)),
            (i_k + 1, j_k): (dx * (1 - dy), 1 - dy, -dx),
            (i_k, j_k + 1): ((1 - dx) * dy, -dy, 1 - dx),
            (i_k + 1, j_k + 1): (dx * dy, dy, dx),
        }
        for (i, j), (w, w_dx, w_dy) in cases.items():
            if 0 <= i < columns and 0 <= j < rows:
                images[:, j, i] += w, w_dx * -dt_k, w_dy * -dt_k  # Eq. I_w, I_w_v_x, dx_k_x'_k_x'_k_v_x
    pixels = width * height
    mu = image.sum() / pixels
    c = ((image - mu) ** 2).sum() / pixels  # Eq. C
    # Eq. C_v_x, with Eq. mu_v_x.
    grad = [2 / pixels * ((image - mu) * (d - d.sum() / pixels)).sum() for d in (d_x, d_y)]
    return image, d_x, d_y, c, np.array(grad)
