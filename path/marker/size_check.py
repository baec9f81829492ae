"""The size of a marker as the rig says it, held against depth that is measured on the marker
itself.

A marker's side scales every distance that is measured by it: one that is said to be 64 mm and is 40
makes a drone come so near as 40 to 64. Where the drone that looks has a depth camera, the same
marker is seen at two distances, one by its
side and the pose, one by its depth, and the side that would make them agree is the true one::

    true side = said side * measured depth / depth by the pose

How far the two may differ follows from the frame itself: the pose's and the depth's own standard
deviations, how well the side is known, and the scale that a depth camera has been measured to be
wrong by. Most of that is the same from frame to frame, so that many frames do not make it smaller:
they only keep single wild ones from deciding. Pure.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Callable, Sequence

from path.config import MethodConfig
from path.geometry.transforms import Matrix, Pose
from path.marker.layout import Marker, MarkerLayout
from path.observations import Box, Depth, MarkerDetection, RangeSource
from path.values import value

MEASURE = "measure the black square with a caliper, and say it as side_m in both rigs"
DEPTH_SCALE_SIGMA = 0.01
"""Of a depth camera's scale: half of what the D415's data sheet allows at 2 m."""
CERTAIN_SIGMAS = 5.0
LOOKS = 15
_INNER = 0.7  # of a marker's side: at its edges the depth is partly of what is behind
# a smaller marker is smaller than what a stereo camera compares, and has the depth of what is
# behind
_LEAST_PX = 12.0


@value
class SizeContradiction:
    """A marker that is not as large as the rig says, or a depth camera whose scale is wrong.

    Attributes:
        marker_id, said_m: the marker, and its side in the rig.
        depth_m, depth_sigma_m: the side that depth says, and its standard deviation.
        sigmas: how far apart the two are.
    """

    marker_id: int
    said_m: float
    depth_m: float
    depth_sigma_m: float
    sigmas: float

    def __str__(self) -> str:
        said = f"marker {self.marker_id} is {1000.0 * self.said_m:.1f} mm by the rig"
        found = f"{1000.0 * self.depth_m:.1f} +- {1000.0 * self.depth_sigma_m:.1f} mm by depth measured on it"
        off = self.depth_m / self.said_m
        other = f"is it right, the depth camera's scale or the focal length is wrong by {off:.2f}"
        return f"{said} and {found} ({self.sigmas:.0f} sigmas): {MEASURE}; {other}"


class SizeCheck:
    """The newest looks at one layout's markers, by their side and by depth."""

    def __init__(
        self,
        layout: MarkerLayout,
        method: MethodConfig,
        looks: int = LOOKS,
    ) -> None:
        self._markers = {marker.id: marker for marker in layout.markers}
        self._fraction = method.depth_center_fraction
        self._looks = looks
        self._newest: deque[tuple[Marker, float, float]] = deque(maxlen=looks)

    def look(
        self,
        T_c_v: Pose,
        covariance: Matrix,
        detections: Sequence[MarkerDetection],
        depth_over: Callable[[Box], Depth | None],
    ) -> None:
        """Take in one frame. Without depth on its largest marker it says nothing.

        Args:
            covariance: of ``T_c_v``, (6, 6), translation first, m.
            depth_over: the frame's depth over the middle of a box, as ``View.depth``.
        """
        known = [each for each in detections if each.marker_id in self._markers]
        if not known:
            return
        largest = max(known, key=_side_px)
        if _side_px(largest) < _LEAST_PX:
            return
        depth = depth_over(self._inner_box(largest))
        if depth is None or depth.source is not RangeSource.DEPTH:
            return
        marker = self._markers[largest.marker_id]
        by_pose_m = float(T_c_v.apply(marker.corners_v).mean(axis=0)[2])
        if by_pose_m <= 0.0:
            return
        sigma = math.hypot(
            math.sqrt(float(covariance[2, 2])) / by_pose_m,
            depth.sigma_m / depth.z_m,
            marker.side_sigma_m / marker.side_m,
            DEPTH_SCALE_SIGMA,
        )
        self._newest.append((marker, math.log(depth.z_m / by_pose_m), sigma))

    def by_depth_m(self) -> float | None:
        """Return the side that the newest looks say by depth; None while they are too few."""
        if len(self._newest) < self._looks:
            return None
        marker, _, _ = self._newest[-1]
        return marker.side_m * math.exp(
            statistics.median([log_ratio for _, log_ratio, _ in self._newest])
        )

    def contradiction(self) -> SizeContradiction | None:
        """Return what the newest looks say against the rig's size; None while they agree with it or
        are too few.
        """
        if len(self._newest) < self._looks:
            return None
        off = statistics.median([log_ratio / sigma for _, log_ratio, sigma in self._newest])
        depth_m = None if abs(off) < CERTAIN_SIGMAS else self.by_depth_m()
        if depth_m is None:
            return None
        marker, _, _ = self._newest[-1]
        sigma = statistics.median([sigma for _, _, sigma in self._newest])
        return SizeContradiction(marker.id, marker.side_m, depth_m, depth_m * sigma, abs(off))

    def _inner_box(self, detection: MarkerDetection) -> Box:
        """Return the box whose middle, which is all that is asked for depth, is the inner part of a
        marker.
        """
        low_x, low_y = detection.corners_px.min(axis=0).tolist()
        high_x, high_y = detection.corners_px.max(axis=0).tolist()
        wide = (high_x - low_x) * _INNER / self._fraction
        high = (high_y - low_y) * _INNER / self._fraction
        return Box(0.5 * (low_x + high_x - wide), 0.5 * (low_y + high_y - high), wide, high)


def _side_px(detection: MarkerDetection) -> float:
    corners: list[list[float]] = detection.corners_px.tolist()
    following = (*corners[1:], corners[0])
    sides = (math.dist(a, b) for a, b in zip(corners, following, strict=True))
    return sum(sides) / len(corners)
