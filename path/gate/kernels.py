"""A pair's boxes compared, compiled: one crossing each. ``path.gate.agreement`` says what it means.

``views`` is the array of ``numbers_of``: D1's lens, D2's, and ``T_v_c1``. A box is ``(x, y, w,
h)``; ``body`` is the span and height of the target in m, 0 where they are not stated. What there is
not is NaN.
"""

from __future__ import annotations

import math

import numpy as np

from path.arrays import Array
from path.camera.kernels import lens_of, project, ray
from path.camera.model import CameraModel
from path.compiled import as_it_is, inner, kernel
from path.geometry.rigid import Rigid, rigid_from_quat, transform, transform_back
from path.messages import Quat, Vec3
from path.target.cylinder import box_middle_v, middle_v, reach_m

Four = tuple[float, float, float, float]
Two = tuple[float, float]
Own = tuple[float, ...]
"""D1's sample of its target: box, point and depth with its standard deviation, gravity, oversize
(13 numbers).
"""
Judged = tuple[Four, float, Two, float, float, Vec3]
"""D2's box mapped, overlap, offset, overlap when placed by that, the target's depth for D2,
``sized``.
"""

LENS_2 = 16
MOUNT = 32
TINY_M = 1e-6

as_it_is(rigid_from_quat)


def numbers_of(camera1: CameraModel, camera2: CameraModel, T_v_c1: Rigid) -> Array:
    """The numbers that stay the same from pair to pair, as the kernels take it, shape (44,)."""
    return np.array([*lens_of(camera1), *lens_of(camera2), *T_v_c1], np.float64)


@inner
def _mount(views: Array) -> Rigid:
    m = views[MOUNT:]
    return m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10], m[11]


@inner
def _turned(rotation: Quat, position: Vec3) -> Rigid:
    """A transform from a quaternion that is nearly of unit length."""
    w, x, y, z = rotation
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0.0:
        norm = -norm
    return rigid_from_quat((w / norm, x / norm, y / norm, z / norm), position)


@as_it_is
def overlap(
    ax: float, ay: float, aw: float, ah: float, bx: float, by: float, bw: float, bh: float
) -> float:
    """Intersection over union of two boxes, 0..1; 0 when either is empty."""
    width = min(ax + aw, bx + bw) - max(ax, bx)
    height = min(ay + ah, by + bh) - max(ay, by)
    if not (width > 0.0 and height > 0.0):
        return 0.0
    common = width * height
    return min(1.0, common / (aw * ah + bw * bh - common))


@kernel
def mapped(views: Array, T_v_c2: Rigid, box2: Four, z1: float, z2: float, corner: float) -> Four:
    """Return D2's box in D1's image.

    ``corner`` is 1 where the box's corner is mapped, 0 for its centre.
    """
    lens1 = views[:LENS_2]
    lens2 = views[LENS_2:MOUNT]
    x, y, w, h = box2
    if corner == 0.0:
        x = x + w / 2.0
        y = y + h / 2.0
    ray_x, ray_y = ray(lens2, x, y)
    seen_v = transform(T_v_c2, (z2 * ray_x, z2 * ray_y, z2))
    x, y, z = transform_back(_mount(views), seen_v)
    if not z > 0.0:
        return math.nan, math.nan, math.nan, math.nan
    u, v = project(lens1, x, y, z)
    w = w * (lens1[0] / lens2[0]) * (z2 / z1)
    h = h * (lens1[1] / lens2[1]) * (z2 / z1)
    if corner > 0.0:
        return u, v, w, h
    return u - 0.5 * w, v - 0.5 * h, w, h


@kernel
def offset(
    views: Array,
    body: Two,
    T_v_c2: Rigid,
    box2: Four,
    center: Two,
    z1: float,
    point_v: Vec3,
    gravity_v: Vec3,
) -> Two:
    """Return how far D2's box is from where an object at a point has its own, m.

    In D1's image, at the point's depth.
    """
    span_m, height_m = body
    x, y, w, h = box2
    if not span_m > 0.0:
        z2 = transform_back(T_v_c2, point_v)[2]
        if not (z2 > 0.0 and z1 > 0.0):
            return math.nan, math.nan
        x, y, w, h = mapped(views, T_v_c2, box2, z1, z2, 0.0)
        return (x + w / 2.0 - center[0]) * z1 / views[0], (y + h / 2.0 - center[1]) * z1 / views[1]
    # the middle of the box against where it is of a body of that size with this point in D1's box's
    # middle
    T_v_c1 = _mount(views)
    middle = middle_v(T_v_c1, point_v, gravity_v, span_m, height_m)
    expected_v = box_middle_v(T_v_c2, middle, gravity_v, span_m, height_m)
    z2 = transform_back(T_v_c2, expected_v)[2]
    ray_x, ray_y = ray(views[LENS_2:MOUNT], x + w / 2.0, y + h / 2.0)
    x, y, z = transform_back(T_v_c1, transform(T_v_c2, (z2 * ray_x, z2 * ray_y, z2)))
    xe, ye, ze = transform_back(T_v_c1, expected_v)
    if not (z2 > 0.0 and z > 0.0 and ze > 0.0):  # also when the pixel has no ray
        return math.nan, math.nan
    return x * ze / z - xe, y * ze / z - ye


@inner
def _sized(
    fx: float,
    fy: float,
    body: Two,
    T_v_c: Rigid,
    w: float,
    h: float,
    z: float,
    point_v: Vec3,
    gravity_v: Vec3,
) -> Vec3:
    """Return a box's width and height in m, and how many times too large it is."""
    wide_m = max(TINY_M, w * z / fx)
    high_m = max(TINY_M, h * z / fy)
    if not body[0] > 0.0:
        return wide_m, high_m, math.nan
    most_wide_m, most_high_m = reach_m(T_v_c, point_v, gravity_v, body[0], body[1])
    return wide_m, high_m, max(wide_m / most_wide_m, high_m / most_high_m)


@kernel
def located(views: Array, u: float, v: float, z: float) -> tuple[Vec3, float]:
    """Return the point at a pixel of D1 at a depth, in the marker's frame, and its distance.

    NaN when the pixel has no ray.
    """
    x, y = ray(views[:LENS_2], u, v)
    x = z * x
    y = z * y
    return transform(_mount(views), (x, y, z)), math.sqrt(x * x + y * y + z * z)


@kernel
def sized(
    views: Array, body: Two, w: float, h: float, z: float, point_v: Vec3, gravity_v: Vec3
) -> Vec3:
    """Return the width and height in m of D1's box, and how many times too large it is."""
    return _sized(views[0], views[1], body, _mount(views), w, h, z, point_v, gravity_v)


@kernel
def judged(
    views: Array, body: Two, corner: float, own: Own, rotation: Quat, position: Vec3, box2: Four
) -> Judged:
    """All that is computed of a box of D2, and of D1's target at that instant."""
    u = own[0]
    v = own[1]
    w = own[2]
    h = own[3]
    point_v = (own[4], own[5], own[6])
    z1 = own[7]
    gravity_v = (own[9], own[10], own[11])
    T_v_c2 = _turned(rotation, position)
    z2 = transform_back(T_v_c2, point_v)[2]
    center = u + w / 2.0, v + h / 2.0
    off = offset(views, body, T_v_c2, box2, center, z1, point_v, gravity_v)
    box1 = math.nan, math.nan, math.nan, math.nan
    score = placed = math.nan
    sizes = math.nan, math.nan, math.nan
    if z2 > 0.0:
        box1 = mapped(views, T_v_c2, box2, z1, z2, corner)
        score = overlap(u, v, w, h, box1[0], box1[1], box1[2], box1[3])
        left = center[0] + off[0] * views[0] / z1 - 0.5 * box1[2]
        top = center[1] + off[1] * views[1] / z1 - 0.5 * box1[3]
        placed = overlap(u, v, w, h, left, top, box1[2], box1[3])
        sizes = _sized(
            views[LENS_2], views[LENS_2 + 1], body, T_v_c2, box2[2], box2[3], z2, point_v, gravity_v
        )
    return box1, score, off, placed, z2, sizes
