"""A camera's intrinsics: from pixels to rays and back, and how its own rotation moves the image."""

from dataclasses import astuple, dataclass

import numpy as np

from ...errors import ConfigError

#: Most rounds of the fixed point that undistorts, and what it has to settle within; event cameras' lenses take 20.
_ROUNDS, _SETTLED = 200, 1e-13
_ALLOWED_PX = 1e-3  # between a pixel and the ray that was found for it, seen again


@dataclass(frozen=True)
class Camera:
    """Pinhole and distortion of Brown and Conrady, in OpenCV's order.

    Parameters
    ----------
    fx, fy, cx, cy : float
        Focal lengths and principal point, px.
    k1, k2, p1, p2, k3 : float
        Radial (k) and tangential (p) distortion.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __str__(self):
        distortion = ", ".join(f"{name} = {value:g}" for name, value in list(vars(self).items())[4:] if value)
        place = f"f = {self.fx:g}, {self.fy:g} px, centre {self.cx:g}, {self.cy:g} px"
        return f"{place}, {distortion or 'no distortion'}"

    @property
    def text(self):
        """The numbers as the field ``camera`` of a :class:`~cmfpga.config.Config` has them."""
        return ",".join(map(repr, map(float, astuple(self))))

    def _distort(self, x, y):
        _, _, _, _, k1, k2, p1, p2, k3 = astuple(self)
        r = x * x + y * y
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        return radial, 2 * p1 * x * y + p2 * (r + 2 * x * x), p1 * (r + 2 * y * y) + 2 * p2 * x * y

    def rays(self, column, row):
        """X/Z and Y/Z of what is seen at ``column`` and ``row``, px: float64 [2, n].

        OpenCV's iteration, until it has settled. Raises :exc:`ConfigError` where it does not.
        """
        seen = np.stack([(np.asarray(column) - self.cx) / self.fx, (np.asarray(row) - self.cy) / self.fy])
        found = seen
        with np.errstate(all="ignore"):  # where it does not settle
            for _ in range(_ROUNDS):
                radial, *shift = self._distort(*found)
                before, found = found, (seen - np.stack(shift)) / radial
                if np.abs(found - before).max(initial=0) < _SETTLED:
                    break
            again = self.pixels(*found)
        missed = ~(np.abs(again - np.stack([np.asarray(column), np.asarray(row)])).max(axis=0) < _ALLOWED_PX)
        if missed.any():
            k = int(np.flatnonzero(missed)[0])
            at = f"{np.ravel(column)[k]:g},{np.ravel(row)[k]:g}"
            raise ConfigError(f"camera: {self}: no ray is seen at {at} px; this distortion is no lens's there")
        return found

    def undistorted(self, column, row):
        """Where a camera without distortion, of the same focal lengths and centre, sees it: px, float64 [2, n]."""
        x, y = self.rays(column, row)
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy])

    def distorted(self, column, row):
        """The other way round: where this camera sees what that one sees there, px: float64 [2, n]."""
        return self.pixels((np.asarray(column) - self.cx) / self.fx, (np.asarray(row) - self.cy) / self.fy)

    def pixels(self, x, y):
        """Column and row, px, where a ray is seen: float64 [2, n]."""
        radial, *shift = self._distort(x, y)
        return np.stack([(x * radial + shift[0]) * self.fx + self.cx, (y * radial + shift[1]) * self.fy + self.cy])

    @staticmethod
    def rotation(x, y):
        """How rays at ``x``, ``y`` move per rad of the camera's rotation about its x, y, z: float64 [2, 3, n]."""
        return np.stack([[x * y, -(1 + x * x), y], [1 + y * y, -x * y, -x]])

    def speeds(self, omega, column, row, dt=1e-4):
        """(vx, vy) in px/s at ``column`` and ``row``, px, of a still scene, the camera turning by ``omega`` rad/s."""
        at = self.rays(column, row)
        step = np.einsum("akn,k->an", self.rotation(*at), np.asarray(omega, float)) * dt
        return (self.pixels(*(at + step)) - self.pixels(*(at - step))) / (2 * dt)
