"""Lenses that others describe their cameras by, and the Brown-Conrady lens that stands for each of
them here.

Everything that flies computes with one lens, ``path.camera.model.CameraModel``. Makers and
calibration programs have others: the inverse of Brown-Conrady (RealSense's colour cameras), its
modified form (older RealSense), a rational one (OpenCV's eight coefficients; Azure Kinect) and the
equidistant one of fisheyes (Kannala-Brandt; OpenCV's ``fisheye``, Kalibr). ``as_brown_conrady``
finds the camera whose pixels are where theirs are, and says by how much it is off at worst: a lens
that bends too much for it is refused with that number, never taken as nearly right.

With x, y the undistorted and xd, yd the distorted normalised coordinates, r2 = x2 + y2, and B(x, y)
Brown-Conrady:

    brown_conrady            (xd, yd) = B(x, y)                                    k1 k2 p1 p2 k3
    inverse_brown_conrady    (x, y) = B(xd, yd)                                    k1 k2 p1 p2 k3
    modified_brown_conrady   B, its tangential part of the radially moved point    k1 k2 p1 p2 k3
    rational                 the radial factor of B over 1 + k4 r2 + k5 r4 + k6 r6  k1 k2 p1 p2 k3 k4 k5 k6
    equidistant              angle a to a (1 + k1 a2 + k2 a4 + k3 a6 + k4 a8)       k1 k2 k3 k4

Sources: librealsense's rsutil.h; OpenCV's calib3d and fisheye documentation; Kannala and Brandt
2006.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from path.arrays import Array
from path.camera.model import CameraModel, distort
from path.values import frozen

LensKind = Literal[
    "brown_conrady", "inverse_brown_conrady", "modified_brown_conrady", "rational", "equidistant"
]
COEFFICIENTS: dict[LensKind, int] = {
    "brown_conrady": 5,
    "inverse_brown_conrady": 5,
    "modified_brown_conrady": 5,
    "rational": 8,
    "equidistant": 4,
}

MOST_PX = 0.25  # that a lens may be off where it is at its worst: 0.3 mm at 1 m and 800 px
GRID = (41, 31)  # pixels that are compared
# of Newton's method
STEPS = 60
STEP = 1e-12
NUDGE = 1e-6  # of a derivative
TURNS = 16  # of the fit
WIDEST = 8.0  # a ray 83 degrees off the axis


@frozen
class Lens:
    """A camera by its maker's or its calibration program's own lens.

    Attributes:
        coefficients: as the table above has them, in that order.

    Raises:
        ValueError: as many coefficients as another kind has, or one that is not finite.
    """

    kind: LensKind
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        wanted = COEFFICIENTS[self.kind]
        if len(self.coefficients) != wanted:
            raise ValueError(
                f"a lens of kind {self.kind} has {wanted} coefficients, not {len(self.coefficients)}"
            )
        if not np.isfinite(self.coefficients).all():
            raise ValueError(f"coefficients: {self.coefficients!r} are not finite")

    def project(self, rays: Array) -> Array:
        """Return the pixels (n, 2) of undistorted normalised coordinates (n, 2)."""
        inverse = self.kind == "inverse_brown_conrady"
        bent = _inverted(self._bend, rays) if inverse else self._bend(rays)
        return bent * (self.fx, self.fy) + (self.cx, self.cy)

    def rays(self, pixels: Array) -> Array:
        """Return the undistorted normalised coordinates (n, 2) of pixels (n, 2); NaN rows where
        there are none.
        """
        bent = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.kind == "inverse_brown_conrady":
            return self._bend(bent)
        if self.kind == "equidistant":
            return self._unbent_from_angle(bent)
        return _inverted(self._bend, bent)

    def _bend(self, points: Array) -> Array:
        """Return B of points (n, 2), or what stands for it."""
        if self.kind == "equidistant":
            return self._bent_to_angle(points)
        x = points[:, 0]
        y = points[:, 1]
        k1, k2, p1, p2, k3 = self.coefficients[:5]
        if self.kind == "modified_brown_conrady":
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x = x * radial
            y = y * radial
            across = x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
            down = y + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)
            return np.stack((across, down), axis=1)
        if self.kind == "rational":
            k4, k5, k6 = self.coefficients[5:]
            r2 = x * x + y * y
            over = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
            radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / over
            tangential = np.stack(distort(x, y, (0.0, 0.0, p1, p2, 0.0)), axis=1) - points
            return points * radial[:, None] + tangential
        return np.stack(distort(x, y, (k1, k2, p1, p2, k3)), axis=1)

    def _bent_to_angle(self, points: Array) -> Array:
        radius = np.hypot(points[:, 0], points[:, 1])
        angle = np.arctan(radius)
        factor = np.where(radius > 1e-12, self._angle(angle)[0] / np.maximum(radius, 1e-12), 1.0)
        return points * factor[:, None]

    def _unbent_from_angle(self, bent: Array) -> Array:
        """Newton's method on the angle; a ray from the side or from behind has no normalised
        coordinates.
        """
        wanted = np.hypot(bent[:, 0], bent[:, 1])
        angle = np.minimum(wanted, 1.5)
        with np.errstate(all="ignore"):
            for _ in range(STEPS):
                value, slope = self._angle(angle)
                angle = np.clip(angle - (value - wanted) / slope, 0.0, np.pi)
            value, slope = self._angle(angle)
            found = (np.abs(value - wanted) < 1e-9) & (slope > 0.0) & (angle < np.arctan(WIDEST))
        factor = np.where(wanted > 1e-12, np.tan(angle) / np.maximum(wanted, 1e-12), 1.0)
        return np.where(found[:, None], bent * factor[:, None], np.nan)

    def _angle(self, angle: Array) -> tuple[Array, Array]:
        """Return the bent angle and its derivative."""
        k1, k2, k3, k4 = self.coefficients
        a2 = angle * angle
        value = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
        slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
        return value, slope


@frozen
class StandIn:
    """The Brown-Conrady camera that stands for another lens. ``worst_px``: how far off it is where
    it is worst.
    """

    camera: CameraModel
    worst_px: float


def as_brown_conrady(lens: Lens) -> StandIn:
    """Return the Brown-Conrady camera whose pixels look where those of a lens do.

    Focal lengths and centre are fitted too: they are not the lens's own.

    Raises:
        ValueError: it would be off by more than ``MOST_PX``, the lens sees to the side of the
            camera, or the numbers are no camera.
    """
    straight = not any(lens.coefficients) and lens.kind != "equidistant"
    if straight or lens.kind == "brown_conrady":
        k1, k2, p1, p2, k3 = lens.coefficients[:5]
        own = CameraModel(
            lens.width,
            lens.height,
            lens.fx,
            lens.fy,
            lens.cx,
            lens.cy,
            (k1, k2, p1, p2, k3),
        )
        return StandIn(own, 0.0)
    pixels = _spread(lens.width, lens.height)
    rays = lens.rays(pixels)
    if not np.isfinite(rays).all():
        raise ValueError(
            f"a lens of kind {lens.kind} that shows what is beside the camera, or cannot be inverted over its image"
        )
    values = _fitted(lens, rays, pixels)
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = values.tolist()
    worst_px = float(np.hypot(*(_projected(values, rays) - pixels).T).max())
    if worst_px > MOST_PX:
        raise ValueError(
            f"a lens of kind {lens.kind}, from which the nearest Brown-Conrady lens is off by {worst_px:.2f} px "
            f"(at most {MOST_PX:g})"
        )
    return StandIn(
        CameraModel(lens.width, lens.height, fx, fy, cx, cy, (k1, k2, p1, p2, k3)), worst_px
    )


def _fitted(
    lens: Lens,
    rays: Array,
    pixels: Array,
) -> Array:
    """Return fx fy cx cy k1 k2 p1 p2 k3 of the camera that is least off over the image: by Gauss
    and Newton.
    """
    values = np.array([lens.fx, lens.fy, lens.cx, lens.cy, 0.0, 0.0, 0.0, 0.0, 0.0])
    weights = np.ones(len(rays))
    for turn in range(TURNS):
        off = _projected(values, rays) - pixels
        slopes = (_derivatives(values, rays) * weights[:, None, None]).reshape(-1, len(values))
        scale = np.linalg.norm(slopes, axis=0) + 1e-12
        scaled = slopes / scale
        step = np.linalg.solve(scaled.T @ scaled, scaled.T @ (off * weights[:, None]).ravel())
        values = values - step / scale
        if turn >= TURNS // 2:  # from here on what is off most weighs more: the worst place decides
            off_px = np.hypot(*(_projected(values, rays) - pixels).T)
            weights = weights * np.sqrt(0.1 + off_px / max(float(off_px.max()), 1e-12))
            weights /= weights.max()
    return values


def _derivatives(values: Array, rays: Array) -> Array:
    """Return d(u, v) over fx fy cx cy k1 k2 p1 p2 k3, (n, 2, 9)."""
    fx, fy = values[:2]
    x = rays[:, 0]
    y = rays[:, 1]
    r2 = x * x + y * y
    k1, k2, p1, p2, k3 = values[4:]
    xd, yd = distort(x, y, (k1, k2, p1, p2, k3))
    none = np.zeros_like(x)
    one = np.ones_like(x)
    xy2 = 2.0 * x * y
    across = (
        xd,
        none,
        one,
        none,
        fx * x * r2,
        fx * x * r2**2,
        fx * xy2,
        fx * (r2 + 2.0 * x * x),
        fx * x * r2**3,
    )
    down = (
        none,
        yd,
        none,
        one,
        fy * y * r2,
        fy * y * r2**2,
        fy * (r2 + 2.0 * y * y),
        fy * xy2,
        fy * y * r2**3,
    )
    return np.stack((np.stack(across, axis=1), np.stack(down, axis=1)), axis=1)


def _projected(values: Array, rays: Array) -> Array:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
    xd, yd = distort(rays[:, 0], rays[:, 1], (k1, k2, p1, p2, k3))
    return np.stack((fx * xd + cx, fy * yd + cy), axis=1)


def _spread(width: int, height: int) -> Array:
    columns = np.linspace(-0.5, width - 0.5, GRID[0])
    rows = np.linspace(-0.5, height - 0.5, GRID[1])
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def _inverted(bend: Callable[[Array], Array], bent: Array) -> Array:
    """Return points (n, 2) that ``bend`` takes to ``bent``, by Newton's method; NaN rows where
    there are none.
    """
    points = bent.copy()
    right, below = NUDGE * np.eye(2)
    determinant = np.ones(len(bent))
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            off = bend(points) - bent
            across = (bend(points + right) - bend(points - right)) / (2.0 * NUDGE)
            down = (bend(points + below) - bend(points - below)) / (2.0 * NUDGE)
            determinant = across[:, 0] * down[:, 1] - down[:, 0] * across[:, 1]
            dx = (down[:, 1] * off[:, 0] - down[:, 0] * off[:, 1]) / determinant
            dy = (across[:, 0] * off[:, 1] - across[:, 1] * off[:, 0]) / determinant
            points = points - np.stack((dx, dy), axis=1)
            if not np.any(np.abs(dx) + np.abs(dy) >= STEP):
                break
        off = np.abs(bend(points) - bent).sum(axis=1)
        good = (off < 1e-9) & (determinant > 0.0) & (np.abs(points).max(axis=1) < WIDEST)
    return np.where(good[:, None], points, np.nan)
