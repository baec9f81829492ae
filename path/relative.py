"""The marker's pose relative to D2's camera, between and beyond marker measurements.

A Kalman filter of the pose and of the error of the velocity that both vehicles report. The position is kept in NED, by
D2's own attitude, and the marker's attitude beside it; they move with both reported velocities and turn with both
attitudes (what an attitude has as a constant error is in the measured pose already, only its wander counts). Marker
measurements come with their full covariance. Their errors have two parts: noise, and what persists from frame to frame
(printed size, focal length, biases of the attitudes that the pose rests on). The persistent part never averages out: it
is kept out of the filter and added to what the filter says.

Perturbations of a pose are ``t + dt``, ``R <- exp(dw) R``; covariances are (6, 6) in the order (dt, dw), as in
``path.marker.pose``.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from path.geometry import Matrix, Pose, Vector
from path.messages import Vec3
from path.observations import Missed, MissReason
from path.relative_kernels import carried, fuse, known_by, placed

FREE_SPEED_MPS, FREE_WALK_MPS = 0.7, 1.0  # of an unreported velocity: its deviation, and its change in a second
FREE_TURN_RAD = math.radians(5.0)  # of an unreported attitude, in ``wander_s``
FLIPPED_RAD = math.radians(8.0)  # a refused attitude that is off by more has turned over
STILL: Vec3 = (0.0, 0.0, 0.0)
ORIGIN: Vector = np.zeros(3)
UPRIGHT: Matrix = np.eye(3)


@dataclass(frozen=True, slots=True)
class RelativeSettings:
    """What is known of the errors, as standard deviations per axis.

    Attributes:
        velocity_sigma_mps: error of the relative velocity that the two vehicles report.
        velocity_walk_mps: how much that error changes in a second.
        tilt_wander_rad, yaw_wander_rad: what either vehicle's attitude errs more at one time than at another.
        wander_s: how long it takes for that.
        persistent: share of a measurement's variance that the next frames share, and ``persistent_s`` for how long.
        gate: squared Mahalanobis distance (six degrees of freedom) a measurement may have; normal errors exceed 45
            once in 2e7 frames, real ones have longer tails.
        settle: this many refused measurements in a row that agree with each other replace the state.
        coast_s: without a measurement for longer, there is no prediction.
    """

    velocity_sigma_mps: float = 0.12
    velocity_walk_mps: float = 0.06
    tilt_wander_rad: float = math.radians(0.25)
    yaw_wander_rad: float = math.radians(0.4)
    wander_s: float = 0.5
    persistent: float = 0.5
    persistent_s: float = 10.0
    gate: float = 45.0
    settle: int = 15
    coast_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Relative:
    """The marker at an instant.

    Attributes:
        marker_n_m: from D2's camera to the marker, in ``n``; ``velocity_n_mps`` is how the two drones move apart.
        sigma_m: standard deviation of the position, mean over the axes.
        T_c_v: its pose in the camera, for the attitudes asked for; ``covariance`` is (6, 6), see the module.
    """

    marker_n_m: Vec3
    velocity_n_mps: Vec3
    sigma_m: float
    T_c_v: Pose
    covariance: Matrix


class Travel:
    """Reported velocities of one vehicle, and how far they have carried it."""

    _KEPT = 128

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._velocities: list[Vec3] = []
        self._travelled: list[Vec3] = []

    @property
    def known(self) -> bool:
        return bool(self._stamps)

    def add(self, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        """One report; one that is not newer than the newest is ignored."""
        if self._stamps:
            if stamp_ns <= self._stamps[-1]:
                return
            half = 0.5e-9 * (stamp_ns - self._stamps[-1])
            (x, y, z), (a, b, c), (u, v, w) = self._travelled[-1], self._velocities[-1], velocity_n_mps
            self._travelled.append((x + half * (a + u), y + half * (b + v), z + half * (c + w)))
        else:
            self._travelled.append(STILL)
        self._stamps.append(stamp_ns)
        self._velocities.append(velocity_n_mps)
        if len(self._stamps) > 2 * self._KEPT:
            for values in (self._stamps, self._velocities, self._travelled):
                del values[: self._KEPT]

    def at(self, stamp_ns: int) -> tuple[Vec3, Vec3]:
        """Way since the first report, and velocity, at an instant: linear between reports, steady outside of them."""
        after = bisect_right(self._stamps, stamp_ns)
        before = max(0, after - 1)
        dt = (stamp_ns - self._stamps[before]) * 1e-9
        (x, y, z), (a, b, c) = self._travelled[before], self._velocities[before]
        if 0 < after < len(self._stamps):
            share = dt / ((self._stamps[after] - self._stamps[before]) * 1e-9)
            u, v, w = self._velocities[after]
            u, v, w = a + share * (u - a), b + share * (v - b), c + share * (w - c)
        else:
            u, v, w = a, b, c
        half = 0.5 * dt
        return (x + half * (a + u), y + half * (b + v), z + half * (c + w)), (u, v, w)


@dataclass(frozen=True, slots=True)
class _State:
    """The filter at the instant of a measurement. ``P`` (9, 9) as in ``path.relative_kernels``, without ``persistent``.

    Attributes:
        p, R, e: (3,) position, (3, 3) ``R_n_v``, (3,) error of the velocity.
        persistent: (6, 6) in ``n``, of the newest measurement.
        R_n_c, R_n_v: the attitudes as reported then; the marker's None when it was not.
    """

    stamp_ns: int
    p: Vector
    R: Matrix
    e: Vector
    P: Matrix
    persistent: Matrix
    R_n_c: Matrix
    R_n_v: Matrix | None


class RelativeFilter:
    """The marker's pose relative to the camera. All stamps are of one clock.

    Args:
        lever_c_m: of the camera from its own drone's centre, in the camera's axes.
        lever_v_m: of the marker from its drone's centre, in the axes of ``v``.
    """

    def __init__(
        self, settings: RelativeSettings | None = None, lever_c_m: Vector = ORIGIN, lever_v_m: Vector = ORIGIN
    ) -> None:
        self._settings = settings or RelativeSettings()
        self._lever_c, self._lever_v = np.ascontiguousarray(lever_c_m), np.ascontiguousarray(lever_v_m)
        self._own, self._peer = Travel(), Travel()
        self._state: _State | None = None
        self._refused: _State | None = None
        self._refusals = 0

    def set_own_velocity(self, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        self._report(self._own, self._peer, stamp_ns, velocity_n_mps, -1.0)

    def set_peer_velocity(self, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        """Of the marker's drone."""
        self._report(self._peer, self._own, stamp_ns, velocity_n_mps, 1.0)

    def unseen_s(self, stamp_ns: int) -> float:
        """Time since the newest accepted measurement; infinite before the first."""
        return math.inf if self._state is None else (stamp_ns - self._state.stamp_ns) * 1e-9

    def predict(self, stamp_ns: int, R_n_c: Matrix | None = None, R_n_v: Matrix | None = None) -> Relative | None:
        """The marker at an instant; None before the first measurement and after too long a coast.

        Args:
            R_n_c, R_n_v: attitudes of the camera and of the marker as reported for that instant; those of the newest
                measurement when they are not given.
        """
        state = self._state
        if state is None or stamp_ns - state.stamp_ns > self._settings.coast_s * 1e9:
            return None
        p, R, P = self._carried(state, stamp_ns, R_n_c, R_n_v)
        R_c_n = np.ascontiguousarray((state.R_n_c if R_n_c is None else R_n_c).T)
        t_c, R_c_v, covariance = placed(R_c_n, p, R, P[:6, :6] + state.persistent)
        north, east, down = p.tolist()
        vx, vy, vz = self._velocity(max(stamp_ns, state.stamp_ns))
        ex, ey, ez = state.e.tolist()
        xx, yy, zz, *_ = covariance.diagonal().tolist()
        return Relative(
            (north, east, down),
            (vx + ex, vy + ey, vz + ez),
            math.sqrt((xx + yy + zz) / 3.0),
            Pose(R_c_v, t_c),
            covariance,
        )

    def update(
        self, stamp_ns: int, T_c_v: Pose, covariance: Matrix, R_n_c: Matrix, R_n_v: Matrix | None = None
    ) -> Missed | None:
        """Fuse a measured pose; None when it was.

        Args:
            covariance: (6, 6) of ``T_c_v`` in the camera.
            R_n_c, R_n_v: attitudes of camera and marker as the two vehicles report them for that instant.

        Returns:
            Missed MARKER_FLIPPED or POSE_UNCERTAIN when attitude or position lie outside the gate, STALE when it is no
            newer than the newest one. It is not used then.
        """
        contiguous = None if R_n_v is None else np.ascontiguousarray(R_n_v)
        seen = self._seen(stamp_ns, T_c_v, covariance, np.ascontiguousarray(R_n_c), contiguous)
        state = self._state
        if state is None or stamp_ns - state.stamp_ns > self._settings.coast_s * 1e9:
            self._state, self._refused, self._refusals = seen, None, 0
            return None
        if stamp_ns <= state.stamp_ns:
            return Missed(MissReason.STALE, ignored=True)
        fused, angle = self._fused(state, seen)
        if fused is not None:
            self._state, self._refused, self._refusals = fused, None, 0
            return None
        again = None if self._refused is None else self._fused(self._refused, seen)[0]
        self._refusals = 1 if again is None else self._refusals + 1
        self._refused = seen if again is None else again
        if self._refusals >= self._settings.settle:
            self._state, self._refused, self._refusals = self._refused, None, 0
            return None
        return Missed(MissReason.MARKER_FLIPPED if angle > FLIPPED_RAD else MissReason.POSE_UNCERTAIN)

    def _report(self, own: Travel, other: Travel, stamp_ns: int, velocity: Vec3, sign: float) -> None:
        first = not own.known
        own.add(stamp_ns, velocity)
        if first and other.known and self._state is not None:
            # what was taken for the whole velocity is its error from now on
            reported = np.array(self._velocity(self._state.stamp_ns))
            for state in (self._state, self._refused):
                if state is not None:
                    state.e[:] -= reported

    def _velocity(self, stamp_ns: int) -> Vec3:
        """Reported, of the marker's drone minus the own; zero while one of them reports none."""
        if not (self._own.known and self._peer.known):
            return STILL
        (a, b, c), (u, v, w) = self._own.at(stamp_ns)[1], self._peer.at(stamp_ns)[1]
        return u - a, v - b, w - c

    def _way(self, from_ns: int, to_ns: int) -> Vec3:
        """What the reports say the marker's drone moved, minus the own, m."""
        if to_ns <= from_ns or not (self._own.known and self._peer.known):
            return STILL
        (a, b, c), (d, e, f) = self._own.at(from_ns)[0], self._own.at(to_ns)[0]
        (u, v, w), (x, y, z) = self._peer.at(from_ns)[0], self._peer.at(to_ns)[0]
        return x - u - d + a, y - v - e + b, z - w - f + c

    def _carried(
        self, state: _State, stamp_ns: int, R_n_c: Matrix | None, R_n_v: Matrix | None
    ) -> tuple[Vector, Matrix, Matrix]:
        """``p``, ``R`` and ``P`` of a state at a later instant; attitudes that are not given stay as they were."""
        settings = self._settings
        dt = max(0.0, (stamp_ns - state.stamp_ns) * 1e-9)
        known = self._own.known and self._peer.known
        walk = settings.velocity_walk_mps if known else FREE_WALK_MPS
        # of a wander, between two instants
        spread = 2.0 * (1.0 - math.exp(-dt / settings.wander_s))
        tilt, yaw = spread * settings.tilt_wander_rad**2, spread * settings.yaw_wander_rad**2
        own = peer = (tilt, tilt, yaw)
        before, after = state.R_n_v, R_n_v
        if before is None or after is None:
            before = after = UPRIGHT
            peer = (free := spread * FREE_TURN_RAD**2, free, free)
        return carried(
            state.p, state.R, state.e, state.P, state.R_n_c, before,
            state.R_n_c if R_n_c is None else np.ascontiguousarray(R_n_c), after,
            self._way(state.stamp_ns, stamp_ns), dt, walk * walk, own, peer, self._lever_c, self._lever_v,
        )  # fmt: skip

    def _seen(self, stamp_ns: int, T_c_v: Pose, covariance: Matrix, R_n_c: Matrix, R_n_v: Matrix | None) -> _State:
        """A state that knows nothing but one measurement."""
        settings = self._settings
        sigma_mps = settings.velocity_sigma_mps if self._own.known and self._peer.known else FREE_SPEED_MPS
        p, R, P, persistent = known_by(
            R_n_c, T_c_v.t, np.ascontiguousarray(T_c_v.R), covariance, settings.persistent, sigma_mps * sigma_mps
        )
        return _State(stamp_ns, p, R, np.zeros(3), P, persistent, R_n_c, R_n_v)

    def _fused(self, before: _State, seen: _State) -> tuple[_State | None, float]:
        """A state with a later measurement in it, None outside the gate; and by what angle they differ."""
        p, R, P = self._carried(before, seen.stamp_ns, seen.R_n_c, seen.R_n_v)
        kept = math.exp(-(seen.stamp_ns - before.stamp_ns) * 1e-9 / self._settings.persistent_s)
        distance2, angle, e = fuse(
            p, R, before.e, P, before.persistent, seen.p, seen.R, seen.P, seen.persistent, kept, self._settings.gate
        )
        if not distance2 <= self._settings.gate:
            return None, angle
        return _State(seen.stamp_ns, p, R, e, P, seen.persistent, seen.R_n_c, seen.R_n_v), angle
