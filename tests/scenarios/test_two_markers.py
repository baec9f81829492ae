"""A drone that carries two markers: one is enough when the other is hidden, the larger one reaches
farther.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.rig.parts import Rig, with_errors
from flight.harness.renderer import RenderedInstant, RendererSetup
from hil.camera.pictures import CameraRenderer
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import load_run
from missions.look.report.summary import summarize
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from path.marker.locate import Gravity, LocatedMarker, locate_marker
from path.messages import Role

LARGE_M = 0.08
BESIDE = Pose(R_from_rpy(0.0, 0.0, 0.0), np.array([0.10, 0.0, 0.0]))
# turned by 90 degrees about v's y
CORNER = Pose(R_from_rpy(0.0, math.pi / 2.0, 0.0), np.array([0.07, 0.0, -0.07]))


def rig_with(rig: str, T_v_m: Pose, side_m: float) -> Rig:
    """The rig's own 40 mm marker, and a second one."""
    own = rig_library.load(rig)
    second = Marker(1, side_m, 0.0002, T_v_m)
    return replace(own, layout=MarkerLayout((own.layout.markers[0], second), own.layout.dictionary))


def look(rig: Rig, T_v_c: Pose, cover: int | None = None) -> tuple[LocatedMarker | object, float]:
    """Returns what D2's camera sees of the markers from a place in ``v``, rendered; and the error
    of its position, m.

    ``cover``: something grey hangs in front of this marker.
    """
    own = rig.receiver
    setup = RendererSetup(own.camera, own.mount.T_b_c, own.mount.T_b_v, rig.layout)
    T_w_b1 = Pose(R_from_rpy(math.pi, 0.0, 0.0), np.array([0.0, 0.0, 3.0]))
    T_w_c = T_w_b1 @ rig.sender.mount.T_b_v @ T_v_c
    stage = RenderedInstant({Role.SENDER: T_w_b1, Role.RECEIVER: T_w_c @ own.mount.T_b_c.inverse()})
    image = CameraRenderer(setup, 1).shoot(stage, Role.RECEIVER, 1).color.copy()
    if cover is not None:
        marker = rig.layout.markers[cover]
        plate = marker.T_v_m.t + 1.2 * (marker.corners_v - marker.T_v_m.t)
        corners = own.camera.project(T_v_c.inverse().apply(plate))
        (u0, v0), (u1, v1) = corners.min(axis=0).astype(int), corners.max(axis=0).astype(int) + 1
        image[v0:v1, u0:u1] = 120
    down_w = np.array([0.0, 0.0, -1.0])
    found = locate_marker(
        image, own.camera, rig.layout,
        gravity_v=gravity((T_w_b1 @ rig.sender.mount.T_b_v).R, down_w), gravity_c=gravity(T_w_c.R, down_w),
    )  # fmt: skip
    if not isinstance(found, LocatedMarker):
        return found, math.inf
    return found, float(np.linalg.norm(found.T_c_v.inverse().t - T_v_c.t))


def gravity(R_w_x: NDArray[np.float64], down_w: NDArray[np.float64]) -> Gravity:
    x, y, z = (R_w_x.T @ down_w).tolist()
    return Gravity((x, y, z))


def facing(x: float, y: float, z: float) -> Pose:
    """A camera at a place in ``v`` that looks at the markers."""
    ahead = np.array([0.04, 0.0, 0.0]) - (x, y, z)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return Pose(np.stack([right, np.cross(ahead, right), ahead], axis=1), np.array([x, y, z]))


def ids(found: LocatedMarker | object) -> list[int]:
    return sorted(d.marker_id for d in found.detections) if isinstance(found, LocatedMarker) else []


def test_either_marker_is_enough_when_the_other_is_hidden() -> None:
    rig = rig_with("sim-rendered", BESIDE, LARGE_M)
    place = facing(0.4, 0.3, 1.2)
    both, both_m = look(rig, place)
    assert ids(both) == [0, 1] and both_m < 0.004
    for cover in (0, 1):
        one, one_m = look(rig, place, cover)
        assert ids(one) == [1 - cover] and one_m < 0.01


def test_a_larger_marker_reaches_where_the_small_one_is_not_found() -> None:
    place = facing(0.8, 0.5, 3.4)
    _, small_m = look(rig_library.load("sim-rendered"), place)
    found, both_m = look(rig_with("sim-rendered", BESIDE, LARGE_M), place)
    assert math.isinf(small_m)
    assert ids(found)[-1:] == [1] and both_m < 0.05


@pytest.mark.parametrize(("side", "seen"), [(0.3, 0), (1.35, 1)])
def test_a_pair_at_right_angles_shows_one_marker_from_either_side(side: float, seen: int) -> None:
    """From where one is too oblique the other faces the camera."""
    place = facing(1.2 * math.sin(side), 0.2, 1.2 * math.cos(side))
    found, off_m = look(rig_with("sim-rendered", CORNER, 0.04), place)
    assert seen in ids(found) and off_m < 0.01
    _, alone_m = look(rig_library.load("sim-rendered"), place)
    assert math.isinf(alone_m) == (seen == 1)


def test_a_handoff_with_two_markers_commits(tmp_path: Path) -> None:
    rig = with_errors(rig_with("sim", BESIDE, LARGE_M), "exact")
    facts = fly_once(rig, 2, (), tmp_path, lambda _: None)
    assert facts.outcome == "committed", facts.detail
    summary = summarize(load_run(tmp_path))
    assert summary["agreement_s"] == pytest.approx(1.6, abs=0.1)
    assert summary["d2_error_m"] < 0.002  # 4 to 9 mm with the small one alone
