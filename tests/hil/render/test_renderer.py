"""The renderer draws each thing where it is, and hides what is behind it; the same inputs give the
same bytes.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hil.render.renderer import STAGES, Renderer, warm_up
from hil.render.scene import GAP_M
from hil.render.sensor import NOISE_FREE, SensorNoise
from hil.world.snapshot import Snapshot
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.messages import Role
from tests.hil.render.views import (
    ABOVE,
    FAR_AWAY,
    LEVEL,
    TAIL,
    VGA,
    at,
    drone,
    hovering,
    looking_at,
    mount,
    scene,
)

Image = NDArray[np.uint8]

DOWN = mount(45.0)


def renderer(
    noise: SensorNoise | None = None, seed: int = 1, camera: CameraModel = VGA
) -> Renderer:
    return Renderer(camera, DOWN, TAIL, single_marker(), noise, seed)


def orange(color: Image) -> NDArray[np.bool_]:
    hsv = cv2.cvtColor(color, cv2.COLOR_BGR2HSV)
    return (hsv[..., 0] >= 3) & (hsv[..., 0] <= 22) & (hsv[..., 1] > 140) & (hsv[..., 2] > 90)


def found_markers(color: Image) -> list[int]:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, ids, _ = detector.detectMarkers(color)
    return [int(i) for i in np.ravel(ids)] if corners else []


def digest(color: Image, depth: NDArray[np.uint16]) -> str:
    return hashlib.sha256(color.tobytes() + depth.tobytes()).hexdigest()


def test_images_have_the_shapes_and_types_of_a_frame() -> None:
    color, depth = renderer().render(scene(), Role.RECEIVER, 0)
    assert color.shape == (480, 640, 3)
    assert color.dtype == np.uint8
    assert color.flags.c_contiguous
    assert depth.shape == (480, 640)
    assert depth.dtype == np.uint16


def test_receiver_sees_marker_and_target_where_they_are() -> None:
    snapshot = scene()
    color, depth = renderer().render(snapshot, Role.RECEIVER, 0)
    T_c_w = (snapshot.drones[Role.RECEIVER].T_w_b @ DOWN).inverse()
    assert found_markers(color) == [0]
    mask = orange(color)
    for thing in snapshot.objects:
        roof_c = T_c_w.apply(np.array(thing.position_w_m) + np.array((0.0, 0.0, 0.16)))
        u, v = (round(x) for x in VGA.project_point((roof_c[0], roof_c[1], roof_c[2])))
        if VGA.contains(u, v, 5.0):
            assert mask[v, u]
            assert abs(int(depth[v, u]) - 1000.0 * roof_c[2]) < 150.0


def test_sender_does_not_see_itself() -> None:
    color, _ = renderer(NOISE_FREE).render(scene(), Role.SENDER, 0)
    alone = scene()
    del alone.drones[Role.RECEIVER]
    assert np.array_equal(color, renderer(NOISE_FREE).render(alone, Role.SENDER, 0)[0])
    assert orange(color).sum() > 2000


def test_only_cars_are_orange() -> None:
    snapshot = scene()
    color, _ = renderer().render(Snapshot(0.0, snapshot.drones, ()), Role.RECEIVER, 0)
    assert not orange(color).any()


def test_look_alikes_look_exactly_like_the_target() -> None:
    drones = scene().drones
    target = renderer().render(Snapshot(0.0, drones, (at(0, 0.3, 1.2, 0.4),)), Role.RECEIVER, 0)
    other = renderer().render(Snapshot(0.0, drones, (at(3, 0.3, 1.2, 0.4),)), Role.RECEIVER, 0)
    assert digest(*target) == digest(*other)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_car_hides_the_farther_and_both_hide_the_ground(order: tuple[int, int]) -> None:
    """Whatever order they are listed in; seen along the ground from the south, in the level
    camera.
    """
    pair = (at(0, 0.0, 1.5, 0.0), at(1, 0.05, 2.2, 0.0))
    low = Pose(hovering(0, 0, 0).R @ mount(0.0).R @ np.eye(3), np.array([0.0, 0.0, 0.09]))
    drones = {Role.RECEIVER: drone(low)}
    camera = Renderer(VGA, LEVEL, TAIL, single_marker(), NOISE_FREE)
    _, depth = camera.render(Snapshot(0.0, drones, tuple(pair[i] for i in order)), Role.RECEIVER, 0)
    row, column = 240, round(VGA.cx)
    assert abs(int(depth[row, column]) - 1420) <= 2  # body: half its 0.16 m width before the middle
    assert depth[row, 60] == 0  # the ground is beyond the sensor's range there


def test_a_drone_hides_the_car_behind_it() -> None:
    snapshot = scene()
    T_w_c = snapshot.drones[Role.RECEIVER].T_w_b @ DOWN
    body = snapshot.drones[Role.SENDER].T_w_b.t
    ray = body - T_w_c.t
    foot = T_w_c.t + ray * (T_w_c.t[2] - 0.05) / -ray[2]
    hidden = Snapshot(0.0, snapshot.drones, (at(0, float(foot[0]), float(foot[1])),))
    color, depth = renderer(NOISE_FREE).render(hidden, Role.RECEIVER, 0)
    c = T_w_c.inverse().apply(body)
    u, v = (round(x) for x in VGA.project_point((c[0], c[1], c[2])))
    assert not orange(color)[v, u]
    assert abs(int(depth[v, u]) - 1000.0 * c[2]) < 100.0
    del hidden.drones[Role.SENDER]
    assert orange(renderer(NOISE_FREE).render(hidden, Role.RECEIVER, 0)[0])[v, u]


def test_rotors_are_translucent_and_leave_the_depth() -> None:
    snapshot = scene()
    # the wide car roof, 0.2 m below the front right rotor, seen from straight above
    rotor_w = snapshot.drones[Role.SENDER].T_w_b.apply(np.array([0.11 + 0.04, 0.11, -0.038]))
    T_w_c = Pose(np.diag([1.0, -1.0, -1.0]), rotor_w + np.array((0.0, 0.0, 0.5)))
    views = {
        armed: Renderer(VGA, LEVEL, TAIL, single_marker(), NOISE_FREE).render(
            Snapshot(
                0.0,
                {
                    Role.RECEIVER: drone(T_w_c),
                    Role.SENDER: drone(snapshot.drones[Role.SENDER].T_w_b, armed=armed),
                },
                (at(0, float(rotor_w[0]), float(rotor_w[1])),),
            ),
            Role.RECEIVER,
            0,
        )
        for armed in (True, False)
    }
    turning, still = views[True][0], views[False][0]
    row, column = round(VGA.cy), round(VGA.cx)
    assert orange(still)[row, column]  # between the blades at rest there is nothing
    through, bare = turning[row, column].astype(float), still[row, column].astype(float)
    share = through[2] / bare[2]
    assert 0.4 < share < 0.9
    assert through[2] > 1.5 * through[0]  # still orange underneath
    assert np.array_equal(views[True][1], views[False][1])


def test_blades_turn_with_the_phase() -> None:
    def view(phase_rad: float) -> Image:
        snapshot = scene()
        snapshot.drones[Role.SENDER] = drone(
            snapshot.drones[Role.SENDER].T_w_b, phase_rad=phase_rad
        )
        return renderer(NOISE_FREE).render(snapshot, Role.RECEIVER, 0)[0]

    assert np.any(view(0.0) != view(1.0))
    assert np.array_equal(view(0.0), view(float(np.pi)))  # two blades


def test_a_hidden_marker_is_a_blank_plate() -> None:
    seen, depth = renderer().render(scene(), Role.RECEIVER, 0)
    blank, blank_depth = renderer().render(scene(marker_hidden=True), Role.RECEIVER, 0)
    assert found_markers(seen) == [0]
    assert found_markers(blank) == []
    assert np.array_equal(depth, blank_depth)


def test_depth_holes_are_over_the_cars_only() -> None:
    drones, objects = scene().drones, scene().objects
    camera = renderer(NOISE_FREE)
    _, bare = camera.render(Snapshot(0.0, drones, ()), Role.RECEIVER, 0)
    _, whole = camera.render(Snapshot(0.0, drones, objects), Role.RECEIVER, 0)
    _, holes = camera.render(Snapshot(0.0, drones, objects, depth_holes=True), Role.RECEIVER, 0)
    on_cars = whole != bare
    assert on_cars.sum() > 5000
    assert not holes[on_cars].any()
    assert np.array_equal(holes[~on_cars], whole[~on_cars])


def test_every_marker_of_a_layout_is_drawn() -> None:
    still = np.eye(3)
    markers = tuple(
        Marker(i, 0.04, 0.0, Pose(still, np.array([x, 0.0, 0.0])))
        for i, x in ((3, -0.05), (7, 0.05))
    )
    camera = Renderer(VGA, DOWN, TAIL, MarkerLayout(markers), NOISE_FREE)
    assert sorted(found_markers(camera.render(scene(), Role.RECEIVER, 0)[0])) == [3, 7]


def test_a_camera_that_stands_on_the_ground_still_sees() -> None:
    drones = {
        Role.SENDER: drone(hovering(0.0, 1.0, 0.0)),
        Role.RECEIVER: drone(hovering(0.0, 0.0, 0.0)),
    }
    landed = Snapshot(0.0, drones, ())
    for role in Role:
        color, _ = renderer(NOISE_FREE).render(landed, role, 0)
        assert color.max() > 0


def test_nothing_behind_the_camera_is_drawn() -> None:
    snapshot = looking_at(Pose(np.eye(3), np.array([0.0, 0.0, -2.0])))
    camera = Renderer(VGA, LEVEL, TAIL, single_marker(), NOISE_FREE)
    bare = Snapshot(0.0, {Role.RECEIVER: snapshot.drones[Role.RECEIVER]}, ())
    assert np.array_equal(
        camera.render(snapshot, Role.RECEIVER, 0)[0], camera.render(bare, Role.RECEIVER, 0)[0]
    )


def test_a_face_that_reaches_past_the_camera_is_drawn() -> None:
    """The camera half a metre before the plate of a marker of two metres, its lower part behind the
    camera.
    """
    tilted = Pose(
        np.array([[1.0, 0, 0], [0, -0.2, -0.98], [0, 0.98, -0.2]]), np.array([0.0, 0.4, 0.6])
    )
    camera = Renderer(VGA, LEVEL, LEVEL, single_marker(2.0), NOISE_FREE)
    _, depth = camera.render(looking_at(tilted), Role.RECEIVER, 0)
    x, y = VGA.ray(320.0, 400.0)
    normal = tilted.R[:, 2]
    expected = 1000.0 * (normal @ tilted.t) / (normal @ (x, y, 1.0))
    assert abs(int(depth[400, 320]) - expected) <= 1.0


def test_the_same_inputs_give_the_same_bytes_in_every_instance_and_thread() -> None:
    jobs = [(role, seed) for role in Role for seed in range(4)]
    alone = [digest(*renderer().render(scene(), role, seed)) for role, seed in jobs]

    def run(job: tuple[Role, int]) -> list[str]:
        own = renderer()
        return [digest(*own.render(scene(), *job)) for _ in range(3)]

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(run, jobs))
    assert together == [[one] * 3 for one in alone]
    assert len(set(alone)) == len(jobs)


def test_the_same_inputs_give_the_same_bytes_in_another_process() -> None:
    here = digest(*renderer().render(scene(), Role.RECEIVER, 9))
    code = (
        "from tests.hil.render.test_renderer import *\n"
        "import sys\n"
        "sys.stdout.write(digest(*renderer().render(scene(), Role.RECEIVER, 9)))"
    )
    root = Path(__file__).parents[3]
    there = subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        check=True,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert there.stdout == here


def test_seed_and_frame_seed_change_the_noise_only() -> None:
    base, depth = renderer(seed=1).render(scene(), Role.RECEIVER, 0)
    for seed, frame_seed in ((2, 0), (1, 1), (1, -1)):
        other, other_depth = renderer(seed=seed).render(scene(), Role.RECEIVER, frame_seed)
        assert np.any(other != base)
        assert np.any(other_depth != depth)
        assert np.abs(other.astype(int) - base).mean() < 4.0


def test_warm_up_tells_how_far_it_is() -> None:
    calls: list[tuple[str, int, int]] = []
    warm_up(lambda stage, number, of: calls.append((stage, number, of)))
    assert [number for _, number, _ in calls] == list(range(1, STAGES + 1))
    assert {of for _, _, of in calls} == {STAGES}


def test_a_tilted_plate_keeps_its_backing_behind_it() -> None:
    """Faces a millimetre apart do not fight: the blank plate is one colour."""
    camera = Renderer(VGA, LEVEL, ABOVE, single_marker(0.2), NOISE_FREE)
    T_c_v = Pose(
        cv2.Rodrigues(np.array([0.0, 1.1, 0.0]))[0] @ np.diag([1.0, -1.0, -1.0]),
        np.array([0.0, 0.0, 3.0]),
    )
    snapshot = looking_at(T_c_v @ ABOVE.inverse())
    blank = Snapshot(0.0, snapshot.drones, (), marker_hidden=True)
    color, depth = camera.render(blank, Role.RECEIVER, 0)
    corners = VGA.project(
        T_c_v.apply(0.13 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]))
    )
    inside = np.zeros((480, 640), np.uint8)
    cv2.fillConvexPoly(inside, np.round(corners).astype(np.int32), 1)
    inside = cv2.erode(inside, np.ones((3, 3))) > 0
    assert inside.sum() > 500
    assert len(np.unique(color[inside].reshape(-1, 3), axis=0)) == 1
    assert GAP_M >= 0.001
    assert depth[inside].min() > 0


def test_a_world_far_from_the_origin_looks_the_same() -> None:
    """The ground repeats every 16.384 m; nothing else depends on where it is."""
    period = 2.048 * 8

    def view(shift: float) -> tuple[Image, NDArray[np.uint16]]:
        drones = {
            Role.RECEIVER: drone(hovering(0.2 + shift, 0.1, 2.0)),
            Role.SENDER: drone(FAR_AWAY),
        }
        return renderer(NOISE_FREE).render(
            Snapshot(0.0, drones, (at(0, 0.2 + shift, 1.6),)), Role.RECEIVER, 0
        )

    near, far = view(0.0), view(40 * period)
    assert np.abs(near[0].astype(int) - far[0]).max() <= 2
    assert np.abs(near[1].astype(int) - far[1]).max() <= 1
