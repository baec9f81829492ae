"""A Monte-Carlo hand-over made ready: frames, poses, messages and their arrivals as arrays.

What is before the cameras is placed as far as the hand-over is run; what they see, when they are
asked.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flight.harness.montecarlo import Attempt, Circumstances
from flight.tracking.association import Sighting
from hil.geometric.noise import ObservationNoise
from hil.geometric.perception import Sensor
from hil.geometric.scene import CameraSetup
from hil.montecarlo.follower import Follower
from hil.montecarlo.motion import (
    P_W_N,
    RECEIVER,
    SENDER,
    HandoverMotion,
    HandoverPoses,
    exp_all,
    within,
)
from hil.montecarlo.perception import NOBODY, CameraPath, HandoverCamera, HandoverView
from hil.montecarlo.scene import Believed, Drawn, Generator, draw
from hil.world.errors import SensorErrors
from hil.world.snapshot import TargetKind
from path.arrays import Array, Whole
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.messages import Role
from path.observations import MissReason
from path.values import frozen

RATE_HZ = 50.0
STATUS_HZ = 10.0
# from a frame to the end of its processing
SENDER_LATENCY_S = (0.008, 0.020)
RECEIVER_LATENCY_S = (0.010, 0.030)
LATENCY_JITTER_S = 0.002
STREAMS = 7
BLOCK_S = 0.5
HORIZON_S = 8.2  # how far an attempt is made ready at first
CLOSEST_STEP_S = 0.02
EPOCH_S = 10.0  # of the clocks, when an attempt begins
# what happens
SENDER_FRAME = 0
TARGET_HEARD = 1
RECEIVER_FRAME = 2
CANDIDATE_HEARD = 3


class HandoverFrames(NamedTuple):
    """Both cameras' frames: numbers, stamps, and what is known beside the images.

    ``gravity_v``, ``gravity_c``: (n, 3) as each drone believes; ``R_n_c``: of D2's camera, (n, 3,
    3). ``shift_c``, ``turn``: what D2's pose is off by, (3,) and (3, 3).
    ``own_velocity``: of D2 with each of its frames; ``peer_stamp``, ``peer_velocity``,
    ``peer_yaw``: D1's reports, and ``heard``: (n,) how many of them D2 has by a frame.
    """

    number_1: Whole
    stamp_1: Whole
    gravity_v: Array
    number_2: Whole
    stamp_2: Whole
    gravity_c: Array
    R_n_c: Array
    shift_c: Array
    turn: Array
    own_velocity: Array
    peer_stamp: Whole
    peer_velocity: Array
    peer_yaw: Array
    heard: Whole


@frozen
class Timed:
    """Frames of one camera.

    Attributes:
        number: (n,) running number; frames that a frozen camera did not give are left out.
        taken_s, done_s, heard_s: (n,) when it was taken, when its processing ended, when the other
            drone heard of it; infinite for a message that was lost.
        stamped_s: (n,) when it was taken, by its stamp.
    """

    number: Whole
    taken_s: Array
    done_s: Array
    heard_s: Array
    stamped_s: Array

    def until(self, time_s: float) -> Timed:
        """Return the frames taken before an instant."""
        count = int(np.searchsorted(self.taken_s, time_s))
        columns = self.number, self.taken_s, self.done_s, self.heard_s, self.stamped_s
        return Timed(*(column[:count] for column in columns))  # type: ignore[arg-type]


class HandoverSetup:
    """One attempt before it is run."""

    def __init__(self, attempt: Attempt, believed: Believed, method: MethodConfig) -> None:
        seeds = np.random.SeedSequence([attempt.seed, attempt.index]).spawn(STREAMS)
        streams = [np.random.default_rng(seed) for seed in seeds]
        self.drawn: Drawn = draw(attempt, believed, streams[:4])
        self.rig = believed.rolled(attempt.roll_deg)
        self._frame_m = believed.frame_m
        self._middle_m = believed.middle_m
        self._motion = HandoverMotion(self.drawn, streams[4])
        faults = self.drawn.faults
        self.clock_ns = round((self.drawn.errors.clock_s + faults.clock_s) * 1e9)
        self.frames = tuple(
            self._timed(
                attempt.limit_s, latency, frozen, self.drawn.errors.built.sensors[role], streams[5]
            )
            for role, latency, frozen in zip(
                Role, (SENDER_LATENCY_S, RECEIVER_LATENCY_S), faults.frozen, strict=True
            )
        )
        look_seeds = streams[6].integers(1 << 62, size=2).tolist()
        self._kind: TargetKind = believed.kind
        self._sensor_1, self._sensor_2 = (
            self._sensor(role, believed.noise, method, seed)
            for role, seed in zip(Role, look_seeds, strict=True)
        )
        self._T_v_m = believed.rig.layout.markers[0].T_v_m
        self.follower = Follower(
            self.rig.sender.camera, believed.mission, method, self.drawn.things, -self._middle_m
        )
        self._limit_s = attempt.limit_s
        self._prepare(min(HORIZON_S, attempt.limit_s))

    def _sensor(
        self, role: Role, noise: ObservationNoise, method: MethodConfig, seed: int
    ) -> Sensor:
        """A camera as it truly is, with the perception behind it."""
        built = self.drawn.errors.built
        own = built.rig.role(role)
        lapse_rate = noise.marker.lapse_rate + self.drawn.faults.lapse_rate
        noise = replace(noise, marker=noise.marker._replace(lapse_rate=lapse_rate))
        setup = CameraSetup(role, own.camera, own.mount.T_b_c, own.mount.T_b_v, built.rig.layout)
        return Sensor(setup, noise, method, seed, built.sensors[role])

    def _timed(
        self,
        limit_s: float,
        latency: tuple[float, float],
        frozen: Array,
        sensor: SensorErrors,
        rng: Generator,
    ) -> Timed:
        faults = self.drawn.faults
        count = math.ceil(limit_s * RATE_HZ)
        taken = rng.uniform(0.0, 1.0 / RATE_HZ) + np.arange(count) / RATE_HZ
        first = int(rng.integers(1, 60000))
        done = taken + rng.uniform(*latency) + rng.exponential(LATENCY_JITTER_S, count)
        done = np.maximum.accumulate(done)
        heard = done + faults.delay_s + rng.uniform(0.0, faults.jitter_s, count)
        heard[rng.random(count) < faults.loss] = math.inf
        jitter = np.clip(
            sensor.stamp_jitter_s * rng.standard_normal(count), -0.45 / RATE_HZ, 0.45 / RATE_HZ
        )
        stamped = taken + sensor.stamp_late_s + jitter
        there = ~within(taken, frozen)
        return Timed(
            first + np.flatnonzero(there), taken[there], done[there], heard[there], stamped[there]
        )

    def _prepare(self, horizon_s: float) -> None:
        """Poses of all frames up to a time, and what is before the cameras."""
        self._horizon_s = horizon_s
        drawn = self.drawn
        own_1 = self.rig.sender.mount
        own_2 = self.rig.receiver.mount
        faults = drawn.faults
        sender, receiver = (frames.until(horizon_s) for frames in self.frames)
        (things_1, target_1), (things_2, target_2) = (
            _things(each, drawn, self._frame_m) for each in (sender, receiver)
        )
        at_1 = self._motion.poses(sender.taken_s, target_1)
        at_2 = self._motion.poses(receiver.taken_s, target_2)
        self.flown_1 = _flown(sender, at_1, SENDER, things_1)
        self.flown_2 = _flown(receiver, at_2, RECEIVER, things_2)
        self._times_1 = sender.taken_s
        self._holes = within(sender.taken_s, faults.holes)
        self._hidden = within(receiver.taken_s, faults.hidden)
        things_2[within(receiver.taken_s, faults.swapped), 0] = (
            np.nan
        )  # D2's detector is blind for the target, also where another touches it
        R_n_b1 = at_1.estimated(SENDER)
        self._R_n_c1 = R_n_b1 @ own_1.T_b_c.R
        self._t_n_c1 = at_1.t_n[SENDER] + at_1.drift + R_n_b1 @ own_1.T_b_c.t
        R_n_c2 = at_2.estimated(RECEIVER) @ own_2.T_b_c.R
        self._camera_1 = HandoverCamera(self._sensor_1, self._kind, self.flown_1)
        self._camera_2 = HandoverCamera(self._sensor_2, self._kind, self.flown_2)
        self.seen = HandoverFrames(
            sender.number, _ns(sender.stamped_s), np.ascontiguousarray((R_n_b1 @ own_1.T_b_v.R)[:, 2]),
            receiver.number, _ns(receiver.stamped_s) + self.clock_ns, self._gravity_c(R_n_c2, receiver), R_n_c2,
            drawn.shift_c, exp_all(drawn.turn_c[None])[0], *self._reports(receiver),
        )  # fmt: skip

    def _reports(self, receiver: Timed) -> tuple[Array, Whole, Array, Array, Whole]:
        """Return both vehicles' reports of their motion, D1's yaw in it, and how many D2 has by
        each of its frames.
        """
        faults = self.drawn.faults
        motion = self._motion
        said_s = np.arange(-2.0, self._horizon_s * STATUS_HZ) / STATUS_HZ
        heard = np.searchsorted(said_s + faults.delay_s + faults.jitter_s, receiver.done_s)
        own = motion.reported(receiver.taken_s, RECEIVER)
        peer = motion.reported(said_s, SENDER)
        return own, _ns(said_s), peer, motion.yaw(said_s), np.maximum(heard, 1)

    def _gravity_c(self, R_n_c2: Array, receiver: Timed) -> Array:
        """Gravity in D2's camera as D2 believes; while flipped, what makes the other planar
        solution the likely one.
        """
        gravity_c = np.ascontiguousarray(R_n_c2[:, 2])
        mount = self.drawn.errors.built.rig.receiver.mount
        flown = self.flown_2
        for k in np.flatnonzero(within(receiver.taken_s, self.drawn.faults.flipped)).tolist():
            T_c_w = (Pose(flown.R[k], flown.t[k]) @ mount.T_b_c).inverse()
            T_w_v = Pose(flown.other_R[k], flown.other_t[k]) @ mount.T_b_v
            R = mirrored(T_c_w @ T_w_v, self._T_v_m)
            gravity_c[k] = R @ -T_w_v.R[2]
        return gravity_c

    def reach(self, until_s: float) -> None:
        """Make what is known ready of frames taken before ``until_s``."""
        if until_s > self._horizon_s:
            self._prepare(self._limit_s)

    def followed(self, k: int) -> tuple[Sighting | MissReason, int]:
        """D1's frame: the target that it follows there, and whose box that is. Frames are asked for
        in their order.
        """
        view = self._camera_1.view(k, int(self.seen.stamp_1[k]), depth_holes=bool(self._holes[k]))
        found = self.follower.look(
            view, float(self._times_1[k]), Pose(self._R_n_c1[k], self._t_n_c1[k])
        )
        return found, view.whose(found.box) if isinstance(found, Sighting) else NOBODY

    def receiver_view(self, k: int) -> HandoverView:
        return self._camera_2.view(
            k, int(self.seen.stamp_2[k]), marker_hidden=bool(self._hidden[k])
        )

    @property
    def events(self) -> tuple[Whole, Whole, Whole]:
        """Return the kinds of events, their frames, and their instants (ns), in the order of
        time.
        """
        sender, receiver = self.frames
        when = (sender.done_s, sender.heard_s, receiver.done_s, receiver.heard_s)
        kinds = (SENDER_FRAME, TARGET_HEARD, RECEIVER_FRAME, CANDIDATE_HEARD)
        times = np.concatenate(when)
        kind = np.concatenate([np.full(len(w), k) for w, k in zip(when, kinds, strict=True)])
        which = np.concatenate([np.arange(len(w)) for w in when])
        order = np.argsort(times, kind="stable")
        order = order[np.isfinite(times[order])]
        return kind[order].astype(np.int64), which[order].astype(np.int64), _ns(times[order])

    @property
    def circumstances(self) -> Circumstances:
        """The true circumstances at the beginning."""
        things = self.flown_1.things[0]
        middle = np.array([things[0, 0], things[0, 1], self._middle_m])
        own_1, own_2 = (self.drawn.errors.built.rig.role(role).mount for role in Role)
        T_w_c1 = Pose(self.flown_1.R[0], self.flown_1.t[0]) @ own_1.T_b_c
        T_w_c2 = Pose(self.flown_2.R[0], self.flown_2.t[0]) @ own_2.T_b_c
        marker = self.flown_2.other_R[0] @ own_1.T_b_v.t + self.flown_2.other_t[0]
        others = np.linalg.norm(things[1:, :2] - things[0, :2], axis=1)
        known = others[np.isfinite(others)]
        places = self.drawn.things.at(np.arange(0.0, self._limit_s, CLOSEST_STEP_S))[0]
        distances = np.linalg.norm(places[:, 1:] - places[:, :1], axis=2)
        return Circumstances(
            range_1_m=float(np.linalg.norm(middle - T_w_c1.t)),
            range_2_m=float(np.linalg.norm(middle - T_w_c2.t)),
            marker_m=float(np.linalg.norm(marker - T_w_c2.t)),
            look_alike_m=float(known.min()) if len(known) else math.inf,
            closest_m=float(np.min(distances, initial=math.inf, where=np.isfinite(distances))),
            relative_roll_deg=math.degrees(relative_roll(T_w_c1, T_w_c2)),
            target_mps=self.drawn.things.speed_mps,
        )


def mirrored(T_c_v: Pose, T_v_m: Pose) -> Array:
    """``R_c_v`` of a marker that faces the other way of the line of sight: about the second planar
    solution.

    The marker's centre stays where it is; its axes turn by pi about the line to it, and by pi about
    its own normal.
    """
    centre = T_c_v.apply(T_v_m.t)
    line = centre / np.linalg.norm(centre)
    flip = T_v_m.R @ np.diag([-1.0, -1.0, 1.0]) @ T_v_m.R.T
    return (2.0 * np.outer(line, line) - np.eye(3)) @ T_c_v.R @ flip


def relative_roll(T_w_c1: Pose, T_w_c2: Pose) -> float:
    """Angle in rad by which "up" differs between two images: between the image directions of D1's x
    axis in both.
    """
    across = (T_w_c2.R.T @ T_w_c1.R)[:, 0]
    return math.atan2(across[1], across[0])


def _ns(times_s: Array) -> Whole:
    return np.rint((times_s + EPOCH_S) * 1e9).astype(np.int64)


def _things(frames: Timed, drawn: Drawn, up_m: float) -> tuple[Array, Array]:
    """Everything so high in the world, ENU and yaw (n, m, 4), and the target's north and east, (n,
    2).
    """
    places, yaw = drawn.things.at(frames.taken_s)
    things = np.zeros((*yaw.shape, 4))
    things[..., 0], things[..., 1], things[..., 2], things[..., 3] = (
        places[..., 1],
        places[..., 0],
        up_m,
        0.5 * math.pi - yaw,
    )
    return things, places[:, 0]


def _flown(frames: Timed, poses: HandoverPoses, own: int, things: Array) -> CameraPath:
    """Return both bodies in the world, ENU."""
    R = [P_W_N @ each for each in poses.R_n_b]
    t = [each @ P_W_N.T for each in poses.t_n]
    return CameraPath(frames.number, R[own], t[own], R[1 - own], t[1 - own], things)
