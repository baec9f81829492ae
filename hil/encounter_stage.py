"""An encounter made ready: frames, poses, messages and their arrivals as arrays; what is seen is filled in block by
block, as far as it is played."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flight.encounter import Attempt, Circumstances
from hil.encounter_motion import P_W_N, Motion, Poses, exp_all, within
from hil.encounter_play import CANDIDATE_HEARD, RECEIVER_FRAME, SENDER_FRAME, TARGET_HEARD, Seen
from hil.encounter_pose import Print, mirrored
from hil.encounter_relative import Reports, reports
from hil.encounter_scene import TARGET_HEIGHT_M, Believed, Calibrated, Drawn, draw
from hil.encounter_sight import (
    FOLLOWER_SIZE,
    FOUND_COLUMNS,
    MARKER_COLUMNS,
    OWN_COLUMNS,
    POSITION,
    PP,
    VELOCITY,
    VV,
    Depths,
    Eyes,
    Flown,
    receiver_sees,
    sender_sees,
    with_lapses,
)
from hil.geometric_scene import car_parts, drone_parts, lens_row
from hil.geometric_sight import Sensor
from path.camera import CameraModel
from path.geometry import Pose

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

RATE_HZ = 50.0
STATUS_HZ = 10.0
SENDER_LATENCY_S, RECEIVER_LATENCY_S = (0.008, 0.020), (0.010, 0.030)  # from a frame to the end of its processing
LATENCY_JITTER_S = 0.002
FOLLOWER_SIGMA_M, FOLLOWER_SIGMA_MPS = 0.02, 0.05
STREAMS = 7
BLOCK_S = 1.0
EPOCH_S = 10.0  # of the clocks, when an attempt begins


@dataclass(frozen=True, slots=True)
class Timed:
    """Frames of one camera.

    Attributes:
        number: (n,) running number; frames that a frozen camera did not give are left out.
        taken_s, done_s, heard_s: (n,) when it was taken, when its processing ended, when the other drone heard of it;
            infinite for a message that was lost.
    """

    number: Whole
    taken_s: Array
    done_s: Array
    heard_s: Array


def printed_marker(believed: Believed) -> Print:
    marker = believed.rig.layout.markers[0]
    T = marker.T_v_m
    return Print(marker.corners_v, np.ascontiguousarray(T.R), T.t, marker.side_m, marker.side_sigma_m / marker.side_m)


class Stage:
    """One attempt before it is played. ``fill`` lets the cameras see."""

    def __init__(self, attempt: Attempt, believed: Believed, sensor: Sensor) -> None:
        seeds = np.random.SeedSequence([attempt.seed, attempt.index]).spawn(STREAMS)
        streams = [np.random.default_rng(seed) for seed in seeds]
        self.drawn: Drawn = draw(attempt, believed, streams[:4])
        self.believed = believed.calibrated(attempt.roll_deg)
        self._motion = Motion(self.drawn, streams[4])
        faults = self.drawn.faults
        self.clock_ns = round((self.drawn.errors.clock_s + faults.clock_s) * 1e9)
        self.frames = tuple(
            self._timed(attempt.limit_s, latency, frozen, streams[5])
            for latency, frozen in zip((SENDER_LATENCY_S, RECEIVER_LATENCY_S), faults.frozen, strict=True)
        )
        self._look_seeds = streams[6].integers(1 << 62, size=2).tolist()
        self._filled = [0, 0]
        self._prepare(believed, sensor)

    def _timed(self, limit_s: float, latency: tuple[float, float], frozen: Array, rng: np.random.Generator) -> Timed:
        faults, count = self.drawn.faults, math.ceil(limit_s * RATE_HZ)
        taken = rng.uniform(0.0, 1.0 / RATE_HZ) + np.arange(count) / RATE_HZ
        first = int(rng.integers(1, 60000))
        done = taken + rng.uniform(*latency) + rng.exponential(LATENCY_JITTER_S, count)
        done = np.maximum.accumulate(done)
        heard = done + faults.delay_s + rng.uniform(0.0, faults.jitter_s, count)
        heard[rng.random(count) < faults.loss] = math.inf
        there = ~within(taken, frozen)
        return Timed(first + np.flatnonzero(there), taken[there], done[there], heard[there])

    def _prepare(self, believed: Believed, sensor: Sensor) -> None:
        sender, receiver = self.frames
        drawn, motion, calibrated = self.drawn, self._motion, self.believed
        at_1, at_2 = motion.sender(sender.taken_s), motion.receiver(receiver.taken_s)
        self.at_1, self.at_2 = at_1, at_2
        self.flown_1 = _flown(sender, at_1, motion.receiver(sender.taken_s), drawn)
        self.flown_2 = _flown(receiver, at_2, motion.sender(receiver.taken_s), drawn)
        true, layout = drawn.errors.true, believed.rig.layout
        car = car_parts()
        plain, marked = (drone_parts(true.T_b_v, layout, marked=on) for on in (False, True))
        self._eyes_1 = _eyes(true.camera_1, true.T_b_c1, car, plain, drawn.errors.boxes[0], self._look_seeds[0])
        self._eyes_2 = _eyes(true.camera_2, true.T_b_c2, car, marked, drawn.errors.boxes[1], self._look_seeds[1])
        self._depths = Depths(sensor.depth, *sensor.depth_noise, drawn.errors.depth_scale)
        self._corners_b = true.T_b_v.apply(true.corners_v)
        self._print = with_lapses(believed.noise.marker, drawn.faults.lapse_rate)
        self._holes = within(sender.taken_s, drawn.faults.holes)
        self._hidden = within(receiver.taken_s, drawn.faults.hidden)
        self._swapped = within(receiver.taken_s, drawn.faults.swapped)
        self.R_n_c1 = at_1.R_estimated @ calibrated.T_b_c1.R
        self.t_n_c1 = at_1.t_n + motion.drift(sender.taken_s) + at_1.R_estimated @ calibrated.T_b_c1.t
        self.lens_1 = lens_row(calibrated.camera_1)
        self.follower = self._follower(sender.taken_s)
        n, m, most = len(sender.number), len(receiver.number), self.flown_2.things.shape[1]
        R_n_c2 = at_2.R_estimated @ calibrated.T_b_c2.R
        self.seen = Seen(
            sender.number, _ns(sender.taken_s), np.zeros((n, OWN_COLUMNS)),
            np.ascontiguousarray((at_1.R_estimated @ calibrated.T_b_v.R)[:, 2]), receiver.number,
            _ns(receiver.taken_s) + self.clock_ns, np.zeros((m, MARKER_COLUMNS)), np.zeros((m, most, FOUND_COLUMNS)),
            np.zeros(m, np.int64), self._gravity_c(R_n_c2, believed), R_n_c2,
            drawn.shift_c, exp_all(drawn.turn_c[None])[0], *self._reports(),
        )  # fmt: skip

    def _reports(self) -> tuple[Reports, Reports, Array, Whole]:
        """What both vehicles say of their motion, D1's yaw in it, and how much of it D2 has by each of its frames."""
        receiver, faults, motion = self.frames[1], self.drawn.faults, self._motion
        own = reports(_ns(receiver.taken_s) + self.clock_ns, motion.speeds(receiver.taken_s, 1))
        said_s = np.arange(-2.0, receiver.taken_s[-1] * STATUS_HZ) / STATUS_HZ
        peer = reports(_ns(said_s), motion.speeds(said_s, 0))
        R = motion.sender(said_s).R_estimated
        heard = np.searchsorted(said_s + faults.delay_s + faults.jitter_s, receiver.done_s)
        return own, peer, np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.maximum(heard, 1)

    def _gravity_c(self, R_n_c2: Array, believed: Believed) -> Array:
        """Gravity in D2's camera as D2 believes; while flipped, what makes the other planar solution the likely one."""
        gravity_c = np.ascontiguousarray(R_n_c2[:, 2])
        printed, true = printed_marker(believed), self.drawn.errors.true
        for k in np.flatnonzero(within(self.frames[1].taken_s, self.drawn.faults.flipped)).tolist():
            flown = self.flown_2
            T_c_w = (Pose(flown.R[k], flown.t[k]) @ true.T_b_c2).inverse()
            T_w_v = Pose(flown.other_R[k], flown.other_t[k]) @ true.T_b_v
            T_c_v, R, t = T_c_w @ T_w_v, np.empty((3, 3)), np.empty(3)
            mirrored(np.ascontiguousarray(T_c_v.R), T_c_v.t, printed, R, t)
            gravity_c[k] = R @ -T_w_v.R[2]
        return gravity_c

    def _follower(self, times_s: Array) -> Array:
        """D1 has followed the target for a while: where it is, and how it moves."""
        around, _ = self.drawn.things.at(times_s[0] + np.array([0.0, 0.1]))
        row = np.zeros(FOLLOWER_SIZE)
        row[POSITION : POSITION + 2] = around[0, 0] + self._motion.drift(times_s[:1])[0, :2]
        row[POSITION + 2] = -TARGET_HEIGHT_M
        row[VELOCITY : VELOCITY + 2] = (around[1, 0] - around[0, 0]) / 0.1
        row[PP], row[VV] = FOLLOWER_SIGMA_M**2, FOLLOWER_SIGMA_MPS**2
        row[-1] = times_s[0]
        return row

    @property
    def events(self) -> tuple[Whole, Whole, Whole]:
        """What happens, to which frame, and when (ns), in the order of time: see ``hil.encounter_play``."""
        sender, receiver = self.frames
        when = (sender.done_s, sender.heard_s, receiver.done_s, receiver.heard_s)
        kinds = (SENDER_FRAME, TARGET_HEARD, RECEIVER_FRAME, CANDIDATE_HEARD)
        times = np.concatenate(when)
        kind = np.concatenate([np.full(len(w), k) for w, k in zip(when, kinds, strict=True)])
        which = np.concatenate([np.arange(len(w)) for w in when])
        order = np.argsort(times, kind="stable")
        order = order[np.isfinite(times[order])]
        return kind[order].astype(np.int64), which[order].astype(np.int64), _ns(times[order])

    def fill(self, until_s: float) -> None:
        """What the cameras see of frames taken before ``until_s``."""
        sender, receiver = self.frames
        first, last = self._filled[0], int(np.searchsorted(sender.taken_s, until_s))
        sender_sees(
            first, last, self._eyes_1, self.flown_1, self._depths, self._holes, sender.taken_s, self.R_n_c1,
            self.t_n_c1, self.lens_1, self.follower, self.seen.own,
        )  # fmt: skip
        self._filled[0] = max(first, last)
        first, last = self._filled[1], int(np.searchsorted(receiver.taken_s, until_s))
        receiver_sees(
            first, last, self._eyes_2, self.flown_2, self._corners_b, self._print, self._hidden, self._swapped,
            self.seen.markers, self.seen.found, self.seen.many,
        )  # fmt: skip
        self._filled[1] = max(first, last)

    @property
    def circumstances(self) -> Circumstances:
        """In truth, at the beginning."""
        things = self.flown_2.things[0]
        middle = np.array([things[0, 0], things[0, 1], TARGET_HEIGHT_M])
        true = self.drawn.errors.true
        T_w_c1 = Pose(self.flown_1.R[0], self.flown_1.t[0]) @ true.T_b_c1
        T_w_c2 = Pose(self.flown_2.R[0], self.flown_2.t[0]) @ true.T_b_c2
        marker = self.flown_2.other_R[0] @ true.T_b_v.t + self.flown_2.other_t[0]
        others = np.linalg.norm(things[1:, :2] - things[0, :2], axis=1)
        known = others[np.isfinite(others)]
        return Circumstances(
            range_1_m=float(np.linalg.norm(middle - T_w_c1.t)),
            range_2_m=float(np.linalg.norm(middle - T_w_c2.t)),
            marker_m=float(np.linalg.norm(marker - T_w_c2.t)),
            look_alike_m=float(known.min()) if len(known) else math.inf,
            relative_roll_deg=math.degrees(relative_roll(T_w_c1, T_w_c2)),
            target_mps=self.drawn.things.speed_mps,
        )


def relative_roll(T_w_c1: Pose, T_w_c2: Pose) -> float:
    """Angle in rad by which "up" differs between two images: between the image directions of D1's x axis in both."""
    across = (T_w_c2.R.T @ T_w_c1.R)[:, 0]
    return math.atan2(across[1], across[0])


def _ns(times_s: Array) -> Whole:
    return np.rint((times_s + EPOCH_S) * 1e9).astype(np.int64)


def _eyes(camera: CameraModel, T_b_c: Pose, car: Array, drone: Array, boxes: object, seed: int) -> Eyes:
    return Eyes(np.ascontiguousarray(T_b_c.R), T_b_c.t, lens_row(camera), car, drone, boxes, seed)  # type: ignore[arg-type]


def _flown(frames: Timed, own: Poses, other: Poses, drawn: Drawn) -> Flown:
    """Both bodies and everything on the ground in the world, ENU."""
    places, yaw = drawn.things.at(frames.taken_s)
    things = np.zeros((*yaw.shape, 4))
    things[..., 0], things[..., 1], things[..., 3] = places[..., 1], places[..., 0], 0.5 * math.pi - yaw
    return Flown(frames.number, P_W_N @ own.R_n_b, own.t_n @ P_W_N.T, P_W_N @ other.R_n_b, other.t_n @ P_W_N.T, things)


def mounting(calibrated: Calibrated) -> Array:
    """``T_v_c1`` as both believe it, (3, 4)."""
    T_v_c = calibrated.T_b_v.inverse() @ calibrated.T_b_c1
    return np.concatenate((T_v_c.R, T_v_c.t[:, None]), axis=1)


def lever(T_b_x: Pose) -> Array:
    """Of a part from its drone's centre, in its own axes."""
    return T_b_x.R.T @ T_b_x.t
