"""The objects that D1 sees beside its target, remembered, and D2's box measured from each."""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import TwoViews
from path.geometry.rigid import Rigid, rigid, transform_back
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.messages import Vec3
from path.observations import Box, Depth
from path.target.rivals import SEEN_TIMES, Rival, Rivals
from tests.path.gate.compared import compared, own_values

CAMERA = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5, (0.0, 0.0, 0.0, 0.0, 0.0))
DOWN: Vec3 = (0.0, 0.0, 1.0)
# the marker's frame is D1's camera's; both look straight down, D2 from half a metre aside and
# turned
T_V_C1 = Pose(np.eye(3), np.zeros(3))
T_V_C2 = Pose(exp(np.array([0.0, -0.2, 0.5])), np.array([0.5, 0.2, -0.4]))
VIEWS = TwoViews(CAMERA, CAMERA, rigid(T_V_C1))
TARGET: Vec3 = (0.1, 0.0, 2.0)
MS = 1_000_000


def box_at(point_v: Vec3, T_v_c: Rigid, side_m: float = 0.3) -> Box:
    x, y, z = transform_back(T_v_c, point_v)
    u, v = CAMERA.project_point((x, y, z))
    side = side_m * CAMERA.fx / z
    return Box(u - side / 2, v - side / 2, side, side)


def beside(*places: Vec3, depth: bool = True) -> list[Rival]:
    boxes = [(box_at(place, rigid(T_V_C1)), place[2]) for place in places]
    return [Rival(box, Depth(z, 0.01) if depth else None) for box, z in boxes]


def rivals_after(*frames: list[Rival], seconds: float = 0.02) -> Rivals:
    rivals = Rivals(VIEWS, MethodConfig())
    own = box_at(TARGET, rigid(T_V_C1))
    for k, seen in enumerate(frames):
        rivals.note(round(k * seconds * 1e9), own, TARGET[2], TARGET, DOWN, seen)
    return rivals


def measured(
    rivals: Rivals, seen_by_2: Vec3
) -> tuple[tuple[float, float], tuple[tuple[float, float], ...]]:
    T = rigid(T_V_C2)
    box2, own_box = box_at(seen_by_2, T), box_at(TARGET, rigid(T_V_C1))
    own = own_values(own_box, TARGET[2], TARGET, DOWN)
    target_m = compared(VIEWS, T_V_C2, own, box2, MethodConfig()).offset_m
    assert target_m is not None
    return target_m, rivals.offsets(target_m, T, box2, own_box, own).rivals_m


@pytest.mark.parametrize("place", [(0.4, 0.1, 2.0), (0.1, -0.5, 1.7), (-0.2, 0.2, 2.4)])
def test_a_box_of_the_rival_is_off_the_target_and_on_the_rival(place: Vec3) -> None:
    rivals = rivals_after(*[beside(place)] * SEEN_TIMES)
    target, (rival,) = measured(rivals, place)
    assert math.hypot(*target) > 0.15
    assert rival == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_box_of_the_target_is_on_it() -> None:
    target, (rival,) = measured(rivals_after(*[beside((0.4, 0.0, 2.0))] * SEEN_TIMES), TARGET)
    assert target == pytest.approx((0.0, 0.0), abs=1e-9)
    assert rival[0] == pytest.approx(-0.3, abs=0.02)


def test_without_depth_a_rival_is_as_high_as_the_target() -> None:
    place = (0.5, -0.1, 2.0)
    _, (rival,) = measured(rivals_after(*[beside(place, depth=False)] * SEEN_TIMES), place)
    assert rival == pytest.approx((0.0, 0.0), abs=1e-9)


def test_one_that_was_seen_too_seldom_may_be_nothing() -> None:
    assert measured(rivals_after(*[beside((0.4, 0.0, 2.0))] * (SEEN_TIMES - 1)), TARGET)[1] == ()
    everywhere = [beside((0.2 * k - 0.5, 0.4, 2.0)) for k in range(6)]
    assert measured(rivals_after(*everywhere), TARGET)[1] == ()


def test_one_that_is_missed_is_remembered_for_a_while() -> None:
    seen: list[list[Rival]] = [beside((0.4, 0.0, 2.0))] * SEEN_TIMES
    assert len(measured(rivals_after(*seen, *[[]] * 100), TARGET)[1]) == 1
    assert measured(rivals_after(*seen, *[[]] * 160), TARGET)[1] == ()


def test_the_nearest_ones_are_told_of() -> None:
    places: list[Vec3] = [(0.1 + d, 0.0, 2.0) for d in (0.9, 0.3, 0.5, 0.7)]
    _, offsets = measured(rivals_after(*[beside(*places)] * SEEN_TIMES), TARGET)
    assert [round(-x, 1) for x, _ in offsets] == [0.3, 0.5, 0.7]
