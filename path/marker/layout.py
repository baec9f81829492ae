"""The layout of printed markers in frame ``v``. Nothing heavy is imported here: rigs are decoded
with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from path.geometry.transforms import Matrix, Pose

# every marker is printed with a white border of at least one cell around its black frame
QUIET_CELLS = 1.0

_SIZES = {
    f"DICT_{bits}X{bits}_{count}": (bits, count)
    for bits in (4, 5, 6, 7)
    for count in (50, 100, 250, 1000)
}
DICTIONARIES: dict[str, tuple[int, int]] = {
    **_SIZES,
    "DICT_ARUCO_ORIGINAL": (5, 1024),
    "DICT_APRILTAG_16h5": (4, 30),
    "DICT_APRILTAG_25h9": (5, 35),
    "DICT_APRILTAG_36h10": (6, 2320),
    "DICT_APRILTAG_36h11": (6, 587),
}
"""OpenCV's predefined dictionaries: name -> (bits along a side, number of markers)."""


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """One printed fiducial. Its own frame ``m``: origin at the centre, x right and y up as printed,
    z to the viewer.

    Attributes:
        id: id in the dictionary of the layout.
        side_m: outer side of the black frame, as measured on the print.
        side_sigma_m: how well that is known (standard deviation). It scales every distance measured
            with the marker.
        T_v_m: where it sits in frame ``v``.
        corners_v: shape (4, 3), metres in ``v``: top-left, top-right, bottom-right, bottom-left as
            printed.

    Raises:
        ValueError: naming the field that cannot be right.
    """

    id: int
    side_m: float
    side_sigma_m: float
    T_v_m: Pose
    corners_v: Matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.side_m) and self.side_m > 0.0):
            raise ValueError(f"side_m: {self.side_m!r} is not a positive length in metres")
        if not 0.0 <= self.side_sigma_m < 0.5 * self.side_m:
            raise ValueError(
                f"side_sigma_m: {self.side_sigma_m!r} is not between 0 and half the side {self.side_m!r}"
            )
        h = 0.5 * self.side_m
        corners_m = np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
        object.__setattr__(self, "corners_v", self.T_v_m.apply(corners_m))


@dataclass(frozen=True, slots=True, eq=False)
class MarkerLayout:
    """The markers that make up frame ``v``, all of one dictionary.

    Raises:
        ValueError: for an unknown dictionary, no marker, an id twice, or an id the dictionary does
            not have.
    """

    markers: tuple[Marker, ...]
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if self.dictionary not in DICTIONARIES:
            raise ValueError(
                f"dictionary: {self.dictionary!r} is none of {', '.join(DICTIONARIES)}"
            )
        if not self.markers:
            raise ValueError("markers: a layout needs at least one")
        count = DICTIONARIES[self.dictionary][1]
        for marker in self.markers:
            if not 0 <= marker.id < count:
                raise ValueError(
                    f"id: {self.dictionary} has no marker {marker.id!r}, only 0..{count - 1}"
                )
            if sum(other.id == marker.id for other in self.markers) > 1:
                raise ValueError(f"id: marker {marker.id} is in the layout more than once")

    def marker(self, marker_id: int) -> Marker | None:
        """The marker of this id, None when the layout has none."""
        for marker in self.markers:
            if marker.id == marker_id:
                return marker
        return None


def single_marker(
    side_m: float = 0.04,
    side_sigma_m: float = 0.0002,
    marker_id: int = 0,
    dictionary: str = "DICT_4X4_50",
) -> MarkerLayout:
    """The paper's layout: one marker, whose own frame is ``v``."""
    return MarkerLayout(
        (Marker(marker_id, side_m, side_sigma_m, Pose(np.eye(3), np.zeros(3))),), dictionary
    )
