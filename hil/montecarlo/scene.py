"""The draws for one Monte-Carlo hand-over: who stands where, errors that last, what goes wrong and
when.

Every group has its own stream of random numbers, so that one fault or another changes nothing else.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drivers.rig.parts import Mount, Rig
from drivers.rig.tables import decode_table
from flight.config import MissionConfig
from flight.harness.montecarlo import Attempt, FaultName
from flight.rendezvous.viewpoint import Viewpoint, ViewpointScene, plan_viewpoint
from hil.geometric.noise import ObservationNoise
from hil.geometric.scene import parts_of
from hil.geometric.targets import TargetNoise
from hil.montecarlo.faults import HandoverFaults, direction, draw_faults
from hil.world.errors import Built, as_built, level_of, sizes_of
from hil.world.snapshot import TargetKind
from hil.world.targets import CROSSING_PAST_M, LookAlikeConfig, TargetConfig
from path.arrays import Array, Flags
from path.geometry.rotation import R_from_yaw, exp
from path.geometry.transforms import Pose
from path.values import frozen

Generator = np.random.Generator

# Ranges and standard deviations of what is drawn; the trial prints them. Beside where the mission
# has D1:
BEHIND_M = (-0.25, 0.25)
HEIGHT_M = (-0.2, 0.3)
SIDE_M = 0.10
# D2 at its viewpoint
PLACE_SIGMA_M = 0.07
YAW_SIGMA_RAD = math.radians(3.0)
# of an attitude estimate: roll, pitch, yaw
BIAS_RAD = (math.radians(0.5), math.radians(0.5), math.radians(2.0))
CLOCK_SIGMA_S = 0.002
MOVING_SHARE = 0.75
SPEED_MPS = (0.05, 0.4)
TURN_RAD_S = 0.15
PARKED_NEARER_M = 0.2  # than look-alikes are at first
CROSSING_MPS = 1.0
CROSSING_HALF_S = 3.5


@frozen
class Believed:
    """The rig as Monte-Carlo hand-overs need it, and what there is in its world.

    ``frame_m``, ``middle_m``: height above the ground of the target's frame and of its middle.
    """

    rig: Rig
    mission: MissionConfig
    noise: ObservationNoise
    kind: TargetKind
    look_alikes: LookAlikeConfig
    frame_m: float
    middle_m: float

    @classmethod
    def of(cls, rig: Rig) -> Believed:
        mission = decode_table(rig.mission, MissionConfig, rig.where("[mission]"))
        target = decode_table(
            rig.world.get("target", {}), TargetConfig, rig.where("[world.target]")
        )
        others = decode_table(
            rig.world.get("look_alikes", {}), LookAlikeConfig, rig.where("[world.look_alikes]")
        )
        parts = parts_of(target.kind)
        top = np.max(parts[:, 2] + parts[:, 5])
        bottom = np.min(parts[:, 2] - parts[:, 5])
        frame_m = target.height_m if target.kind == "drone" else 0.0
        middle_m = frame_m + 0.5 * float(top + bottom)
        return cls(rig, mission, ObservationNoise(), target.kind, others, frame_m, middle_m)

    @property
    def sender_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ranges of D1's horizontal distance from the target and of its height above the ground."""
        behind_m = self.mission.follow.behind_m
        height_m = self.mission.follow.height_m
        return (behind_m + BEHIND_M[0], behind_m + BEHIND_M[1]), (
            height_m + HEIGHT_M[0],
            height_m + HEIGHT_M[1],
        )

    @property
    def parked_gap_m(self) -> float:
        """The least distance from the target to where a look-alike is parked."""
        return self.look_alikes.min_distance_m - PARKED_NEARER_M

    @property
    def boxes(self) -> TargetNoise:
        """The noise of the detector's boxes."""
        boxes = {"car": self.noise.targets, "person": self.noise.people, "drone": self.noise.drones}
        return boxes[self.kind]

    def rolled(self, roll_deg: float) -> Rig:
        """The rig with D2's camera turned about its optical axis."""
        receiver = self.rig.receiver
        mount = self.rig.receiver.mount
        turned = Pose(
            mount.T_b_c.R @ exp(np.array([0.0, 0.0, math.radians(roll_deg)])), mount.T_b_c.t
        )
        return replace(self.rig, receiver=replace(receiver, mount=Mount(turned, mount.T_b_v)))


@frozen
class Place:
    """The places where the drones hold: D1 from the target, D2's body from D1's, local NED; D1
    heads north.
    """

    sender_n_m: Array
    receiver_n_m: Array
    receiver_yaw_rad: float


@frozen
class Things:
    """The target (row 0) and its look-alikes.

    Attributes:
        start: (m, 2) north and east at time 0, of an attached one from the target.
        velocity: (m, 2) m/s; of an attached one relative to the target.
        attached: (m,) whether it drives along with the target.
        span_s: (m, 2) from when to when it is there.
        yaw_rad: (m,) clockwise from north; of an attached one from the target's.
        speed_mps, heading_rad, turn_rad_s: the target's own motion.
    """

    start: Array
    velocity: Array
    attached: Flags
    span_s: Array
    yaw_rad: Array
    speed_mps: float
    heading_rad: float
    turn_rad_s: float

    def at(self, times_s: Array) -> tuple[Array, Array]:
        """North and east, shape (n, m, 2), NaN where there is none, and yaw (n, m)."""
        heading = self.heading_rad + self.turn_rad_s * times_s
        mean = self.heading_rad + 0.5 * self.turn_rad_s * times_s
        half = 0.5 * self.turn_rad_s * times_s
        chord = self.speed_mps * times_s * np.sinc(half / math.pi)
        target = np.stack((chord * np.cos(mean), chord * np.sin(mean)), axis=1)
        there = (
            self.start
            + self.velocity * times_s[:, None, None]
            + self.attached[:, None] * target[:, None]
        )
        there[:, 0] = target
        gone = (times_s[:, None] < self.span_s[:, 0]) | (times_s[:, None] > self.span_s[:, 1])
        there[gone] = np.nan
        return there, self.yaw_rad + np.where(self.attached, heading[:, None], 0.0)


@frozen
class LastingErrors:
    """The differences to what is believed, for the whole attempt: the truth where it can be
    given.
    """

    built: Built
    tilt_bias: Array  # (2, 3) of each drone's attitude estimate, rotation vector in the body
    mean_tilt: Array  # (2, 3) roll, pitch, yaw in the mean
    attitude_noise: float  # times what the estimates waver by
    clock_s: float  # D2's stamps as D1 converts them, minus the truth


@frozen
class Drawn:
    """One attempt's circumstances. ``shift_c``, ``turn_c``: of D2's pose, m and rad in its camera's
    axes.
    """

    place: Place
    things: Things
    errors: LastingErrors
    faults: HandoverFaults
    shift_c: Array
    turn_c: Array


def draw(attempt: Attempt, believed: Believed, streams: list[Generator]) -> Drawn:
    """``streams``: of place, things, errors and faults."""
    rig = believed.rolled(attempt.roll_deg)
    place = _place(believed, attempt.reach, streams[0])
    errors = _errors(rig, streams[2])
    names, faults = draw_faults(attempt.fault, streams[3])
    things = _things(attempt, believed, names, streams[1])
    shift = np.zeros(3)
    turn = np.zeros(3)
    if attempt.wrong is not None:
        shift, turn = _bias(attempt, believed, rig, place, things, streams[1])
        if attempt.wrong.kind == "lock":
            faults = replace(faults, swapped=np.array([[-1.0, math.inf]]))
    return Drawn(place, things, errors, faults, shift, turn)


def _place(believed: Believed, reach: float, rng: Generator) -> Place:
    """Both drones as the mission would place them, each a little beside."""
    mission = believed.mission
    sender = believed.rig.sender
    receiver = believed.rig.receiver
    T_b_v = sender.mount.T_b_v
    camera = receiver.camera
    behind_m, height_m = believed.sender_m
    while True:
        behind = rng.uniform(*behind_m)
        height = rng.uniform(*height_m)
        side = SIDE_M * rng.standard_normal()
        behind = reach * behind
        height = reach * height
        sender_n = np.array([-behind, side, -height])
        target_h = -sender_n - T_b_v.t - np.array([0.0, 0.0, believed.middle_m])
        side_m = believed.rig.layout.markers[0].side_m
        half_m = mission.target.half_size_m
        scene = ViewpointScene(target_h, T_b_v.R[:, 2], side_m, -T_b_v.t, target_radius_m=half_m)
        plan = plan_viewpoint(
            scene, camera, receiver.mount.T_b_c, mission.rendezvous, mission.separation
        )
        beside = PLACE_SIGMA_M * rng.standard_normal(3)
        turn = YAW_SIGMA_RAD * rng.standard_normal()
        mirrored = rng.random() < 0.5
        if isinstance(plan, Viewpoint):
            break
    # the other side is as good when the target is ahead
    across = -1.0 if mirrored and abs(side) < SIDE_M else 1.0
    yaw = across * plan.yaw_h_rad + turn
    camera_h = np.array(plan.camera_h_m) * (1.0, across, 1.0)
    receiver_n = T_b_v.t + camera_h - R_from_yaw(yaw) @ receiver.mount.T_b_c.t + beside
    return Place(sender_n, receiver_n, yaw)


def _things(
    attempt: Attempt, believed: Believed, names: tuple[FaultName, ...], rng: Generator
) -> Things:
    """The target, three look-alikes that keep away, and what a fault adds."""
    others = believed.look_alikes
    moving = rng.random() < MOVING_SHARE
    speed = rng.uniform(*SPEED_MPS)
    heading = rng.uniform(-math.pi, math.pi)
    turn = rng.uniform(-TURN_RAD_S, TURN_RAD_S)
    rows: list[tuple[Array, Array, bool, tuple[float, float], float]] = []
    always = (-math.inf, math.inf)
    yaw = rng.uniform(-math.pi, math.pi)
    rows.append((np.zeros(2), np.zeros(2), True, always, yaw))
    times = np.linspace(0.0, attempt.limit_s, 40)
    alone = Things(
        np.zeros((1, 2)), np.zeros((1, 2)), np.array([True]), np.array([always]), np.zeros(1),
        speed if moving else 0.0, heading, turn,
    )  # fmt: skip
    path = alone.at(times)[0][:, 0]
    for k in range(3):
        for _ in range(20):
            start = rng.uniform(others.min_distance_m, others.max_distance_m) * direction(rng)
            distances = start[None] if k == 0 else start - path
            if np.hypot(distances[:, 0], distances[:, 1]).min() >= believed.parked_gap_m:
                rows.append((start, np.zeros(2), k == 0, always, rng.uniform(-math.pi, math.pi)))
                break
    extra = np.random.default_rng(int(rng.integers(1 << 62)))
    if attempt.wrong is not None:
        rows.insert(1, _beside(attempt.wrong.distance_m, attempt.wrong.crossing, extra))
    for name in names:
        if name == "look_alike_near":
            rows.insert(1, _beside(extra.uniform(0.3, 1.0), False, extra))
        elif name == "detector_swap":
            rows.insert(1, _beside(extra.uniform(0.3, 0.8), False, extra))
        elif name == "look_alike_crossing":
            rows.insert(1, _beside(extra.uniform(*CROSSING_PAST_M[believed.kind]), True, extra))
    starts, velocities, attached, spans, yaws = zip(*rows, strict=True)
    return Things(
        np.array(starts), np.array(velocities), np.array(attached), np.array(spans), np.array(yaws),
        alone.speed_mps, heading, turn,
    )  # fmt: skip


def _beside(
    distance_m: float, crossing: bool, rng: Generator
) -> tuple[Array, Array, bool, tuple[float, float], float]:
    """A look-alike at a distance from the target, along with it or past it."""
    aside = direction(rng)
    middle_s = rng.uniform(1.0, 6.0)
    yaw = rng.uniform(-math.pi, math.pi)
    if not crossing:
        return distance_m * aside, np.zeros(2), True, (-math.inf, math.inf), yaw
    velocity = CROSSING_MPS * np.array([-aside[1], aside[0]])
    span = middle_s - CROSSING_HALF_S, middle_s + CROSSING_HALF_S
    return (
        distance_m * aside - middle_s * velocity,
        velocity,
        True,
        span,
        math.atan2(velocity[1], velocity[0]),
    )


def _errors(rig: Rig, rng: Generator) -> LastingErrors:
    """From the one table of errors, by the level of the rig (``hil.world.errors``)."""
    sizes = sizes_of(level_of(rig))
    bias = np.array([sizes.tilt_bias, sizes.tilt_bias, sizes.yaw_bias]) * np.array(BIAS_RAD)
    return LastingErrors(
        built=as_built(rig, int(rng.integers(1 << 62))),
        tilt_bias=bias * rng.standard_normal((2, 3)),
        mean_tilt=np.radians([1.5, 1.5, 1.5]) * rng.standard_normal((2, 3)),
        attitude_noise=sizes.attitude_noise,
        clock_s=CLOCK_SIGMA_S * rng.standard_normal(),
    )


def _bias(
    attempt: Attempt,
    believed: Believed,
    rig: Rig,
    place: Place,
    things: Things,
    rng: Generator,
) -> tuple[Array, Array]:
    """Return the errors of D2's pose, m and rad in its camera, that put the prior on the
    look-alike.
    """
    wrong = attempt.wrong
    assert wrong is not None
    residual = wrong.residual_m * rng.standard_normal(3)
    if wrong.kind == "lock":
        return np.zeros(3), np.zeros(3)
    R_c_n = (R_from_yaw(place.receiver_yaw_rad) @ rig.receiver.mount.T_b_c.R).T
    # it stays at its distance, or the bias is that of its closest
    away = things.start[1]
    if wrong.crossing:
        along = things.velocity[1]
        away = away - along * (away @ along) / (along @ along)
    offset = R_c_n @ np.array([away[0], away[1], 0.0]) + residual
    if wrong.kind == "shift":
        return offset, np.zeros(3)
    to_target = R_c_n @ (
        -place.sender_n_m - rig.sender.mount.T_b_v.t - np.array([0.0, 0.0, believed.middle_m])
    )
    return np.zeros(3), _turn_between(to_target, to_target + offset)


def _turn_between(a: Array, b: Array) -> Array:
    """Rotation vector of the smallest turn that takes the direction of one vector to that of
    another.
    """
    axis = np.cross(a, b)
    size = float(np.linalg.norm(axis))
    return axis * (math.atan2(size, float(a @ b)) / size) if size > 0.0 else axis
