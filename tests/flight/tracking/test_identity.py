"""A box is offered only while it is the designated object's for sure; else it is followed, and the
frame is a miss.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from flight.config import FollowConfig, MissionConfig
from flight.guidance import Vec3
from flight.tracking.association import Sighting, follow
from flight.tracking.candidates import Candidates
from flight.tracking.target_track import TargetTrack
from path.belief import boxes
from path.belief.motion import along_ray
from path.config import MethodConfig
from path.observations import Box, Depth, Detection, MissReason, Region
from tests.flight.tracking.test_association import CAMERA, PLACE, SECOND, T_N_C, FakeView, beside

FRAME_NS = SECOND // 50


def followed(*east_m: float) -> TargetTrack:
    """A track of what is at PLACE, a second old, with others so far to the east of it."""
    track = TargetTrack.of(MissionConfig(), PLACE, 0)
    for k in range(51):
        view = FakeView([PLACE, *(beside(PLACE, each) for each in east_m)], k * FRAME_NS)
        assert isinstance(follow(view, T_N_C, CAMERA, track), Sighting)
    return track


def test_what_is_alone_is_the_one() -> None:
    track = followed()
    view = FakeView([PLACE], track.stamp_ns + FRAME_NS)
    follow(view, T_N_C, CAMERA, track)
    assert track.identity is not None
    assert track.identity.of(view.boxes()[0]) > 1.0 - 1e-6


class InFloat32(FakeView):
    """Boxes as networks say them."""

    def boxes(self) -> list[Box]:
        return [Box(*np.array((b.x, b.y, b.w, b.h), np.float32)) for b in super().boxes()]


def test_nothing_is_compiled_in_flight_for_boxes_in_float32() -> None:
    kernels = (along_ray, boxes._beyond, boxes._likelier, boxes._inside)
    track = followed()
    before = [len(each.signatures) for each in kernels]
    candidates = Candidates(CAMERA, MethodConfig(), 0.01, 1.0, 1.0, flies=False)
    for k in (1, 2):
        view = InFloat32([PLACE], track.stamp_ns + k * FRAME_NS)
        assert isinstance(follow(view, T_N_C, CAMERA, track), Sighting)
        assert candidates.look(view, T_N_C, PLACE[2])
    assert [len(each.signatures) for each in kernels] == before


def test_what_stands_beside_it_is_not_the_one() -> None:
    track = followed(0.35)
    view = FakeView([PLACE, beside(PLACE, 0.35)], track.stamp_ns + FRAME_NS)
    follow(view, T_N_C, CAMERA, track)
    assert track.identity is not None
    target, other = view.boxes()
    assert track.identity.of(target) > 1.0 - 1e-4
    assert track.identity.of(other) < 1e-4


@pytest.mark.parametrize(("gap_s", "offered"), [(0.2, True), (4.0, False)])
def test_one_of_two_that_were_out_of_sight_for_long_is_followed_and_not_offered(
    gap_s: float, offered: bool
) -> None:
    track = followed(0.35)
    stamp_ns = track.stamp_ns + round(gap_s * SECOND)
    offers: list[bool] = []
    reasons: set[MissReason] = set()
    for k in range(250):
        both = [PLACE, beside(PLACE, 0.35)]
        seen = follow(FakeView(both, stamp_ns + k * FRAME_NS), T_N_C, CAMERA, track)
        offers.append(isinstance(seen, Sighting))
        if isinstance(seen, MissReason):
            reasons.add(seen)
    assert any(offers) is offered
    assert offered or MissReason.AMBIGUOUS_TARGET in reasons


def test_another_one_that_walks_through_the_place_of_one_that_is_missed_is_not_gone_after() -> None:
    """The detector misses the target for a second and a half, and finds the other one in every
    frame.
    """
    track = TargetTrack.of(MissionConfig(follow=FollowConfig(carry_s=0.0)), PLACE, 0)

    def other(k: int) -> Vec3:
        return beside(PLACE, 0.9 - 0.5 * k / 50)

    def seen(k: int, places: Sequence[Vec3]) -> Sighting | MissReason:
        return follow(FakeView(places, k * FRAME_NS), T_N_C, CAMERA, track)

    for k in range(50):
        assert isinstance(seen(k, [PLACE, other(k)]), Sighting)
    for k in range(50, 125):
        assert isinstance(seen(k, [other(k)]), MissReason)
    assert math.dist(track.position_n_m, PLACE) < 0.1
    after = [seen(k, [PLACE, other(k)]) for k in range(125, 150)]
    assert isinstance(after[-1], Sighting)
    assert after[-1].box == FakeView([PLACE]).boxes()[0]


def test_the_designated_object_is_gone_after_where_the_track_had_gone_over_to_another() -> None:
    """The belief has both of them all the time: the track is taken back to its own."""
    track = followed(0.5)
    track.position_n_m = beside(PLACE, 0.5)
    view = FakeView([PLACE, beside(PLACE, 0.5)], track.stamp_ns + FRAME_NS)
    seen = follow(view, T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting)
    assert seen.box == view.boxes()[0]
    assert math.dist(track.position_n_m, PLACE) < 0.05


@pytest.mark.parametrize(("unseen_s", "taken"), [(0.1, False), (1.0, True)])
def test_whom_nobody_kept_for_a_while_is_looked_for_where_it_most_likely_is(
    unseen_s: float, taken: bool
) -> None:
    """And not offered: it is followed, to be seen when it is sure again."""
    track = followed(0.5)
    assert track.identity is not None and track.identity.belief is not None
    own, other = track.identity.belief.tracks
    own.identity, other.identity = 0.7, 0.3
    stamp_ns = track.stamp_ns + FRAME_NS
    track.position_n_m = beside(PLACE, 3.0)
    track.stamp_ns -= round(unseen_s * SECOND)
    seen = follow(FakeView([PLACE, beside(PLACE, 0.5)], stamp_ns), T_N_C, CAMERA, track)
    assert isinstance(seen, MissReason)
    assert (math.dist(track.position_n_m, PLACE) < 0.05) is taken


def test_a_box_that_the_border_cuts_is_known_to_be_cut_along_that_side() -> None:
    class WithoutDepth(FakeView):
        def depth(self, box: Box) -> Depth | None:
            return None

    track = followed()
    assert track.identity is not None
    (inside,) = FakeView([PLACE]).targets(None)
    for box, cut in (
        (inside.box, (False, False)),
        (replace(inside.box, x=0.0), (True, False)),
        (replace(inside.box, y=CAMERA.height - inside.box.h), (False, True)),
    ):
        view = WithoutDepth([PLACE], track.stamp_ns)
        measured = track.identity._measured(
            view, T_N_C, CAMERA, replace(inside, box=box), PLACE[2], 2.0
        )
        assert measured.cut == cut


def test_what_is_known_beside_the_target_is_looked_at_as_long_as_it_is_in_view() -> None:
    """Else it is as good as out of sight, and comes back as nobody knows whom."""
    track = TargetTrack.of(MissionConfig(), PLACE, 0)
    asked: list[Region | None] = []

    class Asked(FakeView):
        def targets(self, region: Region | None) -> Sequence[Detection]:
            asked.append(region)
            return super().targets(region)

    for k in range(100):
        places = [PLACE, beside(PLACE, 0.4 + 0.5 * k / 50)]
        follow(Asked(places, k * FRAME_NS), T_N_C, CAMERA, track)
    region = asked[-1]
    assert region is not None
    assert region.contains(*FakeView([beside(PLACE, 1.39)]).boxes()[0].center)
