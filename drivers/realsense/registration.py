"""Depth as the colour camera sees it, by the colour camera's own calibration.

librealsense's ``align`` leaves out the distortion of the colour camera (its Brown-Conrady models
are not honoured), which is some pixels towards the corners. So every depth pixel is projected here,
as a square as large as its neighbours are apart, and the nearest one wins.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import numpy as np

from path.arrays import Array, Depths, Singles
from path.camera.model import CameraModel
from path.compiled import inner, kernel
from path.geometry.transforms import Pose

NOTHING = 65535  # while the nearest is sought; 0 when done
F = np.float32
INT = np.int32
ZERO = F(0.0)
HALF = F(0.5)
ONE = F(1.0)
TWO = F(2.0)
# of neighbouring squares: depth noise moves them apart, and would leave gaps between them
OVERLAP_PX = 0.1
MAX_HALF_PX = 1.0  # so that a square covers at most two pixels each way
NEAREST_MM = F(10.0)
LARGEST = F(NOTHING)


class DepthRegistration:
    """Projects depth images of one camera into another. Keeps scratch buffers: use it from one
    thread at a time.
    """

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
            ValueError: depth that is not rectified, far coarser than colour, or of what the colour
                camera does not see.
        """
        if any(depth.distortion):
            raise ValueError(
                f"distortion of the depth stream: {depth.distortion!r}; only rectified depth can be registered"
            )
        # The ray of a depth pixel, turned into the colour camera's frame, is linear in column and
        # row.
        linear = T_color_depth.R @ np.linalg.inv(depth.K)
        columns, rows = np.meshgrid(
            np.arange(depth.width, dtype=float), np.arange(depth.height, dtype=float)
        )
        rays = np.stack((columns, rows, np.ones_like(columns)), axis=2) @ linear.T
        if rays[..., 2].min() < 0.1:
            raise ValueError("depth and colour camera look in different directions")
        self._color, self._linear = color, linear.astype(np.float32)
        self._t_mm = (T_color_depth.t * 1000.0).astype(np.float32)
        self._unit_mm = F(unit_m * 1000.0)
        self._limits_mm = F(limits_m[0] * 1000.0), F(limits_m[1] * 1000.0)
        self._lens = np.array(
            [color.fx, color.fy, color.cx, color.cy, *color.distortion], np.float32
        )
        self._max_r2 = F(min(color.max_radius, 1e3) ** 2)
        self._half = _half_px(depth, color, rays)
        self._columns = np.arange(depth.width, dtype=np.float32)
        self._cells = np.empty((4, depth.width), np.int32)

    def register(self, depth: Depths) -> Depths:
        """Depth of the colour image's pixels, z along the colour camera's axis in mm, 0 where there
        is none.

        Args:
            depth: (h, w) uint16 of the depth camera, in its own units, 0 = none.
        """
        out = np.empty((self._color.height, self._color.width), np.uint16)
        cells = self._cells
        limits = self._limits_mm
        lens = self._lens
        linear = self._linear
        t_mm = self._t_mm
        unit_mm = self._unit_mm
        _register(
            depth,
            linear,
            self._columns,
            t_mm,
            unit_mm,
            *limits,
            lens,
            self._max_r2,
            self._half,
            cells,
            out,
        )
        return out


def _half_px(depth: CameraModel, color: CameraModel, rays: Array) -> Singles:
    """Half the side of a depth pixel in the colour image, where it is largest there (parallax
    aside).
    """
    pixels = color.project(rays.reshape(-1, 3)).reshape(depth.height, depth.width, 2)
    seen = (
        (pixels > -1.0).all(axis=2)
        & (pixels[..., 0] < color.width)
        & (pixels[..., 1] < color.height)
    )
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


@inner
def _place(measured, linear, columns, r, t_mm, unit_mm, near, far, lens, max_r2, half, size, cells):
    """Compute where a row of depth pixels lies in the colour image.

    A loop without branches, so that it vectorises. ``cells``, int32 (4, w): number of the first
    pixel, whether there is a second one to its right, and one below, z in mm. z is NOTHING where
    there is no depth or it is not in the image.
    """
    fx = lens[0]
    fy = lens[1]
    cx = lens[2]
    cy = lens[3]
    k1 = lens[4]
    k2 = lens[5]
    p1 = lens[6]
    p2 = lens[7]
    k3 = lens[8]
    tx = t_mm[0]
    ty = t_mm[1]
    tz = t_mm[2]
    half_u = half[0]
    half_v = half[1]
    last_u = F(size[1] - 1)
    last_v = F(size[0] - 1)
    width = F(size[1])
    x1 = linear[0, 0]
    y1 = linear[1, 0]
    z1 = linear[2, 0]
    x0 = linear[0, 1] * F(r) + linear[0, 2]
    y0 = linear[1, 1] * F(r) + linear[1, 2]
    z0 = linear[2, 1] * F(r) + linear[2, 2]
    first = cells[0]
    wide = cells[1]
    high = cells[2]
    depth = cells[3]
    for c in range(measured.size):
        d = F(measured[c]) * unit_mm
        column = columns[c]
        z = d * (z0 + z1 * column) + tz
        over = ONE / max(z, NEAREST_MM)
        x = (d * (x0 + x1 * column) + tx) * over
        y = (d * (y0 + y1 * column) + ty) * over
        r2 = x * x + y * y
        radial = ONE + r2 * (k1 + r2 * (k2 + r2 * k3))
        xy2 = TWO * x * y
        u = fx * (x * radial + p1 * xy2 + p2 * (r2 + TWO * x * x)) + cx
        v = fy * (y * radial + p1 * (r2 + TWO * y * y) + p2 * xy2) + cy
        left = np.ceil(max(u - half_u, ZERO))
        right = np.floor(min(u + half_u, last_u))
        top = np.ceil(max(v - half_v, ZERO))
        bottom = np.floor(min(v + half_v, last_v))
        inside = (left <= right) & (top <= bottom) & (r2 <= max_r2)
        believed = (
            inside & (d >= near) & (d <= far) & (d > ZERO) & (z >= NEAREST_MM) & (z < LARGEST)
        )
        first[c] = INT(top * width + left)  # exact: below 2^24
        wide[c] = INT(right - left)
        high[c] = INT(bottom - top)
        depth[c] = INT(z + HALF) if believed else INT(NOTHING)


@kernel
def _register(depth, linear, columns, t_mm, unit_mm, near, far, lens, max_r2, half, cells, out):
    """Fill ``out``: the nearest of what falls on a pixel, 0 where nothing does."""
    out[:] = NOTHING
    flat = out.reshape(-1)
    width = np.uint32(out.shape[1])
    for r in range(depth.shape[0]):
        _place(
            depth[r],
            linear,
            columns,
            r,
            t_mm,
            unit_mm,
            near,
            far,
            lens,
            max_r2,
            half,
            out.shape,
            cells,
        )
        for c in range(depth.shape[1]):
            # unsigned: no look whether it counts from the end
            z = np.uint16(cells[3, c])
            n = np.uint32(cells[0, c])
            if z == NOTHING:
                continue
            flat[n] = min(flat[n], z)
            if cells[1, c]:
                flat[n + np.uint32(1)] = min(flat[n + np.uint32(1)], z)
            if cells[2, c]:
                n += width
                flat[n] = min(flat[n], z)
                if cells[1, c]:
                    flat[n + np.uint32(1)] = min(flat[n + np.uint32(1)], z)
    for i in range(out.shape[0]):
        row = out[i]
        for j in range(row.size):
            row[j] = row[j] if row[j] != NOTHING else np.uint16(0)


def warm_up() -> None:
    """Compile the kernel or load it compiled: some seconds the first time on a machine."""
    small = CameraModel(8, 6, 8.0, 8.0, 3.5, 2.5)
    registration = DepthRegistration(small, small, Pose(np.eye(3), np.zeros(3)), 0.001, (0.1, 10.0))
    registration.register(np.full((6, 8), 1000, np.uint16))
