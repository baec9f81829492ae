"""Each scene looks otherwise, the same each time, and the drones' own shadows fall where the sun
puts them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.rig.parts import with_scene
from drivers.rig.tables import RigError
from hil.render.looks import LOOKS
from hil.render.overlay import AREA_M, patches
from hil.render.renderer import Renderer
from hil.render.sensor import NOISE_FREE
from hil.world.check import check_world
from hil.world.config import SCENES, SceneName, scene_of
from hil.world.snapshot import Snapshot
from missions.ground import rig_library
from path.camera.model import CameraModel
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.render.views import TAIL, mount, scene

Image = NDArray[np.uint8]

CAMERA = CameraModel(320, 240, 300.0, 300.0, 160.0, 120.0)
DOWN = mount(60.0)


def seen(name: SceneName, snapshot: Snapshot | None = None) -> Image:
    renderer = Renderer(CAMERA, DOWN, TAIL, single_marker(), NOISE_FREE, 5, name)
    return renderer.render_color(snapshot or scene(), Role.RECEIVER, 0)


@cache
def kept(name: SceneName) -> Image:
    return seen(name)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_has_its_own_look_and_the_same_each_time(name: SceneName) -> None:
    assert np.array_equal(seen(name), kept(name))
    others = [kept(other) for other in SCENES if other != name]
    assert all(np.abs(kept(name).astype(int) - other).mean() > 4.0 for other in others)


def test_dusk_is_dark_and_noisy() -> None:
    assert kept("dusk").mean() < 0.5 * kept("overcast").mean()
    own, dusk = LOOKS["plain"].noise(NOISE_FREE), LOOKS["dusk"]
    assert own == NOISE_FREE
    assert dusk.read_times > 1.0
    assert dusk.shot_times > 1.0


def test_a_camera_sees_its_own_drones_shadow_where_the_sun_puts_it() -> None:
    snapshot = scene()
    T_w_b = snapshot.drones[Role.RECEIVER].T_w_b
    sun = LOOKS["outdoor-sun"].sun_w
    middle = T_w_b.t - sun * (T_w_b.t[2] / sun[2])
    renderer = Renderer(CAMERA, DOWN, TAIL, single_marker(), NOISE_FREE, 5, "outdoor-sun")
    T_w_c = renderer.T_w_c(snapshot, Role.RECEIVER)
    x, y, z = T_w_c.inverse().apply(middle).tolist()
    u, v = (round(each) for each in CAMERA.project_point((x, y, z)))
    assert CAMERA.contains(u, v, 10.0)
    image = renderer.render_color(snapshot, Role.RECEIVER, 0)
    bodies = renderer.bodies(snapshot, Role.RECEIVER)
    without, _ = renderer.draw(T_w_b, bodies, 0)
    inside = (slice(v - 1, v + 2), slice(u - 1, u + 2))
    assert image[inside].mean() < 0.7 * without[:, *inside].mean()


def test_litter_lies_by_the_seed_within_its_area() -> None:
    one, same, other = (patches(LOOKS["outdoor-sun"], seed) for seed in (1, 1, 2))
    assert np.array_equal(one.corners, same.corners)
    assert not np.array_equal(one.corners, other.corners)
    assert np.abs(one.corners).max() < AREA_M + 0.1
    assert len(patches(LOOKS["plain"], 1).corners) == 0


def test_a_name_that_is_none_is_refused_with_those_that_are() -> None:
    rig = rig_library.load("sim-rendered")
    assert scene_of(rig) == "plain"
    with pytest.raises(
        RigError,
        match=r'"plain", "outdoor-sun", "overcast", "low-sun", "dusk", "hall", found "moon"',
    ):
        check_world(with_scene(rig, "moon"))
    check_world(with_scene(rig, "dusk"))
    assert scene_of(with_scene(rig, "dusk")) == "dusk"
    assert with_scene(rig, None) is rig


def test_where_boxes_come_from_geometry_a_scene_is_one_in_which_a_detector_was_measured() -> None:
    rig = rig_library.load("sim-person")
    check_world(with_scene(rig, "overcast"))
    with pytest.raises(
        RigError, match=r"on a person in 'dusk': state .*, or take one of plain, overcast, hall"
    ):
        check_world(with_scene(rig, "dusk"))
    stated = replace(rig, world={**rig.world, "detector": {"recall": 0.5}})
    check_world(with_scene(stated, "dusk"))


def test_a_scene_that_nobody_draws_is_refused() -> None:
    with pytest.raises(RigError, match="drawn at level sim-rendered"):
        check_world(with_scene(rig_library.load("sitl"), "dusk"))
    with pytest.raises(RigError, match="no world of its own"):
        with_scene(replace(rig_library.load("sim"), harness=None), "dusk")
