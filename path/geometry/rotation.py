"""Rotations: quaternions ``wxyz``, rotation vectors, roll-pitch-yaw. Quaternion and yaw helpers
work on plain floats.

``q_a_b`` and ``R_a_b`` turn coordinates in ``b`` into coordinates in ``a``, as
``path.geometry.transforms.Pose`` does.
"""

from __future__ import annotations

import math

import numpy as np

from path.geometry.transforms import Matrix, Pose, Vector
from path.messages import Quat, Vec3

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


def normalized(q: Quat) -> Quat:
    """Unit quaternion with w >= 0. Raises ValueError when ``q`` is zero or not finite."""
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not (math.isfinite(norm) and norm > 1e-12):
        raise ValueError(f"quaternion {q!r} has no direction")
    if w < 0.0:
        norm = -norm
    return w / norm, x / norm, y / norm, z / norm


def multiply(a: Quat, b: Quat) -> Quat:
    """Hamilton product: ``q_a_c = multiply(q_a_b, q_b_c)``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Quat) -> Quat:
    """The opposite rotation of a unit quaternion."""
    w, x, y, z = q
    return w, -x, -y, -z


def rotate(q: Quat, point: Vec3) -> Vec3:
    """Turn a vector by a unit quaternion: ``p_a = rotate(q_a_b, p_b)``."""
    w, a, b, c = q
    x, y, z = point
    u = 2.0 * (b * z - c * y)
    v = 2.0 * (c * x - a * z)
    s = 2.0 * (a * y - b * x)
    return x + w * u + (b * s - c * v), y + w * v + (c * u - a * s), z + w * s + (a * v - b * u)


def slerp(
    a: Quat,
    b: Quat,
    fraction: float,
) -> Quat:
    """Unit quaternion on the shorter arc from ``a`` (fraction 0) to ``b`` (fraction 1)."""
    dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    sign = -1.0 if dot < 0.0 else 1.0
    dot = abs(dot)
    if dot > 0.9995:
        wa = 1.0 - fraction
        wb = sign * fraction
    else:
        angle = math.acos(dot)
        wa = math.sin((1.0 - fraction) * angle) / math.sin(angle)
        wb = sign * math.sin(fraction * angle) / math.sin(angle)
    return normalized(
        (
            wa * a[0] + wb * b[0],
            wa * a[1] + wb * b[1],
            wa * a[2] + wb * b[2],
            wa * a[3] + wb * b[3],
        ),
    )


def R_from_quat(q: Quat) -> Matrix:
    """Rotation matrix, shape (3, 3). Raises ValueError when ``q`` is zero or not finite."""
    w, x, y, z = normalized(q)
    entries = (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip
    return np.array(entries).reshape(3, 3)


def quat_from_R(R: Matrix) -> Quat:
    """Unit quaternion with w >= 0 of a rotation matrix of shape (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    return quat_from_entries((a, b, c, d, e, f, g, h, i))


def quat_from_entries(
    entries: tuple[float, float, float, float, float, float, float, float, float],
) -> Quat:
    """Unit quaternion with w >= 0 of a rotation matrix given row by row; exact at every angle
    (Shepperd's method).
    """
    a, b, c, d, e, f, g, h, i = entries
    trace = a + e + i
    largest = max(trace, a, e, i)
    if largest == trace:
        q = (1.0 + trace, h - f, c - g, d - b)
    elif largest == a:
        q = (h - f, 1.0 + a - e - i, b + d, c + g)
    elif largest == e:
        q = (c - g, b + d, 1.0 - a + e - i, f + h)
    else:
        q = (d - b, c + g, f + h, 1.0 - a - e + i)
    return normalized(q)


def exp(w: Vector) -> Matrix:
    """Rotation matrix of a rotation vector of shape (3,) in rad (Rodrigues)."""
    x, y, z = (float(component) for component in w)
    angle = math.sqrt(x * x + y * y + z * z)
    half = 0.5 * angle
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(half) / angle
    return R_from_quat((math.cos(half), scale * x, scale * y, scale * z))


def log(R: Matrix) -> Vector:
    """Rotation vector, shape (3,), in rad and of length <= pi, of a rotation matrix."""
    w, x, y, z = quat_from_R(R)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return np.array([scale * x, scale * y, scale * z])


def angle_between(a: Matrix, b: Matrix) -> float:
    """Angle in rad, 0..pi, of the rotation that takes ``a`` to ``b``."""
    return float(np.linalg.norm(log(a.T @ b)))


def yaw_of(q: Quat) -> float:
    """Heading in rad, -pi..pi, of a body-to-local quaternion (z-y-x order)."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quat_from_rpy(
    roll: float,
    pitch: float,
    yaw: float,
) -> Quat:
    """Body-to-local quaternion of aerospace angles in rad: yaw about z, then pitch about y, then
    roll about x.
    """
    cr = math.cos(0.5 * roll)
    sr = math.sin(0.5 * roll)
    cp = math.cos(0.5 * pitch)
    sp = math.sin(0.5 * pitch)
    cy = math.cos(0.5 * yaw)
    sy = math.sin(0.5 * yaw)
    return normalized(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


def rpy_from_quat(q: Quat) -> tuple[float, float, float]:
    """Roll, pitch, yaw in rad of a unit body-to-local quaternion; pitch in -pi/2..pi/2."""
    w, x, y, z = q
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return roll, pitch, yaw_of(q)


def stepped(pose: Pose, step: Vector) -> Pose:
    """Return a pose moved by ``step[:3]`` in m, and turned by ``step[3:]``, a rotation vector in
    rad.
    """
    return Pose(exp(step[3:]) @ pose.R, pose.t + step[:3])


def R_from_yaw(yaw: float) -> Matrix:
    """Rotation matrix about z, angle in rad: of a level body, body-to-local."""
    c = math.cos(yaw)
    s = math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def R_from_rpy(
    roll: float,
    pitch: float,
    yaw: float,
) -> Matrix:
    """Body-to-local rotation matrix Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
    return R_from_quat(quat_from_rpy(roll, pitch, yaw))


def wrapped(angle: float) -> float:
    """The same angle in -pi..pi (rad)."""
    return math.remainder(angle, 2.0 * math.pi)
