"""The distance that D2 keeps while all it has are positions, and what sends it round again."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import FlightMode, VehicleState
from drivers.rig.parts import Mount
from flight.config import GuardConfig, MissionConfig, RendezvousConfig
from flight.guidance import Vec3, add, norm, scale, subtract
from flight.rendezvous.course import Rendezvous, stand_off_m
from missions.ground import rig_library
from path.geometry.transforms import Pose
from path.messages import Role, Status

LEVEL = (1.0, 0.0, 0.0, 0.0)
WRONG = RendezvousConfig(positions_within_m=2.0, heights_within_m=1.0)


@dataclass
class Seen:
    """The marker view's answers."""

    marker_n_m: Vec3 = (1.0, 0.0, 0.5)
    velocity_n_mps: Vec3 = (0.0, 0.0, 0.0)
    sigma_m: float = 0.01
    known: bool = True
    target_n_m: Vec3 | None = None

    def predict(self, stamp_ns: int) -> Any:
        return self if self.known else None


def state(position_n_m: Vec3) -> VehicleState:
    still = (0.0, 0.0, 0.0)
    return VehicleState(
        0, 0, position_n_m, still, LEVEL, True, True, True, FlightMode.OFFBOARD, 1.0
    )


def rendezvous(
    config: MissionConfig,
    seen: Seen,
    clock_ns: list[int] | None = None,
    rig_name: str = "sim",
    there: Vec3 = (2.0, 0.0, -1.5),
) -> Rendezvous:
    rig = rig_library.load(rig_name)
    layout = rig.layout
    peer = Status(Role.SENDER, 0, there, (0.0, 0.0, 0.0), 0.0, 0, True, True, 1.0)
    now = clock_ns or [0]
    return Rendezvous(
        config, rig.receiver.camera, rig.receiver.mount, layout, cast(Any, seen), lambda: peer, lambda: now[0]
    )  # fmt: skip


def test_the_stand_off_is_clear_of_the_other_drone_however_the_positions_are_wrong() -> None:
    known = RendezvousConfig(positions_within_m=0.1, heights_within_m=0.1)
    assert stand_off_m(MissionConfig(rendezvous=known)) == 1.75
    config = MissionConfig(rendezvous=WRONG)
    assert stand_off_m(config) == pytest.approx(0.70 + 0.3 + math.hypot(2.0, 1.0))
    guide = rendezvous(config, Seen())
    place, _ = guide._facing_marker(guide.stand_off_m)
    assert norm(subtract(place, (2.0, 0.0, -1.5))) == pytest.approx(stand_off_m(config))


def test_a_camera_that_looks_steeply_down_leads_d2_to_no_place_above_the_other_drone() -> None:
    apart = MissionConfig().separation
    guide = rendezvous(MissionConfig(), Seen())
    guide._steepness_rad = math.radians(85.0)
    (north, east, down), _ = guide._facing_marker(2.0)
    height_m = -1.5 - down
    assert height_m == pytest.approx(2.0 * math.sin(math.radians(85.0)))
    keep_m = apart.wash_m + apart.wash_per_m * height_m
    assert math.hypot(north - 2.0, east) == pytest.approx(keep_m)


def test_once_the_marker_was_seen_it_says_where_the_sender_is() -> None:
    config = MissionConfig(rendezvous=WRONG)
    seen = Seen(marker_n_m=(2.0, 1.0, 1.0))
    guide = rendezvous(config, seen)
    own = state((-3.0, -0.5, -2.0))
    guide.note_seen(own, seen.marker_n_m)
    place, _ = guide._facing_marker(guide.stand_off_m)
    rig = rig_library.load("sim")
    camera = np.array(own.position_n_m) + rig.receiver.mount.T_b_c.t
    sender = camera + np.array(seen.marker_n_m) - rig.sender.mount.T_b_v.t
    assert np.linalg.norm(np.array(place) - sender) == pytest.approx(config.rendezvous.stand_off_m)
    assert guide.stand_off_m == config.rendezvous.stand_off_m


@pytest.mark.parametrize(
    ("seen", "why"),
    [
        (Seen(), ""),
        (Seen(known=False), ""),
        (Seen(marker_n_m=(0.8, 0.0, 0.2)), "0.82 m from the marker"),
        (
            Seen(marker_n_m=(-0.2, 0.0, 1.0)),
            "in the air of the upper drone, 1.02 m from the marker",
        ),
        (
            Seen(marker_n_m=(-0.2, 0.0, -1.0)),
            "in the air of the upper drone, 1.02 m from the marker",
        ),
        (Seen(marker_n_m=(0.4, 0.0, 1.0)), ""),
        (Seen(velocity_n_mps=(-1.2, 0.0, 0.0)), "closing in at 1.1 m/s"),
        (Seen(velocity_n_mps=(1.2, 0.0, 0.0)), ""),
        (Seen(sigma_m=2.0 * MissionConfig().rendezvous.max_position_sigma_m), ""),
        (Seen(sigma_m=0.2), "uncertain by 0.20 m at 1.1 m"),
        (Seen(marker_n_m=(3.0, 0.0, 1.0), velocity_n_mps=(-1.2, 0.0, 0.0), sigma_m=0.2), ""),
    ],
)
def test_an_approach_goes_on_only_within_its_bounds(seen: Seen, why: str) -> None:
    assert rendezvous(MissionConfig(), seen).out_of_bounds() == why


@pytest.mark.parametrize(
    ("off_m", "speed_mps", "there"),
    [
        (0.0, 0.0, True),
        (0.9, 0.9, True),
        (0.0, 1.1, False),
        (1.1, 0.0, False),
        (0.0, math.nan, False),
    ],
)
def test_at_the_viewpoint_is_near_and_slow_in_any_direction(
    off_m: float, speed_mps: float, there: bool
) -> None:
    """Shares of what the settings allow: a drone that passes through at speed has not arrived."""
    config = MissionConfig()
    most_m, most_mps = config.rendezvous.arrived_m, config.rendezvous.arrived_speed_mps
    for way in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)):
        seen = Seen()
        guide = rendezvous(config, seen)
        guide._viewpoint = cast(Any, SimpleNamespace(camera_h_m=(-1.2, 0.1, -0.6), yaw_h_rad=0.0))
        seen.marker_n_m = add((1.2, -0.1, 0.6), scale(way, off_m * most_m))
        seen.velocity_n_mps = scale(way, speed_mps * most_mps)
        assert guide.at_viewpoint() is there
    assert not rendezvous(config, Seen(known=False)).at_viewpoint()


def test_the_search_comes_no_nearer_than_the_stand_off_while_the_marker_can_be_seen_from_there() -> (
    None
):
    config, clock_ns = MissionConfig(rendezvous=replace(WRONG, gain_per_s=0.1)), [0]
    guide = rendezvous(config, Seen(known=False), clock_ns, "sim-field")
    guide.begin_search()
    place, yaw = guide._facing_marker(guide.stand_off_m)
    yaws: list[float] = []
    for second in range(0, 60):
        clock_ns[0] = second * 1_000_000_000
        setpoint = guide.search(state(place))
        ahead, _, down = setpoint.velocity_n_mps
        # outward and upward only, from the stand-off
        assert ahead * math.cos(yaw) <= 1e-9 and down <= 1e-9
        yaws.append(setpoint.yaw_rad - yaw)
    # it settles for 1.5 s, and then looks to and fro
    assert yaws[:2] == [0.0, 0.0] and abs(yaws[3]) > 0.1
    assert min(yaws) < -0.7 and max(yaws) > 0.7


def test_the_stand_off_is_where_the_plate_faces_whichever_way_that_is() -> None:
    guide = rendezvous(MissionConfig(), Seen())
    mount = rig_library.load("sim").receiver.mount
    for normal in ((-0.6, 0.8, 0.0), (0.8, 0.6, 0.0), (0.0, -1.0, 0.0)):
        right = np.array([normal[1], -normal[0], 0.0])
        R_b_v = np.stack([right, np.cross(normal, right), normal], axis=1)
        guide._mount = Mount(mount.T_b_c, Pose(R_b_v, mount.T_b_v.t))
        place, yaw = guide._facing_marker(2.0)
        north, east, _ = subtract(place, (2.0, 0.0, -1.5))
        level_m = math.hypot(north, east)
        assert level_m == pytest.approx(2.0 * math.sqrt(1.0 - mount.T_b_c.R[2, 2] ** 2))
        assert (north / level_m, east / level_m) == pytest.approx(normal[:2])
        assert (math.cos(yaw), math.sin(yaw)) == pytest.approx((-normal[0], -normal[1]))


def test_a_plate_that_faces_up_is_looked_for_from_behind_its_drone() -> None:
    guide = rendezvous(MissionConfig(), Seen())
    mount = rig_library.load("sim").receiver.mount
    R_b_v = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    guide._mount = Mount(mount.T_b_c, Pose(R_b_v, mount.T_b_v.t))
    north, east, _ = subtract(guide._facing_marker(2.0)[0], (2.0, 0.0, -1.5))
    assert north < -1.0 and east == pytest.approx(0.0)


def test_a_lost_marker_is_climbed_for_as_far_as_the_way_to_it_is_long() -> None:
    """The missing height is that of the camera's axis over both parts of the way, north and
    east.
    """
    guide = rendezvous(MissionConfig(), Seen(known=False))
    own, gain = state((-1.0, 0.5, -2.0)), MissionConfig().rendezvous.gain_per_s
    steepness = math.asin(float(rig_library.load("sim").receiver.mount.T_b_c.R[2, 2]))
    guide.note_seen(own, (0.6, 0.8, math.tan(steepness) - 0.1))  # 1 m away: 0.1 m too low
    _, _, down = guide.to_viewpoint(own).velocity_n_mps
    assert down == pytest.approx(-0.1 * gain)


def test_for_a_small_marker_the_search_comes_in_along_the_axis_of_the_camera_and_no_farther_than_it_must() -> (
    None
):
    config, clock_ns = MissionConfig(rendezvous=replace(WRONG, gain_per_s=10.0)), [0]
    guide = rendezvous(config, Seen(known=False), clock_ns)
    guide.begin_search()
    (start, yaw), (end, _) = guide._facing_marker(guide.stand_off_m), guide._facing_marker(1.75)
    axis = np.subtract(end, start) / norm(subtract(end, start))
    place, came_in_m = np.array(start), [0.0]
    for tenth in range(1, 600):
        clock_ns[0] = tenth * 100_000_000
        setpoint = guide.search(state((float(place[0]), float(place[1]), float(place[2]))))
        place = place + 0.1 * np.array(setpoint.velocity_n_mps)
        way = place - np.array(start)
        came_in_m.append(float(way @ axis))
        if tenth <= 60:
            assert np.linalg.norm(way - came_in_m[-1] * axis) < 1e-6 and setpoint.yaw_rad == yaw
    assert max(np.diff(came_in_m[:60])) <= 0.1 * 0.3 + 1e-6
    assert max(came_in_m) == pytest.approx(guide.stand_off_m - 1.75, abs=0.01)


def test_in_a_hall_the_receiver_looks_from_as_far_below_the_ceiling_as_from_its_walls() -> None:
    """It stood off right below the ceiling, and met it."""
    hall = ((-4.0, -4.0), (-4.0, 4.0), (4.0, 4.0), (4.0, -4.0))
    guard = GuardConfig(fence_height_m=3.0, corners_m=hall, clear_m=0.3)
    config = MissionConfig(rendezvous=replace(WRONG, gain_per_s=1.0), guard=guard)
    guide = rendezvous(config, Seen(known=False), [0], "sim-field", (1.0, 0.0, -1.5))
    place, _ = guide._facing_marker(guide.stand_off_m)
    assert -place[2] == pytest.approx(3.0 - 0.6)


@pytest.mark.parametrize("there", [(2.0, 0.0, -4.5), (-24.0, 5.0, -1.5)])
def test_wherever_the_sender_is_the_receiver_looks_for_it_from_within_the_fence(
    there: Vec3,
) -> None:
    config, clock_ns = MissionConfig(rendezvous=replace(WRONG, gain_per_s=1.0)), [0]
    guide = rendezvous(config, Seen(known=False), clock_ns, "sim-field", there)
    # less what may be wrong
    radius_m, height_m = config.guard.fence_radius_m - 2.0, config.guard.fence_height_m - 1.0
    place, _ = guide._facing_marker(guide.stand_off_m)
    guide.begin_search()
    farthest_m = highest_m = 0.0
    for second in range(0, 60):
        clock_ns[0] = second * 1_000_000_000
        place = add(place, guide.search(state(place)).velocity_n_mps)
        farthest_m, highest_m = (
            max(farthest_m, math.hypot(place[0], place[1])),
            max(highest_m, -place[2]),
        )
    assert farthest_m <= radius_m + 1e-6 and highest_m <= height_m + 1e-6
    assert farthest_m > radius_m - 0.05 or highest_m > height_m - 0.05  # it would have gone farther


def test_a_lost_marker_is_looked_for_where_positions_have_it_and_from_as_far_above_as_the_camera_looks_down() -> (
    None
):
    seen = Seen(marker_n_m=(0.6, 0.8, 0.3))
    guide = rendezvous(MissionConfig(), seen)
    own = state((-1.0, 0.5, -2.0))
    before = guide._back_off(own)
    assert before == (pytest.approx((-0.25, 0.0, 0.0)), pytest.approx(0.0))  # ahead is all it knows
    guide.note_seen(own, seen.marker_n_m)
    seen.known = False
    setpoint = guide.to_viewpoint(own)
    away, east, down = setpoint.velocity_n_mps
    assert setpoint.yaw_rad == pytest.approx(math.atan2(0.8, 0.6))
    assert (away, east) == pytest.approx((-0.25 * 0.6, -0.25 * 0.8))
    assert -0.4 <= down < -0.3  # 1 m away, and only 0.3 m above the marker
    seen.marker_n_m = (0.6, 0.8, 1.4)
    guide.note_seen(own, seen.marker_n_m)
    assert guide.to_viewpoint(own).velocity_n_mps[2] == 0.0  # never down
    high = state((-1.0, 0.5, -5.5))
    guide.note_seen(high, (0.6, 0.8, 0.3))
    assert guide.to_viewpoint(high).velocity_n_mps[2] == 0.0  # nor through its fence
