"""What is likely wrong where gravity contradicts the corners of a marker, in words for whoever put
the plate on.

Called only for a pose that was refused, and by ``doctor``: nothing here needs to be fast.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from path.geometry import rotation
from path.geometry.transforms import Matrix, Vector
from path.marker.layout import MarkerLayout

NEAR_RAD = math.radians(20.0)  # what a guess at the cause may leave between the two directions
# of a plate in its own plane; positive is counter-clockwise, seen by who reads it
TURNS_DEG = (180.0, 90.0, -90.0)
OFFICIAL = "OpenCV's AprilTags are turned by 180 degrees against AprilRobotics' own pictures"


def likely_cause(
    poses_R: Sequence[Matrix],
    gravity_v: Sequence[float],
    gravity_c: Sequence[float],
    layout: MarkerLayout,
) -> str:
    """Return a sentence that says how far gravity and the corners are apart, and what would explain
    it.

    Args:
        poses_R: (3, 3) each, ``R_c_v`` of the poses that the corners alone allow.
        gravity_v, gravity_c: unit gravity in ``v`` and in the camera.
    """
    down_v = np.asarray(gravity_v)
    down_c = np.asarray(gravity_c)
    apart_rad = min(_angle(R @ down_v, down_c) for R in poses_R)
    said = f"gravity contradicts the marker's corners by {math.degrees(apart_rad):.0f} degrees"
    normal_v = layout.markers[0].T_v_m.R[:, 2]
    for turn_deg in TURNS_DEG:
        # what would be down in v if the plate were turned back
        back = rotation.exp(-math.radians(turn_deg) * normal_v)
        if _nearest(poses_R, back @ down_v, down_c) < NEAR_RAD:
            return f"{said}: {_plate(turn_deg, layout)}"
    if _nearest(poses_R, -down_v, down_c) < NEAR_RAD:
        return f"{said}: does one of the two gravities point up? An accelerometer at rest measures what is up"
    return f"{said}: are marker and camera mounted as the rig says, and both attitudes right?"


def _plate(turn_deg: float, layout: MarkerLayout) -> str:
    if abs(turn_deg) < 180.0:
        way = "counter-clockwise" if turn_deg > 0.0 else "clockwise"
        return f"is the plate turned by {abs(turn_deg):.0f} degrees {way}, against the rig, or the camera?"
    question = "is the plate the right way up, and the camera?"
    return f"{question} {OFFICIAL}" if "APRILTAG" in layout.dictionary else question


def _nearest(
    poses_R: Sequence[Matrix],
    down_v: Vector,
    down_c: Vector,
) -> float:
    return min(_angle(R @ down_v, down_c) for R in poses_R)


def _angle(one: Vector, other: Vector) -> float:
    return math.acos(min(1.0, max(-1.0, float(one @ other))))
