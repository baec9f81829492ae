"""The relative-pose filter on a marker that it does not see: a recorded flight replayed with gaps
in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from drivers.rig.parts import Rig
from missions.look.report.records import RunRecords
from missions.look.report.truth import Truth
from path.arrays import Array, Whole
from path.geometry.rotation import R_from_quat, log
from path.geometry.transforms import Matrix, Pose
from path.messages import Vec3
from path.relative_pose.filter import Relative, RelativeFilter, RelativeSettings
from path.values import frozen

SEEN_S = 0.8
HIDDEN_S = 1.05
STEP_S = 0.1
SLACK_S = 0.009
STARTS = 6  # of the rows of gaps, in one replay each
# of the true pose, m and rad: it is logged at 25 Hz only
TRUTH_SIGMAS = np.array([3e-4] * 3 + [5e-4] * 3)


@frozen
class FilterInput:
    """The filter's input of one frame; ``T_c_v`` and ``covariance`` are None when no marker was
    seen.
    """

    stamp_ns: int
    own: tuple[int, Vec3]
    peer: tuple[int, Vec3]
    R_n_c: Matrix
    R_n_v: Matrix | None
    T_c_v: Pose | None
    covariance: Matrix | None


@frozen
class Coasts:
    """Predictions without a marker, n of them.

    Attributes:
        unseen_s: (n,) since the newest measurement.
        error: (n, 6), true minus predicted (dt, dw), m and rad.
        sigma_m, sigma_rad: (n,) claimed, root of the sum over the axes.
        nees: (n,) normalised error squared, per degree of freedom.
        block: (n,) which gap of the flight it belongs to, by time.
    """

    unseen_s: Array
    error: Array
    sigma_m: Array
    sigma_rad: Array
    nees: Array
    block: Whole


def frames_of(run: RunRecords) -> list[FilterInput]:
    """All frames in which the marker was looked for."""
    given = {r.stamp_ns: r.record for r in run.receiver.get("/motion", ())}
    frames: list[FilterInput] = []
    for r in run.receiver.get("/marker", ()):
        motion = given[r.stamp_ns]
        T_c_v = covariance = None
        if r.record["position_v_m"] is not None and motion["covariance"] is not None:
            T_c_v = Pose(
                R_from_quat(r.record["rotation_v_c2"]), np.array(r.record["position_v_m"], float)
            ).inverse()
            covariance = np.reshape(np.array(motion["covariance"], float), (6, 6))
        frames.append(
            FilterInput(
                r.stamp_ns,
                (motion["own_stamp_ns"], _vec3(motion["own_n_mps"])),
                (motion["peer_stamp_ns"], _vec3(motion["peer_n_mps"])),
                R_from_quat(motion["q_n_c"]),
                None if motion["q_n_v"] is None else R_from_quat(motion["q_n_v"]),
                T_c_v,
                covariance,
            )
        )
    return frames


def _vec3(values: list[float]) -> Vec3:
    x, y, z = values
    return x, y, z


def coasts(
    run: RunRecords,
    rig: Rig,
    truth: Truth,
) -> Coasts:
    """Replay a flight with gaps of ``HIDDEN_S`` after ``SEEN_S`` of marker each, begun at several
    instants.

    Predictions are judged every ``STEP_S`` of a gap.
    """
    frames = frames_of(run)

    @cache
    def true_at(stamp_ns: int) -> Pose:
        return truth.T_v_c2(stamp_ns).inverse()

    rows = [row for start in range(STARTS) for row in _replayed(frames, rig, true_at, start)]
    unseen, errors, sigmas_m, sigmas_rad, nees, blocks = (
        np.array([row[k] for row in rows]) if rows else np.zeros((0, 6)[: 2 if k == 1 else 1])
        for k in range(6)
    )
    return Coasts(unseen, errors, sigmas_m, sigmas_rad, nees, blocks.astype(np.int64))


def _replayed(
    frames: list[FilterInput],
    rig: Rig,
    true_at: Callable[[int], Pose],
    start: int,
) -> Iterator[tuple[float, Array, float, float, float, int]]:
    sender = rig.sender.mount
    receiver = rig.receiver.mount
    filtered = RelativeFilter(
        RelativeSettings(coast_s=1.1),  # the last frame of a second shall not depend on rounding
        lever_c_m=receiver.T_b_c.R.T @ receiver.T_b_c.t,
        lever_v_m=sender.T_b_v.R.T @ sender.T_b_v.t,
    )
    period_ns = round((SEEN_S + HIDDEN_S) * 1e9)
    begin_ns = frames[0].stamp_ns + start * period_ns // STARTS
    for frame in frames:
        filtered.set_own_velocity(*frame.own)
        filtered.set_peer_velocity(*frame.peer)
        since_ns = frame.stamp_ns - begin_ns
        hidden = since_ns > 0 and since_ns % period_ns > SEEN_S * 1e9
        if not hidden and frame.T_c_v is not None and frame.covariance is not None:
            filtered.update(frame.stamp_ns, frame.T_c_v, frame.covariance, frame.R_n_c, frame.R_n_v)
        unseen_s = filtered.unseen_s(frame.stamp_ns)
        if (
            since_ns <= 0
            or not unseen_s <= HIDDEN_S
            or abs(math.remainder(unseen_s, STEP_S)) > SLACK_S
        ):
            continue
        relative = filtered.predict(frame.stamp_ns, frame.R_n_c, frame.R_n_v)
        if relative is not None:
            error, nees = judged(relative, true_at(frame.stamp_ns))
            position = np.trace(relative.covariance[:3, :3])
            rotation = np.trace(relative.covariance[3:, 3:])
            yield unseen_s, error, position**0.5, rotation**0.5, nees, since_ns // period_ns


def judged(relative: Relative, true: Pose) -> tuple[Array, float]:
    """Error (6,) of a predicted ``T_c_v``, and its square normalised, per degree of freedom."""
    error = np.concatenate([true.t - relative.T_c_v.t, log(true.R @ relative.T_c_v.R.T)])
    covariance = relative.covariance + np.diag(TRUTH_SIGMAS**2)
    return error, float(error @ np.linalg.solve(covariance, error)) / 6.0
