"""The effect of errors of depth and of the marker's pose on D2's prior (paper, section "Sensor
Sensitivity").

The printed text leaves conventions open; these reproduce its nominal projection:

- The handoff-local frame ``v`` has the axes of D1's camera, and its origin there: D1's mounting
  plays no part.
- The relative yaw turns about the camera's vertical axis y, ``R_c2_v = Ry(+25 deg)``, and the
  translation is the origin of ``v`` in D2's camera frame: ``X_c2 = R_c2_v X_v + t_2v``.
- A pose error changes one of the two: ``t <- t + dt``, or ``R <- exp(dw) R`` with ``t`` untouched.

The marker itself, the origin of ``v``, then lies at u = -426 px, outside D2's image: the geometry
is good for arithmetic, and no rendezvous. All functions are pure; lengths in m, angles in rad,
errors in px.
"""

from __future__ import annotations

import math

import numpy as np

from path.arrays import Array
from path.camera.model import CameraModel
from path.geometry.rotation import exp
from path.geometry.transforms import Pose, Vector
from path.values import frozen

NOMINAL_SIZE = (1920, 1080)
NOMINAL_FIELD_DEG = (69.4, 42.5)
NOMINAL_T_2V_M = (-1.0, 0.2, 1.0)
NOMINAL_YAW_DEG = 25.0


@frozen
class ReferenceErrors:
    """Magnitudes from the literature (paper, table reference_sensor_errors)."""

    depth_m: float = 0.005  # at 1 m
    translation_m: float = 0.0043
    rotation_rad: float = math.radians(1.83)


@frozen
class Terms:
    """RMS displacement of the projected target, px (eq. projection_rms), by what is wrong."""

    depth: float
    translation: float
    rotation: float

    @property
    def pose(self) -> float:
        return math.hypot(self.translation, self.rotation)

    @property
    def combined(self) -> float:
        return math.hypot(self.depth, self.pose)


def nominal_camera() -> CameraModel:
    """The D415's colour camera by its data sheet (eq. nominal_intrinsics), without distortion."""
    (width, height), (across, down) = NOMINAL_SIZE, NOMINAL_FIELD_DEG
    fx = 0.5 * width / math.tan(math.radians(0.5 * across))
    fy = 0.5 * height / math.tan(math.radians(0.5 * down))
    return CameraModel(width, height, fx, fy, 0.5 * width, 0.5 * height)


def nominal_pose() -> Pose:
    """``T_c2_v`` of the nominal geometry."""
    return Pose(exp(np.array([0.0, math.radians(NOMINAL_YAW_DEG), 0.0])), np.array(NOMINAL_T_2V_M))


def on_axis(depth_m: float) -> Vector:
    """The target in ``v`` at D1's principal point, shape (3,)."""
    return np.array([0.0, 0.0, depth_m])


def directions(count: int, rng: np.random.Generator) -> Array:
    """Unit vectors, uniform on the sphere, shape (count, 3)."""
    raw = rng.standard_normal((count, 3))
    return raw / np.linalg.norm(raw, axis=1, keepdims=True)


def project(
    camera: CameraModel,
    T_c2_v: Pose,
    point_v: Vector,
) -> Array:
    """Pixel of a point in ``v``, shape (2,) (eqs. target_d2 to d2_projection)."""
    return camera.project(T_c2_v.apply(point_v)[None])[0]


def depth_error2(
    camera: CameraModel,
    T_c2_v: Pose,
    point_v: Vector,
    error_m: float,
) -> Array:
    """Squared displacements, px^2, shape (2,), for a depth that is too large and one that is too
    small.
    """
    scale = 1.0 + np.array([error_m, -error_m]) / point_v[2]
    return _displaced2(camera, T_c2_v, point_v, T_c2_v.apply(point_v * scale[:, None]))


def translation_error2(
    camera: CameraModel,
    T_c2_v: Pose,
    point_v: Vector,
    error_m: float,
    toward: Array,
) -> Array:
    """Squared displacements, px^2, shape (n,), for errors of the translation in the directions
    ``toward``, (n, 3).
    """
    return _displaced2(camera, T_c2_v, point_v, T_c2_v.apply(point_v) + error_m * toward)


def rotation_error2(
    camera: CameraModel,
    T_c2_v: Pose,
    point_v: Vector,
    error_rad: float,
    axes: Array,
) -> Array:
    """Squared displacements, px^2, shape (n,), for errors of the rotation about ``axes``, (n, 3)
    unit vectors.
    """
    turned = T_c2_v.R @ point_v
    along = (axes @ turned)[:, None] * axes
    moved = (
        math.cos(error_rad) * (turned - along)
        + math.sin(error_rad) * np.cross(axes, turned)
        + along
    )
    return _displaced2(camera, T_c2_v, point_v, moved + T_c2_v.t)


def first_order(
    camera: CameraModel,
    T_c2_v: Pose,
    point_v: Vector,
    errors: ReferenceErrors,
) -> Terms:
    """The terms by the projection's derivatives, averaged over all directions in closed form.

    For a linear map ``A`` and unit vectors uniform on the sphere, the mean of ``|A e|^2`` is
    ``|A|_F^2 / 3``.
    """
    J = camera.jacobian(T_c2_v.apply(point_v)[None])[0]
    x, y, z = T_c2_v.R @ point_v
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    along = J @ T_c2_v.R @ (point_v / point_v[2])
    return Terms(
        errors.depth_m * float(np.linalg.norm(along)),
        errors.translation_m * float(np.linalg.norm(J)) / math.sqrt(3.0),
        errors.rotation_rad * float(np.linalg.norm(J @ cross)) / math.sqrt(3.0),
    )


def _displaced2(
    camera: CameraModel,
    T_c2_v: Pose,
    point_v: Vector,
    moved_c2: Array,
) -> Array:
    return np.sum((camera.project(moved_c2) - project(camera, T_c2_v, point_v)) ** 2, axis=1)
