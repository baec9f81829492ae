"""Set-up of flat primitives for one image: from a body's rectangles to functions linear in the
pixel's ray.

With M = [E1 E2 P0] in the camera frame and A = M^-1, a ray (x, y, 1) meets the plane where A (x, y,
1) = (u, v, 1)/z. So u/z, v/z and 1/z are linear in the ray, and so is every edge: inside is u/z >=
  0, (1-u)/z >= 0, and so on. Depth and
texture coordinates are exact, nothing needs clipping, and the lens distortion is only in the rays.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import numpy as np

from hil.render.scene import MARKER, PATTERN, PRINT, ROTOR
from path.compiled import inner, kernel

# Columns of a primitive. Edges are scaled so that a pixel whose centre has every edge >= 1 lies
# inside as a whole, and one with an edge < -1 lies outside as a whole.
EDGES = 0  # 4 x 3 coefficients
INVERSE_Z = 12  # 3 coefficients of 1/z in 1/m
OVER_U = 15  # 3 coefficients of u/z
OVER_V = 18
COLOR = 21  # BGR after shading, 0..255
LIGHT = 24  # shading factor
BLADE_COS = 25  # rotor: direction of its blades in the disc
BLADE_SIN = 26
SPIN = 27  # rotor: 1 turning (translucent disc), 0 at rest (two blades)
CENTER_Z = 28  # of the middle of the rectangle, m
# rotor: z over the radius of a pixel's disc, so that a step becomes a ramp of one pixel
SHARPNESS = 29
SECOND = 30  # pattern or print: its other colour, BGR after shading
COLUMNS = 33

# Columns of the integers of a primitive.
KIND = 0
CELLS = 1  # MARKER: index of its cells
# half-open bounds in pixels
ROW_0 = 2
ROW_1 = 3
COLUMN_0 = 4
COLUMN_1 = 5
VEHICLE = 6  # 1: part of what is tracked
SHADES = 7  # PATTERN, PRINT: index of its table
TAGS = 8

HALF_DIAGONAL_PX = 0.7072  # of a pixel, rounded up
NEAR_M = 1e-3
AMBIENT = 0.58
DIFFUSE = 0.42


@inner
def first_at_least(values, threshold):
    """First index of a rising array whose value is >= threshold; its length when there is none."""
    low = 0
    high = values.size
    while low < high:
        middle = (low + high) // 2
        if values[middle] >= threshold:
            high = middle
        else:
            low = middle + 1
    return low


@inner
def _turned(R, vectors, i, first):
    """R times the three columns from ``first`` of row i, as a tuple (compiles faster than an
    array).
    """
    x = vectors[i, first]
    y = vectors[i, first + 1]
    z = vectors[i, first + 2]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@inner
def _cross(a, b, divisor):
    return (
        (a[1] * b[2] - a[2] * b[1]) / divisor,
        (a[2] * b[0] - a[0] * b[2]) / divisor,
        (a[0] * b[1] - a[1] * b[0]) / divisor,
    )


@inner
def _bounds(p0, e1, e2, column_x, row_y, pixel, tag):
    """Rows and columns the rectangle can touch; False when it is out of sight.

    ``column_x`` (2, w) and ``row_y`` (2, h): smallest and largest ray coordinate of each column and
    row.
    """
    x_low = np.inf
    x_high = -np.inf
    y_low = np.inf
    y_high = -np.inf
    behind = 0
    for corner in range(4):
        a = corner & 1
        b = corner >> 1
        z = p0[2] + a * e1[2] + b * e2[2]
        if z < NEAR_M:
            behind += 1
            continue
        x = (p0[0] + a * e1[0] + b * e2[0]) / z
        y = (p0[1] + a * e1[1] + b * e2[1]) / z
        x_low = min(x_low, x)
        x_high = max(x_high, x)
        y_low = min(y_low, y)
        y_high = max(y_high, y)
    if behind == 4:
        return False
    if behind > 0:  # reaches past the camera: its projection is not bounded by its corners
        tag[ROW_0], tag[ROW_1], tag[COLUMN_0], tag[COLUMN_1] = (
            0,
            row_y.shape[1],
            0,
            column_x.shape[1],
        )
        return True
    tag[ROW_0] = first_at_least(row_y[1], y_low - pixel)
    tag[ROW_1] = first_at_least(row_y[0], y_high + pixel)
    tag[COLUMN_0] = first_at_least(column_x[1], x_low - pixel)
    tag[COLUMN_1] = first_at_least(column_x[0], x_high + pixel)
    return tag[ROW_0] < tag[ROW_1] and tag[COLUMN_0] < tag[COLUMN_1]


@inner
def _fill(p0, e1, e2, determinant, pixel, primitive):
    """Write the linear functions of one rectangle. ``determinant`` = P0 . (E1 x E2)."""
    over_u = _cross(e2, p0, determinant)
    over_v = _cross(p0, e1, determinant)
    inverse_z = _cross(e1, e2, determinant)
    for k in range(3):
        primitive[OVER_U + k], primitive[OVER_V + k], primitive[INVERSE_Z + k] = (
            over_u[k],
            over_v[k],
            inverse_z[k],
        )
    for edge in range(4):
        along = over_u if edge < 2 else over_v
        first = EDGES + 3 * edge
        for k in range(3):
            primitive[first + k] = along[k] if edge % 2 == 0 else inverse_z[k] - along[k]
        slope = np.hypot(primitive[first], primitive[first + 1])
        scale = 1.0 / max(slope * pixel * HALF_DIAGONAL_PX, 1e-12)
        for k in range(3):
            primitive[first + k] *= scale


@inner
def _swept(point, sweep):
    """The place of a point (camera frame) when the row that shows it is read. sweep: as in
    ``add_body``.
    """
    x, y, z = point
    for _ in range(2):  # its row is where it is by then
        down = y / max(z, NEAR_M)
        radius2 = (x * x + y * y) / max(z * z, NEAR_M * NEAR_M)
        late = sweep[6] + sweep[7] * down * (1.0 + radius2 * (sweep[9] + radius2 * sweep[10]))
        late = min(max(late, -sweep[8]), sweep[8])
        x = point[0] + late * (sweep[0] + sweep[4] * point[2] - sweep[5] * point[1])
        y = point[1] + late * (sweep[1] + sweep[5] * point[0] - sweep[3] * point[2])
        z = point[2] + late * (sweep[2] + sweep[3] * point[1] - sweep[4] * point[0])
    return x, y, z


@inner
def _apart(a, b):
    return (b[0] - a[0], b[1] - a[1], b[2] - a[2])


@inner
def _sum(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel
def add_body(
    corners, looks, first_table, R, t, sun_c, motion, sweep, vehicle, view, primitives, tags, count
):
    """Append the rectangles of one body that may be seen; returns the new count.

    corners (n, 9), looks (colors (n, 3), seconds (n, 3), kinds (n,)): as in ``scene.Model``.
    first_table: index of the first table of shades of this body. R (3, 3), t (3,): T_c_body. sun_c
    (3,): towards the sun. motion (3,): cosine and sine of the blades' angle, and 1 when they turn.
    sweep (11,): velocity and rates of the body's points in the camera frame, and when what lies in
    a direction is read: s from the frame's instant, s for each of y / z, at most so far from it,
    and the lens's k1 and k2. Each rectangle's corners are where they are then. vehicle: 1 for what
    is tracked. view: ``column_x`` (2, w), ``row_y`` (2, h), and the largest size of a pixel on the
    plane z = 1.
    """
    column_x, row_y, pixel = view
    colors, seconds, kinds = looks
    markers = 0
    tables = 0
    for i in range(kinds.size):
        kind = kinds[i]
        if kind == MARKER:
            markers += 1
        elif kind in (PATTERN, PRINT):
            tables += 1
        p0 = _turned(R, corners, i, 0)
        p0 = (p0[0] + t[0], p0[1] + t[1], p0[2] + t[2])
        e1 = _turned(R, corners, i, 3)
        e2 = _turned(R, corners, i, 6)
        if sweep[8] > 0.0:
            right = _swept(_sum(p0, e1), sweep)
            below = _swept(_sum(p0, e2), sweep)
            p0 = _swept(p0, sweep)
            e1 = _apart(p0, right)
            e2 = _apart(p0, below)
        normal = _cross(e1, e2, 1.0)  # away from the viewer
        determinant = p0[0] * normal[0] + p0[1] * normal[1] + p0[2] * normal[2]
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        if determinant <= 1e-9 * length and (kind != ROTOR or determinant >= -1e-9 * length):
            continue
        if not _bounds(p0, e1, e2, column_x, row_y, pixel, tags[count]):
            continue
        facing = -(normal[0] * sun_c[0] + normal[1] * sun_c[1] + normal[2] * sun_c[2]) / length
        light = AMBIENT + DIFFUSE * max(0.0, facing) if kind != ROTOR else 1.0
        primitive = primitives[count]
        _fill(p0, e1, e2, determinant, pixel, primitive)
        for k in range(3):
            primitive[COLOR + k] = min(255.0, colors[i, k] * light)
            primitive[SECOND + k] = min(255.0, seconds[i, k] * light)
        primitive[LIGHT] = light
        slope = np.hypot(primitive[OVER_U], primitive[OVER_U + 1]) + np.hypot(
            primitive[OVER_V], primitive[OVER_V + 1]
        )
        primitive[SHARPNESS] = 1.0 / max(slope * pixel, 1e-9)
        primitive[CENTER_Z] = p0[2] + 0.5 * (e1[2] + e2[2])
        primitive[BLADE_COS], primitive[BLADE_SIN], primitive[SPIN] = (
            motion[0],
            motion[1],
            motion[2],
        )
        tags[count, KIND] = kind
        tags[count, CELLS] = markers - 1 if kind == MARKER else 0
        tags[count, VEHICLE] = vehicle
        tags[count, SHADES] = first_table + tables - 1
        count += 1
    return count
