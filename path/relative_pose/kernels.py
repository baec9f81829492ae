"""Arithmetic of the relative-pose filter, compiled: what is worth knowing about it is in
``path.relative_pose.filter``.

The error state is (dp, dw, de), 9 numbers in ``n``: position of the marker from the camera, its
attitude perturbed as ``exp(dw) R_n_v``, and the error of the reported relative velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from path.arrays import Array, Whole
from path.compiled import inner, kernel
from path.marker.kernels import cholesky, exp_times
from path.messages import Vec3


class Reports(NamedTuple):
    """The motion that one vehicle has reported: the first ``many`` rows.

    Attributes:
        stamps: (n,) ns.
        values: (n, 6) velocity, and the way since the first report by trapezes, m/s and m in ``n``.
    """

    stamps: Whole
    values: Array
    many: int


class State(NamedTuple):
    """The filter at the instant of a measurement.

    Attributes:
        p, R, e: (3,) position, (3, 3) ``R_n_v``, (3,) error of the velocity.
        P: (9, 9), see the module, without ``persistent``.
        persistent: (6, 6) in ``n``, of the newest measurement.
        R_n_c, R_n_v: (3, 3) the attitudes as reported then.
        levelled: whether the marker's attitude was reported.
    """

    stamp_ns: int
    p: Array
    R: Array
    e: Array
    P: Array
    persistent: Array
    R_n_c: Array
    R_n_v: Array
    levelled: bool


class Drift(NamedTuple):
    """The filter's assumptions about the time between two instants.

    Attributes:
        wander_s: how long an attitude's error takes to change; ``tilt``, ``yaw``: its variances,
            rad^2.
        free: variance of an attitude that is not reported, rad^2.
        walk, free_walk: variance that the velocity's error gains in a second, (m/s)^2; without
            reports.
        lever_c, lever_v: (3,) of camera and marker from their drones' centres, in their own axes.
    """

    wander_s: float
    tilt: float
    yaw: float
    free: float
    walk: float
    free_walk: float
    lever_c: Array
    lever_v: Array


@kernel
def reported(reports: Reports, stamp_ns: int) -> tuple[float, float, float, float, float, float]:
    """Velocity, and way since the first report, at an instant: linear between reports, steady
    outside of them.
    """
    after = reports.many
    while after > 0 and reports.stamps[after - 1] > stamp_ns:
        after -= 1
    before = max(0, after - 1)
    dt = (stamp_ns - reports.stamps[before]) * 1e-9
    a = reports.values[before, 0]
    b = reports.values[before, 1]
    c = reports.values[before, 2]
    x = reports.values[before, 3]
    y = reports.values[before, 4]
    z = reports.values[before, 5]
    u = a
    v = b
    w = c
    if 0 < after < reports.many:
        share = dt / ((reports.stamps[after] - reports.stamps[before]) * 1e-9)
        u = a + share * (reports.values[after, 0] - a)
        v = b + share * (reports.values[after, 1] - b)
        w = c + share * (reports.values[after, 2] - c)
    half = 0.5 * dt
    return u, v, w, x + half * (a + u), y + half * (b + v), z + half * (c + w)


@kernel
def velocity(own: Reports, peer: Reports, stamp_ns: int) -> Vec3:
    """Return the velocity of the marker's drone minus the own one; zero while one of them reports
    none.
    """
    if own.many == 0 or peer.many == 0:
        return 0.0, 0.0, 0.0
    a, b, c, _, _, _ = reported(own, stamp_ns)
    u, v, w, _, _, _ = reported(peer, stamp_ns)
    return u - a, v - b, w - c


@inner
def _way(own: Reports, peer: Reports, from_ns: int, to_ns: int) -> Vec3:
    """Return the way of the marker's drone minus the own one's, by their reports, m."""
    if to_ns <= from_ns or own.many == 0 or peer.many == 0:
        return 0.0, 0.0, 0.0
    _, _, _, a, b, c = reported(own, from_ns)
    _, _, _, d, e, f = reported(own, to_ns)
    _, _, _, u, v, w = reported(peer, from_ns)
    _, _, _, x, y, z = reported(peer, to_ns)
    return x - u - d + a, y - v - e + b, z - w - f + c


@inner
def carried(
    state: State, stamp_ns: int, to_R_n_c: Array, to_R_n_v: Array, levelled: bool, own: Reports, peer: Reports,
    drift: Drift,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """``p``, ``R`` and ``P`` of a state at a later instant.

    Args:
        to_R_n_c, to_R_n_v: (3, 3), attitudes of camera and marker as reported then; ``levelled``
            whether the marker's was.
        own, peer: what the receiver and the marker's drone reported.
    """
    dt = max(0.0, (stamp_ns - state.stamp_ns) * 1e-9)
    walk = drift.walk if own.many > 0 and peer.many > 0 else drift.free_walk
    # of a wander, between two instants
    spread = 2.0 * (1.0 - math.exp(-dt / drift.wander_s))
    tilt = spread * drift.tilt
    yaw = spread * drift.yaw
    free = spread * drift.free
    # the own one turns position and attitude together
    own_turn = (tilt, tilt, yaw)
    peer_turn = (tilt, tilt, yaw)
    both_levelled = levelled and state.levelled
    if not both_levelled:
        peer_turn = (free, free, free)
    way = _way(own, peer, state.stamp_ns, stamp_ns)
    p = state.p
    R = state.R
    e = state.e
    R_n_c = state.R_n_c
    R_n_v = state.R_n_v
    lever_c = drift.lever_c
    lever_v = drift.lever_v
    turn = np.empty((3, 3))
    turned_R = np.empty((3, 3))
    lever = np.empty(3)
    moved = np.empty(3)
    for i in range(3):
        for j in range(3):
            turn[i, j] = 1.0 if i == j else 0.0
            if both_levelled:
                turn[i, j] = (
                    to_R_n_v[i, 0] * R_n_v[j, 0]
                    + to_R_n_v[i, 1] * R_n_v[j, 1]
                    + to_R_n_v[i, 2] * R_n_v[j, 2]
                )
    for i in range(3):
        moved[i], lever[i] = p[i] + way[i] + e[i] * dt, 0.0
        for j in range(3):
            turned_R[i, j] = turn[i, 0] * R[0, j] + turn[i, 1] * R[1, j] + turn[i, 2] * R[2, j]
            lever[i] += turned_R[i, j] * lever_v[j]
            moved[i] += (turned_R[i, j] - R[i, j]) * lever_v[j] - (
                to_R_n_c[i, j] - R_n_c[i, j]
            ) * lever_c[j]
    return moved, turned_R, _covariance(state.P, turn, dt, walk, moved, own_turn, lever, peer_turn)


@kernel
def predicted(
    state: State,
    stamp_ns: int,
    R_n_c: Array,
    R_n_v: Array,
    levelled: bool,
    own: Reports,
    peer: Reports,
    drift: Drift,
) -> tuple[Vec3, Vec3, float, Array, Array, Array]:
    """A state at a later instant.

    Returns:
        Position, velocity and standard deviation of the position in ``n``, and in the camera
        translation, rotation and covariance (6, 6).
    """
    p, R, P = carried(state, stamp_ns, R_n_c, R_n_v, levelled, own, peer, drift)
    R_c_n = np.empty((3, 3))
    spread = np.empty((6, 6))
    for i in range(3):
        for j in range(3):
            R_c_n[i, j] = R_n_c[j, i]
    for i in range(6):
        for j in range(6):
            spread[i, j] = P[i, j] + state.persistent[i, j]
    t_c, R_c_v, covariance = placed(R_c_n, p, R, spread)
    vx, vy, vz = velocity(own, peer, max(stamp_ns, state.stamp_ns))
    moving = vx + state.e[0], vy + state.e[1], vz + state.e[2]
    sigma_m = math.sqrt((covariance[0, 0] + covariance[1, 1] + covariance[2, 2]) / 3.0)
    return (p[0], p[1], p[2]), moving, sigma_m, t_c, R_c_v, covariance


@kernel
def fused(
    before: State,
    seen: State,
    own: Reports,
    peer: Reports,
    drift: Drift,
    persistent_s: float,
    gate: float,
) -> tuple[float, float, State]:
    """A state with a later measurement in it.

    Returns:
        The squared Mahalanobis distance (above ``gate`` the state is only carried on; NaN when a
        covariance is none), the angle between the attitudes, and the state.
    """
    p, R, P = carried(
        before, seen.stamp_ns, seen.R_n_c, seen.R_n_v, seen.levelled, own, peer, drift
    )
    kept = math.exp(-(seen.stamp_ns - before.stamp_ns) * 1e-9 / persistent_s)
    distance2, angle, e = fuse(
        p, R, before.e, P, before.persistent, seen.p, seen.R, seen.P, seen.persistent, kept, gate
    )
    state = State(seen.stamp_ns, p, R, e, P, seen.persistent, seen.R_n_c, seen.R_n_v, seen.levelled)
    return distance2, angle, state


@inner
def _covariance(
    P: Array, turn: Array, dt: float, walk: float, p: Array, own: Vec3, lever: Array, peer: Vec3
) -> Array:
    """``P`` after ``dt`` seconds; ``turn`` (3, 3) of the marker's drone, ``p`` and ``lever`` (3,)
    afterwards.
    """
    half = np.empty((9, 9))
    out = np.empty((9, 9))
    for j in range(9):
        for i in range(3):
            half[i, j] = P[i, j] + dt * P[6 + i, j]
            half[3 + i, j] = turn[i, 0] * P[3, j] + turn[i, 1] * P[4, j] + turn[i, 2] * P[5, j]
            half[6 + i, j] = P[6 + i, j]
    for i in range(9):
        for j in range(3):
            out[i, j] = half[i, j] + dt * half[i, 6 + j]
            out[i, 3 + j] = (
                turn[j, 0] * half[i, 3] + turn[j, 1] * half[i, 4] + turn[j, 2] * half[i, 5]
            )
            out[i, 6 + j] = half[i, 6 + j]
    for i in range(3):
        out[i, i] += walk * dt * dt * dt / 3.0
        out[i, 6 + i] += 0.5 * walk * dt * dt
        out[6 + i, i] += 0.5 * walk * dt * dt
        out[6 + i, 6 + i] += walk * dt
    _add_turned(out, p, own)
    _add_turned(out, lever, peer)
    return out


@inner
def _add_turned(P: Array, arm: Array, variances: Vec3) -> None:
    """Add a random turn ``d`` about the axes of ``n``: ``dp += d x arm``, ``dw += d``."""
    G = np.zeros((6, 3))
    G[0, 1], G[0, 2], G[1, 0] = arm[2], -arm[1], -arm[2]
    G[1, 2], G[2, 0], G[2, 1] = arm[0], arm[1], -arm[0]
    G[3, 0], G[4, 1], G[5, 2] = 1.0, 1.0, 1.0
    for i in range(6):
        for j in range(6):
            for k in range(3):
                P[i, j] += G[i, k] * variances[k] * G[j, k]


@inner
def turned(covariance: Array, R: Array) -> Array:
    """A pose's covariance (6, 6) in another frame: both halves turned by ``R`` (3, 3)."""
    half = np.empty((6, 6))
    out = np.empty((6, 6))
    for i in range(3):
        for j in range(6):
            for b in range(0, 6, 3):
                half[b + i, j] = (
                    R[i, 0] * covariance[b, j]
                    + R[i, 1] * covariance[b + 1, j]
                    + R[i, 2] * covariance[b + 2, j]
                )
    for i in range(6):
        for j in range(3):
            for b in range(0, 6, 3):
                out[i, b + j] = (
                    R[j, 0] * half[i, b] + R[j, 1] * half[i, b + 1] + R[j, 2] * half[i, b + 2]
                )
    return out


@inner
def placed(R_a_b: Array, p_b: Array, R_b_v: Array, covariance: Array) -> tuple[Array, Array, Array]:
    """A pose and its covariance (6, 6) in another frame, which is only turned: ``R_a_b p``, ``R_a_b
    R`` and so on.
    """
    p = np.empty(3)
    R = np.empty((3, 3))
    for i in range(3):
        p[i] = R_a_b[i, 0] * p_b[0] + R_a_b[i, 1] * p_b[1] + R_a_b[i, 2] * p_b[2]
        for j in range(3):
            R[i, j] = (
                R_a_b[i, 0] * R_b_v[0, j] + R_a_b[i, 1] * R_b_v[1, j] + R_a_b[i, 2] * R_b_v[2, j]
            )
    return p, R, turned(covariance, R_a_b)


@kernel
def known_by(
    R_n_c: Array, t: Array, R_c_v: Array, covariance: Array, persistent: float, spread: float
) -> tuple[Array, Array, Array, Array]:
    """``p``, ``R``, ``P`` and the persistent covariance (6, 6) of a state that knows nothing but
    one measured pose.

    Args:
        persistent: share of its variance that persists.
        spread: variance of the velocity's error, (m/s)^2.
    """
    p, R, measured = placed(R_n_c, t, R_c_v, covariance)
    P = np.zeros((9, 9))
    for i in range(6):
        for j in range(6):
            P[i, j] = (1.0 - persistent) * measured[i, j]
            measured[i, j] *= persistent
    for i in range(6, 9):
        P[i, i] = spread
    return p, R, P, measured


@inner
def _surprise(p: Array, R: Array, seen_p: Array, seen_R: Array) -> Array:
    """Return a measured pose's difference to the state's, (6,): ``seen_p - p``, the rotation
    vector to ``seen_R``.
    """
    out = np.empty(6)
    D = np.empty((3, 3))
    for i in range(3):
        out[i] = seen_p[i] - p[i]
        for j in range(3):
            D[i, j] = seen_R[i, 0] * R[j, 0] + seen_R[i, 1] * R[j, 1] + seen_R[i, 2] * R[j, 2]
    x = D[2, 1] - D[1, 2]
    y = D[0, 2] - D[2, 0]
    z = D[1, 0] - D[0, 1]
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    if sine > 1e-7:
        scale = 0.5 * angle / sine
    elif angle < 1.0:
        scale = 0.5
    else:  # half a turn, about whatever axis: no measurement that will be believed
        x = angle
        y = 0.0
        z = 0.0
        scale = 1.0
    out[3], out[4], out[5] = scale * x, scale * y, scale * z
    return out


@inner
def _expected(
    P: Array, persistent: Array, seen_P: Array, seen_persistent: Array, kept: float
) -> Array:
    """Covariance (6, 6) of the difference between a state and a measured pose; arguments as in
    ``fuse``.
    """
    S = np.empty((6, 6))
    size = 0.0
    seen_size = 0.0
    for i in range(6):
        size += persistent[i, i]
        seen_size += seen_persistent[i, i]
    change = 1.0 - kept * min(size, seen_size) / max(size, seen_size, 1e-30)
    for i in range(6):
        for j in range(6):
            S[i, j] = P[i, j] + seen_P[i, j] + change * (persistent[i, j] + seen_persistent[i, j])
    return S


@inner
def _white(S: Array, difference: Array, P: Array) -> tuple[Array, Array]:
    """``S^-1/2`` of the difference (6,), and of the first six rows of P (6, 9); ``S`` is a Cholesky
    factor.
    """
    white = np.empty(6)
    W = np.empty((6, 9))
    for i in range(6):
        white[i] = difference[i]
        for j in range(9):
            W[i, j] = P[i, j]
        for k in range(i):
            white[i] -= S[i, k] * white[k]
            for j in range(9):
                W[i, j] -= S[i, k] * W[k, j]
        white[i] /= S[i, i]
        for j in range(9):
            W[i, j] /= S[i, i]
    return white, W


@inner
def fuse(
    p: Array, R: Array, e: Array, P: Array, persistent: Array, seen_p: Array, seen_R: Array, seen_P: Array,
    seen_persistent: Array, kept: float, gate: float,
) -> tuple[float, float, Array]:  # fmt: skip
    """Kalman update by a measured pose. ``p``, ``R`` and ``P`` are changed in place.

    Args:
        persistent, seen_persistent: (6, 6), the part of the newest measurement's covariance that
            persists, and of this one's: the two errors differ the more, the longer ago and the less
            alike they are.
        seen_P: (9, 9), what of this one's does not persist.
        kept: how much of a persistent error is left by now, 0..1.

    Returns:
        The squared Mahalanobis distance (above ``gate`` nothing is changed; NaN when a covariance
        is none), the angle between the attitudes, and the new ``e``.
    """
    difference = _surprise(p, R, seen_p, seen_R)
    angle = math.sqrt(difference[3] ** 2 + difference[4] ** 2 + difference[5] ** 2)
    error = np.empty(3)
    for i in range(3):
        error[i] = e[i]
    S = _expected(P, persistent, seen_P, seen_persistent, kept)
    if not cholesky(S):
        return math.nan, angle, error
    white, W = _white(S, difference, P)
    distance2 = 0.0
    for i in range(6):
        distance2 += white[i] * white[i]
    if distance2 <= gate:
        correction = np.zeros(9)
        for i in range(9):
            for k in range(6):
                correction[i] += W[k, i] * white[k]
                for j in range(9):
                    P[i, j] -= W[k, i] * W[k, j]
        for i in range(3):
            p[i] += correction[i]
            error[i] += correction[6 + i]
        turned_R = exp_times(correction[3:6], R)
        for i in range(3):
            for j in range(3):
                R[i, j] = turned_R[i, j]
    return distance2, angle, error
