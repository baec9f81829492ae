"""Frames of both drones that hover and watch four cars: what every method of the compute trial is
timed on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.rig.parts import Rig
from flight.harness.renderer import FrameRenderer, RenderedInstant, RendererSetup, Thing
from missions.trials.shared.trial import TrialRequest
from path.arrays import Depths, Image
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Matrix, Pose
from path.messages import Role, Vec3
from path.observations import Box
from path.values import frozen

SIZES = {"640x480": (640, 480), "1280x720": (1280, 720)}
PERIOD_NS = 20_000_000
BETWEEN_NS = 7_000_000  # D2's frames come this long after D1's: the two cameras are not synchronous
# 6 mm in a period of 16 frames, less in a shorter one
SWAY_MPS2 = 2.3
SWAY_RAD = math.radians(0.4)
PLACES_W_M = {Role.SENDER: (0.0, 0.0, 1.4), Role.RECEIVER: (0.45, -0.95, 2.1)}
HEADINGS_RAD = {Role.SENDER: 0.0, Role.RECEIVER: -0.25}
CARS = (
    Thing("car", (0.05, 1.5, 0.0), 0.6),  # the target
    Thing("car", (1.3, 2.0, 0.0), 2.0),
    Thing("car", (-1.0, 2.4, 0.0), -1.0),
    Thing("car", (-1.2, 0.4, 0.0), 1.2),
)
TARGET_W_M = (0.05, 1.5, 0.08)
R_W_N = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@frozen(eq=False)
class Moment:
    """One frame of each drone.

    Attributes:
        color, depth_mm: by role; depth is D1's alone.
        R_n_b: true attitudes at the two instants.
        velocity_n_mps: true velocities then.
        box1: D1's target, by its detector.
        boxes2: everything the detector finds in D2's frame: what the baselines choose from.
    """

    color: dict[Role, Image]
    depth_mm: Depths
    R_n_b: dict[Role, Matrix]
    velocity_n_mps: dict[Role, Vec3]
    box1: Box
    boxes2: tuple[Box, ...]


@frozen
class Film:
    """Moments that repeat without a jump: the drones' swaying has their number of frames as its
    period.
    """

    size: str
    cameras: dict[Role, CameraModel]
    moments: tuple[Moment, ...]


def shoot_film(
    request: TrialRequest,
    size: str,
    count: int,
) -> Film:
    """Render ``count`` moments. Raises RuntimeError when the detector does not find the target in one
    of them.
    """
    rig = request.rig
    renderer_of = request.part("renderer")
    cameras = {role: camera_of(rig, role, size) for role in Role}
    mounts = {role: rig.role(role).mount for role in Role}
    renderers: dict[Role, FrameRenderer] = {
        role: renderer_of(
            RendererSetup(cameras[role], mounts[role].T_b_c, mounts[role].T_b_v, rig.layout),
            request.seed,
        )
        for role in Role
    }
    detector = ColorDetector(ColorDetectorConfig())
    moments: list[Moment] = []
    for k in request.work.steps(f"frames of {size}", range(count)):
        instants = {Role.SENDER: float(k), Role.RECEIVER: k + BETWEEN_NS / PERIOD_NS}
        stages = {role: _stage(instant / count, count) for role, instant in instants.items()}
        shots = {role: renderers[role].shoot(stage, role, k) for role, stage in stages.items()}
        T_c_w = (stages[Role.SENDER].T_w_b[Role.SENDER] @ mounts[Role.SENDER].T_b_c).inverse()
        x, y, z = T_c_w.apply(np.array(TARGET_W_M)).tolist()
        found = {
            role: [each.box for each in detector.detect(shot.color, None)]
            for role, shot in shots.items()
        }
        box1 = _nearest(found[Role.SENDER], cameras[Role.SENDER].project_point((x, y, z)))
        if box1 is None or not found[Role.RECEIVER]:
            raise RuntimeError(f"{size}, frame {k}: the target is not found")
        moments.append(
            Moment(
                {role: shot.color for role, shot in shots.items()},
                shots[Role.SENDER].depth_mm,
                {role: R_W_N.T @ stage.T_w_b[role].R for role, stage in stages.items()},
                {role: _velocity(role, instant, count) for role, instant in instants.items()},
                box1,
                tuple(found[Role.RECEIVER]),
            )
        )
    return Film(size, cameras, tuple(moments))


def camera_of(
    rig: Rig,
    role: Role,
    size: str,
) -> CameraModel:
    """The rig's camera, or one with the same lens for another size: the D415 crops its wide image
    for 4:3.
    """
    camera = rig.role(role).camera
    width, height = SIZES[size]
    factor = height / camera.height
    if (width, height) == (camera.width, camera.height):
        return camera
    cx = 0.5 * (width - 1) + factor * (camera.cx - 0.5 * (camera.width - 1))
    cy = factor * (camera.cy + 0.5) - 0.5
    return replace(
        camera,
        width=width,
        height=height,
        fx=factor * camera.fx,
        fy=factor * camera.fy,
        cx=cx,
        cy=cy,
    )


def _stage(phase: float, count: int) -> RenderedInstant:
    """Return the stage at a share of the period of the swaying, which has so many frames."""
    turn = 2.0 * math.pi * phase
    sway_m = SWAY_MPS2 * (count * PERIOD_NS * 1e-9 / (2.0 * math.pi)) ** 2
    poses: dict[Role, Pose] = {}
    for number, role in enumerate(Role):
        sway = sway_m * np.array(
            [math.sin(turn + number), math.cos(turn + 2.0 * number), 0.5 * math.sin(turn - number)]
        )
        roll = SWAY_RAD * math.sin(turn + 1.0 + number)
        pitch = SWAY_RAD * math.cos(turn - number)
        attitude = R_W_N @ R_from_rpy(roll, pitch, HEADINGS_RAD[role])
        poses[role] = Pose(attitude, np.array(PLACES_W_M[role]) + sway)
    return RenderedInstant(poses, CARS, rotor_phase_rad=turn)


def _velocity(
    role: Role,
    instant: float,
    count: int,
) -> Vec3:
    """Return a velocity in ``n``, m/s, at an instant in frames, of a film that repeats after
    ``count`` of them.
    """
    before, after = (
        _stage((instant + step) / count, count).T_w_b[role].t for step in (-0.05, 0.05)
    )
    north, east, down = (R_W_N.T @ (after - before) / (0.1 * PERIOD_NS * 1e-9)).tolist()
    return north, east, down


def _nearest(boxes: Sequence[Box], pixel: tuple[float, float]) -> Box | None:
    nearest = min(boxes, key=lambda box: math.dist(box.center, pixel), default=None)
    return (
        nearest
        if nearest is not None and math.dist(nearest.center, pixel) < 0.5 * nearest.w
        else None
    )
