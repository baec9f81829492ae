"""No marker of a layout was found in an image: what is there in its place?

Prints go wrong in a few ways: another id, another dictionary, white on black, or mirrored by a
transfer foil. A detector finds none of them, and says nothing for ever. Here each is looked for in
turn, which takes too long for a frame in flight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from path.marker.detect import quiet
from path.marker.kernels import Array
from path.marker.layout import DICTIONARIES, MarkerLayout
from path.marker.photometric.texture import dictionary_of
from path.marker.printed import aligned, look

FAMILIES = ("4X4", "5X5", "6X6", "7X7")
OTHERS = (
    "DICT_APRILTAG_36h11",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_16h5",
)
SCALES = (1.0, 2.0)
# grey levels below the mean of so many pixels that are black
THRESHOLD = 7.0
WINDOW = 13
# of a print that nobody asked for
SURE_LIKENESS = 0.8
SURE_BORDER = 0.8


def seen_instead(grey: NDArray[np.uint8], layout: MarkerLayout) -> str | None:
    """Return a sentence about what is in the image in place of the layout's markers; None when that
    is nothing known.

    Args:
        grey: uint8, (height, width), C-contiguous.
    """
    wanted = tuple(marker.id for marker in layout.markers)
    rig = f"asked for is {_named(wanted)} of {layout.dictionary}"
    own = _ids(grey, layout.dictionary)
    if own & set(wanted):
        return None
    if own:
        return f"{_named(sorted(own))} of {layout.dictionary} is there: {rig}"
    for inverted, mirrored, what in (
        (True, False, "inverted, white on black: print it black on white, with a white border"),
        (False, True, "mirrored: it is printed from behind, or the camera's image is mirrored"),
        (
            True,
            True,
            "inverted and mirrored: print it black on white, with a white border, and not from behind",
        ),
    ):
        image = 255 - grey if inverted else grey
        found = _ids(np.ascontiguousarray(image[:, ::-1] if mirrored else image), layout.dictionary)
        if found:
            return f"{_named(sorted(found))} of {layout.dictionary} is there, {what}"
    best: tuple[str, set[int]] | None = None
    for name in _others(layout.dictionary):
        found = _ids(grey, name)
        if len(found) > (0 if best is None else len(best[1])):
            best = name, found
    if best is None:
        return None
    return f"{_named(sorted(best[1]))} of {_smallest(*best)} is there: {rig}"


def grey_of(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image, BGR or grey, as ``seen_instead`` takes it."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return np.ascontiguousarray(grey, dtype=np.uint8)


def _others(dictionary: str) -> Iterator[str]:
    """The other dictionaries; of a family the largest, whose first markers are the smaller ones."""
    for name in (*(f"DICT_{family}_1000" for family in FAMILIES), *OTHERS):
        if name != dictionary:
            yield name


def _smallest(name: str, ids: set[int]) -> str:
    """The smallest dictionary of a family that has all these ids."""
    family = [
        other for other in DICTIONARIES if name.endswith("_1000") and other.startswith(name[:-4])
    ] or [name]
    return min(
        (each for each in family if DICTIONARIES[each][1] > max(ids)),
        key=lambda each: DICTIONARIES[each][1],
    )


def _named(ids: Sequence[int]) -> str:
    return f"marker {ids[0]}" if len(ids) == 1 else f"markers {', '.join(map(str, ids))}"


def _ids(grey: NDArray[np.uint8], dictionary: str) -> set[int]:
    """The markers of a dictionary that are surely there, whole and with their border."""
    found: set[int] = set()
    for scale in SCALES:
        for marker_id, quad in _decoded(grey, dictionary, scale):
            if marker_id not in found and _is_there(grey, quad, quiet(dictionary, marker_id)):
                found.add(marker_id)
    return found


@lru_cache(maxsize=32)
def _detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = WINDOW
    parameters.adaptiveThreshWinSizeMax = WINDOW
    parameters.adaptiveThreshConstant = THRESHOLD
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.25
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.errorCorrectionRate = 1.0
    return cv2.aruco.ArucoDetector(dictionary_of(dictionary), parameters)


def _decoded(grey: NDArray[np.uint8], dictionary: str, scale: float) -> list[tuple[int, Array]]:
    """Ids and corners (4, 2) in pixels of ``grey``."""
    enlarged = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    corners, ids, _ = _detector(dictionary).detectMarkers(enlarged)
    quads: list[tuple[int, Array]] = []
    for row, corner in enumerate(corners):
        marker_id = int(np.ravel(ids)[row])  # shape (n, 1) in OpenCV 4, (n,) in 5
        quads.append((marker_id, (corner.reshape(4, 2).astype(np.float64) + 0.5) / scale - 0.5))
    return quads


def _is_there(grey: NDArray[np.uint8], quad: Array, pattern: Array) -> bool:
    corners = aligned(grey, quad, pattern)
    if corners is None:
        return False
    seen = look(grey, corners, pattern)
    return seen.likeness >= SURE_LIKENESS and seen.wrong == 0.0 and seen.border >= SURE_BORDER
