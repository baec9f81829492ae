"""The corner methods that are held against each other: OpenCV's and the project's own."""

from __future__ import annotations

import math
from functools import cache
from typing import cast, get_args

import cv2
import numpy as np

from path.arrays import Image
from path.camera.model import CameraModel
from path.geometry.transforms import Matrix, Pose
from path.marker.detect import Refine, detect_markers
from path.marker.layout import MarkerLayout
from path.marker.photometric.texture import dictionary_of
from path.observations import Region
from path.values import frozen

OPENCV = {"contour": cv2.aruco.CORNER_REFINE_CONTOUR, "apriltag": cv2.aruco.CORNER_REFINE_APRILTAG}
# AprilTag's own code puts the centre of the first pixel at 0.5
PIXEL_CENTRE = {"contour": 0.0, "apriltag": 0.5}
TITLES = {
    "subpix": "cv2 SUBPIX",
    "contour": "cv2 CONTOUR",
    "apriltag": "cv2 APRILTAG",
    "edges": "edge lines",
    "photometric": "photometric",
    "expected": "photometric, expected",
}
METHODS: tuple[str, ...] = tuple(
    name for name in TITLES if name in (*OPENCV, *get_args(Refine), "expected")
)
# OpenCV's own methods see the region so much larger: at its own size they miss small markers
ENLARGED = 4.0
WINDOW_PX = 23  # of the threshold, in the enlarged region


@frozen(eq=False)
class FoundMarker:
    """Corners (4, 2) px of one marker in the order of the print, their covariance (8, 8) where the
    method has one, and what it called wrong.
    """

    corners_px: Matrix
    covariance_px2: Matrix | None = None
    wrong: tuple[str, ...] = ()


def find(
    method: str,
    image: Image,
    region: Region,
    layout: MarkerLayout,
    camera: CameraModel,
    T_c_v: Pose,
) -> FoundMarker | None:
    """The first marker of the layout in a region, None when it is not found, or more than once.

    ``T_c_v`` is the pose that is expected, for the method that is told one.
    """
    if method in OPENCV:
        return _by_opencv(method, image, region, layout)
    if method == "expected":
        found = detect_markers(image, region, layout, camera, expected=T_c_v)
    else:
        found = detect_markers(image, region, layout, camera, refine=cast(Refine, method))
    if len(found) != 1:
        return None
    return FoundMarker(found[0].corners_px, found[0].covariance_px2)


def _by_opencv(
    method: str,
    image: Image,
    region: Region,
    layout: MarkerLayout,
) -> FoundMarker | None:
    area = region.clipped(image.shape[1], image.shape[0])
    if area is None:
        return None
    u0 = int(area.x0)
    v0 = int(area.y0)
    cut = cv2.cvtColor(image[v0 : math.ceil(area.y1), u0 : math.ceil(area.x1)], cv2.COLOR_BGR2GRAY)
    large = cv2.resize(cut, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    corners, ids, _ = _detector(layout.dictionary, OPENCV[method]).detectMarkers(large)
    own = (
        [k for k, marker_id in enumerate(np.ravel(ids)) if marker_id == layout.markers[0].id]
        if corners
        else []
    )
    if len(own) != 1:
        return None
    quad = np.asarray(corners[own[0]], float).reshape(4, 2) - PIXEL_CENTRE[method]
    return FoundMarker((quad + 0.5) / ENLARGED - 0.5 + np.array([u0, v0]))


@cache
def _detector(dictionary: str, refinement: int) -> cv2.aruco.ArucoDetector:
    """Return a detector with the parameters that the project's own detection uses."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = WINDOW_PX
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.25
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.errorCorrectionRate = 1.0
    parameters.cornerRefinementMethod = refinement
    return cv2.aruco.ArucoDetector(dictionary_of(dictionary), parameters)
