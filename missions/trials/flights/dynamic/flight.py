"""The motion of a mission flown for the trial, and what its logs say: PATH's trajectories and the beacons'.

Frame ``u`` is north, west, up by a drone's own estimate: as the beacons' frame it is level, so that
only a turn about the vertical lies between the two.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drivers.beacons.log import Mounted
from drivers.interfaces import BeaconFix, PartError
from drivers.log.mcap_log import LogRecord
from drivers.rig.parts import Reference, Rig
from missions.look.report.records import RunRecords
from missions.trials.shared.trajectory import Trajectory
from path.arrays import Array
from path.geometry.rotation import R_from_quat, normalized
from path.geometry.transforms import Pose
from path.values import frozen

BEACON_RECORD = "beacons.mcap"
BEACON_LIST = "beacons.csv"
TARGET_MPS = 0.45
VERIFY_S = 20.0  # of agreement before the hand-over, so that there is something to compare
FOLLOW_S = 1.0
STEADY_S = 1.0
R_U_N = np.diag([1.0, -1.0, -1.0])

MIN_QUALITY = 75.0
MEDIAN_OVER = 5  # positions
JUMP_M = 0.25  # from the median of its neighbours: no drone moves so between two positions


def moving(rig: Rig, verify_s: float = VERIFY_S) -> Rig:
    """The rig with a faster target and a longer hand-over."""
    frames = round(verify_s * rig.method.hold_frames / rig.method.hold_s)
    target = {**rig.world["target"], "speed_mps": TARGET_MPS}
    return replace(
        rig,
        method=replace(rig.method, gate="count", hold_frames=frames, hold_s=verify_s),
        mission={**rig.mission, "follow_after_s": FOLLOW_S},
        world={**rig.world, "target": target},
    )


def reference_of(rig: Rig) -> Reference:
    """Raise PartError for a rig without beacons."""
    if rig.reference is None:
        raise PartError(
            f"{rig.where('[reference]')}: missing table",
            "say which beacon is on which body: [reference.sender], [reference.receiver] and [reference.target], each "
            "with address and lever_m (docs/beacons.md)",
        )
    return rig.reference


@frozen
class Motions:
    """The motions that PATH and the vehicles tell, by the receiver's clock, s, in ``u``.

    Attributes:
        own, own_1: D2's and D1's beacon by their own estimates; ``still_until_s`` is when D2 was
            armed.
        d2, target: from D1's beacon to D2's, and to the point on the target, as PATH has them. D1's
            attitude turns them from ``v`` to ``u``.
        speed_mps: rms of D1 and of D2 while flown by the scripts.
    """

    own: Trajectory
    own_1: Trajectory
    still_until_s: float
    d2: Trajectory
    target: Trajectory
    speed_mps: tuple[float, float]


def load_motions(run: RunRecords, rig: Rig) -> Motions:
    """Read from the logs of the roles alone."""
    levers = {
        name: np.array(mounted.lever_m) for name, mounted in reference_of(rig).mounted.items()
    }
    states = run.receiver["/state"]
    # D1's clock minus D2's, by their pings
    offsets = [r.record["clock_offset_ns"] for r in run.receiver["/link"]]
    offset_ns = int(np.median([offset for offset in offsets if offset is not None]))
    armed = next((r.stamp_ns for r in states if r.record["armed"]), states[-1].stamp_ns)
    T_v_b = rig.sender.mount.T_b_v.inverse()
    T_c_b = rig.receiver.mount.T_b_c.inverse()
    beacon_1_v = T_v_b.apply(levers["sender"])
    beacon_2_c = T_c_b.apply(levers["receiver"])
    R_n_v = {
        r.stamp_ns: _R(r.record["q_n_v"])
        for r in run.receiver["/motion"]
        if r.record["q_n_v"] is not None
    }
    d2: list[tuple[int, Array]] = []
    for r in run.receiver["/marker"]:
        if r.record["position_v_m"] is not None and r.stamp_ns in R_n_v:
            T_v_c = Pose(_R(r.record["rotation_v_c2"]), np.array(r.record["position_v_m"], float))
            d2.append((r.stamp_ns, R_n_v[r.stamp_ns] @ (T_v_c.apply(beacon_2_c) - beacon_1_v)))
    target = [
        (r.stamp_ns, R_n_v[r.stamp_ns] @ (np.array(r.record["point_v_m"]) - beacon_1_v))
        for r in _stamped_by_capture(run.receiver.get("/candidate", ()))
        if r.record["point_v_m"] is not None and r.stamp_ns in R_n_v
    ]
    late_ns = round(reference_of(rig).telemetry_late_s * 1e9)
    return Motions(
        own=_by_own_estimate(states, levers["receiver"], late_ns),
        own_1=_by_own_estimate(run.sender["/state"], levers["sender"], offset_ns + late_ns),
        still_until_s=armed * 1e-9,
        d2=_trajectory(d2),
        target=_trajectory(target),
        speed_mps=(_rms_speed(run.sender), _rms_speed(run.receiver)),
    )


def _by_own_estimate(
    states: Sequence[LogRecord],
    lever_b: Array,
    offset_ns: int,
) -> Trajectory:
    """``offset_ns``: of the log's stamps from the receiver's clock."""
    t = np.array([r.stamp_ns - offset_ns for r in states]) * 1e-9
    p, v = (
        np.array([r.record[name] for r in states]) for name in ("position_n_m", "velocity_n_mps")
    )
    levers = np.array([_R(r.record["q_n_b"]) @ lever_b for r in states])
    return Trajectory(t, (steadied(t, p, v) + levers) @ R_U_N.T)


def steadied(
    t: Array,
    p: Array,
    v: Array,
    over_s: float = STEADY_S,
) -> Array:
    """Positions (n, 3) whose quick changes are those of the velocities (n, 3), and whose slow ones
    are their own.

    Positions of a navigation filter jitter and jump within a second, its velocities do not. What
    the positions have beyond the integrated velocities is taken as a line within ``over_s`` of each
    instant, to both sides alike: nothing is delayed.
    """
    driven = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t)[:, None], axis=0)]
    )
    weights = np.exp(-np.abs(t[:, None] - t) / over_s)
    weights /= weights.sum(axis=1, keepdims=True)
    middle = weights @ t
    leaning = weights * (t - middle[:, None])
    spread = np.sum(leaning * t, axis=1)[:, None]
    beyond = p - driven
    slope = leaning @ beyond / np.maximum(spread, 1e-9)
    return driven + weights @ beyond + slope * (t - middle)[:, None]


def _stamped_by_capture(records: Sequence[LogRecord]) -> list[LogRecord]:
    return [LogRecord(r.topic, r.record["capture_ns"], r.record) for r in records]


def _R(q: Sequence[float]) -> Array:
    w, x, y, z = q
    return R_from_quat(normalized((w, x, y, z)))


def _trajectory(samples: Sequence[tuple[int, Array]]) -> Trajectory:
    if not samples:
        return Trajectory(np.zeros(0), np.zeros((0, 3)))
    t = np.array([stamp for stamp, _ in samples]) * 1e-9
    p = np.array([place for _, place in samples])
    newer = np.concatenate([[True], np.diff(t) > 0.0])
    return Trajectory(t[newer], p[newer] @ R_U_N.T)


def _rms_speed(records: Mapping[str, Sequence[LogRecord]]) -> float:
    """Reported velocity while the script flew the drone."""
    flown = [
        r.record["velocity_n_mps"] for r in records["/state"] if r.record["mode"] == "offboard"
    ]
    return math.sqrt(float(np.mean(np.sum(np.square(flown), axis=1)))) if flown else 0.0


@frozen
class BeaconTrace:
    """The beacons' log by body, without what is plainly wrong.

    Instants are by the clock of who listened (the beacons' own in a log without it), s; places in
    their frame.
    """

    paths: Mapping[str, Trajectory]
    fixes: int
    refused: int


def heard_of(fixes: Sequence[BeaconFix], mounted: Mapping[str, Mounted]) -> BeaconTrace:
    """Poorly rated positions and jumps are left out, and counted."""
    paths = {
        name: _clean([fix for fix in fixes if fix.address == own.address])
        for name, own in mounted.items()
    }
    return BeaconTrace(paths, len(fixes), len(fixes) - sum(len(path.t) for path in paths.values()))


def _clean(fixes: Sequence[BeaconFix]) -> Trajectory:
    rated = sorted((fix for fix in fixes if not fix.quality < MIN_QUALITY), key=_instant_ns)
    if len(rated) < MEDIAN_OVER:
        return Trajectory(np.zeros(0), np.zeros((0, 3)))
    t = np.array([_instant_ns(fix) for fix in rated]) * 1e-9
    p = np.array([fix.position_m for fix in rated])
    half = MEDIAN_OVER // 2
    padded = np.pad(p, ((half, half), (0, 0)), mode="edge")
    median = np.median(
        np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_OVER, axis=0), axis=2
    )
    fine = np.linalg.norm(p - median, axis=1) < JUMP_M
    fine[1:] &= np.diff(t) > 0.0
    return Trajectory(t[fine], p[fine])


def _instant_ns(fix: BeaconFix) -> int:
    return fix.stamp_ns if fix.host_ns is None else fix.host_ns


def between(of: Trajectory, base: Trajectory) -> tuple[Trajectory, Array]:
    """Return the way from one beacon to another at the other's instants, and its noise.

    The noise is in variances of one position, (n,).
    """
    at_base = base.at(of.t, 0.4)
    known = np.isfinite(at_base[:, 0])
    after = np.clip(np.searchsorted(base.t, of.t[known]), 1, len(base.t) - 1)
    share = (of.t[known] - base.t[after - 1]) / (base.t[after] - base.t[after - 1])
    return Trajectory(of.t[known], (of.p - at_base)[known]), 1.0 + share**2 + (1.0 - share) ** 2
