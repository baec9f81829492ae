"""Following one object: it must be where it is expected, be told apart from what looks alike, and
survive gaps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from flight.guidance import Vec3, norm, subtract
from flight.tracking.association import Sighting, follow
from flight.tracking.objects import is_cut
from flight.tracking.places import place, point_in_camera, to_local
from flight.tracking.target_track import TargetTrack
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, MarkerDetection, MissReason, Region

CAMERA = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0, (0.1, -0.2, 0.0005, -0.0005, 0.05))
C = math.sqrt(0.5)
# two metres up, looking north and 45 degrees down
T_N_C = Pose(np.array([[0.0, -C, C], [1.0, 0.0, 0.0], [0.0, C, C]]), np.array([0.0, 0.0, -2.0]))
PLACE: Vec3 = (2.0, 0.0, -0.1)
SECOND = 1_000_000_000


@dataclass
class FakeView:
    """Objects at places in NED, each with a box of 60 x 40 px around its pixel."""

    places: Sequence[Vec3]
    stamp_ns: int = 0
    frame_id: int = 0
    has_depth: bool = True
    scores: Sequence[float] = ()
    hidden_behind_m: float = math.inf  # the depth of something in front of everything

    def boxes(self) -> list[Box]:
        pixels = [self._seen(place)[0] for place in self.places]
        return [Box(u - 30.0, v - 20.0, 60.0, 40.0) for u, v in pixels]

    def targets(self, region: Region | None) -> Sequence[Detection]:
        scores = self.scores or [0.9] * len(self.places)
        found = [Detection(box, score) for box, score in zip(self.boxes(), scores, strict=True)]
        return [d for d in found if region is None or region.contains(*d.box.center)]

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        return []

    def depth(self, box: Box) -> Depth | None:
        if box not in self.boxes():
            return Depth(self.hidden_behind_m, 0.01) if self.hidden_behind_m < math.inf else None
        at = self.boxes().index(box)
        z_m = min(self.hidden_behind_m, self._seen(self.places[at])[1])
        return Depth(z_m, 0.01) if self.has_depth else None

    def image(self) -> NDArray[np.uint8] | None:
        return None

    @staticmethod
    def _seen(place: Vec3) -> tuple[tuple[float, float], float]:
        x, y, z = T_N_C.inverse().apply(np.array(place)).tolist()
        return CAMERA.project_point((x, y, z)), z


def tracked(view: FakeView, track: TargetTrack) -> Sighting:
    seen = follow(view, T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting), seen
    return seen


def beside(place: Vec3, east_m: float) -> Vec3:
    return place[0], place[1] + east_m, place[2]


# --- geometry


@given(st.floats(1.0, 3.5), st.floats(-0.8, 0.8), st.floats(-0.5, 0.0))
def test_a_box_and_its_depth_give_back_the_place(north: float, east: float, down: float) -> None:
    view = FakeView([(north, east, down)])
    box = view.boxes()[0]
    depth = view.depth(box)
    assert depth is not None
    assert to_local(point_in_camera(box, depth.z_m, CAMERA), T_N_C) == pytest.approx(
        (north, east, down), abs=1e-6
    )


# --- the designated object


# --- following


def test_a_moving_object_is_followed_and_its_velocity_learnt() -> None:
    track = TargetTrack(PLACE, 0)
    for k in range(1, 151):
        place = beside(PLACE, 0.4 * k / 50)
        assert (
            tracked(FakeView([place], k * SECOND // 50), track).box == FakeView([place]).boxes()[0]
        )
    assert norm(subtract(track.position_n_m, beside(PLACE, 1.2))) < 0.03
    assert track.velocity_n_mps == pytest.approx((0.0, 0.4, 0.0), abs=0.03)
    assert track.seen_ns == 3 * SECOND


def test_an_object_far_from_the_prediction_is_not_the_target() -> None:
    track = settled(PLACE)
    view = FakeView([beside(PLACE, 0.9)], track.stamp_ns + SECOND // 50)
    before = (track.position_n_m, track.seen_ns)
    assert follow(view, T_N_C, CAMERA, track) is MissReason.NO_TARGET
    assert (track.position_n_m, track.seen_ns) == before


def settled(place: Vec3) -> TargetTrack:
    track = TargetTrack(place, 0)
    for k in range(1, 51):
        tracked(FakeView([place], k * SECOND // 50), track)
    return track


@pytest.mark.parametrize(
    ("target_m", "other_m", "told_apart"),
    [
        (0.0, 0.25, True),
        (0.05, 0.2, True),
        (0.1, -0.12, False),
        (0.1, 0.15, False),
        (0.02, 0.6, True),
    ],
)
def test_a_look_alike_nearly_as_near_is_not_told_apart(
    target_m: float, other_m: float, told_apart: bool
) -> None:
    for order in (1, -1):
        track = settled(PLACE)
        view = FakeView(
            [beside(PLACE, target_m), beside(PLACE, other_m)][::order],
            track.stamp_ns + SECOND // 50,
        )
        seen = follow(view, T_N_C, CAMERA, track)
        if told_apart:
            assert isinstance(seen, Sighting)
            assert seen.box == FakeView([beside(PLACE, target_m)]).boxes()[0]
        else:
            assert seen is MissReason.AMBIGUOUS_TARGET


@given(st.floats(-0.6, 0.6), st.floats(-0.4, 0.4))
def test_two_objects_are_never_put_together(east_m: float, north_m: float) -> None:
    track = settled(PLACE)
    other = (PLACE[0] + north_m, PLACE[1] + east_m, PLACE[2])
    view = FakeView([PLACE, other], track.stamp_ns + SECOND // 50)
    seen = follow(view, T_N_C, CAMERA, track)
    assert isinstance(seen, MissReason) or seen.box in view.boxes()


def test_what_is_hardly_an_object_makes_nothing_ambiguous() -> None:
    track = settled(PLACE)
    view = FakeView(
        [beside(PLACE, 0.05), beside(PLACE, 0.06)], track.stamp_ns + SECOND // 50, scores=[0.9, 0.2]
    )
    assert tracked(view, track).box == view.boxes()[0]


def test_an_ambiguous_frame_leaves_the_track_as_it_was() -> None:
    track = settled(PLACE)
    before = (track.position_n_m, track.velocity_n_mps, track.seen_ns)
    follow(
        FakeView([beside(PLACE, 0.1), beside(PLACE, -0.1)], track.stamp_ns + SECOND // 50),
        T_N_C,
        CAMERA,
        track,
    )
    assert (track.position_n_m, track.velocity_n_mps, track.seen_ns) == before


@pytest.mark.parametrize(
    ("gap_s", "beside_it", "found"), [(0.3, True, True), (1.0, True, False), (1.0, False, True)]
)
def test_the_target_is_found_again_where_it_must_be_after_a_gap(
    gap_s: float, beside_it: bool, found: bool
) -> None:
    """It moved on unseen; a look-alike may stand where it was. After a while only what is alone is
    taken for it.
    """
    track = TargetTrack(PLACE, 0)
    for k in range(1, 101):
        tracked(FakeView([beside(PLACE, 0.4 * k / 50)], k * SECOND // 50), track)
    gone = beside(PLACE, 0.8)
    places = [*([gone] if beside_it else []), beside(gone, 0.4 * gap_s)]
    view = FakeView(places, track.stamp_ns + round(gap_s * SECOND))
    seen = follow(view, T_N_C, CAMERA, track)
    if found:
        assert isinstance(seen, Sighting)
        assert seen.box == view.boxes()[-1]
    else:
        assert seen is MissReason.AMBIGUOUS_TARGET


@pytest.mark.parametrize(
    ("gap_s", "away_m", "found"), [(0.7, 1.3, True), (0.9, 1.3, True), (1.8, 1.3, False)]
)
def test_a_target_that_was_missed_is_taken_again_while_the_other_cannot_be_it(
    gap_s: float, away_m: float, found: bool
) -> None:
    """The other is farther off than the target can have driven meanwhile; after 1.8 s it no longer
    is.
    """
    track = settled(PLACE)
    view = FakeView([PLACE, beside(PLACE, away_m)], track.stamp_ns + round(gap_s * SECOND))
    seen = follow(view, T_N_C, CAMERA, track)
    assert isinstance(seen, Sighting) if found else seen is MissReason.AMBIGUOUS_TARGET


def test_the_other_alone_is_not_taken_for_a_target_that_is_missed() -> None:
    """However long, wherever the target may have gone, as long as it is farther off than a gate is
    ever wide.
    """
    for tenths in range(6, 60):
        track = settled(PLACE)
        view = FakeView([beside(PLACE, 0.65)], track.stamp_ns + tenths * SECOND // 10)
        assert isinstance(follow(view, T_N_C, CAMERA, track), MissReason)


class Framed(FakeView):
    """Its boxes end at the border, as a detector's do, which scores them low for that."""

    def boxes(self) -> list[Box]:
        boxes: list[Box] = []
        for box in super().boxes():
            x0, y0 = max(box.x, -0.5), max(box.y, -0.5)
            x1, y1 = min(box.x + box.w, CAMERA.width - 0.5), min(box.y + box.h, CAMERA.height - 0.5)
            boxes.append(Box(x0, y0, x1 - x0, y1 - y0))
        return boxes

    def targets(self, region: Region | None) -> Sequence[Detection]:
        found = [Detection(box, 0.18 if is_cut(box, CAMERA) else 0.9) for box in self.boxes()]
        return [d for d in found if region is None or region.contains(*d.box.center)]


def test_a_box_that_the_border_cuts_keeps_the_track_and_says_nothing_of_the_velocity() -> None:
    """It stands at the edge of the image and is half in it; half a box's middle is 0.05 m from the
    object's.
    """
    edge: Vec3 = (2.0, 1.2, -0.1)
    track = settled(edge)
    view = Framed([edge])
    assert not is_cut(view.boxes()[0], CAMERA)
    begun_ns = track.stamp_ns
    at_border: Vec3 = (2.0, 1.3, -0.1)
    for k in range(1, 101):
        view = Framed([at_border], begun_ns + k * SECOND // 50)
        assert is_cut(view.boxes()[0], CAMERA)
        # no evidence for the other drone
        assert follow(view, T_N_C, CAMERA, track) is MissReason.NO_TARGET
        assert track.seen_ns == view.stamp_ns
    assert norm(track.velocity_n_mps) < 0.02
    assert math.dist(track.position_n_m, at_border) < 0.04
    assert isinstance(
        follow(Framed([edge], track.stamp_ns + SECOND // 50), T_N_C, CAMERA, track), Sighting
    )


def test_what_was_seen_beside_the_target_is_never_taken_for_it() -> None:
    """The target is not detected for a while; the look-alike 0.3 m beside it is, alone, all the
    time.
    """
    track, other = settled(PLACE), beside(PLACE, 0.3)
    tracked(FakeView([PLACE, other], track.stamp_ns + SECOND // 50), track)
    begin_ns = track.stamp_ns
    for k in range(1, 140):
        assert isinstance(
            follow(FakeView([other], begin_ns + k * SECOND // 50), T_N_C, CAMERA, track), MissReason
        )
    assert (
        tracked(FakeView([PLACE], begin_ns + 140 * SECOND // 50), track).box
        == FakeView([PLACE]).boxes()[0]
    )


def test_an_object_farther_off_does_not_make_a_nearer_one_forgotten() -> None:
    track, other = settled(PLACE), beside(PLACE, 0.3)
    tracked(FakeView([PLACE, other], track.stamp_ns + SECOND // 50), track)
    tracked(FakeView([PLACE, beside(PLACE, -0.5)], track.stamp_ns + SECOND // 50), track)
    view = FakeView([other], track.stamp_ns + SECOND // 5)
    assert follow(view, T_N_C, CAMERA, track) is MissReason.NO_TARGET


def test_without_depth_the_target_is_followed_at_the_height_it_had() -> None:
    track = settled(PLACE)
    for k in range(1, 101):
        place = beside(PLACE, 0.3 * k / 50)
        seen = tracked(FakeView([place], track.stamp_ns + SECOND // 50, has_depth=False), track)
        assert seen.depth is None
    assert track.position_n_m == pytest.approx(beside(PLACE, 0.6), abs=0.03)
    assert track.position_n_m[2] == pytest.approx(PLACE[2], abs=1e-6)
    assert track.velocity_n_mps == pytest.approx((0.0, 0.3, 0.0), abs=0.05)


def test_the_depth_of_what_hangs_in_front_of_the_target_is_not_the_targets() -> None:
    """Believed, it would take the track up its ray, and a drone that keeps its distance would flee
    backwards.
    """
    track = TargetTrack(PLACE, 0)
    for k in range(1, 51):
        tracked(FakeView([PLACE], k * SECOND // 50), track)
    for k in range(51, 101):
        seen = tracked(FakeView([PLACE], k * SECOND // 50, hidden_behind_m=1.2), track)
        assert seen.depth is None
    assert norm(subtract(track.position_n_m, PLACE)) < 0.02 and norm(track.velocity_n_mps) < 0.05
    assert tracked(FakeView([PLACE], 3 * SECOND), track).depth is not None


def test_a_ray_that_hardly_comes_down_places_nothing() -> None:
    """Looking level, a pixel near the horizon says nothing about the distance: seen, but not
    measured.
    """
    level = Pose(
        np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.0, 0.0, -0.4])
    )
    track = TargetTrack(PLACE, 0)

    class LevelView(FakeView):
        def boxes(self) -> list[Box]:
            x, y, z = level.inverse().apply(np.array(PLACE)).tolist()
            u, v = CAMERA.project_point((x, y, z))
            return [Box(u - 30.0, v - 20.0, 60.0, 40.0)]

    seen = follow(LevelView([PLACE], SECOND // 50, has_depth=False), level, CAMERA, track)
    assert isinstance(seen, Sighting)
    assert (track.position_n_m, track.seen_ns) == (PLACE, 0)


@pytest.mark.parametrize("place", [(-2.0, 0.0, -0.1), (2.0, 5.0, -0.1), (0.0, 0.0, -3.0)])
def test_a_target_outside_the_image_is_not_looked_for(place: Vec3) -> None:
    class Blind(FakeView):
        def targets(self, region: Region | None) -> Sequence[Detection]:
            raise AssertionError("nothing to be seen there")

    assert follow(Blind([]), T_N_C, CAMERA, TargetTrack(place, 0)) is MissReason.NO_TARGET


# --- the filter


def test_a_coast_grows_less_sure_and_leaves_the_filter_as_it_is() -> None:
    track = settled(PLACE)
    sigmas = [track.predict(track.stamp_ns + k * SECOND // 2)[1] for k in range(5)]
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 4.0 * sigmas[0]
    assert track.predict(track.stamp_ns + 2 * SECOND)[1] == sigmas[4]


def test_an_older_measurement_is_ignored() -> None:
    track = settled(PLACE)
    before = (track.position_n_m, track.velocity_n_mps, track.stamp_ns, track.seen_ns)
    track.update((9.0, 9.0, 9.0), track.stamp_ns - 1)
    assert (track.position_n_m, track.velocity_n_mps, track.stamp_ns, track.seen_ns) == before


def test_the_past_is_not_predicted_by_going_back() -> None:
    track = settled(PLACE)
    track.velocity_n_mps = (1.0, 0.0, 0.0)
    assert track.predict(track.stamp_ns - SECOND)[0] == track.position_n_m


def test_a_velocity_is_flown_by_as_far_as_it_is_known() -> None:
    track = TargetTrack(PLACE, 0)
    assert track.believed(SECOND) == (PLACE, (0.0, 0.0, 0.0))
    for k in range(1, 101):
        track.update(beside(PLACE, 0.4 * k / 50), k * SECOND // 50)
    at_once, velocity = track.believed(track.stamp_ns)
    assert at_once == track.position_n_m
    assert velocity == pytest.approx(track.velocity_n_mps, abs=0.01)
    later = [track.believed(track.stamp_ns + k * SECOND // 4) for k in range(25)]
    east = [place[1] for place, _ in later]
    assert east == sorted(east)  # never back
    assert east[-1] - east[0] < 0.4**2 / 0.6 * math.pi / 2  # it may have braked
    speeds = [norm(velocity) for _, velocity in later]
    assert speeds == sorted(speeds, reverse=True) and speeds[8] < 0.15 * speeds[0]


def test_a_velocity_that_is_not_known_yet_is_not_flown_by() -> None:
    track = TargetTrack(PLACE, 0)
    track.update(beside(PLACE, 0.1), SECOND // 25)
    assert norm(track.velocity_n_mps) > 0.01
    assert norm(track.believed(track.stamp_ns)[1]) < 0.1 * norm(track.velocity_n_mps)


@given(st.integers(0, 2**32 - 1))
def test_the_filter_is_as_sure_as_it_may_be(seed: int) -> None:
    """Noise of 0.05 m on a steady course: the error stays within a few of its own standard
    deviations.
    """
    rng = np.random.default_rng(seed)
    velocity = rng.uniform(-0.4, 0.4, 3)
    track = TargetTrack((0.0, 0.0, 0.0), 0, flies=True)  # its course climbs
    for k in range(1, 101):
        place = velocity * k / 50
        north, east, down = (place + rng.normal(0.0, 0.05, 3)).tolist()
        track.update((north, east, down), k * SECOND // 50)
    at, sigma_m = track.predict(2 * SECOND)
    assert 0.005 < sigma_m < 0.05
    north, east, down = (velocity * 2.0).tolist()
    assert norm(subtract(at, (north, east, down))) < 6.0 * sigma_m


# --- ranges that are only estimated


def test_an_estimated_range_gives_way_to_the_height_that_is_known() -> None:
    box = FakeView([PLACE]).boxes()[0]
    wrong = 1.2 * FakeView._seen(PLACE)[1]
    assert place(box, Depth(wrong, 0.3), CAMERA, T_N_C, PLACE[2]) == pytest.approx(PLACE, abs=1e-6)
    measured = place(box, Depth(wrong, 0.02), CAMERA, T_N_C, PLACE[2])
    assert math.dist(measured, PLACE) == pytest.approx(0.2 / 1.2 * wrong, rel=0.01)


def test_an_estimated_range_is_all_there_is_for_what_is_level_with_the_camera() -> None:
    level = Pose(
        np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.0, 0.0, -2.0])
    )
    box = Box(290.0, 220.0, 60.0, 40.0)  # around the principal point
    assert place(box, Depth(3.0, 0.3), CAMERA, level, 0.0) == pytest.approx(
        (3.0, 0.0, -2.0), abs=0.01
    )


class TakenForOne(FakeView):
    """Its object, and another one right behind it, in one box that is 1.6 times as high."""

    def boxes(self) -> list[Box]:
        return [Box(box.x, box.y - 0.6 * box.h, box.w, 1.6 * box.h) for box in super().boxes()]


def test_a_box_that_has_more_in_it_from_one_frame_to_the_next_moves_the_track_little_and_not_up() -> (
    None
):
    track = settled(PLACE)
    for _ in range(10):
        seen = follow(TakenForOne([PLACE], track.stamp_ns + SECOND // 50), T_N_C, CAMERA, track)
        assert seen is MissReason.AMBIGUOUS_TARGET
    assert math.dist(track.position_n_m, PLACE) < 0.02
    assert (
        tracked(FakeView([PLACE], track.stamp_ns + SECOND // 50), track).box
        == FakeView([PLACE]).boxes()[0]
    )


def test_what_has_grown_and_stays_so_is_the_object() -> None:
    track, begun_ns = settled(PLACE), SECOND
    seen: Sighting | MissReason = MissReason.AMBIGUOUS_TARGET
    while isinstance(seen, MissReason) and track.stamp_ns < 6 * SECOND:
        seen = follow(TakenForOne([PLACE], track.stamp_ns + SECOND // 50), T_N_C, CAMERA, track)
    assert 2.5 * SECOND < track.stamp_ns - begun_ns < 3.5 * SECOND


class FarBehind(FakeView):
    """Its object, and one so far behind it that the middle of the box around both is outside the
    gate.
    """

    def boxes(self) -> list[Box]:
        return [Box(box.x, box.y - 4.0 * box.h, box.w, 5.0 * box.h) for box in super().boxes()]


def test_in_a_box_around_more_than_the_object_it_is_kept_for_a_while() -> None:
    track = settled(PLACE)
    while (
        follow(FarBehind([PLACE], track.stamp_ns + SECOND // 50), T_N_C, CAMERA, track)
        is not MissReason.NO_TARGET
    ):
        assert math.dist(track.position_n_m, PLACE) < 0.02
    assert 4.5 * SECOND < track.seen_ns - SECOND < 5.5 * SECOND


@pytest.mark.parametrize("flies", [False, True])
def test_only_what_flies_goes_up(flies: bool) -> None:
    track = TargetTrack(PLACE, 0, flies=flies)
    for k in range(1, 51):
        track.update((PLACE[0], PLACE[1], PLACE[2] - 0.6 * k / 50), k * SECOND // 50)
    (_, _, down), _ = track.predict(3 * SECOND)
    assert (down < PLACE[2] - 1.5) == flies


def test_what_was_out_of_sight_may_be_as_fast_as_it_was_and_faster() -> None:
    track = TargetTrack(PLACE, 0)
    for k in range(1, 51):
        track.update((PLACE[0] + 0.3 * k / 50.0, PLACE[1], PLACE[2]), k * SECOND // 50)
    later = track.stamp_ns + SECOND // 2
    assert math.hypot(*track.believed(later)[1]) < 0.2
    assert 0.3 < track.fastest_mps(track.stamp_ns) < track.fastest_mps(later) < 2.0
