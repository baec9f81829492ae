"""Two people one behind the other are one box to a detector: the track of one of them stays where
that one is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from flight.guidance import Vec3, norm
from flight.tracking.association import Sighting, follow
from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import is_cut
from flight.tracking.target_track import TargetTrack
from path.config import EvidenceConfig, MethodConfig
from path.observations import Box, Depth, Detection, MissReason, Region
from tests.flight.tracking.test_standing_out import CAMERA, PLACE, SECOND, T_N_C, Upright, settled

BEHIND: Vec3 = (PLACE[0] + 2.4, PLACE[1] + 0.3, PLACE[2])


@dataclass
class InOneBox(Upright):
    """The first body and all behind it in one box, which the image's border cuts, and which is
    scored low for that.

    ``shown``: whether depth shows the first one.
    """

    shown: bool = True

    def targets(self, region: Region | None) -> Sequence[Detection]:
        boxes = [box for box, _ in self.boxes()]
        x0, y0 = min(box.x for box in boxes), max(0.0, min(box.y for box in boxes))
        x1, y1 = max(box.x + box.w for box in boxes), max(box.y + box.h for box in boxes)
        found = Detection(Box(x0, y0, x1 - x0, y1 - y0), 0.18)
        return [found] if region is None or region.contains(*found.box.center) else []

    def depth(self, box: Box) -> Depth | None:
        return super().depth(box) if self.shown else None


def kept(track: TargetTrack, seconds: float, place: Vec3 = PLACE, *, shown: bool = True) -> None:
    """The target is at a place, or on its way to it, and one box is around it and another one
    behind it.
    """
    begun_ns = track.stamp_ns
    frames = round(50 * seconds)
    for k in range(1, frames + 1):
        north, east, down = (a + (b - a) * k / frames for a, b in zip(PLACE, place, strict=True))
        view = InOneBox([(north, east, down), BEHIND], (), begun_ns + k * SECOND // 50, shown=shown)
        (found,) = view.targets(None)
        assert is_cut(found.box, CAMERA)
        # no evidence for the other drone
        assert follow(view, T_N_C, CAMERA, track) is MissReason.AMBIGUOUS_TARGET
    assert track.stamp_ns == begun_ns + frames * SECOND // 50


@pytest.mark.parametrize("shown", [True, False])
def test_a_box_around_two_that_the_border_cuts_does_not_move_the_track(shown: bool) -> None:
    """The middle of what is in view of that box is half a metre farther on."""
    track = settled()
    kept(track, 3.0, shown=shown)
    assert math.dist(track.position_n_m, PLACE) < 0.1
    assert norm(track.velocity_n_mps) < 0.1
    back = Upright([PLACE], [0], track.stamp_ns + SECOND // 50)
    assert isinstance(follow(back, T_N_C, CAMERA, track), Sighting)
    assert norm(track.velocity_n_mps) < 0.1  # D1 flies by it


def test_depth_shows_where_in_such_a_box_the_target_goes() -> None:
    track = settled()
    aside = (PLACE[0] - 0.4, PLACE[1], PLACE[2])
    kept(track, 2.0, aside)
    assert math.dist(track.position_n_m, aside) < 0.2
    assert math.dist(track.velocity_n_mps, (-0.2, 0.0, 0.0)) < 0.12


def test_without_a_sighting_such_a_box_keeps_a_track_for_a_while_only() -> None:
    track = settled()
    begun_ns = track.whole_ns
    for k in range(1, 400):
        view = InOneBox([PLACE, BEHIND], (), begun_ns + k * SECOND // 50, shown=False)
        follow(view, T_N_C, CAMERA, track)
    assert 4.5 * SECOND < track.stamp_ns - begun_ns < 5.5 * SECOND


def test_one_box_around_it_does_not_make_a_nearer_one_the_target() -> None:
    """Another one comes before it, less than a metre away: what the depth shows then is not the
    target.
    """
    track = settled()
    begun_ns = track.stamp_ns
    for k in range(1, 51):
        nearer = (PLACE[0] - 0.9, PLACE[1] - 0.1 + 0.004 * k, PLACE[2])
        view = InOneBox([PLACE, nearer, BEHIND], (), begun_ns + k * SECOND // 50)
        follow(view, T_N_C, CAMERA, track)
    assert math.dist(track.position_n_m, PLACE) < 0.15


STATED = MethodConfig(evidence=EvidenceConfig(span_m=0.77, height_m=1.75))


@pytest.mark.parametrize("stated", [True, False])
def test_a_box_larger_than_the_target_can_be_is_never_its_own(stated: bool) -> None:
    """Where the size is not stated, what has looked so for 3 s is the target."""
    track = TargetTrack(
        PLACE, 0, carry_s=6.0, largest=LargestBox.of(CAMERA, STATED if stated else MethodConfig())
    )
    for k in range(1, 51):
        assert isinstance(
            follow(Upright([PLACE], [0], k * SECOND // 50), T_N_C, CAMERA, track), Sighting
        )
    own_m, taken = track.size_m, False
    for k in range(51, 351):
        view = Upright([PLACE], [], k * SECOND // 50)
        box, _ = view.boxes()[0]
        found = Detection(
            Box(box.x - 0.6 * box.w, box.y - 0.1 * box.h, 2.2 * box.w, 1.2 * box.h), 0.9
        )
        view.targets = lambda region, found=found: [found]  # type: ignore[method-assign]
        taken = taken or isinstance(follow(view, T_N_C, CAMERA, track), Sighting)
    assert taken is not stated
    assert (track.size_m == own_m) is stated
    if stated:
        assert math.dist(track.position_n_m, PLACE) < 0.1
