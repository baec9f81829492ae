"""A body that stands out in depth carries the track of an object that the detector misses, and
nothing else does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from flight.guidance import Vec3
from flight.tracking.association import follow
from flight.tracking.standing_out import standing_out
from flight.tracking.target_track import TargetTrack
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, MarkerDetection, MissReason, Region

CAMERA = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0, (0.0, 0.0, 0.0, 0.0, 0.0))
C = math.sqrt(0.5)
T_N_C = Pose(np.array([[0.0, -C, C], [1.0, 0.0, 0.0], [0.0, C, C]]), np.array([0.0, 0.0, -3.5]))
PLACE: Vec3 = (2.2, 0.0, -0.9)
SECOND = 1_000_000_000
WIDE, HIGH, FAR_M = 0.5, 1.3, 5.6  # of a body, of its box across the line of sight; behind it


@dataclass
class Upright:
    """Bodies as wide and high as a person, upright, before something that is farther off.

    ``found``: those of them that the detector finds. ``before_m``: of what fills the image's left
    half.
    """

    places: Sequence[Vec3]
    found: Sequence[int] = ()
    stamp_ns: int = 0
    behind_m: float = FAR_M
    before_m: float = math.inf
    frame_id: int = 0

    def boxes(self) -> list[tuple[Box, float]]:
        boxes: list[tuple[Box, float]] = []
        for place in self.places:
            x, y, z = T_N_C.inverse().apply(np.array(place)).tolist()
            u, v = CAMERA.project_point((x, y, z))
            w, h = CAMERA.fx * WIDE / z, CAMERA.fy * HIGH / z
            boxes.append((Box(u - 0.5 * w, v - 0.5 * h, w, h), z))
        return boxes

    def targets(self, region: Region | None) -> Sequence[Detection]:
        boxes = self.boxes()
        return [
            Detection(boxes[k][0], 0.9)
            for k in self.found
            if region is None or region.contains(*boxes[k][0].center)
        ]

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        return []

    def depth(self, box: Box) -> Depth | None:
        ray = T_N_C.R @ (*CAMERA.ray(*box.center), 1.0)
        there = [self.behind_m, self.before_m if box.center[0] < 0.5 * CAMERA.width else math.inf]
        for north, east, _ in self.places:  # each is an upright plate that faces the camera
            z = (north - T_N_C.t[0]) / ray[0]
            _, across, down = T_N_C.t + z * ray
            if abs(across - east) <= 0.5 * WIDE and -1.75 <= down <= 0.0:
                there.append(float(z))
        return Depth(min(there), 0.02)

    def image(self) -> NDArray[np.uint8] | None:
        return None


def settled(carry_s: float = 6.0, *, flies: bool = False) -> TargetTrack:
    track = TargetTrack(PLACE, 0, flies=flies, carry_s=carry_s)
    for k in range(1, 51):
        follow(Upright([PLACE], [0], k * SECOND // 50), T_N_C, CAMERA, track)
    assert track.size_m is not None
    return track


def after(view_s: float, track: TargetTrack) -> int:
    return track.seen_ns + round(view_s * SECOND)


def walked(seconds: float, mps: float = 0.3) -> Vec3:
    return PLACE[0], PLACE[1] + mps * seconds, PLACE[2]


def test_a_missed_object_is_followed_by_its_depth() -> None:
    """It turns off to the side once it is missed; it is no sighting, and was not seen."""
    track = settled()
    seen_ns = track.seen_ns
    for k in range(1, 151):
        view = Upright([walked(k / 50)], (), after(k / 50, settled()))
        assert follow(view, T_N_C, CAMERA, track) is MissReason.NO_TARGET
    assert track.seen_ns == seen_ns and track.stamp_ns > seen_ns
    at, sigma_m = track.predict(track.stamp_ns)
    assert math.dist(at, walked(3.0)) < 0.15
    assert sigma_m > 0.04
    back = Upright([walked(3.0)], [0], track.stamp_ns + SECOND // 50)
    assert not isinstance(follow(back, T_N_C, CAMERA, track), MissReason)


def test_depth_carries_for_so_long_as_is_stated() -> None:
    track = settled(carry_s=1.0)
    begun_ns = track.seen_ns
    for k in range(1, 200):
        follow(Upright([PLACE], (), begun_ns + k * SECOND // 50), T_N_C, CAMERA, track)
    assert track.stamp_ns - begun_ns == SECOND
    track = settled(carry_s=0.0)
    follow(Upright([PLACE], (), after(0.02, track)), T_N_C, CAMERA, track)
    assert track.stamp_ns == track.seen_ns


@pytest.mark.parametrize(("gap_s", "carried"), [(0.4, True), (0.6, False)])
def test_depth_does_not_take_a_track_up_again_that_nothing_kept_for_a_while(
    gap_s: float, carried: bool
) -> None:
    """Another one may have come to the place of an object that was neither seen nor carried."""
    track = settled()
    seen_ns = track.stamp_ns
    follow(Upright([PLACE], (), after(gap_s, track)), T_N_C, CAMERA, track)
    assert (track.stamp_ns > seen_ns) is carried


def test_what_flies_is_not_carried() -> None:
    track = settled(flies=True)
    follow(Upright([PLACE], (), after(0.02, track)), T_N_C, CAMERA, track)
    assert track.stamp_ns == track.seen_ns


@pytest.mark.parametrize(
    "view",
    [
        Upright([PLACE, walked(1.0, 0.7)]),
        Upright([walked(1.0, 0.65)]),
        Upright([PLACE], before_m=1.5),
        Upright([]),
        Upright([PLACE], behind_m=3.4),
        Upright([PLACE, PLACE], [1]),
    ],
    ids=[
        "another beside it",
        "too far off",
        "something before it",
        "nothing",
        "ground as far as it",
        "a box of its own",
    ],
)
def test_what_may_be_something_else_carries_nothing(view: Upright) -> None:
    track = settled()
    view.stamp_ns = after(0.02, track)
    # another object, by its box, that is no box of the target: seen, and much larger
    if view.found:
        found = Detection(Box(200.0, 0.0, 400.0, 470.0), 0.9)
        view.targets = lambda region: [found]  # type: ignore[method-assign]
        track.whole_ns = -10 * SECOND
    follow(view, T_N_C, CAMERA, track)
    assert track.stamp_ns == track.seen_ns


def test_a_range_that_is_only_estimated_shows_nothing() -> None:
    class Estimated(Upright):
        def depth(self, box: Box) -> Depth | None:
            depth = super().depth(box)
            return None if depth is None else Depth(depth.z_m, 0.5)

    wide = CAMERA.fx * WIDE / 3.4
    (_, z_m) = Upright([PLACE]).boxes()[0]
    expected = Upright([PLACE]).boxes()[0][0].center
    assert standing_out(Upright([PLACE]), expected, z_m, wide, 60.0) is not None
    assert standing_out(Estimated([PLACE]), expected, z_m, wide, 60.0) is None
