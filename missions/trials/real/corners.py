"""Corners of a board's markers in a photograph, by method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from missions.trials.pose.corners.methods import OPENCV, PIXEL_CENTRE, TITLES, FoundMarker
from missions.trials.real.set import RealSet
from path.arrays import Image
from path.camera.model import CameraModel
from path.geometry.transforms import Matrix
from path.marker.detect import refine_corners, trusted_fit

METHOD_TITLES = {
    "none": "cv2, not refined",
    **{name: TITLES[name] for name in ("subpix", *OPENCV, "photometric")},
}
METHODS = tuple(METHOD_TITLES)
REFINEMENTS = {
    "none": cv2.aruco.CORNER_REFINE_NONE,
    "subpix": cv2.aruco.CORNER_REFINE_SUBPIX,
    **OPENCV,
}
START = "contour"
NAMED = ("filter", "coarse print", "shadow")  # what a fit can call wrong, in its order
FELL_BACK = "fell back to SUBPIX"


Corners = dict[int, FoundMarker]


def starts(own: RealSet, grey: Image) -> dict[int, Matrix]:
    """Corners good to a pixel, by id, as they lie in the camera's image."""
    return {i: found.corners_px for i, found in _by_opencv(own, grey, START).items()}


def corners_by(
    method: str,
    own: RealSet,
    grey: Image,
    start: Mapping[int, Matrix],
    camera: CameraModel,
) -> Corners:
    """Every marker of the board that a method finds."""
    if method == "photometric":
        return by_photometry(own, grey, start, camera)
    found = _by_opencv(own, grey, method)
    return {
        i: replace(marker, corners_px=camera.even(marker.corners_px)) for i, marker in found.items()
    }


def by_photometry(
    own: RealSet,
    grey: Image,
    start: Mapping[int, Matrix],
    camera: CameraModel,
) -> Corners:
    """The project's own corners; where the fit is not to be trusted those it falls back to."""
    found: Corners = {}
    for marker_id, quad in start.items():
        pattern = own.markers[marker_id].pattern
        begun = np.ascontiguousarray(quad)
        fitted = trusted_fit(grey, (0, 0), begun, pattern, camera)
        if fitted is not None:
            wrong = tuple(
                name for name, is_wrong in zip(NAMED, fitted.wrong, strict=True) if is_wrong
            )
            found[marker_id] = FoundMarker(fitted.corners_px, fitted.covariance_px2, wrong)
            continue
        refined = refine_corners(grey, (0, 0), begun, pattern, camera, "subpix")
        if refined is not None:
            found[marker_id] = FoundMarker(*refined, (FELL_BACK,))
    return found


def _by_opencv(
    own: RealSet,
    grey: Image,
    method: str,
) -> Corners:
    if own.dictionary is None:
        return {}
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = REFINEMENTS[method]
    pixel_centre = PIXEL_CENTRE.get(method, 0.0)
    quads, ids, _ = cv2.aruco.ArucoDetector(own.dictionary, parameters).detectMarkers(grey)
    found: Corners = {}
    for quad, marker_id in zip(quads, np.ravel(ids) if quads else (), strict=True):
        if int(marker_id) in own.markers:
            corners_px = np.asarray(quad, float).reshape(4, 2) - pixel_centre
            found[int(marker_id)] = FoundMarker(corners_px)
    return found
