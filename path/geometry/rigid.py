"""Rigid transforms as twelve plain floats, for the few points of one cycle (numpy costs more than
the arithmetic).
"""

from __future__ import annotations

from path.geometry.rotation import conjugate, quat_from_entries
from path.geometry.transforms import Pose
from path.messages import Quat, Vec3

Rigid = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
"""``T_a_b`` as the rotation matrix row by row, then the translation in metres."""


def rigid(pose: Pose) -> Rigid:
    """The same transform as floats."""
    (a, b, c), (d, e, f), (g, h, i) = pose.R.tolist()
    x, y, z = pose.t.tolist()
    return a, b, c, d, e, f, g, h, i, x, y, z


def rigid_from_quat(q: Quat, t: Vec3) -> Rigid:
    """The transform of a unit quaternion ``q_a_b`` and the origin of ``b`` in ``a``."""
    w, x, y, z = q
    a, b, c = t
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
        a,
        b,
        c,
    )


def inverse_as_quat(T_a_b: Rigid) -> tuple[Quat, Vec3]:
    """The opposite transform as quaternion ``q_b_a`` and the origin of ``a`` in ``b``, in
    metres.
    """
    return conjugate(quat_from_entries(T_a_b[:9])), transform_back(T_a_b, (0.0, 0.0, 0.0))


def transform(T_a_b: Rigid, point_b: Vec3) -> Vec3:
    """``p_a = T_a_b p_b``."""
    a, b, c, d, e, f, g, h, i, tx, ty, tz = T_a_b
    x, y, z = point_b
    return a * x + b * y + c * z + tx, d * x + e * y + f * z + ty, g * x + h * y + i * z + tz


def transform_back(T_a_b: Rigid, point_a: Vec3) -> Vec3:
    """``p_b = T_a_b^-1 p_a``."""
    a, b, c, d, e, f, g, h, i, tx, ty, tz = T_a_b
    x = point_a[0] - tx
    y = point_a[1] - ty
    z = point_a[2] - tz
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z
