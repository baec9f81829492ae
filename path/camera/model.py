"""The calibrated camera: pinhole with Brown-Conrady distortion (paper, eqs. d2_normalized to
d2_projection).

The printed distortion equation has the distorted point on both sides; the right-hand vector is the
undistorted one. Scalar methods work on plain floats (a handful of microseconds in the flight loop),
array methods on many points. Pixel centres are at integer coordinates, as in OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field
from functools import cache
from typing import TypeVar

import numpy as np

from path.arrays import Array
from path.camera.thinning import Thinning
from path.values import frozen

Scalar = TypeVar("Scalar", float, Array)
Point3 = tuple[float, float, float]
Coefficients = tuple[float, float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]

UNDISTORT_STEP = 1e-7  # the error after a Newton step is about its square: < 1e-12
UNDISTORT_ITERATIONS = 20
BORDER_SAMPLES = (0.0, 0.25, 0.5, 0.75, 1.0)


def distort(x: Scalar, y: Scalar, coefficients: Coefficients) -> tuple[Scalar, Scalar]:
    """Apply radial and tangential distortion to undistorted normalised coordinates; floats or equal
    arrays.
    """
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xy2 = 2.0 * x * y
    return (
        x * radial + p1 * xy2 + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy2,
    )


def distort_jacobian(
    x: Scalar, y: Scalar, coefficients: Coefficients
) -> tuple[Scalar, Scalar, Scalar]:
    """Derivatives ``(dxd/dx, dxd/dy, dyd/dy)`` of ``distort``; ``dyd/dx`` equals ``dxd/dy``."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope2 = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    return (
        radial + x * x * slope2 + 2.0 * p1 * y + 6.0 * p2 * x,
        x * y * slope2 + 2.0 * (p1 * x + p2 * y),
        radial + y * y * slope2 + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@frozen
class CameraModel:
    """Intrinsics of one camera stream.

    Attributes:
        width, height: image size in px.
        fx, fy, cx, cy: focal lengths and principal point in px.
        distortion: ``(k1, k2, p1, p2, k3)``, OpenCV's order.
        doubts: what the calibration does not know: by how much ``(fx, fy, cx, cy, k1, k2, p1, p2,
            k3)`` are off together, one standard deviation of each of some independent causes.
            Empty: it states none.
        thinning: how the camera leaves out pixels, so that those of its images are not evenly
            spaced; None: they are. All pixel coordinates here are of the evenly spaced image;
            ``even`` leads there from a camera's image.
        max_radius: largest normalised radius at which the radial distortion is still one-to-one
            (inf when it always is). A point beyond it would fold back into the image: it is not
            visible, whatever ``project`` says.

    Raises:
        ValueError: naming the field that cannot be right, or a distortion that cannot be inverted
            over the image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Coefficients = (0.0, 0.0, 0.0, 0.0, 0.0)
    doubts: tuple[Nine, ...] = ()
    thinning: Thinning | None = None
    max_radius: float = field(init=False, repr=False, compare=False)
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = getattr(self, name)
            if not isinstance(size, int) or size < 1:
                raise ValueError(f"{name}: {size!r} is not a positive whole number of pixels")
        for name in ("fx", "fy"):
            focal = getattr(self, name)
            if not (math.isfinite(focal) and focal > 0.0):
                raise ValueError(f"{name}: {focal!r} is not a positive focal length in px")
        for name, size in (("cx", self.width), ("cy", self.height)):
            centre = getattr(self, name)
            if not (math.isfinite(centre) and 0.0 <= centre <= size):
                raise ValueError(
                    f"{name}: principal point {centre!r} is not inside the image (0..{size} px)"
                )
        coefficients = tuple(float(k) for k in self.distortion)
        if len(coefficients) != 5 or not all(math.isfinite(k) for k in coefficients):
            raise ValueError(
                f"distortion: {self.distortion!r} is not five finite numbers k1, k2, p1, p2, k3"
            )
        if not all(
            len(doubt) == 9 and all(math.isfinite(d) for d in doubt) for doubt in self.doubts
        ):
            raise ValueError(
                "doubts: each is nine finite numbers, of fx, fy, cx, cy, k1, k2, p1, p2, k3"
            )
        object.__setattr__(self, "distortion", coefficients)
        object.__setattr__(self, "max_radius", _one_to_one_radius(coefficients))
        lens = (
            self.width,
            self.height,
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            coefficients,
            self.doubts,
        )
        object.__setattr__(self, "_hash", hash(lens))
        self._check_invertible()

    def __hash__(self) -> int:
        return self._hash  # what is made of a camera is looked up by it several times a frame

    def _check_invertible(self) -> None:
        if not any(self.distortion):
            return
        right = self.width - 1.0
        bottom = self.height - 1.0
        border = [
            pixel
            for s in BORDER_SAMPLES
            for pixel in (
                (s * right, 0.0),
                (s * right, bottom),
                (0.0, s * bottom),
                (right, s * bottom),
            )
        ]
        for (u, v), (x, _) in zip(border, self.rays(np.array(border)).tolist(), strict=True):
            if not math.isfinite(x):
                raise ValueError(
                    f"distortion: {self.distortion!r} cannot be inverted at pixel ({u:.0f}, {v:.0f})"
                )

    @property
    def K(self) -> Array:
        """Intrinsic matrix, shape (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def even(self, points: Array) -> Array:
        """Places (n, 2) found between the pixels of this camera's images, where projected points
        are.
        """
        return points if self.thinning is None else self.thinning.even(points)

    def contains(self, u: float, v: float, margin_px: float = 0.0) -> bool:
        """Return whether a pixel lies at least ``margin_px`` inside the image (False for NaN)."""
        return (
            margin_px - 0.5 <= u < self.width - 0.5 - margin_px
            and margin_px - 0.5 <= v < self.height - 0.5 - margin_px
        )

    def sees(self, point_c: Point3, margin_px: float = 0.0) -> bool:
        """Return whether a point in the camera frame, in metres, projects into the image.

        It does not when it is not in front, or folded back by the distortion.
        """
        x, y, z = point_c
        if not z > 0.0 or x * x + y * y > (self.max_radius * z) ** 2:
            return False
        return self.contains(*self.project_point(point_c), margin_px)

    def project_point(self, point_c: Point3) -> tuple[float, float]:
        """Pixel of one point in the camera frame (eqs. d2_normalized, d2_projection); NaN at or
        behind the camera.
        """
        x, y, z = point_c
        if not z > 0.0:
            return math.nan, math.nan
        xd, yd = distort(x / z, y / z, self.distortion)
        return self.fx * xd + self.cx, self.fy * yd + self.cy

    def project(self, points_c: Array) -> Array:
        """Pixels, shape (n, 2), of points (n, 3) in the camera frame in metres; NaN rows at or
        behind the camera.
        """
        z = np.where(points_c[:, 2] > 0.0, points_c[:, 2], np.nan)
        xd, yd = distort(points_c[:, 0] / z, points_c[:, 1] / z, self.distortion)
        return np.stack((self.fx * xd + self.cx, self.fy * yd + self.cy), axis=1)

    def jacobian(self, points_c: Array) -> Array:
        """d(u, v)/d(X, Y, Z) in px/m, shape (n, 2, 3), at points (n, 3) with z > 0; NaN
        otherwise.
        """
        inverse_z = 1.0 / np.where(points_c[:, 2] > 0.0, points_c[:, 2], np.nan)
        x = points_c[:, 0] * inverse_z
        y = points_c[:, 1] * inverse_z
        xx, xy, yy = distort_jacobian(x, y, self.distortion)
        u_row = np.stack((xx, xy, -(x * xx + y * xy)), axis=1) * (self.fx * inverse_z)[:, None]
        v_row = np.stack((xy, yy, -(x * xy + y * yy)), axis=1) * (self.fy * inverse_z)[:, None]
        return np.stack((u_row, v_row), axis=1)

    def ray(self, u: float, v: float) -> tuple[float, float]:
        """Undistorted normalised coordinates of one pixel, by Newton's method to 1e-12; NaN where
        there are none.
        """
        lens_of, ray = _compiled()
        return ray(lens_of(self), float(u), float(v))

    def rays(self, pixels: Array) -> Array:
        """Undistorted normalised coordinates, shape (n, 2), of pixels (n, 2); as ``ray``, NaN rows
        included.
        """
        xd = (pixels[:, 0] - self.cx) / self.fx
        yd = (pixels[:, 1] - self.cy) / self.fy
        if not any(self.distortion):
            return np.stack((xd, yd), axis=1)
        x = xd.copy()
        y = yd.copy()
        step = np.full_like(x, np.inf)
        with np.errstate(all="ignore"):
            for _ in range(UNDISTORT_ITERATIONS):
                gx, gy = distort(x, y, self.distortion)
                xx, xy, yy = distort_jacobian(x, y, self.distortion)
                determinant = xx * yy - xy * xy
                dx = (yy * (gx - xd) - xy * (gy - yd)) / determinant
                dy = (xx * (gy - yd) - xy * (gx - xd)) / determinant
                x = x - dx
                y = y - dy
                step = np.abs(dx) + np.abs(dy)
                if not np.any(step >= UNDISTORT_STEP):
                    break
            bad = ~(step < UNDISTORT_STEP) | (np.hypot(x, y) > self.max_radius)
        x[bad] = np.nan
        y[bad] = np.nan
        return np.stack((x, y), axis=1)


@cache
def _compiled() -> tuple[
    Callable[[CameraModel], Array], Callable[[Array, float, float], tuple[float, float]]
]:
    """``lens_of`` and ``ray``: looked for once, for an import in ``CameraModel.ray`` takes as long
    as all of it.
    """
    from path.camera.kernels import lens_of, ray  # noqa: PLC0415 (numba: not for those who only read a rig)

    return lens_of, ray


def sensor_of(camera: CameraModel) -> CameraModel:
    """The part of a camera's sensor that its images are made of: the camera itself where it leaves
    out no pixels.
    """
    thin = camera.thinning
    if thin is None:
        return camera
    width, height = (
        int(thin.sensor_pixels(n, k)[-1]) + 1 for k, n in enumerate((camera.width, camera.height))
    )
    cx, cy = (thin.sensor_place(c, k) for k, c in enumerate((camera.cx, camera.cy)))
    finer = thin.of / thin.kept
    return CameraModel(
        width, height, finer * camera.fx, finer * camera.fy, cx, cy, camera.distortion
    )


def _one_to_one_radius(coefficients: Coefficients) -> float:
    """Smallest radius where r (1 + k1 r^2 + k2 r^4 + k3 r^6) stops growing, inf when nowhere."""
    k1, k2, _, _, k3 = coefficients
    # in 1/r^2, so that the leading coefficient is never small
    roots = np.roots([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3])
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 1e-9]
    return 1.0 / math.sqrt(max(real)) if real else math.inf
