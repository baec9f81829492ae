"""Markers where they are expected: recognised by their whole print, without a search for
quadrilaterals.

The image around the place where a marker must be is brought into the marker's own plane, where its
print is a small picture that is known. Where that correlates best is the marker, good to a third of
a pixel, which a fit starts from. Every cell must be as printed, so that no other marker is taken
for this one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.kernels import Array
from path.marker.layout import MarkerLayout
from path.marker.photometric.texture import cells
from path.marker.track_kernels import MARGIN, SAMPLES, read, seen_at

# of the angle between normal and line of sight: a marker that is turned farther is not expected
LEAST_COSINE = 0.26
LEAST_SIDE_PX = 14.0  # below which cells are too small to be read
MIN_TRACKED_LIKENESS = 0.75  # correlation with the print


@dataclass(frozen=True, slots=True)
class Recognised:
    """A marker where it was expected.

    Attributes:
        quad: corners (4, 2) in pixels of ``grey``, good to about a third of a pixel.
        grey: the part of the image that shows it, C-contiguous; its first pixel is the camera's
            pixel ``offset``.
        border: light around the frame, as of ``path.marker.printed.Look``.
    """

    marker_id: int
    quad: Array
    grey: NDArray[np.uint8]
    offset: tuple[int, int]
    border: float


def recognise(
    image: NDArray[np.uint8],
    T_c_v: Pose,
    layout: MarkerLayout,
    camera: CameraModel,
) -> list[Recognised] | None:
    """Every marker of the layout that an expected pose turns to the camera; None when one of them
    is not there.

    Args:
        image: as for ``detect_markers``.
        T_c_v: the pose of ``v``, good to about a cell of the print.
    """
    seen: list[Recognised] = []
    lens = lens_of(camera)
    R = np.ascontiguousarray(T_c_v.R)
    t = T_c_v.t
    for marker in layout.markers:
        pattern = cells(layout.dictionary, marker.id)
        cosine, quad, H = seen_at(lens, R, t, marker.corners_v, len(pattern))
        if cosine < LEAST_COSINE:
            continue
        found = _recognised(image, quad, H, marker.id, layout.dictionary)
        if found is None:
            return None
        seen.append(found)
    return seen or None


def _recognised(
    image: NDArray[np.uint8],
    quad: Array,
    H: Array,
    marker_id: int,
    dictionary: str,
) -> Recognised | None:
    """One marker near ``quad``; ``H`` is the homography from its plane, as it is sampled, to the
    image.
    """
    pattern = cells(dictionary, marker_id)
    n = len(pattern)
    (u0, v0), (u1, v1) = quad.min(axis=0).tolist(), quad.max(axis=0).tolist()
    reach = max(u1 - u0, v1 - v0)
    room = (MARGIN + 1) * reach / n
    u = math.floor(u0 - room)
    v = math.floor(v0 - room)
    u_end = math.ceil(u1 + room)
    v_end = math.ceil(v1 + room)
    if not (
        reach >= LEAST_SIDE_PX
        and u >= 0
        and v >= 0
        and u_end < image.shape[1]
        and v_end < image.shape[0]
    ):
        return None
    cut = image[v : v_end + 1, u : u_end + 1]
    grey = np.ascontiguousarray(
        cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY) if cut.ndim == 3 else cut, dtype=np.uint8
    )
    H[0] -= u * H[2]
    H[1] -= v * H[2]
    side = SAMPLES * (n + 2 * MARGIN)
    patch = cv2.warpPerspective(
        grey,
        H,
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    likeness = cv2.matchTemplate(patch, _wanted(dictionary, marker_id), cv2.TM_CCOEFF_NORMED)
    start = np.empty((4, 2))
    border = read(likeness, patch, pattern, H, MIN_TRACKED_LIKENESS, start)
    return None if math.isnan(border) else Recognised(marker_id, start, grey, (u, v), border)


@lru_cache(maxsize=64)
def _wanted(dictionary: str, marker_id: int) -> NDArray[np.uint8]:
    """The print with half a cell of its border, as it is sampled, a little blurred. Shared: do not
    change it.
    """
    print_ = np.pad(cells(dictionary, marker_id), 1, constant_values=1.0)
    large = np.kron(print_, np.full((SAMPLES, SAMPLES), 255.0)).astype(np.uint8)
    cut = SAMPLES // 2
    return np.ascontiguousarray(cv2.blur(large, (3, 3))[cut:-cut, cut:-cut], dtype=np.uint8)
