"""Who was out of sight is taken again only where nothing else can be taken for them, as a detector
misses people.
"""

from __future__ import annotations

import math
from typing import Any, cast

import pytest

from flight.tracking.association import Sighting, follow
from path.observations import Box, MissReason, Region
from tests.flight.tracking.test_association import (
    CAMERA,
    PLACE,
    SECOND,
    T_N_C,
    FakeView,
    beside,
    settled,
)


@pytest.mark.parametrize(("later_s", "found"), [(0.3, False), (2.8, False), (3.2, True)])
def test_what_was_lately_seen_there_with_another_one_is_not_taken_when_it_is_alone(
    later_s: float, found: bool
) -> None:
    """A detector misses objects for half a second and more: that one is alone in a frame says
    little.
    """
    track = settled(PLACE)
    both_ns = track.stamp_ns + SECOND
    both = FakeView([beside(PLACE, 0.5), beside(PLACE, -0.5)], both_ns)
    assert isinstance(follow(both, T_N_C, CAMERA, track), MissReason)
    alone = FakeView([beside(PLACE, 0.2)], both_ns + round(later_s * SECOND))
    seen = follow(alone, T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting) if found else seen is MissReason.AMBIGUOUS_TARGET


@pytest.mark.parametrize(("identity", "found"), [(0.99, True), (0.9, False)])
def test_the_belief_may_be_sure_of_who_stood_with_others_where_it_was_out_of_sight(
    identity: float, found: bool
) -> None:
    """Hidden for 1.5 s with another one 1.4 m away, D2 never took a target again that stood
    still.
    """
    track = settled(PLACE)
    track.identity = cast(Any, Believed(identity))
    seen_ns = track.stamp_ns + round(1.5 * SECOND)
    track.note_company(seen_ns)
    seen = follow(FakeView([PLACE, beside(PLACE, 0.9)], seen_ns), T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting) if found else seen is MissReason.AMBIGUOUS_TARGET


class Believed:
    """A belief that gives every box the same probability."""

    def __init__(self, identity: float) -> None:
        self._identity = identity

    def region(self, own: Region | None, *_: object) -> Region | None:
        return own

    def note(self, *_: object) -> None: ...

    def shown(self, _least: float) -> None: ...

    def is_other(self, _box: Box) -> bool:
        return False

    def of(self, _box: Box) -> float:
        return self._identity


@pytest.mark.parametrize(
    ("before_m", "reason"),
    [
        (0.9, MissReason.OCCLUDED),
        (0.05, MissReason.NO_TARGET),
        (-0.5, MissReason.NO_TARGET),
        (-math.inf, MissReason.NO_TARGET),
    ],
)
def test_a_miss_says_where_depth_shows_something_in_front_of_the_target(
    before_m: float, reason: MissReason
) -> None:
    track = settled(PLACE)
    _, z_m = FakeView([])._seen(PLACE)
    view = FakeView([], track.stamp_ns + SECOND // 5, hidden_behind_m=z_m - before_m)
    assert follow(view, T_N_C, CAMERA, track) is reason


@pytest.mark.parametrize(("gap_s", "found"), [(0.3, True), (0.7, False)])
def test_what_is_much_smaller_is_not_taken_for_a_target_that_was_out_of_sight(
    gap_s: float, found: bool
) -> None:
    """Its box was around two, and this is one of them: nobody knows which."""
    track = settled(PLACE)
    assert track.size_m is not None
    wide_m, high_m = track.size_m
    track.note_size((1.5 * wide_m, 1.5 * high_m), track.stamp_ns)
    seen = follow(FakeView([PLACE], track.stamp_ns + round(gap_s * SECOND)), T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting) if found else seen is MissReason.AMBIGUOUS_TARGET


@pytest.mark.parametrize(
    ("behind_m", "has_depth", "found"),
    [(1.6, True, True), (0.3, True, False), (-0.7, True, False), (1.6, False, False)],
)
def test_what_is_too_far_behind_is_not_taken_for_a_target_that_was_out_of_sight(
    behind_m: float, has_depth: bool, found: bool
) -> None:
    """The target passed in front of another one. What is in front of it may hide it: that tells
    nothing.
    """
    track = settled(PLACE)
    north, east, down = PLACE
    along = 1.0 + behind_m / math.dist(PLACE, T_N_C.t)
    ray = north - T_N_C.t[0], east + 0.2 - T_N_C.t[1], down - T_N_C.t[2]
    other = ray[0] * along + T_N_C.t[0], ray[1] * along + T_N_C.t[1], ray[2] * along + T_N_C.t[2]
    view = FakeView([PLACE, other], track.stamp_ns + round(0.7 * SECOND), has_depth=has_depth)
    seen = follow(view, T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting) if found else seen is MissReason.AMBIGUOUS_TARGET
