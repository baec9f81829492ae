"""Compile, or load from numba's cache, every kernel of the method before a flight needs it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from path.belief.warm_up import warm_up_belief
from path.camera.kernels import extent, lens_of
from path.camera.model import CameraModel
from path.cycle.warm_up import warm_up_cycles
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import single_marker
from path.marker.photometric.kernels import tones
from path.marker.photometric.texture import cells
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.marker.track import recognise
from path.observations import MarkerDetection
from path.relative_pose.filter import RelativeFilter

EYE = np.eye(3)
EYE_6 = np.eye(6)
CAMERA = CameraModel(
    160, 160, 600.0, 600.0, 80.0, 80.0, doubts=((1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),)
)  # of a calibration's file
POSE = Pose(rotation.exp(np.array([2.6, 0.3, 0.2])), np.array([0.0, 0.0, 0.5]))


def warm_up(images: bool = True) -> None:
    """Find a drawn marker and estimate its pose. Seconds after an update of the software, otherwise
    well below one.

    Args:
        images: whether markers are looked for in images; without, the corners come from elsewhere.

    Raises:
        RuntimeError: when the drawn marker gives no pose: the installation is broken.
    """
    warm_up_pose()
    warm_up_relative()
    warm_up_cycles()
    warm_up_belief()
    if images:
        warm_up_image()


def warm_up_image() -> None:
    """Compile what finds a marker in an image. Raises RuntimeError when a drawn one gives no
    pose.
    """
    layout = single_marker()
    camera = CAMERA
    T_c_v = POSE
    marker = layout.markers[0]
    pattern = np.pad(cells(layout.dictionary, marker.id), 1, constant_values=1.0)
    zoom = 12  # pixels of the drawing a cell
    printed = np.kron(30.0 + 170.0 * pattern, np.ones((zoom, zoom)))
    m = marker.side_m / (pattern.shape[0] - 2) / zoom
    middle = 0.5 * (printed.shape[0] - 1)
    to_marker = np.array([[m, 0.0, -m * middle], [0.0, -m, m * middle], [0.0, 0.0, 1.0]])
    to_image = camera.K @ np.column_stack([T_c_v.R[:, 0], T_c_v.R[:, 1], T_c_v.t]) @ to_marker
    drawn = cv2.warpPerspective(
        printed, to_image, (160, 160), flags=cv2.INTER_AREA, borderValue=(120.0,)
    )
    image = np.asarray(cv2.GaussianBlur(drawn, (0, 0), 0.8), dtype=np.uint8)
    # what is asked only where the light is uneven
    shadow = np.where(np.arange(160)[None, :] > 80, 0.7, 1.0)
    for light in (shadow, 1.0):
        found = detect_markers(np.asarray(image * light, dtype=np.uint8), None, layout, camera)
        if not found:
            raise RuntimeError("a drawn marker was not found: reinstall numba and OpenCV")
    if recognise(image, T_c_v, layout, camera) is None:
        raise RuntimeError("a drawn marker was not recognised: reinstall numba and OpenCV")


def warm_up_pose() -> None:
    """Compile what turns a marker's corners into a pose. Raises RuntimeError when there is none."""
    layout = single_marker()
    camera = CAMERA
    T_c_v = POSE
    marker = layout.markers[0]
    corners = camera.project(T_c_v.apply(marker.corners_v))
    down = np.array([0.0, -0.8, -0.6])
    gx, gy, gz = (T_c_v.R @ down).tolist()
    found = MarkerDetection(marker.id, corners, 0.01 * np.eye(8))
    pose = estimate_pose((found,), layout, camera, (0.0, -0.8, -0.6), (gx, gy, gz), PoseSettings())
    if not isinstance(pose, MarkerPose):
        raise RuntimeError(
            f"a drawn marker gave no pose ({pose.reason.value}): reinstall numba and OpenCV"
        )
    extent(lens_of(camera), marker.corners_v, 0.0)
    camera.ray(*corners[0].tolist())


def warm_up_relative() -> None:
    """Compile what keeps a marker's pose from one frame to the next."""
    relative = RelativeFilter()
    for stamp_ns in (0, 20_000_000):
        relative.update(stamp_ns, POSE, 1e-4 * EYE_6, EYE, EYE)
        relative.predict(stamp_ns, EYE, EYE)


def is_compiled() -> bool:
    """True when the kernels of an earlier start are there: one of the smallest is loaded, or else
    compiled.
    """
    smallest: Any = tones
    smallest(np.zeros((1, 6)))
    return not smallest.stats.cache_misses
