"""The geometric perception against the camera model and the renderer, and beside that on pixels as
one contract.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from drivers.interfaces import CameraError, Perception, View
from drivers.rig.obstacle import Obstacle
from drivers.rig.parts import Mount, Origin, PartContext
from hil.camera.capture import Capture, Freeze
from hil.geometric import targets as geometric_targets
from hil.geometric.noise import EXACT, ObservationNoise
from hil.geometric.perception import (
    GeometricPerception,
    GeometricPerceptionConfig,
    GeometricView,
    Sensor,
    warm_up,
)
from hil.geometric.scene import Array, CameraSetup, outlines, place
from hil.render.renderer import Renderer
from hil.render.scene import car
from hil.render.sensor import NOISE_FREE
from hil.world.errors import Built
from hil.world.obstacles import crates_of
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, Region
from path.target.place import registered_depth
from tests.doubles import LoopClock

CAMERA = CameraModel(640, 480, 615.2, 615.9, 322.1, 241.3, (0.112, -0.236, 0.0006, -0.0004, 0.095))
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SLANT = math.sqrt(0.5)
T_B_C = Pose(
    np.array([[0.0, -SLANT, SLANT], [1.0, 0.0, 0.0], [0.0, SLANT, SLANT]]),
    np.array([0.10, 0.0, 0.02]),
)
T_B_V = Pose(
    np.array([[0.0, SLANT, -SLANT], [1.0, 0.0, 0.0], [0.0, -SLANT, -SLANT]]),
    np.array([-0.18, 0.0, -0.06]),
)
LAYOUT = single_marker()


def drone(
    east: float, north: float, up: float, heading_deg: float = 0.0, roll_deg: float = 0.0
) -> DroneTruth:
    R_n_b = R_from_rpy(math.radians(roll_deg), 0.02, math.radians(heading_deg))
    return DroneTruth(
        Pose(NED_TO_ENU @ R_n_b, np.array([east, north, up])), (0.0, 0.0, 0.0), 0.3, True
    )


SENDER = drone(0.0, -1.55, 1.5, 3.0, 2.0)
RECEIVER = drone(0.35, -2.7, 2.3, -5.0, -1.5)


def thing(number: int, east: float, north: float, yaw_deg: float = 30.0) -> ObjectTruth:
    return ObjectTruth(number, (east, north, 0.0), math.radians(yaw_deg), 0.0)


def moment(
    *things: ObjectTruth, sender: DroneTruth = SENDER, receiver: DroneTruth = RECEIVER
) -> Snapshot:
    return Snapshot(0.0, {Role.SENDER: sender, Role.RECEIVER: receiver}, things)


def alone(snapshot: Snapshot, role: Role) -> Snapshot:
    return replace(snapshot, drones={role: snapshot.drones[role]})


def made(role: Role, noise: ObservationNoise, seed: int, T_b_v: Pose) -> Sensor:
    return Sensor(CameraSetup(role, CAMERA, T_B_C, T_b_v, LAYOUT), noise, MethodConfig(), seed)


@cache
def usual(role: Role, noise: ObservationNoise, seed: int) -> Sensor:
    return made(role, noise, seed, T_B_V)


def look(
    snapshot: Snapshot,
    role: Role = Role.SENDER,
    noise: ObservationNoise = EXACT,
    frame_id: int = 1,
    seed: int = 0,
    T_b_v: Pose | None = None,
) -> GeometricView:
    sensor = usual(role, noise, seed) if T_b_v is None else made(role, noise, seed, T_b_v)
    return GeometricView(Capture(frame_id, frame_id, snapshot), sensor)


def T_c_w(snapshot: Snapshot, role: Role) -> Pose:
    return (snapshot.drones[role].T_w_b @ T_B_C).inverse()


def bounds(snapshot: Snapshot, role: Role, thing: ObjectTruth) -> tuple[float, float, float, float]:
    """Box around the car's drawn corners, by the camera model."""
    rows = car().corners
    corners = np.concatenate(
        [rows[:, :3] + a * rows[:, 3:6] + b * rows[:, 6:] for a in (0, 1) for b in (0, 1)]
    )
    c, s = math.cos(thing.yaw_rad), math.sin(thing.yaw_rad)
    world = corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + np.array(
        thing.position_w_m
    )
    pixels = CAMERA.project(T_c_w(snapshot, role).apply(world))
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    return float(x0), float(y0), float(x1 - x0), float(y1 - y0)


def marker_pixels(snapshot: Snapshot) -> Array:
    world = (snapshot.drones[Role.SENDER].T_w_b @ T_B_V).apply(LAYOUT.markers[0].corners_v)
    return CAMERA.project(T_c_w(snapshot, Role.RECEIVER).apply(world))


def values(box: Box) -> tuple[float, float, float, float]:
    return box.x, box.y, box.w, box.h


# --- cars ---


@pytest.mark.parametrize("role", list(Role))
def test_boxes_are_those_of_the_camera_model(role: Role) -> None:
    things = thing(0, 0.1, 0.0), thing(1, -0.6, 0.4, 110.0), thing(2, 0.7, 0.5, -60.0)
    snapshot = alone(moment(*things), role)
    found = [values(d.box) for d in look(snapshot, role).targets(None)]
    assert sorted(found) == [
        pytest.approx(box, abs=1e-9) for box in sorted(bounds(snapshot, role, t) for t in things)
    ]


def test_only_cars_centred_in_the_region_are_given_best_first() -> None:
    snapshot = moment(thing(0, 0.0, 0.0), thing(1, 0.6, 0.1))
    everything = look(snapshot, noise=ObservationNoise()).targets(None)
    assert [d.score for d in everything] == sorted((d.score for d in everything), reverse=True)
    for detection in everything:
        u, v = detection.box.center
        assert look(snapshot, noise=ObservationNoise()).targets(
            Region(u - 1, v - 1, u + 1, v + 1)
        ) == [detection]


def test_what_the_border_cuts_ends_there_with_a_low_score() -> None:
    edge = -(0.5 * 640 / 615 * 2.1) + 0.05
    (cut,) = look(moment(thing(0, edge, 0.0))).targets(None)
    assert cut.box.x == -0.5
    assert cut.score < 0.3
    assert not look(moment(thing(0, 0.0, -4.0))).targets(None)  # behind


def test_a_car_in_front_hides_part_of_the_one_behind() -> None:
    front, behind = thing(0, 0.0, 0.0, 0.0), thing(1, 0.02, 0.235, 0.0)
    both = moment(front, behind)
    boxes = {round(d.box.y): d.box for d in look(both).targets(None)}
    near, far = bounds(both, Role.SENDER, front), bounds(both, Role.SENDER, behind)
    assert values(boxes[round(near[1])]) == pytest.approx(near, abs=1e-9)
    rear = boxes[round(far[1])]
    assert rear.y == pytest.approx(far[1])
    renderer = Renderer(CAMERA, T_B_C, T_B_V, LAYOUT, NOISE_FREE)
    with_rear, without = (
        renderer.render(m, Role.SENDER, 0)[1].astype(int) for m in (both, moment(front))
    )
    lowest_row = np.flatnonzero((np.abs(with_rear - without) > 2).any(axis=1))[-1]
    assert lowest_row < far[1] + far[3] - 6.0
    assert rear.y + rear.h == pytest.approx(lowest_row, abs=7.0)


def test_two_that_touch_in_the_image_may_be_taken_for_one() -> None:
    touching = moment(thing(0, 0.0, 0.0, 0.0), thing(1, 0.16, 0.235, 0.0))
    apart = moment(thing(0, 0.0, 0.0, 0.0), thing(1, 0.6, 0.3, 0.0))
    counts = [
        len(look(touching, noise=ObservationNoise(), frame_id=k).targets(None)) for k in range(200)
    ]
    assert {1, 2} == set(counts)
    assert all(
        len(look(apart, noise=ObservationNoise(), frame_id=k).targets(None)) == 2
        for k in range(200)
    )


def test_boxes_leave_out_the_top_as_often_and_by_as_much_as_is_said() -> None:
    cut = EXACT.targets._replace(edge_sigma_px=1e-6, cut_rate=0.3, cut_px=20.0)
    snapshot = alone(moment(thing(0, 0.1, 0.0)), Role.SENDER)
    ((x, y, w, h),) = [values(d.box) for d in look(snapshot).targets(None)]
    boxes = [
        look(snapshot, Role.SENDER, replace(EXACT, targets=cut), 10 * k).targets(None)[0].box
        for k in range(400)
    ]
    assert all(values(b) == pytest.approx((x, b.y, w, y + h - b.y), abs=1e-4) for b in boxes)
    tops = np.array([b.y - y for b in boxes])
    assert np.mean(tops > 1e-3) == pytest.approx(0.3, abs=0.07)
    assert np.mean(tops[tops > 1e-3]) == pytest.approx(20.0 * math.sqrt(2.0 / math.pi), rel=0.2)


@pytest.mark.parametrize("role", Role)
def test_placed_later_is_the_world_carried_on(role: Role) -> None:
    moving = replace(thing(0, 0.3, 0.2), speed_mps=0.4, climb_mps=0.1)
    drones = (replace(each, velocity_w_mps=(0.5, -0.3, 0.2)) for each in (SENDER, RECEIVER))
    then = moment(moving, thing(1, -0.9, 0.4), sender=next(drones), receiver=next(drones))
    setup = usual(role, EXACT, 1).setup
    later, carried = (
        outlines(setup, place(setup, then, 0.04)),
        outlines(setup, place(setup, then.carried_on(0.04))),
    )
    np.testing.assert_array_equal(later, carried)
    assert not np.array_equal(later, outlines(setup, place(setup, then)))


def test_a_car_behind_the_sender_is_not_seen_by_the_receiver() -> None:
    eye = (RECEIVER.T_w_b @ T_B_C).t
    on = eye + (SENDER.T_w_b.t - eye) * eye[2] / (eye[2] - SENDER.T_w_b.t[2])
    hidden = moment(thing(0, float(on[0]), float(on[1])))
    (free,) = look(alone(hidden, Role.RECEIVER), Role.RECEIVER).targets(None)
    found = look(hidden, Role.RECEIVER).targets(None)
    assert not found or values(found[0].box) != pytest.approx(values(free.box), abs=1.0)


# --- depth ---


@pytest.mark.parametrize("role", list(Role))
def test_depth_is_that_of_the_drawn_surface(role: Role) -> None:
    snapshot = moment(thing(0, 0.1, 0.0), thing(1, -0.6, 0.4, 110.0))
    drawn = Renderer(CAMERA, T_B_C, T_B_V, LAYOUT, NOISE_FREE).render(snapshot, role, 0)[1]
    view = look(snapshot, role)
    boxes = [d.box for d in view.targets(None)] + [Box(300.0, 380.0, 60.0, 60.0)]
    for box in boxes:
        ours, theirs = view.depth(box), registered_depth(drawn, box, MethodConfig())
        assert ours is not None
        assert theirs is not None
        assert ours.z_m == pytest.approx(theirs.z_m, abs=0.012)
        assert ours.sigma_m == pytest.approx(theirs.sigma_m, rel=0.1)


# --- what stands in the way

TARGET = thing(0, 0.1, 0.0)
BETWEEN = Obstacle((-0.7, 0.0), (0.2, 3.0), 1.4)
BESIDE = Obstacle((-0.7, 2.2), (0.2, 3.0), 1.4)
POST = Obstacle((-1.9, 0.1), (0.3, 0.3), 3.0, round=True)


def walled(*obstacles: Obstacle) -> Snapshot:
    return replace(moment(TARGET), obstacles=crates_of(obstacles))


@pytest.mark.parametrize("role", list(Role))
def test_an_obstacle_hides_what_is_behind_it_and_is_what_depth_measures(role: Role) -> None:
    free = look(walled(), role)
    (seen,) = free.targets(None)
    behind = look(walled(BETWEEN), role)
    assert behind.targets(None) == []
    depth = free.depth(seen.box)
    nearer = behind.depth(seen.box)
    assert depth is not None
    assert nearer is not None
    assert nearer.z_m < depth.z_m - 0.3


def test_an_obstacle_beside_the_line_of_sight_hides_nothing() -> None:
    for role in Role:
        seen = [values(each.box) for each in look(walled(BESIDE), role).targets(None)]
        assert seen == [values(each.box) for each in look(walled(), role).targets(None)]


def test_one_that_the_camera_stands_beside_hides_no_more_than_it_covers() -> None:
    """A wall that begins behind the camera still hides what is behind its other end."""
    along = Obstacle((-1.0, 0.4), (6.0, 0.2), 3.0)
    (seen,) = look(walled(along)).targets(None)
    assert values(seen.box) == values(look(walled()).targets(None)[0].box)
    across = Obstacle((-0.7, 0.05), (6.0, 0.2), 3.0, heading_deg=60.0)
    assert look(walled(across)).targets(None) == []


def test_a_marker_behind_an_obstacle_is_not_found() -> None:
    assert len(look(walled(BETWEEN), Role.RECEIVER).markers(None)) == 1
    assert not look(walled(POST), Role.RECEIVER).markers(None)


@pytest.mark.parametrize("role", list(Role))
def test_depth_of_an_obstacle_is_that_of_the_drawn_one(role: Role) -> None:
    snapshot = walled(BETWEEN, POST)
    renderer = Renderer(CAMERA, T_B_C, T_B_V, LAYOUT, noise=NOISE_FREE)
    image = renderer.render(snapshot, role, 0)[1]
    compared = 0
    for column in range(100, 600, 100):
        box = Box(float(column), 60.0, 24.0, 24.0)
        drawn = registered_depth(image, box, MethodConfig())
        found = look(snapshot, role).depth(box)
        if drawn is not None and found is not None:
            assert found.z_m == pytest.approx(drawn.z_m, abs=0.02)
            compared += 1
    assert compared >= 3


def test_another_depth_camera_is_as_good_as_the_rig_says() -> None:
    usual_noise = ObservationNoise()
    lidar = usual_noise.with_depth(0.0002)
    assert lidar.depth_sigma_at_1m_m == 0.0002
    assert lidar.depth_common_sigma_at_1m_m / 0.0002 == pytest.approx(
        usual_noise.depth_common_sigma_at_1m_m / usual_noise.depth_sigma_at_1m_m
    )


def test_without_measurements_on_cars_there_is_no_depth_of_them() -> None:
    snapshot = replace(moment(thing(0, 0.1, 0.0)), depth_holes=True)
    box = look(snapshot).targets(None)[0].box
    assert look(snapshot).depth(box) is None
    assert look(snapshot).depth(Box(300.0, 400.0, 60.0, 60.0)) is not None


def test_there_is_no_depth_outside_the_limits_the_image_or_on_too_few_pixels() -> None:
    view = look(moment(sender=drone(0.0, -9.0, 7.5)))
    assert view.depth(Box(300.0, 200.0, 60.0, 60.0)) is None
    near = look(moment())
    assert near.depth(Box(-200.0, 100.0, 60.0, 60.0)) is None
    assert near.depth(Box(300.0, 300.0, 4.0, 4.0)) is None


# --- markers ---


def test_marker_corners_are_those_of_the_camera_model() -> None:
    (found,) = look(moment(), Role.RECEIVER).markers(None)
    assert found.marker_id == 0
    assert np.abs(found.corners_px - marker_pixels(moment())).max() < 1e-9


def test_corner_noise_is_what_its_covariance_is_about() -> None:
    truth = marker_pixels(moment())
    errors: list[float] = []
    for k in range(300):
        for found in look(moment(), Role.RECEIVER, ObservationNoise(), frame_id=k).markers(None):
            errors.append(
                float(
                    (found.corners_px - truth).ravel()
                    @ np.linalg.inv(found.covariance_px2)
                    @ (found.corners_px - truth).ravel()
                )
            )
    assert len(errors) > 290
    assert 1.0 < np.median(errors) < 8.0


@pytest.mark.parametrize(
    "snapshot",
    [
        replace(moment(), marker_hidden=True),
        moment(sender=drone(0.0, -1.55, 1.5, 180.0)),  # its face, not its tail
        moment(receiver=drone(0.35, -2.7, 2.3, 60.0)),  # out of the image
        moment(receiver=drone(0.0, -40.0, 30.0)),  # too small
        moment(sender=drone(0.3, -3.3, 1.5)),  # behind the camera
    ],
    ids=["covered", "turned away", "out of view", "far", "behind"],
)
def test_a_marker_that_cannot_be_seen_is_not_found(snapshot: Snapshot) -> None:
    noise = EXACT if snapshot.drones[Role.RECEIVER].T_w_b.t[1] > -10 else ObservationNoise()
    assert not look(snapshot, Role.RECEIVER, noise).markers(None)


def test_a_marker_is_found_up_to_the_incidence_where_the_finder_gives_up() -> None:
    plate = SENDER.T_w_b @ T_B_V

    def found(incidence_deg: float) -> bool:
        angle = math.radians(incidence_deg)
        direction = plate.R @ np.array([math.sin(angle), 0.0, math.cos(angle)])
        right = np.cross(-direction, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        T_w_c = Pose(
            np.column_stack((right, np.cross(-direction, right), -direction)),
            plate.t + 0.8 * direction,
        )
        receiver = DroneTruth(T_w_c @ T_B_C.inverse(), (0.0, 0.0, 0.0), 0.0, True)
        return bool(look(moment(receiver=receiver), Role.RECEIVER).markers(None))

    assert [found(angle) for angle in (0.0, 40.0, 75.0, 84.0, 89.0)] == [
        True,
        True,
        True,
        False,
        False,
    ]


def test_a_marker_behind_a_part_of_the_sender_is_not_found() -> None:
    inside = Pose(T_B_V.R, np.array([-0.05, 0.0, 0.0]))
    beside = Pose(T_B_V.R, np.array([-0.05, 0.0, -0.25]))
    assert not look(moment(), Role.RECEIVER, T_b_v=inside).markers(None)
    assert look(moment(), Role.RECEIVER, T_b_v=beside).markers(None)


def test_the_sender_does_not_see_its_own_marker() -> None:
    assert not look(moment(), Role.SENDER).markers(None)


def test_a_marker_is_found_only_whole_in_the_region() -> None:
    (u0, v0), (u1, v1) = marker_pixels(moment()).min(axis=0), marker_pixels(moment()).max(axis=0)
    assert look(moment(), Role.RECEIVER).markers(Region(u0 - 6, v0 - 6, u1 + 6, v1 + 6))
    assert not look(moment(), Role.RECEIVER).markers(Region(u0 - 6, v0 - 6, u1 - 2, v1 + 6))


def test_small_markers_are_found_less_often() -> None:
    def rate(distance_m: float) -> float:
        eye = drone(0.0, -1.75 - distance_m * SLANT, 1.6 + distance_m * SLANT)
        views = [
            look(moment(receiver=eye), Role.RECEIVER, ObservationNoise(), k) for k in range(100)
        ]
        return sum(bool(view.markers(None)) for view in views) / 100

    rates = [rate(d) for d in (1.0, 2.9, 4.0)]
    assert rates[0] > 0.95
    assert rates[0] >= rates[1] >= rates[2]
    assert rates[2] < 0.2


# --- random numbers ---


def everything(view: View) -> list[object]:
    found = list(view.targets(None))
    markers = [(m.marker_id, m.corners_px.tolist()) for m in view.markers(None)]
    return [found, markers, [view.depth(d.box) for d in found]]


def test_the_same_seed_sees_the_same_and_another_seed_or_frame_does_not() -> None:
    snapshot = moment(thing(0, 0.1, 0.0), thing(1, -0.6, 0.4))
    noise = ObservationNoise()
    first = everything(look(snapshot, Role.RECEIVER, noise, 5, seed=1))
    assert everything(look(snapshot, Role.RECEIVER, noise, 5, seed=1)) == first
    assert everything(look(snapshot, Role.RECEIVER, noise, 6, seed=1)) != first
    assert everything(look(snapshot, Role.RECEIVER, noise, 5, seed=2)) != first


def test_a_question_does_not_change_the_answer_to_another() -> None:
    snapshot = moment(thing(0, 0.1, 0.0), thing(1, -0.6, 0.4))
    asked = look(snapshot, Role.RECEIVER, ObservationNoise())
    for _ in range(3):
        everything(asked)
    fresh = look(snapshot, Role.RECEIVER, ObservationNoise())
    box = asked.targets(None)[0].box
    assert fresh.depth(box) == asked.depth(box)
    assert fresh.targets(None) == asked.targets(None)


def test_what_goes_wrong_for_a_while_lasts_some_frames_at_its_rate() -> None:
    noise = replace(
        EXACT,
        marker=EXACT.marker._replace(lapse_rate=0.3),
        targets=EXACT.targets._replace(odd_rate=0.3),
    )
    views = [
        look(moment(thing(0, 0.1, 0.0)), Role.RECEIVER, noise, frame_id=k) for k in range(3000)
    ]
    missed = np.array([not view.markers(None) for view in views])
    odd = np.array([view.targets(None)[0].score < 0.5 for view in views])
    for event in (missed, odd):
        assert event.mean() == pytest.approx(0.3, abs=0.1)
        assert (event[1:] != event[:-1]).mean() < 0.1
    assert not np.array_equal(missed, odd)


# --- a perception in a world; what it shares with others: tests/contracts/test_sight.py ---


@dataclass
class StillWorld:
    def snapshot(self) -> Snapshot:
        return moment(thing(0, 0.1, 0.0))


@dataclass
class StubHarness:
    world: StillWorld = field(default_factory=StillWorld)
    seed: int = 3
    frozen_cameras: dict[Role, Freeze] = field(default_factory=dict[Role, Freeze])
    built: Built | None = None


def context(harness: object | None) -> PartContext:
    mount = Mount(T_B_C, T_B_V)
    return PartContext(
        Role.SENDER, LoopClock(), CAMERA, mount, LAYOUT, Origin(0.0, 0.0, 0.0), harness
    )


def geometric_perception(harness: StubHarness) -> Perception:
    return GeometricPerception(GeometricPerceptionConfig(rate_hz=50.0), context(harness))


def test_after_warming_up_nothing_is_left_to_compile() -> None:
    warm_up()
    compiled = len(geometric_targets.depth_over.signatures)
    view = look(moment(thing(0, 0.1, 0.0)), Role.RECEIVER, ObservationNoise())
    everything(view)
    view.depth(Box(300, 300, 40, 40))
    assert len(geometric_targets.depth_over.signatures) == compiled


def test_a_geometric_sight_needs_a_world() -> None:
    with pytest.raises(CameraError, match="simulated world"):
        GeometricPerception(GeometricPerceptionConfig(), context(None))
