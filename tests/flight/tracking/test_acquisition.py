"""What D1 takes for its target: the one that is meant, alone in a box that is no larger than the
target can be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import View
from drivers.operator.interfaces import BearingTold, Chosen, PlaceTold, Question, RegionTold, Told
from flight.config import FollowConfig, MissionConfig, TargetDesignation
from flight.guidance import Vec3
from flight.tracking.acquisition import Acquisition, Taken
from flight.tracking.candidates import STEADY_FRAMES
from path.config import EvidenceConfig, MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, Region
from tests.flight.following_bench import CAMERA, MOUNT

PERSON = MethodConfig(evidence=EvidenceConfig(span_m=0.77, height_m=1.75))
PLACE: Vec3 = (4.0, 0.0, -0.9)
FRAME_NS = 40_000_000
FOLLOW = FollowConfig(behind_m=2.2, height_m=3.5)
T_N_C = Pose(MOUNT.T_b_c.R, MOUNT.T_b_c.t + np.array((1.8, 0.0, -3.5)))


@dataclass
class Boxes:
    """A view in which the detector has these boxes, all as far away."""

    boxes: list[Box]
    z_m: float
    stamp_ns: int = 0

    def targets(self, region: Region | None) -> list[Detection]:
        return [Detection(box, 0.9) for box in self.boxes]

    def depth(self, box: Box) -> Depth | None:
        return Depth(self.z_m, 0.01)


ONE_PX, TWO_PX = (120.0, 220.0), (180.0, 300.0)


def box_of(place_n_m: Vec3, sides_px: tuple[float, float]) -> tuple[Box, float]:
    x, y, z = T_N_C.inverse().apply(np.array(place_n_m)).tolist()
    u, v = CAMERA.project_point((x, y, z))
    return Box(u - 0.5 * sides_px[0], v - 0.5 * sides_px[1], *sides_px), z


def taken(
    method: MethodConfig, sides_px: tuple[float, float], others: tuple[Vec3, ...] = ()
) -> tuple[Vec3 | None, bool]:
    """What is taken in the last of the frames that it takes, and whether two were seen."""
    box, z_m = box_of(PLACE, sides_px)
    boxes = [box, *(box_of(place, sides_px)[0] for place in others)]
    acquisition, found = begun(method), None
    for k in range(STEADY_FRAMES):
        found = acquisition.look(seen(Boxes(boxes, z_m, k * FRAME_NS)), T_N_C)
    return None if found is None else found.position_n_m, acquisition.ambiguous


def begun(
    method: MethodConfig = PERSON, told: Told | None = None, error_m: float = 0.3
) -> Acquisition:
    mission = MissionConfig(target=TargetDesignation(height_m=-PLACE[2]), follow=FOLLOW)
    acquisition = Acquisition(CAMERA, method, mission)
    acquisition.tell(told or PlaceTold(0, PLACE, error_m))
    return acquisition


def seen(view: Any) -> View:
    return cast("View", view)


def asked(acquisition: Acquisition, view_at: Callable[[int], Any]) -> Question:
    """What is asked, of what is seen for three seconds at most."""
    for k in range(round(3e9 / FRAME_NS)):
        acquisition.look(seen(view_at(k * FRAME_NS)), T_N_C)
        if acquisition.question is not None:
            return acquisition.question
    raise AssertionError("nothing was asked")


def test_one_alone_is_taken_where_it_is() -> None:
    found, ambiguous = taken(PERSON, ONE_PX)
    assert found is not None
    assert math.dist(found, PLACE) < 0.05
    assert not ambiguous


def test_two_in_one_box_are_not_taken() -> None:
    """1 m wide: more than somebody who fits into a cylinder of 0.77 m can fill."""
    assert taken(PERSON, TWO_PX) == (None, False)


@dataclass
class BoxInABox(Boxes):
    """The second box lies in the first, and is of something at another depth."""

    behind_m: float = 0.0

    def depth(self, box: Box) -> Depth | None:
        return Depth(self.z_m + (self.behind_m if box is self.boxes[1] else 0.0), 0.01)


@pytest.mark.parametrize(
    ("behind_m", "inside", "sure"),
    [(1.7, True, False), (-1.2, True, False), (0.3, True, True), (1.7, False, True)],
)
def test_a_box_with_somebody_farther_off_in_it_is_of_two(
    behind_m: float, inside: bool, sure: bool
) -> None:
    """A detector gave one box around two and another around the one behind, in the upper right of
    the first.
    """
    box, z_m = box_of(PLACE, ONE_PX)
    other = Box(box.x + (0.4 if inside else 0.8) * box.w, box.y - 0.5, 0.58 * box.w, 0.5 * box.h)
    acquisition, found = begun(), None
    for k in range(STEADY_FRAMES + round(3e9 / FRAME_NS)):
        view = BoxInABox([box, other], z_m, k * FRAME_NS, behind_m=behind_m)
        found = found or acquisition.look(seen(view), T_N_C)
        question = acquisition.question
        if question is not None:
            number = next(each.number for each in question.shown if each.box == box)
            assert acquisition.choose(Chosen(question.number, number))
    assert (found is not None) == sure


def test_without_a_stated_size_any_box_is_the_objects() -> None:
    assert taken(MethodConfig(), TWO_PX)[0] is not None


@pytest.mark.parametrize(("beside_m", "two"), [(0.6, True), (1.0, True), (2.5, False)])
def test_two_that_it_can_be_are_told(beside_m: float, two: bool) -> None:
    found, ambiguous = taken(PERSON, ONE_PX, ((4.0, beside_m, -0.9),))
    assert ambiguous is two
    assert (found is None) is two


def two_at(stamp_ns: int, places: Sequence[Vec3]) -> Boxes:
    boxes = [box_of(place, ONE_PX) for place in places]
    return Boxes([box for box, _ in boxes], boxes[0][1], stamp_ns)


BESIDE: Vec3 = (4.0, 0.8, -0.9)


def test_of_two_that_it_can_be_it_asks_and_takes_the_one_that_is_chosen() -> None:
    acquisition = begun()
    question = asked(acquisition, lambda ns: two_at(ns, (PLACE, BESIDE)))
    assert len(question.shown) == 2
    assert sum(each.share for each in question.shown) <= 1.0
    chosen = next(each for each in question.shown if each.place_n_m[1] > 0.4)
    assert acquisition.choose(Chosen(question.number, chosen.number))
    found = acquisition.look(seen(two_at(question.stamp_ns + FRAME_NS, (PLACE, BESIDE))), T_N_C)
    assert isinstance(found, Taken)
    assert found.chosen
    assert math.dist(found.position_n_m, BESIDE) < 0.05
    assert acquisition.question is None


def test_answers_to_what_was_never_asked_or_not_shown_are_of_no_use() -> None:
    acquisition = begun()
    question = asked(acquisition, lambda ns: two_at(ns, (PLACE, BESIDE)))
    assert not acquisition.choose(Chosen(question.number + 7, question.shown[0].number))
    assert not acquisition.choose(Chosen(question.number, 99))
    assert (
        acquisition.look(seen(two_at(question.stamp_ns + FRAME_NS, (PLACE, BESIDE))), T_N_C) is None
    )


def test_none_of_these_leaves_the_ones_that_were_shown_out() -> None:
    acquisition = begun()
    question = asked(acquisition, lambda ns: two_at(ns, (PLACE, BESIDE)))
    assert acquisition.choose(Chosen(question.number, 0))
    acquisition.look(seen(two_at(question.stamp_ns + FRAME_NS, (PLACE, BESIDE))), T_N_C)
    assert max(acquisition.shares.of.values()) == 0.0


def test_an_answer_is_of_no_use_once_the_two_may_have_changed_places() -> None:
    """They meet, and part: which of them is which is not known any more."""
    acquisition = begun()
    question = asked(acquisition, lambda ns: two_at(ns, (PLACE, BESIDE)))
    together = [(4.0, 0.38, -0.9), (4.0, 0.42, -0.9)]
    steps = 60
    for k in range(1, 2 * steps):
        share = min(k, 2 * steps - k) / steps
        places = [
            (4.0, own[1] + share * (there[1] - own[1]), -0.9)
            for own, there in zip((PLACE, BESIDE), together, strict=True)
        ]
        acquisition.look(seen(two_at(question.stamp_ns + k * FRAME_NS, places)), T_N_C)
    assert not acquisition.choose(Chosen(question.number, question.shown[0].number))


def test_one_that_was_seen_a_moment_ago_is_still_one_that_it_can_be() -> None:
    """The detector misses the target for a second: the other one is not alone because of that."""
    acquisition = begun()
    for k in range(20):
        assert acquisition.look(seen(two_at(k * FRAME_NS, (PLACE, BESIDE))), T_N_C) is None
    for k in range(20, 45):
        assert acquisition.look(seen(two_at(k * FRAME_NS, (BESIDE,))), T_N_C) is None


def test_where_a_part_of_where_it_can_be_is_out_of_sight_one_alone_is_not_taken() -> None:
    """Said 6 s ago: by now it may be anywhere within 7 m."""
    acquisition = begun(told=PlaceTold(-6_000_000_000, PLACE, 0.3))
    for k in range(40):
        assert acquisition.look(seen(two_at(k * FRAME_NS, (PLACE,))), T_N_C) is None
    assert acquisition.shares.elsewhere > 0.5
    assert "out of sight" in acquisition.why()


def test_what_drives_as_was_said_is_told_from_what_stands_nearer_to_the_place() -> None:
    """Seven places, a second apart, all 0.3 m off to where the other one stands."""
    acquisition = Acquisition(CAMERA, PERSON, MissionConfig(follow=FOLLOW))
    standing: Vec3 = (3.9, 0.75, -0.9)
    found: Taken | None = None
    for k in range(170):
        time_s = k * FRAME_NS * 1e-9
        driven: Vec3 = (3.4 + 0.3 * time_s, 0.0, -0.9)
        if k % 25 == 0:
            acquisition.tell(PlaceTold(k * FRAME_NS, (driven[0], 0.3, -0.9), 0.2))
        found = found or acquisition.look(seen(two_at(k * FRAME_NS, (driven, standing))), T_N_C)
    assert found is not None
    assert abs(found.position_n_m[1]) < 0.1


@pytest.mark.parametrize(
    ("told", "right"),
    [
        (BearingTold(0, (4.0, -3.0), 0.5 * math.pi, math.radians(1.0)), False),
        (BearingTold(0, (0.0, 0.0), 0.0, math.radians(1.0)), True),
        (RegionTold(0, ((3.4, -0.5), (4.6, -0.5), (4.6, 0.5), (3.4, 0.5))), True),
        (RegionTold(0, ((3.4, -0.5), (4.6, -0.5), (4.6, 1.5), (3.4, 1.5))), False),
    ],
    ids=[
        "in the direction of both",
        "in the direction of one",
        "within edges around one",
        "within edges around both",
    ],
)
def test_a_direction_or_edges_tell_which_where_only_one_is_there(told: Told, right: bool) -> None:
    acquisition = begun(told=told)
    if isinstance(told, BearingTold):
        acquisition.tell(RegionTold(0, ((3.5, -1.0), (4.5, -1.0), (4.5, 1.2), (3.5, 1.2))))
    found: Taken | None = None
    for k in range(30):
        found = found or acquisition.look(seen(two_at(k * FRAME_NS, (PLACE, BESIDE))), T_N_C)
    assert (found is not None) is right
    assert found is None or math.dist(found.position_n_m, PLACE) < 0.05


def test_of_what_flies_the_height_tells_too() -> None:
    mission = MissionConfig(target=TargetDesignation(flies=True, height_m=0.9))
    acquisition = Acquisition(CAMERA, PERSON, mission)
    acquisition.tell(PlaceTold(0, PLACE, 0.2, height_told=True))
    for k in range(30):
        acquisition.look(seen(two_at(k * FRAME_NS, ((4.0, 0.5, -0.9),))), T_N_C)
    low = max(acquisition.shares.of.values())
    other = Acquisition(CAMERA, PERSON, mission)
    other.tell(PlaceTold(0, (4.0, 0.0, -2.0), 0.2, height_told=True))
    for k in range(30):
        other.look(seen(two_at(k * FRAME_NS, ((4.0, 0.5, -0.9),))), T_N_C)
    assert max(other.shares.of.values()) < 0.1 * low


def test_what_is_surely_the_target_is_taken_once_it_is_as_near_as_it_is_followed_from() -> None:
    far = Acquisition(CAMERA, PERSON, MissionConfig(target=TargetDesignation(height_m=-PLACE[2])))
    far.tell(PlaceTold(0, PLACE, 0.3))
    for k in range(20):
        assert far.look(seen(two_at(k * FRAME_NS, (PLACE,))), T_N_C) is None
    where = far.where(20 * FRAME_NS)
    assert where is not None
    assert where[1] < 0.3  # it need not look at all of where it can be any more: it comes nearer


@dataclass
class CoarseDepth(Boxes):
    """Depth as a stereo camera has it far off, with its own error in every frame and for every
    box.
    """

    sigma_m: float = 0.5

    def depth(self, box: Box) -> Depth | None:
        off = np.random.default_rng([self.stamp_ns, round(10.0 * box.x)]).standard_normal()
        return Depth(self.z_m + self.sigma_m * float(off), self.sigma_m)


def test_an_answer_holds_for_one_of_two_that_go_beside_each_other_however_coarse_depth_is() -> None:
    """What errs is along the line of sight: across it they are 1.2 m apart, and are never
    confused.
    """
    acquisition = begun(error_m=1.0)

    def at(stamp_ns: int) -> CoarseDepth:
        along_m = 0.5e-9 * stamp_ns
        boxes = [box_of((4.0, east + along_m - 1.2, -0.9), ONE_PX) for east in (0.0, 1.2)]
        return CoarseDepth([box for box, _ in boxes], boxes[0][1], stamp_ns)

    question = asked(acquisition, at)
    for k in range(25):
        acquisition.look(seen(at(question.stamp_ns + (k + 1) * FRAME_NS)), T_N_C)
    assert acquisition.choose(Chosen(question.number, question.shown[0].number))


def test_d1_flies_on_with_what_it_looks_at() -> None:
    """One that is only flown to is never reached where it is fast."""
    acquisition = begun(error_m=1.0)
    for k in range(30):
        east_m = 1.2e-9 * k * FRAME_NS
        acquisition.look(seen(two_at(k * FRAME_NS, [(4.0, east_m, -0.9)])), T_N_C)
    newest_ns = 29 * FRAME_NS
    north, east, down = acquisition.moves(newest_ns)
    assert (north, down) == (pytest.approx(0.0, abs=0.1), 0.0)
    assert east == pytest.approx(1.2, abs=0.2)
    assert acquisition.moves(newest_ns + round(2e9)) == (0.0, 0.0, 0.0)  # out of sight


def test_what_depth_errs_is_no_motion_of_what_stands() -> None:
    """One was taken with 1.0 m/s towards D1 and 0.8 m/s upwards, and lost at once."""
    acquisition = begun(error_m=1.0)
    fastest: list[float] = []
    for k in range(60):
        box, z_m = box_of((4.0, 0.0, -0.9), ONE_PX)
        acquisition.look(seen(CoarseDepth([box], z_m, k * FRAME_NS)), T_N_C)
        north, east, down = acquisition.moves(k * FRAME_NS)
        assert down == 0.0
        fastest.append(math.hypot(north, east))
    assert max(fastest) < 0.35


def test_a_drone_whose_position_walks_takes_nobody_by_a_place_alone_while_another_is_near() -> None:
    def found(own_m: float) -> Taken | None:
        target = TargetDesignation(height_m=-PLACE[2], own_m=own_m)
        acquisition = Acquisition(CAMERA, PERSON, MissionConfig(target=target, follow=FOLLOW))
        acquisition.tell(PlaceTold(0, PLACE, 0.3))
        box, z_m = box_of(PLACE, ONE_PX)
        other = box_of((4.0, 1.4, -0.9), ONE_PX)[0]
        last = None
        for k in range(STEADY_FRAMES + 10):
            last = last or acquisition.look(seen(Boxes([box, other], z_m, k * FRAME_NS)), T_N_C)
        return last

    assert found(0.0) is not None
    assert found(2.0) is None
