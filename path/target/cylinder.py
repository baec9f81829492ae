"""The upright cylinder that a target fits into, as a camera sees it: how far it reaches, and where
its box's middle is.

A box's middle is not the middle of what is in it. What is nearer to the camera looms larger: the
box of a person seen from above has its middle above theirs. And the depth that is measured there is
of the side that faces the camera. Two cameras that look from different sides so mean different
places by the middles of their boxes of the same object: people 0.1 m, a car 0.02 m. Both are known
from the cylinder, whichever way the target heads.
"""

from __future__ import annotations

import math

from path.compiled import as_it_is
from path.geometry.rigid import Rigid, transform, transform_back
from path.messages import Vec3

BEHIND_SHARE = 0.25
"""Of the cylinder's diameter: from its side to its axis it is half, a body that is narrower one way
has less there.
"""
_LEAST = 1e-6
AT_THE_CAMERA: Rigid = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

as_it_is(transform)
as_it_is(transform_back)


@as_it_is
def reach_m(
    T_v_c: Rigid, point_v: Vec3, gravity_v: Vec3, span_m: float, height_m: float
) -> tuple[float, float]:
    """Return the width and height in m that an upright cylinder fills at a point's depth.

    To first order in its size over its distance.

    Args:
        gravity_v: unit vector.
    """
    x, y, z = transform_back(T_v_c, point_v)
    gx, gy, gz = _turned_back(T_v_c, gravity_v)
    return _reach_along(gx, gz, x / z, span_m, height_m), _reach_along(
        gy, gz, y / z, span_m, height_m
    )


@as_it_is
def middle_v(
    T_v_c: Rigid, surface_v: Vec3, gravity_v: Vec3, span_m: float, height_m: float
) -> Vec3:
    """The middle of a target, from the point of its surface in the middle of its box."""
    rx = surface_v[0] - T_v_c[9]
    ry = surface_v[1] - T_v_c[10]
    rz = surface_v[2] - T_v_c[11]
    distance = max(_LEAST, math.sqrt(rx * rx + ry * ry + rz * rz))
    falling = (rx * gravity_v[0] + ry * gravity_v[1] + rz * gravity_v[2]) / distance
    level = math.sqrt(max(0.0, 1.0 - falling * falling))
    by_side = BEHIND_SHARE * span_m / max(_LEAST, level)
    by_top = 0.5 * height_m / max(_LEAST, abs(falling))
    further = behind_m(falling, span_m, height_m) / distance
    on_ray = surface_v[0] + further * rx, surface_v[1] + further * ry, surface_v[2] + further * rz
    across = _moved(T_v_c, on_ray, gravity_v, span_m, height_m, -1.0)
    if by_top <= by_side:
        return across
    # that point is on the axis, and so is the middle
    gx, gy, gz = gravity_v
    along = (
        (across[0] - on_ray[0]) * gx + (across[1] - on_ray[1]) * gy + (across[2] - on_ray[2]) * gz
    )
    along /= level * level
    return on_ray[0] + along * gx, on_ray[1] + along * gy, on_ray[2] + along * gz


@as_it_is
def behind_m(falling: float, span_m: float, height_m: float) -> float:
    """Return how far behind the surface, along a line of sight, a target's middle is.

    Args:
        falling: by how much that line comes down for each metre of it.
    """
    level = math.sqrt(max(0.0, 1.0 - falling * falling))
    return min(
        BEHIND_SHARE * span_m / max(_LEAST, level), 0.5 * height_m / max(_LEAST, abs(falling))
    )


def off_middle(point_c: Vec3, gravity_c: Vec3, span_m: float, height_m: float) -> Vec3:
    """Return from a target's middle to the point at its depth in the middle of its box.

    In the camera's frame.
    """
    middle_c = _moved(AT_THE_CAMERA, point_c, gravity_c, span_m, height_m, -1.0)
    x, y, z = (p - m for p, m in zip(point_c, middle_c, strict=True))
    return x, y, z


@as_it_is
def box_middle_v(
    T_v_c: Rigid, middle: Vec3, gravity_v: Vec3, span_m: float, height_m: float
) -> Vec3:
    """The point at the depth of a target's middle that is in the middle of its box."""
    return _moved(T_v_c, middle, gravity_v, span_m, height_m, 1.0)


@as_it_is
def _moved(
    T_v_c: Rigid, point_v: Vec3, gravity_v: Vec3, span_m: float, height_m: float, way: float
) -> Vec3:
    """Return a point moved across the line of sight by what a box's middle is off there."""
    x, y, z = transform_back(T_v_c, point_v)
    gx, gy, gz = _turned_back(T_v_c, gravity_v)
    if not z > 0.5 * (span_m + height_m):  # inside it, or behind the camera
        return point_v
    off_x = way * (z * _box_middle(gx, gz, x, z, span_m, height_m) - x)
    off_y = way * (z * _box_middle(gy, gz, y, z, span_m, height_m) - y)
    return transform(T_v_c, (x + off_x, y + off_y, z))


@as_it_is
def _turned_back(T_v_c: Rigid, way_v: Vec3) -> Vec3:
    """A direction in the camera's frame."""
    a, b, c, d, e, f, g, h, i, _, _, _ = T_v_c
    x, y, z = way_v
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


@as_it_is
def _upright_and_level(g_side: float, g_ahead: float, tangent: float) -> tuple[float, float]:
    """The parts of a step to one side of an image that are along gravity and across it.

    Of a body off to that side, a step ahead is one back to the middle: what counts is the way along
    (1, -tangent).
    """
    upright = g_side - tangent * g_ahead
    return upright, math.sqrt(max(0.0, 1.0 + tangent * tangent - upright * upright))


@as_it_is
def _reach_along(
    g_side: float, g_ahead: float, tangent: float, span_m: float, height_m: float
) -> float:
    upright, level = _upright_and_level(g_side, g_ahead, tangent)
    return height_m * abs(upright) + span_m * level


@as_it_is
def _box_middle(
    g_side: float, g_ahead: float, side: float, ahead: float, span_m: float, height_m: float
) -> float:
    """Return the tangent of the middle between the outermost points of the rims.

    The near and the far point of either rim.
    """
    tangent = side / ahead
    upright, level = _upright_and_level(g_side, g_ahead, tangent)
    half = 0.5 * span_m / max(_LEAST, level)
    out_side = half * (1.0 - upright * g_side)
    out_ahead = half * (-tangent - upright * g_ahead)
    down_side = 0.5 * height_m * g_side
    down_ahead = 0.5 * height_m * g_ahead
    a = (side + down_side + out_side) / (ahead + down_ahead + out_ahead)
    b = (side + down_side - out_side) / (ahead + down_ahead - out_ahead)
    c = (side - down_side + out_side) / (ahead - down_ahead + out_ahead)
    d = (side - down_side - out_side) / (ahead - down_ahead - out_ahead)
    return 0.5 * (max(a, b, c, d) + min(a, b, c, d))
