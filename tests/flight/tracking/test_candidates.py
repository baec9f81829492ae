"""Objects from frame to frame before there is a target: which detection is whose, and how well its
place is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from flight.guidance import Vec3
from flight.tracking.candidates import (
    COASTED_S,
    REMEMBERED_S,
    STEADY_FRAMES,
    Candidate,
    Candidates,
    Observed,
    competing,
)
from path.belief.motion import Motion
from path.config import MethodConfig
from path.observations import Box, Depth, Detection
from tests.flight.tracking.test_association import CAMERA, T_N_C

FRAME_NS = 40_000_000
S = 1_000_000_000
SIDES = (60.0, 40.0)
FASTEST = 2.0
ANGLE = math.hypot(math.radians(1.0), MethodConfig().pixel_sigma_px / CAMERA.fx)


def box_at(place_n_m: Vec3) -> Box:
    x, y, z = T_N_C.inverse().apply(np.array(place_n_m)).tolist()
    u, v = CAMERA.project_point((x, y, z))
    return Box(u - 30.0, v - 20.0, *SIDES)


@dataclass
class View:
    places: list[Vec3]
    stamp_ns: int = 0
    depth_sigma_m: float | None = 0.02
    scores: list[float] = field(default_factory=list[float])

    def targets(self, region: object) -> list[Detection]:
        assert region is None
        scores = self.scores or [0.9] * len(self.places)
        return [Detection(box_at(p), score) for p, score in zip(self.places, scores, strict=True)]

    def depth(self, box: Box) -> Depth | None:
        place = next(p for p in self.places if box_at(p) == box)
        z = float(T_N_C.inverse().apply(np.array(place))[2])
        return None if self.depth_sigma_m is None else Depth(z, self.depth_sigma_m)


def tracker(*, flies: bool = False) -> Candidates:
    return Candidates(CAMERA, MethodConfig(), math.radians(1.0), FASTEST, 0.5, flies=flies)


def look(own: Candidates, view: View) -> list[Candidate]:
    seen: Any = view
    return own.look(seen, T_N_C, -0.1)


def begun(*places: Vec3, frames: int = STEADY_FRAMES) -> tuple[Candidates, int]:
    own = tracker()
    for k in range(frames):
        look(own, View(list(places), k * FRAME_NS))
    return own, (frames - 1) * FRAME_NS


PLACE: Vec3 = (2.0, 0.0, -0.1)
BESIDE: Vec3 = (2.0, 0.6, -0.1)


def test_each_object_has_a_number_of_its_own_and_keeps_it() -> None:
    own, stamp_ns = begun(PLACE, BESIDE)
    seen = look(own, View([BESIDE, PLACE], stamp_ns + FRAME_NS))
    numbers = {each.number: each.position_n_m[1] for each in seen}
    assert numbers == {1: pytest.approx(0.0, abs=0.03), 2: pytest.approx(0.6, abs=0.03)}
    assert all(each.frames == STEADY_FRAMES + 1 and each.since_ns == 0 for each in seen)
    third = look(own, View([PLACE, (2.6, -0.6, -0.1)], stamp_ns + 2 * FRAME_NS))
    assert sorted(each.number for each in third) == [1, 3]


@pytest.mark.parametrize(("score", "seen"), [(0.3, True), (0.29, False)])
def test_what_a_detector_hardly_believes_is_no_object(score: float, seen: bool) -> None:
    own = tracker()
    assert bool(look(own, View([PLACE], 0, scores=[score]))) is seen


def test_what_the_border_cuts_is_believed_with_less_and_known_worse() -> None:
    own = tracker()
    (whole,) = look(own, View([PLACE], 0))
    far: Vec3 = (2.0, 1.45, -0.1)
    assert box_at(far).x + SIDES[0] > CAMERA.width - 2.0
    (cut,) = look(tracker(), View([far], 0, scores=[0.1]))
    assert cut.observed.depth is None and whole.observed.depth is not None
    assert look(tracker(), View([far], 0, scores=[0.09])) == []
    ray = np.array(cut.observed.place_n_m) - T_N_C.t
    range_m = float(np.linalg.norm(ray))
    across_m = math.hypot(ANGLE * range_m, 0.5 * SIDES[0] / CAMERA.fx * range_m)
    side = np.cross(ray / range_m, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    assert side @ cut.observed.covariance_m2 @ side == pytest.approx(across_m**2)


@pytest.mark.parametrize("depth_sigma_m", [0.02, 0.15, 3.0, None])
def test_a_place_is_known_across_the_line_of_sight_and_along_it_by_depth_or_the_ground(
    depth_sigma_m: float | None,
) -> None:
    (one,) = look(tracker(), View([PLACE], 0, depth_sigma_m))
    ray = np.array(one.observed.place_n_m) - T_N_C.t
    range_m = float(np.linalg.norm(ray))
    ray /= range_m
    across_m = ANGLE * range_m
    on_ground_m = across_m / ray[2]
    z_m = float(T_N_C.inverse().apply(np.array(PLACE))[2])
    along_m = on_ground_m
    if depth_sigma_m is not None:
        along_m = min(depth_sigma_m, max(on_ground_m, 0.058 * z_m))
    on_body_m = 0.1 * SIDES[0] / CAMERA.fx * range_m
    expected = (across_m**2 + on_body_m**2) * np.eye(3) + along_m**2 * np.outer(ray, ray)
    np.testing.assert_allclose(one.observed.covariance_m2, expected, rtol=1e-9)


def test_at_first_it_may_be_as_fast_as_such_a_thing_is() -> None:
    (one,) = look(tracker(), View([PLACE], 7))
    np.testing.assert_allclose(one.motion.covariance[3:, 3:], np.eye(3) * (0.5 * FASTEST) ** 2)
    np.testing.assert_array_equal(one.motion.covariance[:3, :3], one.observed.covariance_m2)
    assert (one.since_ns, one.stamp_ns, one.frames, list(one.path)) == (
        7,
        7,
        1,
        [(7, one.observed.place_n_m)],
    )
    assert one.vv == pytest.approx(FASTEST**2 / 4.0)


@pytest.mark.parametrize(
    ("frames", "kept_s"), [(STEADY_FRAMES, REMEMBERED_S), (STEADY_FRAMES - 1, COASTED_S)]
)
def test_what_was_seen_steadily_is_remembered_and_what_was_not_is_soon_forgotten(
    frames: int, kept_s: float
) -> None:
    own, stamp_ns = begun(PLACE, frames=frames)
    assert (COASTED_S, REMEMBERED_S, STEADY_FRAMES) == (0.6, 20.0, 5)
    look(own, View([], stamp_ns + round(kept_s * S)))
    assert len(own.all) == 1
    look(own, View([], stamp_ns + round(kept_s * S) + 1))
    assert own.all == []


def test_unseen_for_longer_than_may_be_coasted_it_is_taken_up_anew_by_what_can_have_come() -> None:
    own, stamp_ns = begun(PLACE)
    (again,) = look(own, View([PLACE], stamp_ns + round(0.6 * S)))
    assert (again.number, again.since_ns) == (1, 0)
    own, stamp_ns = begun(PLACE)
    later_ns = stamp_ns + round(0.6 * S) + 1
    (again,) = look(own, View([PLACE], later_ns))
    assert (again.number, again.since_ns, again.frames) == (1, later_ns, 1)
    assert list(again.path) == [(later_ns, again.observed.place_n_m)]


def test_what_cannot_have_come_there_is_another_one() -> None:
    """2 m/s, and four deviations of where both are seen."""
    numbers: set[int] = set()
    for east in np.arange(1.5, 4.0, 0.1).tolist():
        own, stamp_ns = begun(PLACE)
        (before,) = own.all
        was, known = before.motion.place_m.copy(), before.observed.covariance_m2
        (seen,) = look(own, View([(2.0 + 0.3 * east, east, -0.1)], stamp_ns + round(0.7 * S)))
        off = np.array(seen.observed.place_n_m) - was
        away_m = float(np.linalg.norm(off))
        way = off / away_m
        sigma_m = math.sqrt(way @ (seen.observed.covariance_m2 + known) @ way)
        assert seen.number == (1 if away_m <= FASTEST * 0.7 + 4.0 * sigma_m else 2), east
        numbers.add(seen.number)
    assert numbers == {1, 2}


def test_where_it_was_is_known_between_all_frames_and_carried_on_a_little() -> None:
    observed = Observed(Box(0.0, 0.0, 1.0, 1.0), None, (4.0, 0.0, 0.0), np.eye(3))
    motion = Motion(np.array([4.0, 0.0, 0.0, 1.0, 0.5, 0.0]), np.eye(6), 10 * S)
    one = Candidate(1, 2 * S, 10 * S, observed, motion, frames=9)
    for stamp_s, north_m in ((2, 0.0), (6, 1.0), (10, 4.0)):
        one.path.append((stamp_s * S, (float(north_m), 0.0, 0.0)))
    assert one.at(0) == one.at(2 * S) == (0.0, 0.0, 0.0)
    assert one.at(4 * S) == pytest.approx((0.5, 0.0, 0.0))
    assert one.at(9 * S) == pytest.approx((3.25, 0.0, 0.0))
    assert one.at(10 * S) == (4.0, 0.0, 0.0)
    assert one.at(10 * S + S // 2) == pytest.approx((4.5, 0.25, 0.0))
    assert one.at(20 * S) == pytest.approx((4.6, 0.3, 0.0))
    gaps = [one.unknown_s(round(s * S)) for s in (0.5, 2.0, 10.0, 10.6, 12.0)]
    assert gaps == pytest.approx([1.5, 0.0, 0.0, 0.0, 1.4])
    one.begin_anew()
    assert (one.since_ns, one.frames, list(one.path)) == (10 * S, 1, [(10 * S, (4.0, 0.0, 0.0))])


def test_a_velocity_counts_as_far_as_it_is_known_against_what_such_a_thing_does() -> None:
    observed = Observed(Box(0.0, 0.0, 1.0, 1.0), None, PLACE, np.eye(3))
    covariance = np.diag([1.0, 1.0, 1.0, 0.25, 1.0, 4.0])
    motion = Motion(np.array([*PLACE, 1.0, 1.0, 1.0]), covariance, 0)
    one = Candidate(1, 0, 0, observed, motion)
    expected = (1.0 / 1.25, 1.0 / 2.0, 1.0 / 5.0)
    assert one.likely_velocity_n_mps(2.0) == pytest.approx(expected)
    assert one.vv == pytest.approx(0.625)
    place, sigma_m = one.predicted(2 * S, 0.0)
    assert place == pytest.approx((4.0, 2.0, 1.9))
    assert sigma_m == pytest.approx(math.sqrt(0.5 * (1.0 + 4.0 * 0.25 + 1.0 + 4.0)))
    assert one.motion.stamp_ns == 0  # it is only looked ahead


@pytest.mark.parametrize("flies", [False, True])
def test_what_goes_along_the_ground_does_not_climb(flies: bool) -> None:
    own = tracker(flies=flies)
    for k in range(20):
        look(own, View([(2.0, 0.0, -0.1 - 0.01 * k)], k * FRAME_NS))
    (one,) = own.all
    climbs_mps = -one.velocity_n_mps[2]
    assert (climbs_mps > 0.15) if flies else abs(climbs_mps) < 0.02
    assert bool(one.motion.covariance[5, 5] > 1e-3) is flies


def test_paths_are_remembered_for_as_long_as_objects_are() -> None:
    own = tracker()
    for k in range(80):
        look(own, View([PLACE], k * S // 2))
    (one,) = own.all
    first_ns, _ = one.path[0]
    assert one.stamp_ns - first_ns == 20 * S


# --- one to one


def test_detections_are_given_surely_when_no_other_way_is_nearly_as_likely() -> None:
    far = {(0, 0): 1.0, (1, 1): 2.0, (0, 1): 40.0, (1, 0): 50.0}
    assert competing(far, {0: 0, 1: 1}) == set()


@pytest.mark.parametrize(("more", "unsure"), [(8.9, {0, 1}), (9.0, set[int]())])
def test_two_that_may_have_changed_places_begin_anew(more: float, unsure: set[int]) -> None:
    costs = {(0, 0): 1.0, (1, 1): 2.0, (0, 1): 5.0, (1, 0): more - 2.0}
    assert competing(costs, {0: 0, 1: 1}) == unsure


@pytest.mark.parametrize(("cost", "unsure"), [(9.9, {0}), (10.0, set[int]())])
def test_one_that_may_be_what_nobody_was_given_begins_anew(cost: float, unsure: set[int]) -> None:
    assert competing({(0, 0): 1.0, (0, 1): cost}, {0: 0}) == unsure


@pytest.mark.parametrize(("cost", "unsure"), [(10.9, {0, 1}), (11.0, set[int]())])
def test_one_that_was_given_nothing_and_might_have_been_begins_anew_with_the_other(
    cost: float, unsure: set[int]
) -> None:
    assert competing({(0, 0): 2.0, (1, 0): cost}, {0: 0}) == unsure


def test_two_whose_exchange_is_impossible_are_sure() -> None:
    costs = {(0, 0): 1.0, (1, 1): 2.0, (0, 1): 1.5}
    assert competing(costs, {0: 0, 1: 1}) == set()


def test_two_that_pass_each_other_closely_are_not_known_to_be_the_same_any_more() -> None:
    own, stamp_ns = begun(PLACE, BESIDE)
    for k in range(1, 16):
        stamp_ns += FRAME_NS
        east = 0.04 * k
        look(own, View([(2.0, east, -0.1), (2.0, 0.6 - east, -0.1)], stamp_ns))
    assert all(each.since_ns > 0 for each in own.all)


def test_detectors_are_told_how_large_the_target_is_where_the_camera_looks() -> None:
    asked: list[Any] = []

    class Asked(View):
        def targets(self, region: object) -> list[Detection]:
            asked.append(region)
            return []

    method = MethodConfig(evidence=replace(MethodConfig().evidence, span_m=0.4, height_m=0.8))
    own = Candidates(CAMERA, method, math.radians(1.0), FASTEST, 0.5, flies=False)
    look(own, Asked([]))
    x, y, z = T_N_C.inverse().apply(np.array(PLACE)).tolist()
    middle_px = 0.8 * CAMERA.fx / math.hypot(x, y, z)
    assert asked[0].side_px == pytest.approx(middle_px, rel=0.3)
    assert (asked[0].x1, asked[0].y1) == (CAMERA.width, CAMERA.height)
