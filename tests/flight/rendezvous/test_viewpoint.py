"""Every viewpoint keeps every rule; each rule, when it cannot be kept, is named."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from flight.config import RendezvousConfig, SeparationConfig
from flight.rendezvous.viewpoint import (
    Floats,
    NoViewpoint,
    Viewpoint,
    ViewpointScene,
    beside_wash_m,
    plan_viewpoint,
)
from path.camera.model import CameraModel
from path.geometry.transforms import Pose

CAMERA = CameraModel(640, 480, 612.8, 613.1, 317.6, 238.2, (0.104, -0.221, -0.0003, 0.0007, 0.088))
# folds back beyond its rim
BARREL = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0, (-0.32, 0.0, 0.0, 0.0, 0.0))
RULES = RendezvousConfig()
APART = SeparationConfig()
LEVEL = np.array([0.0, 0.0, 1.0])


def pitched(down_deg: float) -> Pose:
    """``T_b_c`` of a camera that looks ahead and down."""
    c, s = math.cos(math.radians(down_deg)), math.sin(math.radians(down_deg))
    return Pose(np.array([[0.0, -s, c], [1.0, 0.0, 0.0], [0.0, c, s]]), np.array([0.1, 0.0, 0.02]))


def scene(
    ahead_m: float = 1.65,
    right_m: float = 0.0,
    below_m: float = 1.42,
    side_m: float = 0.04,
    normal_up_deg: float = 45,
) -> ViewpointScene:
    """D1's marker looks back and up; the target is ahead and below."""
    up = math.radians(normal_up_deg)
    return ViewpointScene(
        target_h_m=np.array([ahead_m, right_m, below_m]),
        marker_normal_h=np.array([-math.cos(up), 0.0, -math.sin(up)]),
        marker_side_m=side_m,
        body_h_m=np.array([0.18, 0.0, 0.06]),
    )


def plan(
    view: ViewpointScene,
    camera: CameraModel = CAMERA,
    pitch_deg: float = 45.0,
    rules: RendezvousConfig = RULES,
    apart: SeparationConfig = APART,
    tilt_h: Floats | None = None,
) -> Viewpoint | NoViewpoint:
    return plan_viewpoint(view, camera, pitched(pitch_deg), rules, apart, tilt_h)


def found(
    view: ViewpointScene,
    camera: CameraModel = CAMERA,
    rules: RendezvousConfig = RULES,
    tilt_h: Floats | None = None,
) -> Viewpoint:
    viewpoint = plan(view, camera, rules=rules, tilt_h=tilt_h)
    assert isinstance(viewpoint, Viewpoint), str(viewpoint)
    return viewpoint


def leaning(axis: Floats) -> Floats:
    """The rotation that takes the vertical to a drone's own z axis, by Rodrigues' formula."""
    across = np.cross(LEVEL, axis)
    sine, cosine = float(np.linalg.norm(across)), float(axis[2])
    if sine < 1e-12:
        return np.eye(3)
    x, y, z = across / sine
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sine * K + (1.0 - cosine) * K @ K


@dataclass(frozen=True)
class Seen:
    """The view of a drone's camera from a viewpoint, computed anew."""

    view: ViewpointScene
    viewpoint: Viewpoint
    camera: CameraModel = CAMERA
    pitch_deg: float = 45.0
    tilt_h: Floats | None = None

    def points_c(self) -> tuple[Floats, Floats]:
        """Marker and target in the camera frame."""
        yaw = self.viewpoint.yaw_h_rad
        turned = np.array(
            [
                [math.cos(yaw), -math.sin(yaw), 0.0],
                [math.sin(yaw), math.cos(yaw), 0.0],
                [0.0, 0.0, 1.0],
            ]
        )
        R_h_c = (
            leaning(LEVEL if self.tilt_h is None else self.tilt_h)
            @ turned
            @ pitched(self.pitch_deg).R
        )
        place = np.array(self.viewpoint.camera_h_m)
        return R_h_c.T @ -place, R_h_c.T @ (self.view.target_h_m - place)

    def margins(self) -> list[float]:
        """From marker's and target's rims to the border, px."""
        margins: list[float] = []
        for point, size in zip(
            self.points_c(), (self.view.marker_side_m, self.view.target_radius_m), strict=True
        ):
            x, y, z = point.tolist()
            assert self.camera.sees((x, y, z))
            u, v = self.camera.project_point((x, y, z))
            to_border = min(u, v, self.camera.width - u, self.camera.height - v)
            margins.append(to_border - self.camera.fx * size / z)
        return margins


def check_rules(
    seen: Seen, rules: RendezvousConfig = RULES, apart: SeparationConfig = APART
) -> None:
    view, viewpoint = seen.view, seen.viewpoint
    place = np.array(viewpoint.camera_h_m)
    to_body, to_target = view.body_h_m - place, view.target_h_m - place
    level, vertical = math.hypot(to_body[0], to_body[1]), abs(float(to_body[2]))
    assert (level / apart.horizontal_m) ** 2 + (vertical / apart.vertical_m) ** 2 >= 1.0
    assert np.linalg.norm(to_body) >= apart.viewpoint_m
    assert level >= apart.wash_m + vertical * apart.wash_per_m - 1e-9
    assert np.linalg.norm(to_target) <= rules.max_range_m

    distance = float(np.linalg.norm(place))
    incidence = math.acos(min(1.0, float(place @ view.marker_normal_h) / distance))
    assert incidence == pytest.approx(viewpoint.incidence_rad, abs=1e-6)
    assert incidence <= math.radians(rules.max_incidence_deg) + 1e-9
    size = 0.5 * (seen.camera.fx + seen.camera.fy) * view.marker_side_m / distance
    assert size == pytest.approx(viewpoint.marker_px)
    assert size >= rules.min_marker_px

    margin = min(seen.margins())
    assert margin == pytest.approx(viewpoint.margin_px, abs=1e-6)
    assert margin >= rules.image_margin_px

    # the line of sight to the target's rim passes D1's body
    cosine = float(to_body @ to_target) / float(np.linalg.norm(to_body) * np.linalg.norm(to_target))
    between = math.acos(min(1.0, max(-1.0, cosine)))
    assert between >= math.atan2(view.body_radius_m, float(np.linalg.norm(to_body))) - 1e-9


scenes = st.builds(
    scene,
    ahead_m=st.floats(0.4, 3.0),
    right_m=st.floats(-1.0, 1.0),
    below_m=st.floats(0.5, 2.5),
    side_m=st.floats(0.03, 0.12),
    normal_up_deg=st.floats(10.0, 80.0),
)
tilts = st.tuples(st.floats(-0.12, 0.12), st.floats(-0.12, 0.12)).map(
    lambda lean: np.array([*lean, math.sqrt(1.0 - lean[0] ** 2 - lean[1] ** 2)])
)


@settings(max_examples=150)
@given(scenes, st.sampled_from((CAMERA, BARREL)), st.floats(25.0, 65.0), st.none() | tilts)
def test_every_viewpoint_keeps_every_rule(
    view: ViewpointScene, camera: CameraModel, pitch_deg: float, tilt_h: Floats | None
) -> None:
    viewpoint = plan(view, camera, pitch_deg, tilt_h=tilt_h)
    assume(isinstance(viewpoint, Viewpoint))
    assert isinstance(viewpoint, Viewpoint)
    check_rules(Seen(view, viewpoint, camera, pitch_deg, tilt_h))


@pytest.mark.parametrize(
    ("view", "pitch_deg"),
    [
        (scene(3.05, 1.30, 0.153, 0.059, 49.5), 71.0),
        (scene(2.91, 1.26, 0.987, 0.102, 41.1), 82.9),
        (scene(1.10, 0.133, 0.925, 0.0844, 53.8), -12.8),
    ],
)
def test_what_a_lens_folds_back_into_the_image_is_not_in_view(
    view: ViewpointScene, pitch_deg: float
) -> None:
    """Beyond ``max_radius`` a pixel says nothing: the target is then far outside the image."""
    viewpoint = plan(view, BARREL, pitch_deg)
    if isinstance(viewpoint, Viewpoint):
        check_rules(Seen(view, viewpoint, BARREL, pitch_deg))


def test_the_mission_as_it_comes_has_a_viewpoint() -> None:
    viewpoint = found(scene())
    check_rules(Seen(scene(), viewpoint))
    forward, _, down = viewpoint.camera_h_m
    assert forward < 0.0 and down < 0.0  # behind D1, and above


@settings(max_examples=40)
@given(scenes)
def test_a_scene_and_its_mirror_image_are_equally_good(view: ViewpointScene) -> None:
    """Nothing of the rules prefers a side, and a camera without distortion neither."""
    camera = CameraModel(641, 481, 615.0, 615.0, 320.5, 240.5)
    flip = np.array([1.0, -1.0, 1.0])
    mirrored = replace(view, target_h_m=view.target_h_m * flip)
    here, there = plan(view, camera), plan(mirrored, camera)
    assert isinstance(here, Viewpoint) == isinstance(there, Viewpoint)
    if isinstance(here, Viewpoint) and isinstance(there, Viewpoint):
        assert score(here) == pytest.approx(score(there), abs=1e-6)


def score(viewpoint: Viewpoint) -> float:
    return (
        min(viewpoint.margin_px, 150.0) + 2.0 * viewpoint.marker_px - 20.0 * viewpoint.incidence_rad
    )


@pytest.mark.parametrize(
    ("rule", "changes"),
    [
        ("marker too small", {"min_marker_px": 60.0}),
        ("too oblique", {"max_incidence_deg": 0.5}),
        ("target too far", {"max_range_m": 0.5}),
        ("not both in view", {"image_margin_px": 235.0}),
    ],
)
def test_no_viewpoint_says_which_rule_left_none(rule: str, changes: dict[str, float]) -> None:
    none = plan(scene(), rules=replace(RULES, **changes))
    assert isinstance(none, NoViewpoint)
    assert none.rejected[rule] > 0
    assert f"{rule} {none.rejected[rule]}" in str(none)
    assert str(none).startswith("no viewpoint: ")


@pytest.mark.parametrize(
    ("rule", "apart"),
    [
        ("separation", replace(APART, horizontal_m=3.0, vertical_m=3.0)),
        ("too close", replace(APART, viewpoint_m=3.0)),
        (
            "downwash",
            replace(
                APART,
                wash_m=5.0,
                horizontal_m=0.1,
                vertical_m=0.1,
                viewpoint_m=0.1,
            ),
        ),
    ],
)
def test_no_place_far_enough_says_so(rule: str, apart: SeparationConfig) -> None:
    none = plan(scene(), apart=apart)
    assert isinstance(none, NoViewpoint)
    assert max(none.rejected, key=lambda name: none.rejected[name]) == rule


def test_a_body_in_the_way_is_named() -> None:
    none = plan(replace(scene(), body_radius_m=30.0))
    assert isinstance(none, NoViewpoint)
    assert none.rejected["target hidden by D1"] > 0
    assert "not both in view" not in none.rejected  # nothing was left to be looked at


def test_every_candidate_is_accounted_for_once() -> None:
    counts = {
        sum(none.rejected.values())
        for none in (
            plan(scene(), rules=replace(RULES, image_margin_px=235.0)),
            plan(scene(), rules=replace(RULES, max_range_m=0.5)),
            plan(scene(), apart=replace(APART, viewpoint_m=3.0)),
        )
        if isinstance(none, NoViewpoint)
    }
    assert len(counts) == 1


def test_a_leaning_drone_is_planned_for_as_it_leans() -> None:
    """The planner's margin is the one that a drone with that tilt will have, and a level plan's is
    not.
    """
    # z axis towards the front: nose up, the camera looks higher
    lean = np.array([math.sin(0.1), 0.0, math.cos(0.1)])
    level, leant = found(scene()), found(scene(), tilt_h=lean)
    assert min(Seen(scene(), leant, tilt_h=lean).margins()) == pytest.approx(
        leant.margin_px, abs=1e-6
    )
    surprised = min(Seen(scene(), level, tilt_h=lean).margins())
    assert surprised != pytest.approx(level.margin_px, abs=5.0)
    assert leant.margin_px >= surprised


@pytest.mark.parametrize(("forward", "lower"), [(0.1, True), (-0.1, False)])
def test_a_camera_that_leans_back_sees_things_lower_in_its_image(
    forward: float, lower: bool
) -> None:
    """Nose up: everything moves down in the image; nose down: up."""
    lean = np.array([math.sin(forward), 0.0, math.cos(forward)])
    straight = replace(found(scene()), yaw_h_rad=0.0)
    before, after = (
        Seen(scene(), straight).points_c(),
        Seen(scene(), straight, tilt_h=lean).points_c(),
    )
    for was, now in zip(before, after, strict=True):
        assert bool(now[1] / now[2] > was[1] / was[2]) is lower


def test_a_rule_that_is_made_stricter_is_kept() -> None:
    loose = found(scene())
    for rules in (
        replace(
            RULES, max_incidence_deg=math.degrees(loose.incidence_rad) - 1.0, image_margin_px=60.0
        ),
        replace(RULES, min_marker_px=loose.marker_px + 0.5, image_margin_px=20.0),
        replace(RULES, image_margin_px=loose.margin_px - 1.0),
    ):
        check_rules(Seen(scene(), found(scene(), rules=rules)), rules)


def test_it_keeps_away_from_the_target() -> None:
    """A target as high as D1 itself, just ahead of it: a camera beside D1 would be too near to
    something large.
    """
    near = replace(scene(ahead_m=0.9, below_m=0.1), target_radius_m=1.2)
    refused = plan(near)
    assert isinstance(refused, NoViewpoint)
    assert refused.rejected["target too near"] > 0


def person_from_the_side(right_m: float) -> ViewpointScene:
    """A person seen from 3.5 m above, who is not straight ahead of D1: both fit best into an image
    from close by.
    """
    return replace(scene(ahead_m=2.4, right_m=right_m, below_m=2.6), target_radius_m=0.6)


@pytest.mark.parametrize("right_m", [-0.5, -0.25, 0.0, 0.25, 0.5])
def test_the_marker_is_far_enough_for_two_drones_that_swing(right_m: float) -> None:
    """An approach is broken off below 0.85 m, and D2 was seen to swing by 0.2 m."""
    viewpoint = found(person_from_the_side(right_m))
    assert math.hypot(*viewpoint.camera_h_m) >= APART.marker_m - 1e-9
    check_rules(Seen(person_from_the_side(right_m), viewpoint))


def test_a_viewpoint_that_is_nearer_to_the_marker_is_better_than_none() -> None:
    """None of 20 px and more is as far as the first: the farthest is taken. Unasked it would be a
    nearer one.
    """
    near, unasked = (
        plan(person_from_the_side(0.25), apart=replace(APART, marker_m=m)) for m in (1.5, 0.2)
    )
    assert isinstance(near, Viewpoint) and isinstance(unasked, Viewpoint)
    assert 0.8 < math.hypot(*unasked.camera_h_m) < math.hypot(*near.camera_h_m) < 1.5


@pytest.mark.parametrize("right_m", [-0.7, -0.5, 0.5, 0.7])
@pytest.mark.parametrize("down_m", [0.3, 0.6])
def test_a_body_beside_its_marker_is_kept_clear_of_too(right_m: float, down_m: float) -> None:
    """How far a body is away is reckoned over both level axes: the plate may be on an arm."""
    view = replace(scene(), body_h_m=np.array([-0.8, right_m, down_m]))
    check_rules(Seen(view, found(view)))


@pytest.mark.parametrize("upper", [True, False])
def test_the_air_of_the_upper_drone_is_kept_out_of_where_wind_carries_it(upper: bool) -> None:
    away = 1.0 if upper else -1.0
    to_other = np.array([[away * 0.8, 0.0, away * 1.0], [away * -0.8, 0.0, away * 1.0]])
    windward, leeward = beside_wash_m(to_other, APART, np.array([-0.05, 0.0, 1.0])).tolist()
    calm = beside_wash_m(to_other, APART)
    keep_m = APART.wash_m + APART.wash_per_m
    assert calm == pytest.approx([0.8 - keep_m] * 2)
    assert windward == pytest.approx(calm[0] + 0.05 * APART.wash_lean)
    assert leeward == pytest.approx(calm[0] - 0.05 * APART.wash_lean)
