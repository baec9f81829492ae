"""A box is offered only while it is the designated object's for sure; else it is followed, and the frame is a miss."""

from __future__ import annotations

import pytest

from flight.config import MissionConfig
from flight.tracking.association import Sighting, follow
from flight.tracking.target_track import TargetTrack
from path.observations import MissReason
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


def test_what_stands_beside_it_is_not_the_one() -> None:
    track = followed(0.35)
    view = FakeView([PLACE, beside(PLACE, 0.35)], track.stamp_ns + FRAME_NS)
    follow(view, T_N_C, CAMERA, track)
    assert track.identity is not None
    target, other = view.boxes()
    assert track.identity.of(target) > 1.0 - 1e-4
    assert track.identity.of(other) < 1e-4


@pytest.mark.parametrize(("gap_s", "offered"), [(0.2, True), (4.0, False)])
def test_one_of_two_that_were_out_of_sight_for_long_is_followed_and_not_offered(gap_s: float, offered: bool) -> None:
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
