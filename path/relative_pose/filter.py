"""The marker's pose relative to D2's camera, between and beyond marker measurements.

A Kalman filter of the pose and of the error of the velocity that both vehicles report. The position
is kept in NED, by D2's own attitude, and the marker's attitude beside it; they move with both
reported velocities and turn with both attitudes (what an attitude has as a constant error is in the
measured pose already, only its wander counts). Marker measurements come with their full covariance.
Their errors have two parts: noise, and what persists from frame to frame (printed size, focal
length, biases of the attitudes that the pose rests on). The persistent part never averages out: it
is kept out of the filter and added to what the filter says.

A pose may also come late, from a common view (``path.common_view``), which takes a second to cross
the link and to be worked out: the filter goes back to before it, takes it in, and repeats what it
was given since.

Perturbations of a pose are ``t + dt``, ``R <- exp(dw) R``; covariances are (6, 6) in the order (dt,
dw), as in ``path.marker.pose``.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from path.geometry.transforms import Matrix, Pose, Vector
from path.messages import Vec3
from path.observations import Missed, MissReason
from path.relative_pose.kernels import Drift, Reports, State, fused, known_by, predicted, velocity
from path.values import frozen, value

# of an unreported velocity: its deviation, and its change in a second
FREE_SPEED_MPS = 0.7
FREE_WALK_MPS = 1.0
FREE_TURN_RAD = math.radians(5.0)  # of an unreported attitude, in ``wander_s``
FLIPPED_RAD = math.radians(8.0)  # a refused attitude that is off by more has turned over
REMEMBERED_NS = 5_000_000_000
"""For so long back a measurement may come late."""
ORIGIN: Vector = np.zeros(3)
UPRIGHT: Matrix = np.eye(3)


class Source(Enum):
    """What a measured pose is from."""

    MARKER = "marker"
    COMMON_VIEW = "common_view"


class _Belief(NamedTuple):
    """What the filter has made of its measurements so far.

    Attributes:
        source: of the newest accepted one. ``refused``: a state of those in a row that were not,
            with how many they are worth.
    """

    state: State | None = None
    source: Source = Source.MARKER
    refused: State | None = None
    refusals: float = 0.0


class _Measured(NamedTuple):
    """One measurement, and the belief before it."""

    seen: State
    source: Source
    before: _Belief


@frozen
class RelativeSettings:
    """The errors that the filter assumes, as standard deviations per axis.

    Attributes:
        velocity_sigma_mps: error of the relative velocity that the two vehicles report.
        velocity_walk_mps: how much that error changes in a second.
        tilt_wander_rad, yaw_wander_rad: what either vehicle's attitude errs more at one time than
            at another.
        wander_s: how long it takes for that.
        persistent: share of a measurement's variance that the next frames share, and
            ``persistent_s`` for how long.
        gate: squared Mahalanobis distance (six degrees of freedom) a measurement may have; normal
            errors exceed 45 once in 2e7 frames, real ones have longer tails.
        settle: this many refused measurements in a row that agree with each other replace the
            state.
        settle_common: the same of common views, each of which rests on a keyframe of its own.
        coast_s: without a measurement for longer, there is no prediction.
        late: measurements may come late, and are remembered for that.
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
    settle_common: int = 3
    coast_s: float = 1.0
    late: bool = False


@value
class Relative:
    """The marker at an instant.

    Attributes:
        marker_n_m: from D2's camera to the marker, in ``n``; ``velocity_n_mps`` is how the two
            drones move apart.
        sigma_m: standard deviation of the position, mean over the axes.
        T_c_v: its pose in the camera, for the attitudes asked for; ``covariance`` is (6, 6), see
            the module.
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
        self.reports = Reports(np.empty(2 * self._KEPT, np.int64), np.empty((2 * self._KEPT, 6)), 0)

    @property
    def known(self) -> bool:
        return self.reports.many > 0

    def add(self, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        """One report; one that is not newer than the newest is ignored."""
        stamps, values, count = self.reports
        u, v, w = velocity_n_mps
        x = y = z = 0.0
        if count:
            newest_ns = int(stamps[count - 1])
            if stamp_ns <= newest_ns:
                return
            half = 0.5e-9 * (stamp_ns - newest_ns)
            a, b, c, x, y, z = values[count - 1].tolist()
            x = x + half * (a + u)
            y = y + half * (b + v)
            z = z + half * (c + w)
            if count == len(stamps):
                count -= self._KEPT
                stamps[:count], values[:count] = stamps[-count:].copy(), values[-count:].copy()
        stamps[count], values[count] = stamp_ns, (u, v, w, x, y, z)
        self.reports = Reports(stamps, values, count + 1)


class RelativeFilter:
    """The marker's pose relative to the camera. All stamps are of one clock.

    Args:
        lever_c_m: of the camera from its own drone's centre, in the camera's axes.
        lever_v_m: of the marker from its drone's centre, in the axes of ``v``.
    """

    def __init__(
        self,
        settings: RelativeSettings | None = None,
        lever_c_m: Vector = ORIGIN,
        lever_v_m: Vector = ORIGIN,
    ) -> None:
        self._settings = its = settings or RelativeSettings()
        self._drift = Drift(
            its.wander_s, its.tilt_wander_rad**2, its.yaw_wander_rad**2, FREE_TURN_RAD**2,
            its.velocity_walk_mps * its.velocity_walk_mps, FREE_WALK_MPS * FREE_WALK_MPS,
            np.ascontiguousarray(lever_c_m), np.ascontiguousarray(lever_v_m),
        )  # fmt: skip
        self._own, self._peer = Travel(), Travel()
        self._belief = _Belief()
        self._measured: list[_Measured] = []

    @property
    def source(self) -> Source:
        """Return what the newest accepted measurement is from."""
        return self._belief.source

    def set_own_velocity(self, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        self._report(self._own, self._peer, stamp_ns, velocity_n_mps)

    def set_peer_velocity(self, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        """Take a reported velocity of the marker's drone."""
        self._report(self._peer, self._own, stamp_ns, velocity_n_mps)

    def unseen_s(self, stamp_ns: int) -> float:
        """Time since the newest accepted measurement; infinite before the first."""
        state = self._belief.state
        return math.inf if state is None else (stamp_ns - state.stamp_ns) * 1e-9

    def predict(
        self, stamp_ns: int, R_n_c: Matrix | None = None, R_n_v: Matrix | None = None
    ) -> Relative | None:
        """The marker at an instant; None before the first measurement and after too long a coast.

        Args:
            R_n_c, R_n_v: attitudes of the camera and of the marker as reported for that instant;
                those of the newest measurement when they are not given.
        """
        state = self._belief.state
        if state is None or stamp_ns - state.stamp_ns > self._settings.coast_s * 1e9:
            return None
        own = self._own.reports
        peer = self._peer.reports
        p, moving, sigma_m, t_c, R_c_v, covariance = predicted(
            state, stamp_ns, state.R_n_c if R_n_c is None else np.ascontiguousarray(R_n_c),
            UPRIGHT if R_n_v is None else np.ascontiguousarray(R_n_v), R_n_v is not None, own, peer, self._drift,
        )  # fmt: skip
        return Relative(p, moving, sigma_m, Pose(R_c_v, t_c), covariance)

    def update(
        self,
        stamp_ns: int,
        T_c_v: Pose,
        covariance: Matrix,
        R_n_c: Matrix,
        R_n_v: Matrix | None = None,
        source: Source = Source.MARKER,
    ) -> Missed | None:
        """Fuse a measured pose; None when it was.

        Args:
            covariance: (6, 6) of ``T_c_v`` in the camera.
            R_n_c, R_n_v: attitudes of camera and marker as the two vehicles report them for that
                instant.

        Returns:
            Missed MARKER_FLIPPED or POSE_UNCERTAIN when attitude or position lie outside the gate,
            STALE when it is no newer than the newest one, and, where measurements may come late, no
            newer than all that is remembered. It is not used then.
        """
        if source is Source.COMMON_VIEW:
            stamp_ns -= 1  # just before the marker that may be in the same frame
        seen = self._seen(stamp_ns, T_c_v, covariance, np.ascontiguousarray(R_n_c), R_n_v)
        since = [each for each in self._measured if each.seen.stamp_ns > stamp_ns]
        if not since:
            return self._take(seen, source)
        if len(since) == len(self._measured):
            return Missed(MissReason.STALE, ignored=True)
        # What came after it is taken in once more.
        self._measured = self._measured[: -len(since)]
        self._belief = since[0].before
        missed = self._take(seen, source)
        for each in since:
            self._take(each.seen, each.source)
        return missed

    def _take(self, seen: State, source: Source) -> Missed | None:
        """Fuse a measurement that is the newest."""
        before = self._belief
        if self._settings.late:
            self._remember(_Measured(seen, source, before))
        self._belief, missed = self._after(before, seen, source)
        return missed

    def _remember(self, measured: _Measured) -> None:
        oldest_ns = measured.seen.stamp_ns - REMEMBERED_NS
        while self._measured and self._measured[0].seen.stamp_ns < oldest_ns:
            self._measured.pop(0)
        self._measured.append(measured)

    def _after(self, before: _Belief, seen: State, source: Source) -> tuple[_Belief, Missed | None]:
        """Return the belief after a measurement, and why that is refused; None when it is not."""
        its = self._settings
        state = before.state
        if state is None or seen.stamp_ns - state.stamp_ns > its.coast_s * 1e9:
            return _Belief(seen, source), None
        if seen.stamp_ns <= state.stamp_ns:
            return before, Missed(MissReason.STALE, ignored=True)
        updated, angle = self._fused(state, seen)
        if updated is not None:
            return _Belief(updated, source), None
        again = None if before.refused is None else self._fused(before.refused, seen)[0]
        weight = its.settle / its.settle_common if source is Source.COMMON_VIEW else 1
        refusals = weight if again is None else before.refusals + weight
        refused = seen if again is None else again
        if refusals >= its.settle:
            return _Belief(refused, source), None
        reason = MissReason.MARKER_FLIPPED if angle > FLIPPED_RAD else MissReason.POSE_UNCERTAIN
        return _Belief(state, before.source, refused, refusals), Missed(reason)

    def _report(self, own: Travel, other: Travel, stamp_ns: int, velocity_n_mps: Vec3) -> None:
        first = not own.known
        own.add(stamp_ns, velocity_n_mps)
        belief = self._belief
        if first and other.known and belief.state is not None:
            # what was taken for the whole velocity is its error from now on
            reported = np.array(
                velocity(self._own.reports, self._peer.reports, belief.state.stamp_ns)
            )
            for state in (belief.state, belief.refused):
                if state is not None:
                    state.e[:] -= reported

    def _seen(
        self, stamp_ns: int, T_c_v: Pose, covariance: Matrix, R_n_c: Matrix, R_n_v: Matrix | None
    ) -> State:
        """A state that knows nothing but one measurement."""
        settings = self._settings
        sigma_mps = (
            settings.velocity_sigma_mps if self._own.known and self._peer.known else FREE_SPEED_MPS
        )
        p, R, P, persistent = known_by(
            R_n_c,
            T_c_v.t,
            np.ascontiguousarray(T_c_v.R),
            covariance,
            settings.persistent,
            sigma_mps * sigma_mps,
        )
        attitude = UPRIGHT if R_n_v is None else np.ascontiguousarray(R_n_v)
        return State(stamp_ns, p, R, np.zeros(3), P, persistent, R_n_c, attitude, R_n_v is not None)

    def _fused(self, before: State, seen: State) -> tuple[State | None, float]:
        """A state with a later measurement in it, None outside the gate; and by what angle they
        differ.
        """
        its = self._settings
        own = self._own.reports
        peer = self._peer.reports
        distance2, angle, state = fused(
            before, seen, own, peer, self._drift, its.persistent_s, its.gate
        )
        return (state if distance2 <= its.gate else None), angle
