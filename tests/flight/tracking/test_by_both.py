"""D2's reckoning of the target's place, by what both drones see of one car in the geometric
world.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flight.tracking.by_both import ByBoth, FromBothViews
from path.config import EvidenceConfig, MethodConfig
from path.cycle.prior import Prior
from path.geometry.rigid import rigid
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.messages import Role
from path.observations import Box, Depth, RangeSource, Region
from path.target.place import back_project
from tests.hil.geometric.test_perception import (
    CAMERA,
    NED_TO_ENU,
    RECEIVER,
    SENDER,
    T_B_C,
    T_B_V,
    alone,
    look,
    moment,
    thing,
)

METHOD = replace(MethodConfig(), evidence=EvidenceConfig(span_m=0.39, height_m=0.16))
T_V_C1 = T_B_V.inverse() @ T_B_C
POSE_SIGMA = np.diag([0.003**2] * 3 + [0.004**2] * 3)
CAR = thing(0, 0.1, 0.0)


def one_box(role: Role) -> tuple[Box, Depth]:
    view = look(alone(moment(CAR), role), role)
    (found,) = view.targets(None)
    depth = view.depth(found.box)
    assert depth is not None
    return found.box, depth


def reckoned(
    *,
    scale1: float = 1.0,
    turned_deg: float = 0.0,
    own: bool = True,
    beside_px: float = 0.0,
    frames: int = 1,
) -> tuple[ByBoth, float, float]:
    """What comes out, and how far D1's word and that are off in D2's camera, m.

    Args:
        scale1: of D1's depth; ``turned_deg``: what D2 is wrong about the pose; ``beside_px``: D2
            boxes something else.
    """
    (box1, depth1), (box2, depth2) = one_box(Role.SENDER), one_box(Role.RECEIVER)
    true_c1 = back_project(CAMERA, *box1.center, depth1.z_m)
    said_c1 = back_project(CAMERA, *box1.center, scale1 * depth1.z_m)
    T_v_c2 = (SENDER.T_w_b @ T_B_V).inverse() @ (RECEIVER.T_w_b @ T_B_C)
    T_c2_v = T_v_c2.inverse()
    believed = Pose(exp(np.radians([turned_deg, 0.0, 0.0])) @ T_c2_v.R, T_c2_v.t)
    x, y, z = T_V_C1.apply(np.array(said_c1)).tolist()
    prior = Prior(
        (0.0, 0.0), 0.0, (1.0, 0.0, 1.0), Region(0, 0, 1, 1), 1, rigid(believed), 0.003, (x, y, z)
    )
    gx, gy, gz = ((NED_TO_ENU @ np.array([0.0, 0.0, 1.0])) @ (RECEIVER.T_w_b @ T_B_C).R).tolist()
    seen = replace(box2, x=box2.x + beside_px)
    both_views = FromBothViews(METHOD, CAMERA, T_V_C1, CAMERA)
    given = prior, 0.02, POSE_SIGMA, (gx, gy, gz), seen, depth2 if own else None
    found = [both_views.place(*given) for _ in range(frames)][-1]
    truth = T_c2_v.apply(T_V_C1.apply(np.array(true_c1)))
    said = believed.apply(np.array(prior.point_v_m))
    both = believed.apply(np.array(found.point_v_m))
    return found, float(np.linalg.norm(said - truth)), float(np.linalg.norm(both - truth))


def test_where_both_are_right_nothing_moves_by_more_than_a_box_differs_from_its_cylinder() -> None:
    found, said_m, both_m = reckoned()
    assert said_m < 1e-6
    assert found.agree
    assert both_m < 0.012


def test_what_d2_is_wrong_about_the_pose_is_taken_out_across_its_own_line_of_sight() -> None:
    _, said_m, both_m = reckoned(turned_deg=1.0)
    assert said_m > 0.025
    assert both_m < 0.5 * said_m


def test_what_d1_is_wrong_about_its_depth_is_bettered_by_d2s_own_as_far_as_that_is_worth() -> None:
    """D2 is almost twice as far away, and its depth a share of that."""
    _, said_m, both_m = reckoned(scale1=1.02, frames=50)
    assert said_m > 0.025
    assert both_m < 0.92 * said_m


def test_the_depth_for_d2s_own_track_is_where_its_depth_camera_has_the_surface() -> None:
    found, _, _ = reckoned()
    _, depth2 = one_box(Role.RECEIVER)
    assert found.depth.z_m == pytest.approx(depth2.z_m, abs=0.03)
    without, _, _ = reckoned(own=False)
    assert without.depth.source is RangeSource.VIEWS
    assert without.depth.z_m == pytest.approx(depth2.z_m, abs=0.06)
    assert without.depth.sigma_m > found.depth.sigma_m


def test_a_box_of_something_else_moves_nothing_and_is_told() -> None:
    found, said_m, both_m = reckoned(beside_px=90.0, own=False)
    assert not found.agree
    assert found.chi2 > 14.0
    assert both_m == pytest.approx(said_m, abs=1e-9)
