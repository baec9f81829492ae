"""The renderer of trials draws what that of the world draws, knows the exact depth, and gives the
same bytes again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flight.harness.renderer import DepthNoise, Imaging, RenderedInstant, RendererSetup, Thing
from hil.camera.pictures import CameraRenderer
from hil.render.renderer import Renderer
from hil.world.snapshot import Snapshot
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.render.views import SMALL, TAIL, VGA, at, drone, hovering, mount

DOWN = mount(45.0)
T_W_B = {Role.SENDER: hovering(0.0, 0.0, 1.4), Role.RECEIVER: hovering(0.45, -0.95, 2.1, -0.25)}
CAR = Thing("car", (0.05, 1.5, 0.0), 0.6)
PERSON = Thing("person", (-0.9, 1.6, 0.0), 2.0, 3)
EXACT = DepthNoise(sigma_at_1m_m=0.0, hole_rate=0.0, min_m=0.1)


def setup(camera: CameraModel = VGA, **changes: object) -> RendererSetup:
    return replace(RendererSetup(camera, DOWN, TAIL, single_marker()), **changes)  # type: ignore[arg-type]


def test_a_stage_looks_as_the_simulated_world_does() -> None:
    stage = RenderedInstant(T_W_B, (CAR,), rotor_phase_rad=0.7)
    drones = {role: drone(pose) for role, pose in T_W_B.items()}
    snapshot = Snapshot(0.0, drones, (at(0, 0.05, 1.5, 0.6),))
    world = Renderer(VGA, DOWN, TAIL, single_marker(), None, 5)
    renderer = CameraRenderer(setup(), 5)
    for role in Role:
        color, depth = world.render(snapshot, role, 3)
        shot = renderer.shoot(stage, role, 3)
        assert np.array_equal(shot.color, color)
        assert np.array_equal(shot.depth_mm, depth)


def test_the_same_arguments_give_the_same_bytes() -> None:
    stage = RenderedInstant(T_W_B, (CAR, PERSON))
    first, again = (
        CameraRenderer(setup(SMALL), 1).shoot(stage, Role.RECEIVER, 2) for _ in range(2)
    )
    assert first.color.tobytes() == again.color.tobytes()
    assert first.depth_mm.tobytes() == again.depth_mm.tobytes()
    other_seed = CameraRenderer(setup(SMALL), 2).shoot(stage, Role.RECEIVER, 2)
    other_shot = CameraRenderer(setup(SMALL), 1).shoot(stage, Role.RECEIVER, 3)
    assert np.any(other_seed.color != first.color)
    assert np.any(other_shot.color != first.color)


@pytest.mark.parametrize("size", [(640, 480, 615.0), (1280, 720, 920.0), (1920, 1080, 1380.0)])
def test_the_marker_is_found_at_every_resolution(size: tuple[int, int, float]) -> None:
    width, height, focal = size
    camera = CameraModel(width, height, focal, focal, width / 2, height / 2)
    renderer = CameraRenderer(setup(camera), 0)
    for hidden in (False, True):
        shot = renderer.shoot(RenderedInstant(T_W_B, (), marker_hidden=hidden), Role.RECEIVER, 0)
        assert shot.color.shape == (height, width, 3)
        found = detect_markers(shot.color, None, single_marker(), camera)
        assert [one.marker_id for one in found] == ([] if hidden else [0])


def test_a_drone_that_is_not_named_is_not_there() -> None:
    alone = RenderedInstant({Role.RECEIVER: T_W_B[Role.RECEIVER]})
    renderer = CameraRenderer(setup(depth=EXACT), 0)
    both = renderer.shoot(RenderedInstant(T_W_B), Role.RECEIVER, 0)
    assert np.mean(both.color != renderer.shoot(alone, Role.RECEIVER, 0).color) > 0.02
    assert (
        detect_markers(renderer.shoot(alone, Role.RECEIVER, 0).color, None, single_marker(), VGA)
        == ()
    )


def test_true_depth_is_that_of_the_surface_seen() -> None:
    """Against the rendered depth, which has whole millimetres, wherever it does not step."""
    stage = RenderedInstant(T_W_B, (CAR, PERSON))
    renderer = CameraRenderer(setup(depth=EXACT), 0)
    depth = renderer.shoot(stage, Role.RECEIVER, 0).depth_mm.astype(float)
    rng = np.random.default_rng(0)
    compared = 0
    for _ in range(400):
        u, v = int(rng.integers(2, 638)), int(rng.integers(2, 478))
        around = depth[v - 2 : v + 3, u - 2 : u + 3]
        true_m = renderer.true_depth_m(stage, Role.RECEIVER, u, v)
        if around.min() > 0.0 and np.ptp(around) < 0.02 * around.min():
            assert true_m is not None
            assert 1000.0 * true_m == pytest.approx(depth[v, u], abs=0.51)
            compared += 1
    assert compared > 200


def test_true_depth_is_exact_and_between_pixels() -> None:
    """The roof of the car lies at 0.160 m, seen from straight above; the sky has none."""
    overhead = Pose(hovering(0.05, 1.5, 2.0).R, np.array([0.05, 1.5, 2.0]))
    straight = replace(setup(), T_b_c=Pose(mount(90.0).R, np.zeros(3)))
    renderer = CameraRenderer(straight, 0)
    stage = RenderedInstant({Role.RECEIVER: overhead}, (CAR,))
    assert renderer.true_depth_m(stage, Role.RECEIVER, VGA.cx - 3.3, VGA.cy + 4.7) == pytest.approx(
        1.84, abs=1e-12
    )
    assert renderer.true_depth_m(stage, Role.RECEIVER, 5.0, 5.0) == pytest.approx(2.0, abs=1e-12)
    level = CameraRenderer(setup(), 0)
    up = RenderedInstant(
        {
            Role.RECEIVER: Pose(
                hovering(0, 0, 2).R @ mount(-60.0).R @ DOWN.R.T, np.array([0.0, 0.0, 2.0])
            )
        }
    )
    assert level.true_depth_m(up, Role.RECEIVER, VGA.cx, VGA.cy) is None


def test_depth_noise_is_what_the_setup_says() -> None:
    stage = RenderedInstant({Role.RECEIVER: T_W_B[Role.RECEIVER]})
    exact = (
        CameraRenderer(setup(depth=EXACT), 0).shoot(stage, Role.RECEIVER, 1).depth_mm.astype(float)
    )
    noisy = (
        CameraRenderer(setup(depth=replace(EXACT, sigma_at_1m_m=0.02)), 0)
        .shoot(stage, Role.RECEIVER, 1)
        .depth_mm
    )
    both = (exact > 0) & (noisy > 0) & (exact < 4000)
    assert np.std((noisy - exact)[both] / exact[both] ** 2 * 1e6) == pytest.approx(20.0, rel=0.05)


def test_noise_is_what_the_imaging_says() -> None:
    stage = RenderedInstant({Role.RECEIVER: T_W_B[Role.RECEIVER]})
    quiet = Imaging(read_sigma=0.0, shot_gain=0.0)
    clean, noisy = (
        CameraRenderer(setup(imaging=imaging), 0).shoot(stage, Role.RECEIVER, 1).color.astype(float)
        for imaging in (quiet, replace(quiet, read_sigma=4.0))
    )
    assert np.std(noisy - clean) == pytest.approx(4.0, rel=0.05)
