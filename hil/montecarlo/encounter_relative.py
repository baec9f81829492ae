"""The gate of the marker view, compiled: what ``path.relative.RelativeFilter`` and ``MarkerView.look`` do between the
method's own kernels (``path.relative_kernels``)."""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.geometric.kernels import kernel
from hil.montecarlo.encounter_sight import sees
from path.geometry import Matrix, Vector
from path.relative import FLIPPED_RAD, FREE_TURN_RAD, RelativeSettings
from path.relative_kernels import carried, fuse, known_by

ACCEPTED, REFUSED_STATE = 0, 1
FUSED, TURNED, AWAY = 0, 1, 2
# Of a state: whether there is one, its stamp, whether the marker's attitude was known.
HAS, STAMP, LEVEL = 0, 1, 2


class Believes(NamedTuple):
    """``RelativeSettings`` and the levers as the kernels take them."""

    velocity_variance: float
    walk: float
    tilt_variance: float
    yaw_variance: float
    wander_s: float
    persistent: float
    persistent_s: float
    gate: float
    settle: int
    coast_ns: int
    free_variance: float
    lever_c: np.ndarray
    lever_v: np.ndarray

    @classmethod
    def of(cls, s: RelativeSettings, lever_c: Vector, lever_v: Vector) -> Believes:
        return cls(
            s.velocity_sigma_mps**2, s.velocity_walk_mps**2, s.tilt_wander_rad**2, s.yaw_wander_rad**2, s.wander_s,
            s.persistent, s.persistent_s, s.gate, s.settle, round(s.coast_s * 1e9), FREE_TURN_RAD**2,
            np.ascontiguousarray(lever_c), np.ascontiguousarray(lever_v),
        )  # fmt: skip


class Reports(NamedTuple):
    """Velocities of one vehicle: stamps (n,), velocities (n, 3), and how far they have carried it (n, 3)."""

    stamp: np.ndarray
    velocity: np.ndarray
    travelled: np.ndarray


class Filter(NamedTuple):
    """The accepted state and the refused one, rows 0 and 1; ``refusals`` (1,)."""

    ints: np.ndarray
    p: np.ndarray
    R: np.ndarray
    e: np.ndarray
    P: np.ndarray
    persistent: np.ndarray
    R_n_c: np.ndarray
    R_n_v: np.ndarray
    refusals: np.ndarray


def fresh_filter() -> Filter:
    return Filter(
        np.zeros((2, 3), np.int64), np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros((2, 9, 9)),
        np.zeros((2, 6, 6)), np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), np.zeros(1, np.int64),
    )  # fmt: skip


def reports(stamps_ns: np.ndarray, velocities: Matrix) -> Reports:
    """All of a vehicle's reports, with the way between them by trapezes."""
    steps = 0.5e-9 * np.diff(stamps_ns)[:, None] * (velocities[1:] + velocities[:-1])
    return Reports(stamps_ns, velocities, np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0))))


@kernel
def _travelled(known, count, stamp, out):
    """``Travel.at`` by the first ``count`` reports: the way into ``out`` (3,)."""
    after = count
    while after > 0 and known.stamp[after - 1] > stamp:
        after -= 1
    before = max(0, after - 1)
    dt = (stamp - known.stamp[before]) * 1e-9
    share = 0.0
    if 0 < after < count:
        share = dt / ((known.stamp[after] - known.stamp[before]) * 1e-9)
    for i in range(3):
        v = known.velocity[before, i]
        end = v + share * (known.velocity[after, i] - v) if 0 < after < count else v
        out[i] = known.travelled[before, i] + 0.5 * dt * (v + end)


@kernel
def _way(own, own_count, peer, peer_count, start, stop):
    a, b, c, d = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    if stop > start:
        _travelled(own, own_count, start, a)
        _travelled(own, own_count, stop, b)
        _travelled(peer, peer_count, start, c)
        _travelled(peer, peer_count, stop, d)
    return (d[0] - c[0] - b[0] + a[0], d[1] - c[1] - b[1] + a[1], d[2] - c[2] - b[2] + a[2])


@kernel
def _carried(f, row, stamp, R_n_c, R_n_v, level, way, believes):
    """``RelativeFilter._carried``: position, attitude and covariance of a state at an instant."""
    dt = max(0.0, (stamp - f.ints[row, STAMP]) * 1e-9)
    spread = 2.0 * (1.0 - math.exp(-dt / believes.wander_s))
    tilt, yaw = spread * believes.tilt_variance, spread * believes.yaw_variance
    own, peer = (tilt, tilt, yaw), (tilt, tilt, yaw)
    before, after = f.R_n_v[row], R_n_v
    if f.ints[row, LEVEL] == 0 or not level:
        before = after = np.eye(3)
        free = spread * believes.free_variance
        peer = (free, free, free)
    return carried(
        f.p[row], f.R[row], f.e[row], f.P[row], f.R_n_c[row], before, R_n_c, after, way, dt, believes.walk, own, peer,
        believes.lever_c, believes.lever_v,
    )  # fmt: skip


@kernel
def expected(f, stamp, R_n_c, R_n_v, level, own, own_count, peer, peer_count, lens, reach_m, believes):
    """``MarkerView._region``: whether it is known where the marker must be, around which pixel, within how many px."""
    way = _way(own, own_count, peer, peer_count, f.ints[ACCEPTED, STAMP], stamp)
    p, _, P = _carried(f, ACCEPTED, stamp, R_n_c, R_n_v, level, way, believes)
    x = R_n_c[0, 0] * p[0] + R_n_c[1, 0] * p[1] + R_n_c[2, 0] * p[2]
    y = R_n_c[0, 1] * p[0] + R_n_c[1, 1] * p[1] + R_n_c[2, 1] * p[2]
    z = R_n_c[0, 2] * p[0] + R_n_c[1, 2] * p[1] + R_n_c[2, 2] * p[2]
    visible, u, v = sees(lens, x, y, z)
    if not visible:
        return False, 0.0, 0.0, 0.0
    variance = 0.0
    for i in range(3):
        variance += (P[i, i] + f.persistent[ACCEPTED, i, i]) / 3.0
    return True, u, v, lens[0] * (reach_m + 3.0 * math.sqrt(variance)) / z + 12.0


@kernel
def _fused(f, row, stamp, p, R, P, persistent, R_n_c, R_n_v, level, way, believes):
    """A state with a measurement in it, into itself; outside the gate it stays. Whether it was, and the angle."""
    to_p, to_R, to_P = _carried(f, row, stamp, R_n_c, R_n_v, level, way, believes)
    kept = math.exp(-(stamp - f.ints[row, STAMP]) * 1e-9 / believes.persistent_s)
    distance2, angle, e = fuse(to_p, to_R, f.e[row], to_P, f.persistent[row], p, R, P, persistent, kept, believes.gate)
    if not distance2 <= believes.gate:
        return False, angle
    _store(f, row, stamp, to_p, to_R, e, to_P, persistent, R_n_c, R_n_v, level)
    return True, angle


@kernel
def _store(f, row, stamp, p, R, e, P, persistent, R_n_c, R_n_v, level):
    f.ints[row, HAS], f.ints[row, STAMP], f.ints[row, LEVEL] = 1, stamp, 1 if level else 0
    f.p[row], f.R[row], f.e[row], f.P[row] = p, R, e, P
    f.persistent[row], f.R_n_c[row], f.R_n_v[row] = persistent, R_n_c, R_n_v


@kernel
def _adopt(f):
    """The refused state replaces the accepted one."""
    f.ints[ACCEPTED], f.p[ACCEPTED], f.R[ACCEPTED] = f.ints[REFUSED_STATE], f.p[REFUSED_STATE], f.R[REFUSED_STATE]
    f.e[ACCEPTED], f.P[ACCEPTED] = f.e[REFUSED_STATE], f.P[REFUSED_STATE]
    f.persistent[ACCEPTED] = f.persistent[REFUSED_STATE]
    f.R_n_c[ACCEPTED], f.R_n_v[ACCEPTED] = f.R_n_c[REFUSED_STATE], f.R_n_v[REFUSED_STATE]


@kernel
def update(f, stamp, R_c_v, t_c, spread, R_n_c, R_n_v, level, own, own_count, peer, peer_count, believes):
    """``RelativeFilter.update``: FUSED, or that it was TURNED or AWAY.

    Args:
        spread: (6, 6) of the pose. level: whether ``R_n_v`` is known.
        own, own_count, peer, peer_count: what both vehicles had reported by then.
    """
    p, R, P, persistent = known_by(R_n_c, t_c, R_c_v, spread, believes.persistent, believes.velocity_variance)
    if f.ints[ACCEPTED, HAS] == 0 or stamp - f.ints[ACCEPTED, STAMP] > believes.coast_ns:
        _store(f, ACCEPTED, stamp, p, R, np.zeros(3), P, persistent, R_n_c, R_n_v, level)
        f.ints[REFUSED_STATE, HAS], f.refusals[0] = 0, 0
        return FUSED
    way = _way(own, own_count, peer, peer_count, f.ints[ACCEPTED, STAMP], stamp)
    inside, angle = _fused(f, ACCEPTED, stamp, p, R, P, persistent, R_n_c, R_n_v, level, way, believes)
    if inside:
        f.ints[REFUSED_STATE, HAS], f.refusals[0] = 0, 0
        return FUSED
    again = False
    if f.ints[REFUSED_STATE, HAS] == 1:
        way = _way(own, own_count, peer, peer_count, f.ints[REFUSED_STATE, STAMP], stamp)
        again, _ = _fused(f, REFUSED_STATE, stamp, p, R, P, persistent, R_n_c, R_n_v, level, way, believes)
    if again:
        f.refusals[0] += 1
    else:
        f.refusals[0] = 1
        _store(f, REFUSED_STATE, stamp, p, R, np.zeros(3), P, persistent, R_n_c, R_n_v, level)
    if f.refusals[0] >= believes.settle:
        _adopt(f)
        f.ints[REFUSED_STATE, HAS], f.refusals[0] = 0, 0
        return FUSED
    return TURNED if angle > FLIPPED_RAD else AWAY


@kernel
def levelled(gravity_v, R_b_v, yaw, out):
    """``flight.marker_view.levelled``: the marker's attitude in ``n`` into ``out`` (3, 3)."""
    g = np.zeros(3)
    for i in range(3):
        for j in range(3):
            g[i] += R_b_v[i, j] * gravity_v[j]
    x, y, z = g[0], g[1], g[2]
    across = math.hypot(y, z)
    c, s = math.cos(yaw), math.sin(yaw)
    forward, right = (across, -x * y / across, -x * z / across), (0.0, z / across, -y / across)
    rows = np.empty((3, 3))
    for j in range(3):
        rows[0, j], rows[1, j], rows[2, j] = c * forward[j] - s * right[j], s * forward[j] + c * right[j], g[j]
    for i in range(3):
        for j in range(3):
            out[i, j] = rows[i, 0] * R_b_v[0, j] + rows[i, 1] * R_b_v[1, j] + rows[i, 2] * R_b_v[2, j]
