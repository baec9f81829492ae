"""Depth as the colour camera sees it, by the colour camera's own calibration.

librealsense's ``align`` leaves out the distortion of the colour camera (its Brown-Conrady models are not honoured),
which is some pixels towards the corners. So every depth pixel is projected here, as a square as large as its neighbours
are apart, and the nearest one wins.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from path.camera import CameraModel
from path.geometry import Pose

F, INT = np.float32, np.int32
ZERO, HALF, ONE, TWO = F(0.0), F(0.5), F(1.0), F(2.0)
NOTHING = 65535  # while the nearest is sought; 0 when done
OVERLAP_PX = 0.1  # of neighbouring squares: depth noise moves them apart, and would leave gaps between them
MAX_HALF_PX = 1.0  # so that a square covers at most two pixels each way
NEAREST_MM = F(10.0)


class DepthRegistration:
    """Projects depth images of one camera into another. Keeps scratch buffers: use it from one thread at a time."""

    def __init__(
        self,
        depth: CameraModel,
        color: CameraModel,
        T_color_depth: Pose,
        unit_m: float,
        limits_m: tuple[float, float],
    ) -> None:
        """
        Args:
            T_color_depth: maps points of the depth camera to the colour camera.
            unit_m: metres of one step of the depth image.
            limits_m: nearest and farthest depth that is believed, along the depth camera's axis.

        Raises:
            ValueError: the depth camera has pixels without a ray, or sees nothing of what the colour camera sees.
        """
        self._color = color
        columns, rows = np.meshgrid(np.arange(depth.width, dtype=float), np.arange(depth.height, dtype=float))
        rays = depth.rays(np.stack((columns.ravel(), rows.ravel()), axis=1))
        if not np.isfinite(rays).all():
            raise ValueError(f"distortion: {depth.distortion!r} leaves depth pixels without a ray")
        turned = np.column_stack((rays, np.ones(len(rays)))) @ T_color_depth.R.T
        if turned[:, 2].min() < 0.1:
            raise ValueError("depth and colour camera look in different directions")
        self._rays = np.ascontiguousarray(turned.T.reshape(3, depth.height, depth.width), np.float32)
        self._t_mm = (T_color_depth.t * 1000.0).astype(np.float32)
        self._unit_mm = F(unit_m * 1000.0)
        self._limits_mm = F(limits_m[0] * 1000.0), F(limits_m[1] * 1000.0)
        self._lens = np.array([color.fx, color.fy, color.cx, color.cy, *color.distortion], np.float32)
        self._max_r2 = F(min(color.max_radius, 1e3) ** 2)
        self._half = _half_px(depth, color, turned.reshape(depth.height, depth.width, 3))
        self._cells = np.empty((5, depth.width), np.int32)

    def register(self, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Depth of the colour image's pixels, z along the colour camera's axis in mm, 0 where there is none.

        Args:
            depth: (h, w) uint16 of the depth camera, in its own units, 0 = none.
        """
        out = np.empty((self._color.height, self._color.width), np.uint16)
        cells, limits = self._cells, self._limits_mm
        lens, rays, t_mm, unit_mm = self._lens, self._rays, self._t_mm, self._unit_mm
        _register(depth, rays, t_mm, unit_mm, *limits, lens, self._max_r2, self._half, cells, out)
        return out


def _half_px(depth: CameraModel, color: CameraModel, rays: NDArray[np.float64]) -> NDArray[np.float32]:
    """Half the side of a depth pixel in the colour image, where it is largest there (parallax aside)."""
    pixels = color.project(rays.reshape(-1, 3)).reshape(depth.height, depth.width, 2)
    seen = (pixels > -1.0).all(axis=2) & (pixels[..., 0] < color.width) & (pixels[..., 1] < color.height)
    seen &= np.hypot(rays[..., 0], rays[..., 1]) <= color.max_radius * rays[..., 2]
    across = np.abs(np.diff(pixels[..., 0], axis=1))[seen[:, 1:] & seen[:, :-1]]
    down = np.abs(np.diff(pixels[..., 1], axis=0))[seen[1:] & seen[:-1]]
    if not across.size or not down.size:
        raise ValueError("depth and colour camera look in different directions")
    halves = [0.5 * float(steps.max()) + OVERLAP_PX for steps in (across, down)]
    if not max(halves) < MAX_HALF_PX:
        raise ValueError(
            f"a depth pixel is as large as {max(halves) * 2:.1f} px of colour: choose a finer depth stream"
        )
    return np.array(halves, np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _place(measured, rays, r, t_mm, unit_mm, near, far, lens, max_r2, half, size, cells):
    """Where a row of depth pixels lies in the colour image: ``cells`` int32 (5, w): left, right, top, bottom, z in mm.

    A loop without branches, so that it vectorises. z is NOTHING where there is no depth or it is not in the image.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    tx, ty, tz, half_u, half_v = t_mm[0], t_mm[1], t_mm[2], half[0], half[1]
    last_u, last_v = F(size[1] - 1), F(size[0] - 1)
    ray_x, ray_y, ray_z = rays[0, r], rays[1, r], rays[2, r]
    left, right, top, bottom, depth = cells[0], cells[1], cells[2], cells[3], cells[4]
    for c in range(measured.size):
        d = F(measured[c]) * unit_mm
        z = d * ray_z[c] + tz
        over = ONE / max(z, NEAREST_MM)
        x, y = (d * ray_x[c] + tx) * over, (d * ray_y[c] + ty) * over
        r2 = x * x + y * y
        radial = ONE + r2 * (k1 + r2 * (k2 + r2 * k3))
        xy2 = TWO * x * y
        u = fx * (x * radial + p1 * xy2 + p2 * (r2 + TWO * x * x)) + cx
        v = fy * (y * radial + p1 * (r2 + TWO * y * y) + p2 * xy2) + cy
        left[c] = INT(np.ceil(max(min(u, last_u + TWO) - half_u, ZERO)))
        right[c] = INT(np.floor(min(max(u, -TWO) + half_u, last_u)))
        top[c] = INT(np.ceil(max(min(v, last_v + TWO) - half_v, ZERO)))
        bottom[c] = INT(np.floor(min(max(v, -TWO) + half_v, last_v)))
        believed = (d >= near) & (d <= far) & (d > ZERO) & (z >= NEAREST_MM) & (z < NOTHING) & (r2 <= max_r2)
        depth[c] = INT(z + HALF) if believed else NOTHING


@njit(cache=True, nogil=True, error_model="numpy")
def _register(depth, rays, t_mm, unit_mm, near, far, lens, max_r2, half, cells, out):
    """Fill ``out``: the nearest of what falls on a pixel, 0 where nothing does."""
    out[:] = NOTHING
    for r in range(depth.shape[0]):
        _place(depth[r], rays, r, t_mm, unit_mm, near, far, lens, max_r2, half, out.shape, cells)
        for c in range(depth.shape[1]):
            left, right, top, bottom, z = cells[0, c], cells[1, c], cells[2, c], cells[3, c], np.uint16(cells[4, c])
            if z == NOTHING or right < left or bottom < top:
                continue
            # Unsigned: without a look whether an index counts from the end.
            first, last, begin, end = np.uint32(top), np.uint32(bottom), np.uint32(left), np.uint32(right)
            out[first, begin] = min(out[first, begin], z)
            if begin != end:
                out[first, end] = min(out[first, end], z)
            if first != last:
                out[last, begin] = min(out[last, begin], z)
                out[last, end] = min(out[last, end], z)
    for i in range(out.shape[0]):
        row = out[i]
        for j in range(row.size):
            row[j] = row[j] if row[j] != NOTHING else np.uint16(0)


def warm_up() -> None:
    """Compile the kernel or load it compiled: some seconds the first time on a machine."""
    small = CameraModel(8, 6, 8.0, 8.0, 3.5, 2.5)
    registration = DepthRegistration(small, small, Pose(np.eye(3), np.zeros(3)), 0.001, (0.1, 10.0))
    registration.register(np.full((6, 8), 1000, np.uint16))
