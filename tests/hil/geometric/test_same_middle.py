"""Two cameras that look at one body from different sides mean the same middle of it, whichever way
it heads.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.geometric.noise import ObservationNoise
from hil.geometric.perception import Sensor
from hil.geometric.scene import CameraSetup, outlines, place
from hil.geometric.targets import depth_over
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot, TargetKind
from missions.ground import rig_library
from path.gate.agreement import TwoViews
from path.geometry.rigid import rigid
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box
from path.target.place import back_project
from tests.path.gate.compared import compared, own_values

NOWHERE = Pose(np.eye(3), np.zeros(3))


def looking(at_m: float, azimuth_deg: float, away_m: float, up_m: float) -> Pose:
    """``T_w_c`` of a camera that looks at a point above the origin, so far off and so high above
    that point.
    """
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    eye = np.array([away_m * c, away_m * s, at_m + up_m])
    ahead = np.array([-away_m * c, -away_m * s, -up_m]) / math.hypot(away_m, up_m)
    right = np.array([-s, c, 0.0]) * -1.0
    return Pose(np.column_stack((right, np.cross(ahead, right), ahead)), eye)


@pytest.mark.parametrize(
    ("name", "kind", "middle_m", "unstated_m", "most_m", "overlaps"),
    [
        ("sim", "car", 0.08, 0.04, 0.015, (0.63, 0.72)),
        ("sim-person", "person", 0.9, 0.12, 0.05, (0.59, 0.68)),
        ("sim-drone", "drone", 0.8, 0.02, 0.012, (0.62, 0.66)),
    ],
)
def test_offsets_are_of_what_two_cameras_mean_not_of_where_they_look_from(
    name: str,
    kind: TargetKind,
    middle_m: float,
    unstated_m: float,
    most_m: float,
    overlaps: tuple[float, float],
) -> None:
    rig = rig_library.load_unchecked(name)
    method, mission = rig.method, rig.mission
    behind_m = float(mission.get("follow", {}).get("behind_m", 1.45))
    height_m = float(mission.get("follow", {}).get("height_m", 1.5))
    cameras = rig.sender.camera, rig.receiver.camera
    setups = [
        CameraSetup(role, camera, NOWHERE, NOWHERE, single_marker())
        for role, camera in zip(Role, cameras, strict=True)
    ]
    depths = Sensor(setups[0], ObservationNoise(), method, 0).depth
    unstated = replace(method, evidence=replace(method.evidence, span_m=0.0))
    found: dict[bool, list[float]] = {True: [], False: []}
    overlap: dict[bool, list[float]] = {True: [], False: []}
    for azimuth_deg in (-60.0, 60.0):
        poses = (
            looking(middle_m, 180.0, behind_m, height_m - middle_m),
            looking(middle_m, 180.0 + azimuth_deg, 1.9, 1.9),
        )
        drones = {
            role: DroneTruth(pose, (0.0, 0.0, 0.0), 0.0, True)
            for role, pose in zip(Role, poses, strict=True)
        }
        for heading in np.linspace(0.0, math.pi, 9).tolist():
            thing = ObjectTruth(0, (0.0, 0.0, middle_m if kind == "drone" else 0.0), heading, 0.0)
            snapshot = Snapshot(0.0, drones, (thing,), kind=kind)
            bodies = [place(setup, snapshot) for setup in setups]
            edges = [outlines(setup, each)[0] for setup, each in zip(setups, bodies, strict=True)]
            own, theirs = (Box(x, y, right - x, bottom - y) for x, y, right, bottom, *_ in edges)
            z_m, _ = depth_over(
                bodies[0].boxes, bodies[0].extents, bodies[0].per_object, bodies[0].frame, setups[0].lens, False,
                (own.x, own.y, own.w, own.h), depths, (0.0, 0.0), 0,
            )  # fmt: skip
            point = back_project(cameras[0], *own.center, z_m)
            x, y, z = (poses[0].R.T @ (0.0, 0.0, -1.0)).tolist()
            views = TwoViews(*cameras, rigid(NOWHERE))
            values = own_values(own, z_m, point, (x, y, z))
            for stated, each in ((True, method), (False, unstated)):
                seen = compared(views, poses[0].inverse() @ poses[1], values, theirs, each)
                assert seen.offset_m is not None
                found[stated].append(math.hypot(*seen.offset_m))
                overlap[stated].append(seen.placed_iou if stated else seen.iou)
    assert float(np.mean(found[False])) > unstated_m
    assert float(np.mean(found[True])) < most_m
    assert float(np.mean(overlap[False])) < overlaps[0]
    assert float(np.mean(overlap[True])) > overlaps[1]
