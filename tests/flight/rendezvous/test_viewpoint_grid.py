"""The planner against a search of its own grid that is written down a second time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flight.config import RendezvousConfig, SeparationConfig
from flight.rendezvous.viewpoint import (
    Floats,
    NoViewpoint,
    Viewpoint,
    ViewpointScene,
    _candidates,
    farthest_m,
)
from path.camera.model import CameraModel
from tests.flight.rendezvous.test_viewpoint import (
    APART,
    BARREL,
    CAMERA,
    LEVEL,
    RULES,
    leaning,
    person_from_the_side,
    pitched,
    plan,
    scene,
    score,
)


def test_the_grid_is_behind_and_above_the_marker_from_0_8_to_1_6_metres() -> None:
    places = _candidates(APART)
    distance = np.linalg.norm(places, axis=1)
    elevation = np.degrees(np.arcsin(-places[:, 2] / distance))
    azimuth = np.degrees(np.arctan2(places[:, 1], -places[:, 0]))
    assert (distance.min(), distance.max()) == pytest.approx((0.8, 1.6))
    assert sorted(set(np.round(distance, 6))) == pytest.approx([0.8 + 0.05 * k for k in range(17)])
    assert sorted(set(np.round(elevation, 6))) == pytest.approx([7.5 * k for k in range(9)])
    assert sorted(set(np.round(azimuth, 6))) == pytest.approx([10.0 * k for k in range(-7, 8)])
    assert len(places) == 17 * 9 * 15
    large = replace(APART, viewpoint_m=2.0)
    assert np.linalg.norm(_candidates(large), axis=1).max() == pytest.approx(farthest_m(large))


def broken_rule(
    place: Floats, view: ViewpointScene, camera: CameraModel, rules: RendezvousConfig
) -> str:
    """The first rule that a place breaks; "" when it keeps all that are not about the image."""
    to_body, to_target = view.body_h_m - place, view.target_h_m - place
    level, height = math.hypot(to_body[0], to_body[1]), abs(float(to_body[2]))
    body_m, target_m, marker_m = (float(np.linalg.norm(way)) for way in (to_body, to_target, place))
    between = math.acos(min(1.0, float(to_body @ to_target) / (body_m * target_m)))
    shown = math.atan2(view.body_radius_m, body_m) + math.atan2(view.target_radius_m, target_m)
    incidence = math.acos(min(1.0, float(place @ view.marker_normal_h) / marker_m))
    kept = {
        "separation": (level / APART.horizontal_m) ** 2 + (height / APART.vertical_m) ** 2 >= 1.0,
        "too close": body_m >= APART.viewpoint_m,
        "downwash": level >= APART.wash_m + height * APART.wash_per_m,
        "marker too small": 0.5 * (camera.fx + camera.fy) * view.marker_side_m / marker_m
        >= rules.min_marker_px,
        "too oblique": incidence <= math.radians(rules.max_incidence_deg),
        "target too far": target_m <= rules.max_range_m,
        "target too near": target_m >= APART.minimum_m + view.target_radius_m,
        "target hidden by D1": between >= shown,
    }
    return next((name for name, holds in kept.items() if not holds), "")


def margin_px(
    place: Floats, yaw: float, view: ViewpointScene, camera: CameraModel, tilt_h: Floats
) -> float:
    """From the rims of marker and target to the border; minus infinity where one of them is not
    seen.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    R_h_c = (
        leaning(tilt_h) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ pitched(45.0).R
    )
    margins: list[float] = []
    for way, size_m in (
        (-place, view.marker_side_m),
        (view.target_h_m - place, view.target_radius_m),
    ):
        x, y, z = (R_h_c.T @ way).tolist()
        if z <= 0.1 or math.hypot(x, y) > camera.max_radius * z:
            return -math.inf
        u, v = camera.project_point((x, y, z))
        margins.append(min(u, v, camera.width - u, camera.height - v) - camera.fx * size_m / z)
    return min(margins)


def best_of_all(
    view: ViewpointScene,
    camera: CameraModel,
    rules: RendezvousConfig,
    apart: SeparationConfig,
    tilt_h: Floats,
) -> tuple[float, dict[str, int]]:
    """The best score of any place and yaw of the grid, and how many places each rule took first."""
    rejected: dict[str, int] = {}
    found: list[tuple[float, float]] = []
    for place in _candidates(apart):
        broken = broken_rule(place, view, camera, rules)
        if broken:
            rejected[broken] = rejected.get(broken, 0) + 1
            continue
        to_marker, to_target = -place, view.target_h_m - place
        first = math.atan2(to_marker[1], to_marker[0])
        turn = math.remainder(math.atan2(to_target[1], to_target[0]) - first, 2.0 * math.pi)
        distance_m = float(np.linalg.norm(place))
        marker_px = 0.5 * (camera.fx + camera.fy) * view.marker_side_m / distance_m
        incidence = math.acos(min(1.0, float(place @ view.marker_normal_h) / distance_m))
        for share in (0.35, 0.5, 0.65):
            margin = margin_px(place, first + share * turn, view, camera, tilt_h)
            if margin >= rules.image_margin_px:
                found.append((distance_m, min(margin, 150.0) + 2.0 * marker_px - 20.0 * incidence))
    if not found:
        return -math.inf, rejected
    farthest = max(distance_m for distance_m, _ in found)
    least_m = min(apart.marker_m, farthest) - 1e-6
    return max(value for distance_m, value in found if distance_m >= least_m), rejected


LEAN = np.array([0.06, -0.08, math.sqrt(1.0 - 0.01)])
WIDE = CameraModel(1280, 720, 500.0, 505.0, 640.0, 360.0)
"""With so much room a margin of more than 150 px is no better than one of 150."""


@pytest.mark.parametrize(
    ("view", "camera", "rules", "tilt_h"),
    [
        (scene(), CAMERA, RULES, LEVEL),
        (scene(right_m=0.4), BARREL, RULES, LEAN),
        (person_from_the_side(0.25), CAMERA, RULES, LEVEL),
        (scene(side_m=0.1), WIDE, RULES, LEVEL),
        (scene(ahead_m=0.9, below_m=0.5), CAMERA, replace(RULES, image_margin_px=10.0), LEVEL),
        (replace(scene(), body_radius_m=0.6, target_radius_m=0.5), WIDE, RULES, LEVEL),
    ],
)
def test_no_place_of_the_grid_that_keeps_the_rules_is_better_than_the_one_that_is_found(
    view: ViewpointScene, camera: CameraModel, rules: RendezvousConfig, tilt_h: Floats
) -> None:
    best, _ = best_of_all(view, camera, rules, APART, tilt_h)
    viewpoint = plan(view, camera, rules=rules, tilt_h=tilt_h)
    if math.isinf(best):
        assert isinstance(viewpoint, NoViewpoint)
        return
    assert isinstance(viewpoint, Viewpoint)
    assert score(viewpoint) == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize(
    "view",
    [
        scene(),
        person_from_the_side(0.5),
        replace(scene(ahead_m=0.9, below_m=0.1), target_radius_m=1.2),
    ],
)
def test_what_is_rejected_is_counted_by_the_first_rule_it_breaks(view: ViewpointScene) -> None:
    rules = replace(RULES, image_margin_px=235.0)
    none = plan(view, rules=rules)
    assert isinstance(none, NoViewpoint)
    _, rejected = best_of_all(view, CAMERA, rules, APART, LEVEL)
    assert {
        name: count for name, count in none.rejected.items() if count and name != "not both in view"
    } == rejected
    words = str(none).removeprefix("no viewpoint: ").split(", ")
    counts = [int(word.rpartition(" ")[2]) for word in words]
    assert counts == sorted(counts, reverse=True)


def test_a_place_at_a_bound_of_a_rule_keeps_it() -> None:
    """The best place stays the best where a limit is moved to just what it has."""
    view = scene()
    best = plan(view)
    assert isinstance(best, Viewpoint)
    place = np.array([best.camera_h_m])
    to_body = view.body_h_m - place
    range_m = float(np.linalg.norm(view.target_h_m - place, axis=1)[0])
    body_m = float(np.linalg.norm(to_body, axis=1)[0])
    level_m = float(np.hypot(to_body[:, 0], to_body[:, 1])[0])
    for rules in (
        replace(RULES, max_range_m=range_m),
        replace(RULES, min_marker_px=best.marker_px),
        replace(RULES, image_margin_px=best.margin_px),
    ):
        assert plan(view, rules=rules) == best
    for apart in (
        replace(APART, viewpoint_m=body_m),
        replace(APART, horizontal_m=level_m, vertical_m=1e300),
    ):
        assert farthest_m(apart) == farthest_m(APART)
        assert plan(view, apart=apart) == best


def test_where_all_places_are_near_the_marker_the_farthest_of_them_is_taken() -> None:
    near = replace(RULES, min_marker_px=26.5, image_margin_px=20.0)
    viewpoint = plan(scene(), rules=near, apart=replace(APART, viewpoint_m=0.9))
    assert isinstance(viewpoint, Viewpoint)
    assert 0.85 < math.hypot(*viewpoint.camera_h_m) < 0.95
