"""The inputs of the corner methods: cameras, conditions of image and print, and poses of the
marker.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flight.harness.renderer import (
    IDEAL,
    PRINTED,
    REALISTIC,
    REALISTIC_VIDEO,
    WEBCAM,
    Imaging,
    Printing,
    RenderedInstant,
)
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Matrix, Pose, Vector
from path.marker.layout import single_marker
from path.messages import Role
from path.values import frozen

LAYOUT = single_marker(0.040)
LENS = (0.06, -0.12, 0.001, -0.0008, 0.0)
CAMERAS = {
    "640x480": CameraModel(640, 480, 615.0, 614.5, 321.5, 238.5, LENS),
    "1280x720": CameraModel(1280, 720, 920.0, 919.0, 642.0, 358.0, LENS),
    "1920x1080": CameraModel(1920, 1080, 1380.0, 1379.0, 963.0, 537.0, LENS),
}
MAIN = "1280x720"
QUICK_MAIN = "640x480"

RANGE_M = (0.7, 1.5)
MOST_INCIDENCE_RAD = math.radians(60.0)
MOST_ROLL_RAD = math.radians(30.0)
SEEN_WITHIN = 0.6  # of the image's width and height: where the marker's centre is
HEIGHT_M = 3.0  # of the drone with the marker
TILT_RAD = math.radians(5.0)  # standard deviation of its roll and pitch
MOTION_RAD = math.radians(30.0)  # direction of motion in the image
POSE_STREAM = 1


FLAWLESS = Printing()
COARSE = Printing(picture_px=26)


@frozen
class Condition:
    """One way in which images differ from the ideal; ``title`` is what the reader sees."""

    title: str
    imaging: Imaging = IDEAL
    printing: Printing = FLAWLESS


def _moving(length_px: float) -> Imaging:
    return Imaging(motion_px=(length_px * math.cos(MOTION_RAD), length_px * math.sin(MOTION_RAD)))


CONDITIONS = {
    "ideal": Condition("ideal"),
    "gamma": Condition("gamma 2.2", Imaging(gamma=2.2)),
    "sharpening": Condition("sharpening 1.0", Imaging(sharpen=1.0, sharpen_sigma_px=1.1)),
    "mosaic": Condition("Bayer mosaic", Imaging(mosaic=True)),
    "jpeg": Condition("JPEG 90", Imaging(jpeg_quality=90)),
    "h264": Condition("H.264 crf 23", Imaging(h264_crf=23)),
    "saturation": Condition("saturation", Imaging(exposure=1.5)),
    "motion_1": Condition("motion 1 px", _moving(1.0)),
    "motion_2": Condition("motion 2 px", _moving(2.0)),
    "motion_3": Condition("motion 3 px", _moving(3.0)),
    "blade": Condition("rotor blade", printing=Printing(blade=True)),
    "soft_shadow": Condition("soft shadow", printing=Printing(shadow="soft")),
    "hard_shadow": Condition("hard shadow", printing=Printing(shadow="hard")),
    "ink_spread": Condition(
        "ink spread 0.1 mm", printing=Printing(ink_spread_m=PRINTED.ink_spread_m)
    ),
    "uneven_black": Condition("uneven black", printing=Printing(black_spread=PRINTED.black_spread)),
    "coarse_print": Condition("coarse print", printing=COARSE),
    "realistic": Condition("realistic", REALISTIC, PRINTED),
    "realistic_coarse": Condition(
        "realistic, coarse print",
        REALISTIC,
        replace(PRINTED, picture_px=COARSE.picture_px),
    ),
    "realistic_video": Condition("realistic video", REALISTIC_VIDEO, PRINTED),
    "webcam": Condition("sharp webcam", WEBCAM, PRINTED),
}


def marker_in(stage: RenderedInstant, T_b_v: Pose) -> Pose:
    """Return ``T_c_v``: the camera is mounted in its drone's origin, z ahead."""
    return stage.T_w_b[Role.RECEIVER].inverse() @ stage.T_w_b[Role.SENDER] @ T_b_v


def corners_px(T_c_v: Pose, camera: CameraModel) -> Matrix:
    """Return the true corners, (4, 2): where the edges of the print were meant to be."""
    return camera.project(T_c_v.apply(LAYOUT.markers[0].corners_v))


def view(
    seed: int,
    number: int,
    camera: CameraModel,
    T_b_v: Pose,
) -> RenderedInstant:
    """A random view: range, incidence and place in the image uniform, the same for every camera of
    one shape.
    """
    rng = np.random.default_rng([seed, POSE_STREAM, number])
    T_w_b1 = Pose(
        _turned(rng.normal(0.0, TILT_RAD, 2), rng.uniform(0.0, 2.0 * math.pi)),
        np.array([0.0, 0.0, HEIGHT_M]),
    )
    T_w_v = T_w_b1 @ T_b_v
    right, up, out = T_w_v.R.T
    incidence = rng.uniform(0.0, MOST_INCIDENCE_RAD)
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    across = math.cos(azimuth) * right + math.sin(azimuth) * up
    toward = math.cos(incidence) * out + math.sin(incidence) * across
    R_w_c = _looking(-toward, rng.uniform(-MOST_ROLL_RAD, MOST_ROLL_RAD))
    half = 0.5 * SEEN_WITHIN * np.array([camera.width, camera.height])
    u, v = np.array([camera.width, camera.height]) / 2.0 + half * rng.uniform(-1.0, 1.0, 2)
    x, y = camera.ray(float(u), float(v))
    ray = np.array([x, y, 1.0]) / math.sqrt(x * x + y * y + 1.0)
    R_w_c = R_w_c @ _between(ray)  # the marker is seen along ``ray`` at the same incidence
    T_w_c = Pose(R_w_c, T_w_v.t - rng.uniform(*RANGE_M) * (R_w_c @ ray))
    return RenderedInstant({Role.SENDER: T_w_b1, Role.RECEIVER: T_w_c})


def _turned(tilt_rad: Vector, heading_rad: float) -> Matrix:
    """Attitude of a hovering body (FRD) in ENU."""
    roll, pitch = tilt_rad.tolist()
    cr = math.cos(roll)
    sr = math.sin(roll)
    cp = math.cos(pitch)
    sp = math.sin(pitch)
    c = math.cos(heading_rad)
    s = math.sin(heading_rad)
    level = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    pitched = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    return level @ pitched @ np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])


def _looking(ahead_w: Vector, roll_rad: float) -> Matrix:
    """A camera that looks along a direction, its x axis level before it is rolled."""
    right = np.cross(ahead_w, np.array([0.0, 0.0, 1.0]))
    right /= np.linalg.norm(right)
    level = np.column_stack((right, np.cross(ahead_w, right), ahead_w))
    return level @ R_from_yaw(roll_rad)


def _between(ray: Vector) -> Matrix:
    """The smallest rotation that turns ``ray`` to the optical axis."""
    axis = np.cross(ray, np.array([0.0, 0.0, 1.0]))
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + ray[2])
