"""The velocities and yaws of D2's way to D1, number by number."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import VehicleState
from drivers.rig.parts import Mount
from flight.config import GuardConfig, MissionConfig, RendezvousConfig
from flight.guidance import Vec3, add, bearing, from_heading, norm, scale, subtract
from flight.rendezvous.course import Rendezvous
from flight.rendezvous.viewpoint import NoViewpoint, farthest_m
from missions.ground import rig_library
from path.geometry.rotation import R_from_rpy, quat_from_R
from path.geometry.transforms import Pose
from path.messages import Role, Status, Target
from tests.flight.rendezvous.test_course import Seen, rendezvous, state

PEER = Status(Role.SENDER, 0, (2.0, 0.0, -1.5), (0.3, -0.2, 0.1), 0.7, 0, True, True, 1.0)
CONFIG = MissionConfig()
RULES = CONFIG.rendezvous


def moving(config: MissionConfig, seen: Seen, peer: Status = PEER) -> Rendezvous:
    """A rendezvous with a sender that moves and does not look north."""
    guide = rendezvous(config, seen)
    guide._peer = lambda: peer
    return guide


def turned(position_n_m: Vec3, yaw_rad: float) -> VehicleState:
    w, x, y, z = quat_from_R(R_from_rpy(0.0, 0.0, yaw_rad))
    return replace(state(position_n_m), q_n_b=(w, x, y, z))


def at_viewpoint(
    guide: Rendezvous, camera_h_m: Vec3 = (-1.2, 0.1, -0.6), yaw_h_rad: float = 0.2
) -> None:
    guide._viewpoint = cast(Any, SimpleNamespace(camera_h_m=camera_h_m, yaw_h_rad=yaw_h_rad))


# --- by positions


def test_the_way_to_the_stand_off_is_flown_at_a_metre_a_second_beside_a_sender_that_moves() -> None:
    guide = moving(CONFIG, Seen())
    place, yaw = guide._facing_marker(guide.stand_off_m)
    far = beside(add(place, (-9.0, 0.0, 0.0)))
    setpoint = guide.to_stand_off(far)
    assert setpoint.velocity_n_mps == pytest.approx(add(PEER.velocity_n_mps, (1.0, 0.0, 0.0)))
    assert setpoint.yaw_rad == yaw
    near = beside(add(place, (0.0, 0.1, -0.2)))
    wanted = add(PEER.velocity_n_mps, scale((0.0, -0.1, 0.2), RULES.gain_per_s))
    assert guide.to_stand_off(near).velocity_n_mps == pytest.approx(wanted)


def beside(position_n_m: Vec3) -> VehicleState:
    """A drone that moves as the sender does."""
    return replace(state(position_n_m), velocity_n_mps=PEER.velocity_n_mps)


@pytest.mark.parametrize("response_s", [0.3, 1.0, 2.0])
def test_a_drone_that_answers_late_comes_to_rest_at_the_stand_off_and_not_behind_it(
    response_s: float,
) -> None:
    config = replace(CONFIG, follow=replace(CONFIG.follow, response_s=response_s))
    guide = moving(config, Seen(), replace(PEER, velocity_n_mps=(0.0, 0.0, 0.0)))
    place, _ = guide._facing_marker(guide.stand_off_m)
    position = add(place, (-5.0, 0.0, 0.0))
    velocity = (0.0, 0.0, 0.0)
    past_m = []
    for _ in range(1500):
        drone = replace(state(position), velocity_n_mps=velocity)
        wanted = guide.to_stand_off(drone).velocity_n_mps
        velocity = add(velocity, scale(subtract(wanted, velocity), 0.02 / response_s))
        position = add(position, scale(velocity, 0.02))
        past_m.append(position[0] - place[0])
    assert max(past_m) < 0.1 * RULES.stand_off_tolerance_m
    assert past_m[-1] == pytest.approx(0.0, abs=0.01)


def test_at_the_stand_off_is_nearer_than_its_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    guide = rendezvous(CONFIG, Seen())

    def origin(distance_m: float) -> tuple[Vec3, float]:
        assert distance_m == guide.stand_off_m
        return (0.0, 0.0, 0.0), 0.0

    monkeypatch.setattr(guide, "_facing_marker", origin)
    assert RULES.stand_off_tolerance_m == 0.25
    assert guide.at_stand_off(state((0.0, 0.0, 0.249)))
    assert not guide.at_stand_off(state((0.0, 0.25, 0.0)))


def searched(
    second: float, config: MissionConfig, rig_name: str = "sim-field"
) -> tuple[Vec3, float]:
    """Where a search leads after so long, ahead, right and down of where it began, and the yaw off
    the marker.
    """
    clock_ns = [5_000_000_000]
    guide = rendezvous(config, Seen(known=False), clock_ns, rig_name)
    guide.begin_search()
    clock_ns[0] += round(second * 1e9)
    start, yaw = guide._facing_marker(guide.stand_off_m)
    setpoint = guide.search(state(start))
    gain = config.rendezvous.gain_per_s
    return from_heading(scale(setpoint.velocity_n_mps, 1.0 / gain), -yaw), setpoint.yaw_rad - yaw


@pytest.mark.parametrize("second", [1.0, 2.5, 4.0, 7.0, 12.0, 20.0])
def test_a_search_looks_to_and_fro_slides_outward_and_climbs_each_in_its_own_time(
    second: float,
) -> None:
    """After 1.5 s: 1.1 rad/s to and fro, wider over 3.3 s; 0.3 rad/s outward and back, 0.19 rad/s
    up and down.
    """
    wide = replace(
        RULES, positions_within_m=2.0, heights_within_m=1.0, search_slide_m=2.4, gain_per_s=0.1
    )
    config = replace(
        CONFIG, rendezvous=wide, guard=GuardConfig(fence_radius_m=90.0, fence_height_m=60.0)
    )
    (ahead, right, down), turn = searched(second, config)
    passed = max(0.0, second - 1.5)
    slid_m = 1.2 * (1.0 - math.cos(0.3 * passed))
    assert (ahead, right) == (pytest.approx(-slid_m, abs=1e-9), pytest.approx(0.0, abs=1e-9))
    assert down == pytest.approx(-0.5 * (1.0 - math.cos(0.19 * passed)), abs=1e-9)
    assert turn == pytest.approx(
        math.radians(50.0) * min(1.0, 0.3 * passed) * math.sin(1.1 * passed), abs=1e-9
    )


def test_a_search_slides_by_what_the_positions_may_be_wrong_where_that_is_more() -> None:
    rules = replace(RULES, positions_within_m=3.0, search_slide_m=0.8, gain_per_s=0.1)
    config = replace(
        CONFIG, rendezvous=rules, guard=GuardConfig(fence_radius_m=90.0, fence_height_m=60.0)
    )
    (ahead, _, _), _ = searched(1.5 + math.pi / 0.3, config)
    assert ahead == pytest.approx(-3.0, abs=1e-6)


def test_a_search_is_as_near_as_the_marker_has_fourteen_pixels() -> None:
    guide = rendezvous(MissionConfig(rendezvous=RendezvousConfig(positions_within_m=2.0)), Seen())
    focal_px = 0.5 * (guide._camera.fx + guide._camera.fy)
    for wanted_m, given_m in ((2.3, 2.3), (1.0, RULES.stand_off_m), (9.0, guide.stand_off_m)):
        guide._side_m = 14.0 * wanted_m / focal_px
        assert guide._search_from_m() == pytest.approx(given_m)


def test_where_the_sender_is_follows_from_both_headings_and_both_mountings() -> None:
    """D2 looks east, D1 has its own heading: camera and marker are where their drones carry
    them.
    """
    guide = moving(CONFIG, Seen())
    mount = guide._mount
    guide._mount = Mount(mount.T_b_c, Pose(mount.T_b_v.R, np.array([-0.2, 0.15, -0.05])))
    own = turned((-1.0, 0.5, -2.0), 1.2)
    camera = np.array(own.position_n_m) + R_from_rpy(0.0, 0.0, 1.2) @ mount.T_b_c.t
    marker = np.array(PEER.position_n_m) + R_from_rpy(0.0, 0.0, 0.7) @ (-0.2, 0.15, -0.05)
    shift = np.array([0.1, 0.2, 0.3])
    assert guide._reported(own, (0.1, 0.2, 0.3)) == pytest.approx(tuple(marker + shift - camera))
    measured = (1.5, -0.5, 0.4)
    guide.note_seen(own, measured)
    assert guide._shift_n_m is not None
    assert guide._reported(own, guide._shift_n_m) == pytest.approx(measured)


@pytest.mark.parametrize(("level", "used"), [(0.09, False), (0.15, True)])
def test_a_plate_that_hardly_leans_to_any_side_faces_none(level: float, used: bool) -> None:
    guide = rendezvous(CONFIG, Seen())
    mount = guide._mount
    normal = np.array([0.0, level, -math.sqrt(1.0 - level * level)])
    right = np.array([1.0, 0.0, 0.0])
    guide._mount = Mount(
        mount.T_b_c, Pose(np.stack([right, np.cross(normal, right), normal], axis=1), mount.T_b_v.t)
    )
    north, east, down = subtract(guide._facing_marker(2.0)[0], (2.0, 0.0, -1.5))
    steepness = math.asin(float(mount.T_b_c.R[2, 2]))
    assert down == pytest.approx(-2.0 * math.sin(steepness))
    level_m = 2.0 * math.cos(steepness)
    assert (north, east) == pytest.approx((0.0, level_m) if used else (-level_m, 0.0), abs=1e-9)


def test_a_fence_with_corners_is_kept_by_its_own_shape() -> None:
    corners = ((-5.0, -5.0), (5.0, -5.0), (5.0, 0.3), (-5.0, 0.3))
    config = replace(CONFIG, guard=replace(CONFIG.guard, corners_m=corners))
    guide = rendezvous(config, Seen())
    assert guide._within_fence((1.0, 4.0, -1.0)) == pytest.approx(
        config.fence.nearest((1.0, 4.0, -1.0))
    )
    assert guide._within_fence((1.0, 4.0, -1.0))[1] < 0.3


# --- by the marker


@pytest.mark.parametrize(("sigmas", "share"), [(0.5, 1.0), (1.0, 1.0), (1.01, 0.3)])
def test_the_approach_is_slower_while_the_marker_s_pose_is_unsure(
    sigmas: float, share: float
) -> None:
    seen = Seen(marker_n_m=(9.0, 0.0, 0.0), sigma_m=sigmas * RULES.max_position_sigma_m)
    guide = moving(CONFIG, seen)
    at_viewpoint(guide)
    velocity = subtract(
        guide.to_viewpoint(state((0.0, 0.0, -2.0))).velocity_n_mps, PEER.velocity_n_mps
    )
    assert norm(velocity) == pytest.approx(share * RULES.max_speed_mps)
    error = add(from_heading((-1.2, 0.1, -0.6), PEER.yaw_rad), seen.marker_n_m)
    assert scale(velocity, 1.0 / norm(velocity)) == pytest.approx(scale(error, 1.0 / norm(error)))


def test_at_the_very_bound_a_drone_has_not_arrived(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = Seen()
    guide = rendezvous(CONFIG, seen)
    off: list[Vec3] = [(0.0, 0.0, 0.0)]

    def off_viewpoint(_marker_n_m: Vec3) -> Vec3:
        return off[0]

    monkeypatch.setattr(guide, "_off_viewpoint", off_viewpoint)
    assert guide.at_viewpoint()
    seen.velocity_n_mps = (RULES.arrived_speed_mps, 0.0, 0.0)
    assert not guide.at_viewpoint()
    seen.velocity_n_mps = (0.0, 0.0, 0.0)
    off[0] = (RULES.arrived_m, 0.0, 0.0)
    assert not guide.at_viewpoint()


def test_near_the_viewpoint_the_approach_slows_down_with_what_is_missing() -> None:
    seen = Seen()
    guide = moving(CONFIG, seen)
    at_viewpoint(guide)
    missing = (0.05, -0.02, 0.03)
    seen.marker_n_m = subtract(missing, from_heading((-1.2, 0.1, -0.6), PEER.yaw_rad))
    velocity = guide.to_viewpoint(state((0.0, 0.0, -2.0))).velocity_n_mps
    assert velocity == pytest.approx(add(PEER.velocity_n_mps, scale(missing, RULES.gain_per_s)))


@pytest.mark.parametrize(
    ("target_n_m", "yaw"),
    [
        (None, 0.7 + 0.2),
        ((1.0, 1.0, 2.0), math.radians(22.5)),
        ((1.0, -1.0, 2.0), -math.radians(22.5)),
    ],
)
def test_the_yaw_is_the_planned_one_until_the_target_is_seen_and_then_half_way_to_it(
    target_n_m: Vec3 | None, yaw: float
) -> None:
    guide = moving(CONFIG, Seen(marker_n_m=(1.0, 0.0, 0.5)))
    at_viewpoint(guide)
    guide._marker.target_n_m = target_n_m
    assert guide.to_viewpoint(state((0.0, 0.0, -2.0))).yaw_rad == pytest.approx(yaw)


def test_the_yaw_half_way_is_on_the_short_way_round() -> None:
    guide = moving(CONFIG, Seen(marker_n_m=(-1.0, 0.1, 0.5)))
    at_viewpoint(guide)
    guide._marker.target_n_m = (-1.0, -0.1, 2.0)
    yaw = guide.to_viewpoint(state((0.0, 0.0, -2.0))).yaw_rad
    assert abs(yaw) == pytest.approx(math.pi)


def test_a_drone_that_backs_off_keeps_with_a_sender_that_moves() -> None:
    guide = moving(CONFIG, Seen(known=False))
    own = turned((-1.0, 0.5, -2.0), 1.2)
    setpoint = guide.to_viewpoint(own)
    assert setpoint.velocity_n_mps == pytest.approx(
        add(PEER.velocity_n_mps, from_heading((-0.25, 0.0, 0.0), 1.2))
    )
    assert setpoint.yaw_rad == pytest.approx(1.2)


def test_a_drone_that_backs_off_climbs_at_0_4_metres_a_second_at_most() -> None:
    guide = rendezvous(CONFIG, Seen(known=False))
    own = state((-1.0, 0.5, -2.0))
    guide.note_seen(own, (1.8, 2.4, 0.0))  # 3 m away, and as high as the marker
    assert guide.to_viewpoint(own).velocity_n_mps[2] == -0.4


@pytest.mark.parametrize(
    ("seen", "stops"),
    [
        (Seen(marker_n_m=(0.8501, 0.0, 0.0)), False),
        (Seen(marker_n_m=(0.8499, 0.0, 0.0)), True),
        (Seen(marker_n_m=(1.2, 0.0, 0.0), velocity_n_mps=(-0.899, 0.0, 0.0)), False),
        (Seen(marker_n_m=(1.2, 0.0, 0.0), velocity_n_mps=(-0.901, 0.0, 0.0)), True),
        # past it, not at it
        (Seen(marker_n_m=(0.0, 1.2, 0.0), velocity_n_mps=(-5.0, -0.899, -5.0)), False),
        (Seen(marker_n_m=(1.2, 0.0, 0.0), sigma_m=0.16), False),
        (Seen(marker_n_m=(1.2, 0.0, 0.0), sigma_m=0.1601), True),
        (Seen(marker_n_m=(1.5999, 0.0, 0.0), sigma_m=0.5), True),
        (Seen(marker_n_m=(1.6001, 0.0, 0.0), sigma_m=0.5), False),
    ],
)
def test_each_bound_of_an_approach_is_where_it_is(seen: Seen, stops: bool) -> None:
    """0.85 m; 0.4 m/s above the speed of an approach (0.5); twice the uncertainty to close in with;
    to 1.6 m.
    """
    assert farthest_m(CONFIG.separation) == pytest.approx(1.6)
    assert bool(rendezvous(CONFIG, seen).out_of_bounds()) is stops


def test_the_farthest_place_of_a_marker_grows_with_the_drones() -> None:
    wide = replace(CONFIG.separation, viewpoint_m=2.0)
    assert farthest_m(wide) == pytest.approx(1.18 * 2.0)


# --- the plan


def test_the_viewpoint_is_planned_for_the_sender_as_it_leans_and_the_receiver_as_it_leans(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the planner is given: the scene in D1's levelled frame, and D2's lean as D1's heading
    has it.
    """
    asked: list[tuple[Any, ...]] = []

    def plan(*given: Any) -> NoViewpoint:
        asked.append(given)
        return NoViewpoint({"too close": 1})

    monkeypatch.setattr("flight.rendezvous.course.plan_viewpoint", plan)
    guide = moving(CONFIG, Seen())
    rig = rig_library.load("sim")
    mount = rig.receiver.mount
    guide._mount = Mount(mount.T_b_c, Pose(mount.T_b_v.R, np.array([-0.2, 0.15, -0.05])))
    R_h_b = R_from_rpy(0.1, -0.15, 0.0)
    gravity = mount.T_b_v.R.T @ R_h_b.T @ (0.0, 0.0, 1.0)
    gravity_v = (float(gravity[0]), float(gravity[1]), float(gravity[2]))
    guide.tilt.down_n = (0.1, 0.0, math.sqrt(0.99))
    answer = guide.plan(Target(1, 1, 1, 0, 0, (0.4, -0.3, 1.1), gravity_v, 0.01))
    assert isinstance(answer, NoViewpoint) and guide._viewpoint is None
    ((scene, camera, T_b_c, rules, separation, tilt_h, ground),) = asked
    assert ground is None  # common views are not on
    R_h_v = R_h_b @ mount.T_b_v.R
    assert scene.target_h_m == pytest.approx(R_h_v @ (0.4, -0.3, 1.1))
    assert scene.marker_normal_h == pytest.approx(R_h_v[:, 2])
    assert scene.body_h_m == pytest.approx(R_h_v @ (mount.T_b_v.R.T @ (0.2, -0.15, 0.05)))
    assert scene.marker_side_m == max(marker.side_m for marker in rig.layout.markers)
    assert scene.body_radius_m == 0.5 * CONFIG.separation.horizontal_m
    assert scene.target_radius_m == CONFIG.target.half_size_m
    assert (camera, T_b_c, rules, separation) == (
        guide._camera,
        mount.T_b_c,
        RULES,
        CONFIG.separation,
    )
    expected = (0.1 * math.cos(-0.7), 0.1 * math.sin(-0.7), math.sqrt(0.99))
    assert tuple(tilt_h) == pytest.approx(expected)
    assert bearing((1.0, 1.0, 0.0)) == pytest.approx(math.pi / 4)
