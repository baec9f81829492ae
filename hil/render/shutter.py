"""The motion while a picture is taken: its rows are read one after another, and each is exposed for
a while.

A frame's instant is the middle of the exposure of its middle row. Every corner of a body is drawn
where it is when its own row is read, straight on with its velocity and turn, and what lies between
corners in between. The ground is drawn as of the frame's instant: nothing is measured on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field

import numpy as np

from hil.render.scene import Body
from hil.world.errors import SensorErrors
from path.arrays import Array
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.values import frozen

NO_SWEEP = np.zeros(11)
NEAREST_M = 0.05
LONGEST_PX = 12.0  # of the motion during an exposure that is drawn


@frozen
class Shutter:
    """``exposure_s``: of each row; ``readout_s``: from the first row to the last."""

    exposure_s: float = 0.0
    readout_s: float = 0.0


def shutter_of(errors: SensorErrors) -> Shutter | None:
    """The shutter of a camera with these errors; None where a picture is taken in one instant."""
    drawn = Shutter(errors.exposure_s, errors.readout_s)
    return None if drawn == Shutter() else drawn


@frozen(eq=False)
class CameraMotion:
    """The pose of a camera and how it moves: (3,) m/s and rad/s, in the world. It stands still by
    default.
    """

    T_w_c: Pose
    velocity_w: Array = field(default_factory=lambda: np.zeros(3))
    rates_w: Array = field(default_factory=lambda: np.zeros(3))


def _cross(a: Array, b: Array) -> Array:
    """As ``np.cross`` of two (3,), to the bit; that one takes longer than all the rest of a
    sweep.
    """
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def carried(
    T_w_b: Pose,
    T_b_c: Pose,
    velocity_w: Array,
    rates_w: Array,
) -> CameraMotion:
    """The motion of a camera on a drone that moves and turns."""
    arm_w = T_w_b.R @ T_b_c.t
    return CameraMotion(T_w_b @ T_b_c, velocity_w + _cross(rates_w, arm_w), rates_w)


def twist(body: Body, seen: CameraMotion) -> Array:
    """(6,): a point X of the body, in the camera frame, moves by v + w x X: (v, w)."""
    R_c_w = seen.T_w_c.R.T
    origin_w = seen.T_w_c.t
    rates = R_c_w @ (body.rates_w - seen.rates_w)
    # the body's, carried there
    at_camera_w = body.velocity_w + _cross(body.rates_w, origin_w - body.T_w_body.t)
    return np.concatenate((R_c_w @ (at_camera_w - seen.velocity_w), rates))


def sweep(
    body: Body,
    seen: CameraMotion,
    camera: CameraModel,
    shutter: Shutter,
) -> Array:
    """(11,): as ``hil.render.primitives.add_body`` takes it."""
    row_s = shutter.readout_s / camera.height
    # A corner above or below the picture has its place too: what is between it and others is in the
    # picture.
    late_s = row_s * (camera.cy - 0.5 * (camera.height - 1))
    return np.concatenate(
        (twist(body, seen), (late_s, row_s * camera.fy, shutter.readout_s, *camera.distortion[:2]))
    )


def smear_px(
    bodies: Sequence[Body],
    seen: CameraMotion,
    camera: CameraModel,
    shutter: Shutter,
) -> tuple[float, float]:
    """The motion during an exposure, (u, v), of the body that is seen nearest to the middle; none
    where there is none.

    The whole picture is blurred by it: what a drone follows or looks at is there.
    """
    T_c_w = seen.T_w_c.inverse()
    placed = [(body, (T_c_w @ body.T_w_body).t) for body in bodies]
    ahead = [(body, at) for body, at in placed if at[2] > NEAREST_M]
    if not ahead:
        return 0.0, 0.0
    body, at = min(ahead, key=lambda each: math.hypot(each[1][0], each[1][1]) / float(each[1][2]))
    x, y, z = at.tolist()
    moved = twist(body, seen)
    dx, dy, dz = (moved[:3] + _cross(moved[3:], at)).tolist()
    u = shutter.exposure_s * camera.fx * (dx - dz * x / z) / z
    v = shutter.exposure_s * camera.fy * (dy - dz * y / z) / z
    shorter = min(1.0, LONGEST_PX / max(math.hypot(u, v), LONGEST_PX))
    return shorter * u, shorter * v


def blurred_px(sigma_px: float, length_px: float) -> float:
    """The standard deviation of a blur with even motion over a length."""
    return math.sqrt(sigma_px**2 + length_px**2 / 12.0)
