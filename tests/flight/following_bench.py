"""D1 alone behind a target, closed loop in a few milliseconds of processor time: airframe, camera,
track, guidance.

The airframe is the simulated world's; times are those of the rig ``sitl``: frames 40 ms old, 20
setpoints a second.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import FlightMode, VehicleState, VelocitySetpoint
from drivers.rig.parts import Mount
from flight.config import MissionConfig
from flight.guidance import Vec3, slew
from flight.tracking.association import Sighting, follow
from flight.tracking.target_track import TargetTrack
from hil.world.dynamics import (
    COMMAND_SIZE,
    INTEGRAL,
    MOTORS,
    MOTORS_FLY,
    THRUST,
    AirframeConfig,
    fly,
    standing,
)
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_quat, R_from_rpy
from path.geometry.transforms import Pose
from path.messages import Quat
from path.observations import Box, Depth, Detection, MarkerDetection, Region

STEP_S = 0.005
CAMERA = CameraModel(640, 480, 615.2, 615.9, 322.1, 241.3, (0.112, -0.236, 0.0006, -0.0004, 0.095))
_AHEAD_DOWN = R_from_rpy(0.0, -math.pi / 4, 0.0) @ np.array(
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
)
MOUNT = Mount(Pose(_AHEAD_DOWN, np.array([0.10, 0.0, 0.02])), Pose(np.eye(3), np.zeros(3)))
PX4 = AirframeConfig(  # as measured: docs/conformance.md, the rig sitl
    gain_horizontal_hz=1.4,
    integral_horizontal_hz2=0.3,
    gain_vertical_hz=2.0,
    integral_vertical_hz2=0.6,
    max_yaw_rate_dps=110.0,
)
_HALF_M = (0.16, 0.09, 0.08)  # of the car
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * _HALF_M

Course = Callable[[float], tuple[float, float]]  # north, east of a target at a time
Guidance = Callable[[VehicleState, TargetTrack, int], VelocitySetpoint]


@dataclass
class Seen:
    """The camera's view, through the simulated colour detector: a box that the border cuts is
    hardly one.
    """

    stamp_ns: int
    objects: Sequence[Vec3]
    T_n_c: Pose
    rng: np.random.Generator
    frame_id: int = 0
    found: list[tuple[Detection, float]] = field(default_factory=list[tuple[Detection, float]])

    def __post_init__(self) -> None:
        for place in self.objects:
            corners = self.T_n_c.inverse().apply(_CORNERS + np.array(place))
            if corners[:, 2].min() < 0.2:
                continue
            pixels = np.array([CAMERA.project_point((x, y, z)) for x, y, z in corners.tolist()])
            (x0, y0), (x1, y1) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
            if x1 < 4.0 or y1 < 4.0 or x0 > CAMERA.width - 4.0 or y0 > CAMERA.height - 4.0:
                continue
            cut = x0 < 0.0 or y0 < 0.0 or x1 > CAMERA.width - 1.0 or y1 > CAMERA.height - 1.0
            off = self.rng.normal(0.0, 1.0, 4).tolist()
            x0, y0 = max(x0 + off[0], -0.5), max(y0 + off[1], -0.5)
            x1, y1 = min(x1 + off[2], CAMERA.width - 0.5), min(y1 + off[3], CAMERA.height - 0.5)
            box = Box(x0, y0, x1 - x0, y1 - y0)
            self.found.append((Detection(box, 0.18 if cut else 0.9), float(corners[:, 2].mean())))

    def targets(self, region: Region | None) -> Sequence[Detection]:
        return [d for d, _ in self.found if region is None or region.contains(*d.box.center)]

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        return []

    def depth(self, box: Box) -> Depth | None:
        z_m = next((z for d, z in self.found if d.box == box), None)
        return None if z_m is None else Depth(z_m + float(self.rng.normal(0.0, 0.005)), 0.01)

    def image(self) -> NDArray[np.uint8] | None:
        return None


@dataclass(frozen=True)
class Followed:
    """One flight. Rows are frames."""

    time_s: NDArray[np.float64]
    # true horizontal distance to the target, (n, 2), along and across the heading
    off_m: NDArray[np.float64]
    in_view: NDArray[np.bool_]  # in truth, whole
    held: NDArray[np.bool_]  # by the track

    @property
    def out_of_view_s(self) -> float:
        """Longest time without the whole target in the image."""
        return _longest(~self.in_view) * 0.04

    @property
    def lost_s(self) -> float:
        return _longest(~self.held) * 0.04

    @property
    def nearest_m(self) -> float:
        return float(self.off_m[:, 0].min())


def _longest(flags: NDArray[np.bool_]) -> int:
    most = run = 0
    for flag in flags.tolist():
        run = run + 1 if flag else 0
        most = max(most, run)
    return most


def follow_course(
    course: Course,
    guidance: Guidance,
    config: MissionConfig,
    *,
    start: tuple[float, float, float, float] = (1.7, 0.0, 1.5, 0.0),
    airframe: AirframeConfig = PX4,
    last_s: float = 20.0,
    seed: int = 0,
    wind: Vec3 = (0.0, 0.0, 0.0),
    others: Sequence[Vec3] = (),
    late_s: float = 0.04,
    view_late_s: float = 0.0,
) -> Followed:
    """Fly behind a target from the frame in which it was acquired.

    Args:
        start: north, east, height in m, and speed northwards of the drone.
        late_s: of telemetry and of frames; what a companion commands takes as long again.
        view_late_s: by how much a frame is stamped wrongly.
    """
    rng = np.random.default_rng(seed)
    state = standing(start[0], start[1], 0.0, airframe.leg_m)[None]
    state[0, 2], state[0, 3], state[0, THRUST] = -start[2], start[3], 9.80665
    # it flew so for a while
    state[0, INTEGRAL][:2] = (
        airframe.drag_hz * (start[3] - wind[0]),
        -airframe.drag_hz * wind[1],
    )
    command = np.zeros((1, COMMAND_SIZE))
    command[0, MOTORS], command[0, 1] = MOTORS_FLY, start[3]
    winds, none = np.array([wind]), np.zeros((1, 3))
    history: deque[tuple[int, Vec3, Vec3, Quat]] = deque(maxlen=64)
    waiting: deque[tuple[int, VelocitySetpoint]] = deque()
    track: TargetTrack | None = None
    last = VelocitySetpoint((start[3], 0.0, 0.0), 0.0)
    rows: list[tuple[float, float, float, bool, bool]] = []
    late = round(late_s / STEP_S)
    tilt = rng.normal(0.0, math.radians(0.5), 2).tolist()
    for k in range(round(last_s / STEP_S)):
        now_ns = k * 5_000_000
        s = state[0].tolist()
        q = (s[6], s[7], s[8], s[9])
        history.append((now_ns, (s[0], s[1], s[2]), (s[3], s[4], s[5]), q))
        stamp_ns, position, velocity, attitude = history[max(0, len(history) - 1 - late)]
        heard = _state(stamp_ns, position, velocity, attitude)
        place = (*course(max(0.0, stamp_ns * 1e-9)), -0.1)
        if k % 8 == 0:
            R_n_b = R_from_quat(attitude)
            true = Pose(R_n_b @ MOUNT.T_b_c.R, R_n_b @ MOUNT.T_b_c.t + np.array(position))
            view = Seen(stamp_ns, (place, *others), true, rng)
            R_off = R_from_rpy(tilt[0], tilt[1], 0.0) @ R_n_b
            at = np.array(position) + view_late_s * np.array(velocity)
            believed = Pose(R_off @ MOUNT.T_b_c.R, R_off @ MOUNT.T_b_c.t + at)
            if track is None:
                track = TargetTrack(
                    place, stamp_ns, config.follow.target_accel_mps2, flies=config.target.flies
                )
            held = isinstance(follow(view, believed, CAMERA, track), Sighting)
            alone = Seen(stamp_ns, (place,), true, np.random.default_rng(0)).found
            whole = bool(alone) and alone[0][0].score > 0.5
            rows.append(
                (stamp_ns * 1e-9, place[0] - position[0], place[1] - position[1], whole, held)
            )
        if k % 10 == 0 and track is not None:
            noisy = tuple((np.array(heard.velocity_n_mps) + rng.normal(0.0, 0.03, 3)).tolist())
            heard = _state(heard.stamp_ns, position, noisy, attitude)
            last = slew(last, guidance(heard, track, now_ns), 0.05, config.max_accel_mps2)
            waiting.append((now_ns + round(0.5e9 * late_s), last))
        while waiting and waiting[0][0] <= now_ns:
            command[0, 1:4] = waiting.popleft()[1].velocity_n_mps
        fly(state, command, winds, none, none, none, airframe.row(), STEP_S, 1)
    table = np.array([row[:3] for row in rows])
    return Followed(
        table[:, 0],
        table[:, 1:],
        np.array([row[3] for row in rows]),
        np.array([row[4] for row in rows]),
    )


def _state(stamp_ns: int, position: Vec3, velocity: Vec3, q: Quat) -> VehicleState:
    return VehicleState(
        stamp_ns=stamp_ns,
        heartbeat_ns=stamp_ns,
        position_n_m=position,
        velocity_n_mps=velocity,
        q_n_b=q,
        armed=True,
        in_air=True,
        armable=True,
        mode=FlightMode.OFFBOARD,
        battery=1.0,
    )
