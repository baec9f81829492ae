"""Find the markers of a layout in an image, with corners and their covariance.

``path.marker.search`` says where they may be, good to about half a pixel. Whatever is not the print
to the cell is left out here, and the rest refined.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.kernels import Array
from path.marker.layout import MarkerLayout
from path.marker.photometric.corners import PhotometricFit, fit
from path.marker.photometric.known import Known, Memory
from path.marker.photometric.texture import cells
from path.marker.printed import MIN_BORDER, Look, aligned, look
from path.marker.search.find import search
from path.marker.track import recognise
from path.observations import MarkerDetection, Region

Refine = Literal["photometric", "subpix"]

# a small region that shows nothing is searched once more, enlarged
RETRY_SCALE = 2.0
RETRY_PIXELS = 4.0e4
MIN_EXPLAINED = 0.85  # of the image's variance, for the fit to be trusted
# grey levels, from black to white: what a camera can show, and a little beyond for what it cuts off
MIN_CONTRAST = 8.0
MAX_CONTRAST = 300.0
# correlation with the printed pattern below which a quadrilateral is no marker
MIN_LIKENESS = 0.5
SURE_LIKENESS = 0.88  # from which on its corners are those of the print
CELLS_OF_ONE = 9  # bits of the code for each cell of the print that may seem wrong
MIN_BARE_BORDER = 0.7  # light around the frame below which there is hardly any border
BITS_OF_ONE = 16  # of so many bits of the code one may be wrong: more is another code
MOST_OFF = 0.5  # of a side, that a corner that was found may be from where the print has it
SUBPIX_MOST_PX = 1.5  # that a corner is from where the print has it, as far as that tells
# per axis; common to all corners, towards the centre or away from it
SUBPIX_SIGMA_PX = 0.35
SUBPIX_RADIAL_PX = 0.5


def detect_markers(
    image: NDArray[np.uint8],
    region: Region | None,
    layout: MarkerLayout,
    camera: CameraModel,
    *,
    refine: Refine = "photometric",
    expected: Pose | None = None,
    memory: Memory | None = None,
) -> tuple[MarkerDetection, ...]:
    """Markers of the layout in a region.

    Args:
        image: uint8, (height, width, 3) BGR or (height, width) grey, distorted as the lens gives
            it.
        region: where to look; None for the whole image.
        refine: how corners are refined. "photometric" falls back to "subpix", with its larger
            covariance, where the image does not look like the print.
        expected: ``T_c_v`` good to about a cell of the print. Markers that are there are recognised
            without a search; when one is not, the region is searched. Only for "photometric".
        memory: what earlier frames told of each marker as this camera sees it, bettered by this
            one; with it a fit in a frame takes a third of the time. Not for two cameras.

    Returns:
        Detections by id. A marker that is seen in two places is there twice.
    """
    area = (region or Region(0.0, 0.0, math.inf, math.inf)).clipped(image.shape[1], image.shape[0])
    if area is None:
        return ()
    if expected is not None and refine == "photometric":
        tracked = _tracked(image, expected, layout, camera, memory)
        if tracked:
            return tracked
    u0 = int(area.x0)
    v0 = int(area.y0)
    cut = image[v0 : math.ceil(area.y1), u0 : math.ceil(area.x1)]
    grey = np.ascontiguousarray(
        cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY) if cut.ndim == 3 else cut, dtype=np.uint8
    )
    scales = (1.0, RETRY_SCALE) if grey.size <= RETRY_PIXELS else (1.0,)
    found: list[MarkerDetection] = []
    for scale in scales:
        for marker_id, quad in _searched(grey, layout, scale):
            pattern = quiet(layout.dictionary, marker_id)
            known = _known_of(marker_id, pattern, memory, tracked=expected is not None)
            refined = refine_corners(grey, (u0, v0), quad, pattern, camera, refine, known)
            if refined is not None:
                if memory is not None:
                    memory[marker_id] = known
                found.append(MarkerDetection(marker_id, *refined))
        if found:
            break
    return tuple(sorted(found, key=lambda detection: detection.marker_id))


def _tracked(
    image: NDArray[np.uint8],
    expected: Pose,
    layout: MarkerLayout,
    camera: CameraModel,
    memory: Memory | None,
) -> tuple[MarkerDetection, ...]:
    """All markers that an expected pose shows, with photometric corners; nothing when one of them
    has none.
    """
    found: list[MarkerDetection] = []
    for seen in recognise(image, expected, layout, camera) or ():
        pattern = quiet(layout.dictionary, seen.marker_id)
        bordered = seen.border >= MIN_BORDER
        known = None
        if memory is not None:
            known = memory[seen.marker_id] = _known_of(seen.marker_id, pattern, memory)
        fitted = trusted_fit(
            seen.grey,
            seen.offset,
            seen.quad,
            pattern,
            camera,
            near=True,
            border=bordered,
            known=known,
        )
        if fitted is None:
            return ()
        found.append(MarkerDetection(seen.marker_id, fitted.corners_px, fitted.covariance_px2))
    return tuple(sorted(found, key=lambda detection: detection.marker_id))


def _known_of(
    marker_id: int, pattern: Array, memory: Memory | None, *, tracked: bool = True
) -> Known:
    """What is known of a marker: by its own earlier frames where it is tracked, else by what others
    told of the camera.
    """
    seen = memory or {}
    own = seen.get(marker_id) if tracked else None
    return own or Known.among(
        (each for i, each in seen.items() if i != marker_id), len(pattern) - 2
    )


def _searched(
    grey: NDArray[np.uint8], layout: MarkerLayout, scale: float
) -> list[tuple[int, Array]]:
    """As ``search``, in the image so many times enlarged."""
    if scale == 1.0:
        return search(grey, layout)
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found = search(np.ascontiguousarray(large, np.uint8), layout)
    return [(marker_id, (quad + 0.5) / scale - 0.5) for marker_id, quad in found]


def _side(quad: Array) -> float:
    return float(np.mean(np.hypot(*(np.roll(quad, -1, axis=0) - quad).T)))


def refine_corners(
    grey: NDArray[np.uint8],
    offset: tuple[int, int],
    quad: Array,
    pattern: Array,
    camera: CameraModel,
    refine: Refine = "photometric",
    known: Known | None = None,
) -> tuple[Array, Array] | None:
    """Corners of one marker, good to about a pixel, refined; None when the image there is not the
    print.

    Args:
        grey: uint8, C-contiguous; its pixel (0, 0) is the camera's pixel ``offset``.
        quad: corners as found, (4, 2) in pixels of ``grey``. Where they do not show the whole
            print they are first brought to where the inside of the print has them: something may
            cover one.
        pattern: cells of the print with a border of white ones, 0 black and 1 white.

    Returns:
        Corners (4, 2) in the camera's evenly spaced pixels and their covariance (8, 8).
    """
    placed = _on_print(grey, quad, pattern)
    if placed is None:
        return None
    start, seen = placed
    bordered = seen.border >= MIN_BORDER
    if refine == "photometric":
        fitted = trusted_fit(grey, offset, start, pattern, camera, border=bordered, known=known)
        if fitted is not None:
            # what does not fit counts less and less: the fit may have ended on another code
            ended = start + fitted.corners_px - camera.even(start + offset)
            ended_on = look(grey, np.ascontiguousarray(ended), pattern)
            return (
                (fitted.corners_px, fitted.covariance_px2) if _is_code(ended_on, pattern) else None
            )
    # where the border begins is the only place that is looked at from here on
    if not bordered or (refine == "photometric" and not _is_whole(seen)):
        return None
    corners, covariance = _subpix(grey, start, pattern.shape[0] - 2)
    by_print = aligned(grey, start, pattern)
    if by_print is None:
        return None
    # one that the print has elsewhere, as under something that covers it, is as doubtful as that
    off2 = (corners - by_print) ** 2
    covariance += np.diag(
        np.where(off2.sum(axis=1, keepdims=True) > SUBPIX_MOST_PX**2, off2, 0.0).ravel()
    )
    return camera.even(corners + offset), covariance


def _on_print(grey: NDArray[np.uint8], quad: Array, pattern: Array) -> tuple[Array, Look] | None:
    """Corners good enough to refine, and what is seen between them; None when that is not the
    print.
    """
    seen = look(grey, quad, pattern)
    if seen.likeness < MIN_LIKENESS:
        return None
    if _is_whole(seen):
        return quad, seen
    # something covers a corner or there is no border; or it is small and dim
    start = aligned(grey, quad, pattern)
    if start is None or float(np.abs(start - quad).max()) > MOST_OFF * _side(quad):
        return None
    inside = look(grey, start, pattern)
    # its edges were there already: another code is not this one for being bent until it is like it
    if inside.border < MIN_BORDER <= seen.border:
        return None
    return (start, inside) if _is_code(inside, pattern) else None


def _is_code(seen: Look, pattern: Array) -> bool:
    """Return whether it is this code that is seen; without a border around it every cell has to
    agree.
    """
    if seen.border < MIN_BARE_BORDER and seen.wrong > 0.0:
        return False
    bits = (len(pattern) - 4) ** 2
    cells_wrong = round(seen.wrong * (len(pattern) - 2) ** 2)
    return cells_wrong <= bits // CELLS_OF_ONE and seen.bits <= bits // BITS_OF_ONE


def _is_whole(seen: Look) -> bool:
    return seen.likeness >= SURE_LIKENESS and seen.wrong == 0.0 and seen.border >= MIN_BORDER


def trusted_fit(
    grey: NDArray[np.uint8],
    offset: tuple[int, int],
    quad: Array,
    pattern: Array,
    camera: CameraModel,
    *,
    near: bool = False,
    border: bool = True,
    known: Known | None = None,
) -> PhotometricFit | None:
    """The photometric fit from corners that were found, see ``refine_corners``; None where it is not to be
    trusted.

    ``near``: the corners are good to half a pixel. ``border``: there is a white border around the
    print.
    """
    start = camera.even(quad + offset)
    fitted = fit(grey, offset, start, camera, pattern, near=near, border=border, known=known)
    if (
        fitted is None
        or fitted.explained < MIN_EXPLAINED
        or not MIN_CONTRAST <= fitted.contrast <= MAX_CONTRAST
        or float(np.abs(fitted.corners_px - start).max()) >= max(2.0, 0.15 * _side(quad))
    ):
        if known is not None:
            known.forget()
        return None
    return fitted


@lru_cache(maxsize=64)
def quiet(dictionary: str, marker_id: int) -> Array:
    """The pattern within a border of white cells."""
    return np.pad(cells(dictionary, marker_id), 1, constant_values=1.0)


def _subpix(grey: NDArray[np.uint8], quad: Array, cells_across: int) -> tuple[Array, Array]:
    """Saddle-point refinement, with a covariance that admits its bias along the diagonals."""
    half = max(1, min(5, round(0.6 * _side(quad) / cells_across)))
    points = quad.astype(np.float32).reshape(4, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    corners = (
        cv2.cornerSubPix(grey, points, (half, half), (-1, -1), criteria)
        .reshape(4, 2)
        .astype(np.float64)
    )
    if not np.all(np.isfinite(corners)) or float(np.abs(corners - quad).max()) > half + 1.0:
        corners = quad
    out = corners - corners.mean(axis=0)
    radial = (out / np.hypot(out[:, 0], out[:, 1])[:, None]).ravel()
    return corners, SUBPIX_SIGMA_PX**2 * np.eye(8) + SUBPIX_RADIAL_PX**2 * np.outer(radial, radial)
