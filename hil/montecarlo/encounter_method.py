"""Both sides of the method, compiled, for tens of thousands of encounters.

What ``MarkerView``, ``ReceiverCycle`` and ``SenderCycle`` do with one marker, written again in the terms of one kernel:
the messages are rows of arrays. The method itself is what counts: every trial plays a share of its encounters through
both and holds the verdicts together. Names of the functions are those of what they repeat.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.geometric.kernels import distorted, kernel
from hil.montecarlo.encounter_sight import SEEN, STATUS, UNCLEAR, Z
from path.config import MethodConfig
from path.observations import MissReason

REASONS = tuple(MissReason)


def _code(reason: MissReason) -> int:
    return REASONS.index(reason)


NO_TARGET, NO_DEPTH, NO_MARKER = _code(MissReason.NO_TARGET), _code(MissReason.NO_DEPTH), _code(MissReason.NO_MARKER)
AMBIGUOUS, OBLIQUE = _code(MissReason.AMBIGUOUS_TARGET), _code(MissReason.MARKER_OBLIQUE)
FLIPPED, POSE_UNCERTAIN = _code(MissReason.MARKER_FLIPPED), _code(MissReason.POSE_UNCERTAIN)
OUTSIDE, NO_CANDIDATE, STALE = (
    _code(MissReason.PRIOR_OUTSIDE), _code(MissReason.NO_CANDIDATE), _code(MissReason.STALE),
)  # fmt: skip
NO_TRACK, SILENT = _code(MissReason.NO_TRACK), _code(MissReason.LINK_SILENT)
NONE = -1
S = 1e-9


class Rules(NamedTuple):
    """``MethodConfig`` and what else the cycles are told; times in ns where they meet stamps."""

    max_age_ns: int
    max_future_ns: int
    max_bracket_ns: int
    max_extrapolation_ns: int
    slope_span_ns: int
    min_depth_m: float
    max_depth_m: float
    depth_sigma_at_1m_m: float
    pixel_sigma_px: float
    mount_sigma_m: float
    mount_sigma_rad: float
    target_center_sigma_m: float
    skew_m: float
    relative_accel_mps2: float
    max_pose_sigma_m: float
    search_sigmas: float
    min_search_px: float
    max_search_px: float
    ambiguity_margin: float
    same_iou: float
    search_period_ns: int

    @classmethod
    def of(cls, c: MethodConfig, same_iou: float, search_hz: float) -> Rules:
        return cls(
            round(c.max_age_s * 1e9), round(c.max_future_s * 1e9), round(c.max_bracket_s * 1e9),
            round(c.max_extrapolation_s * 1e9), round(c.slope_span_s * 1e9), c.min_depth_m, c.max_depth_m,
            c.depth_sigma_at_1m_m, c.pixel_sigma_px, c.mount_sigma_m, math.radians(c.mount_sigma_deg),
            c.target_center_sigma_m, c.clock_sigma_s * c.relative_speed_mps, c.relative_accel_mps2,
            c.max_pose_sigma_m, c.search_sigmas, c.min_search_px, c.max_search_px, c.ambiguity_margin, same_iou,
            round(1e9 / search_hz),
        )  # fmt: skip


# --- D1's own side ------------------------------------------------------------------------------------------------

POINT, DEPTH_1, SPREAD = 4, 7, 8  # columns of a sample of D1's track, after the box
SAMPLE = 9


@kernel
def observe(own, depth_sigma_m, mount, lens, rules, sample):
    """D1's sample of a frame: box, point in ``v``, depth, standard deviation; returns why there is none."""
    if own[STATUS] != SEEN:
        return AMBIGUOUS if own[STATUS] == UNCLEAR else NO_TARGET
    z = own[Z]
    if not rules.min_depth_m <= z <= rules.max_depth_m:
        return NO_DEPTH
    x, y = ray(lens, own[1] + own[3] / 2.0, own[2] + own[4] / 2.0)
    x, y = z * x, z * y
    sample[:4] = own[1:5]
    for i in range(3):
        sample[POINT + i] = mount[i, 0] * x + mount[i, 1] * y + mount[i, 2] * z + mount[i, 3]
    distance = math.sqrt(x * x + y * y + z * z)
    across = math.hypot(z * rules.pixel_sigma_px / min(lens[0], lens[1]), rules.mount_sigma_rad * distance)
    sample[DEPTH_1] = z
    sample[SPREAD] = math.hypot(max(depth_sigma_m * distance / z, across), rules.mount_sigma_m)
    return NONE


@kernel
def ray(lens, u, v):
    """As ``CameraModel.ray``."""
    xd, yd = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
    x, y = xd, yd
    for _ in range(20):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        slope = 2.0 * (lens[4] + r2 * (2.0 * lens[5] + r2 * 3.0 * lens[8]))
        gx = x * radial + 2.0 * lens[6] * x * y + lens[7] * (r2 + 2.0 * x * x) - xd
        gy = y * radial + lens[6] * (r2 + 2.0 * y * y) + 2.0 * lens[7] * x * y - yd
        xx = radial + x * x * slope + 2.0 * lens[6] * y + 6.0 * lens[7] * x
        xy = x * y * slope + 2.0 * (lens[6] * x + lens[7] * y)
        yy = radial + y * y * slope + 6.0 * lens[6] * y + 2.0 * lens[7] * x
        det = xx * yy - xy * xy
        dx, dy = (yy * gx - xy * gy) / det, (xx * gy - xy * gx) / det
        x -= dx
        y -= dy
        if abs(dx) + abs(dy) < 1e-7:
            break
    return x, y


@kernel
def at(stamps, valid, samples, count, stamp, max_bracket, out):
    """``Track.at`` over the first ``count`` samples: indices before and after, (-1, -1) for none; fills ``out``."""
    k = count - 1
    while k >= 0 and stamps[k] > stamp:
        k -= 1
    if k < 0 or not valid[k]:
        return -1, -1
    if stamps[k] == stamp:
        out[:] = samples[k]
        return k, k
    if k + 1 >= count or not valid[k + 1] or stamps[k + 1] - stamps[k] > max_bracket:
        return -1, -1
    fraction = (stamp - stamps[k]) / (stamps[k + 1] - stamps[k])
    for i in range(out.size):
        out[i] = samples[k, i] + fraction * (samples[k + 1, i] - samples[k, i])
    return k, k + 1


# --- D2's side ----------------------------------------------------------------------------------------------------


@kernel
def ahead(stamps, samples, count, stamp, rules, out):
    """``Track.ahead`` of D1's targets as D2 has them; False when there is nothing to carry on."""
    newest = count - 1
    if not 0 <= stamp - stamps[newest] <= rules.max_extrapolation_ns:
        return False
    oldest = newest
    for k in range(newest, -1, -1):
        if stamps[oldest] - stamps[k] > rules.max_bracket_ns or stamps[newest] - stamps[k] > rules.slope_span_ns:
            break
        oldest = k
    out[:] = samples[newest]
    if oldest != newest:
        factor = (stamp - stamps[newest]) / (stamps[newest] - stamps[oldest])
        for i in range(out.size):
            out[i] += factor * (samples[newest, i] - samples[oldest, i])
    return True


@kernel
def gravity(stamps, valid, samples, count, stamp, rules, out, down):
    """D1's gravity in ``v`` at an instant into ``down`` (3,); False when unknown."""
    if count == 0:
        return False
    newest = count - 1
    if stamp < stamps[newest]:
        if at(stamps, valid, samples, count, stamp, rules.max_bracket_ns, out)[0] < 0:
            return False
    elif stamp - stamps[newest] <= rules.max_extrapolation_ns:
        out[:] = samples[newest]
    else:
        return False
    x, y, z = out[3], out[4], out[5]
    norm = math.sqrt(x * x + y * y + z * z)
    down[0], down[1], down[2] = x / norm, y / norm, z / norm
    return True


# Columns of a prior: pixel, depth, covariance, half sides of the region, standard deviation of D2's position.
U, V, DEPTH, UU, UV, VV, HALF_U, HALF_V, POSE_SIGMA = 0, 1, 2, 3, 4, 5, 6, 7, 8
PRIOR_SIZE = 9


@kernel
def predict(lens, R, t, spread, point_v, point_sigma, rules, size_1m, out):
    """``path.prior.predict``: the prior into ``out`` (PRIOR_SIZE,), or why there is none."""
    c = np.empty(3)
    for i in range(3):
        c[i] = R[i, 0] * point_v[0] + R[i, 1] * point_v[1] + R[i, 2] * point_v[2] + t[i]
    if not c[2] > 0.0 or c[0] ** 2 + c[1] ** 2 > (lens[11] * c[2]) ** 2:
        return OUTSIDE
    x, y = c[0] / c[2], c[1] / c[2]
    u, v = distorted(lens, x, y)
    if not (-0.5 <= u < lens[9] - 0.5 and -0.5 <= v < lens[10] - 0.5):
        return OUTSIDE
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
    slope = 2.0 * (lens[4] + r2 * (2.0 * lens[5] + r2 * 3.0 * lens[8]))
    xx = radial + x * x * slope + 2.0 * lens[6] * y + 6.0 * lens[7] * x
    xy = x * y * slope + 2.0 * (lens[6] * x + lens[7] * y)
    yy = radial + y * y * slope + 6.0 * lens[6] * y + 2.0 * lens[7] * x
    fx, fy = lens[0] / c[2], lens[1] / c[2]
    a, b, e, f = fx * xx, fx * xy, fy * xy, fy * yy
    d, g = -fx * (x * xx + y * xy), -fy * (x * xy + y * yy)
    qx, qy, qz = c[0] - t[0], c[1] - t[1], c[2] - t[2]
    J = np.zeros((5, 6))
    J[0] = np.array((a, b, d, d * qy - b * qz, a * qz - d * qx, b * qx - a * qy))
    J[1] = np.array((e, f, g, g * qy - f * qz, e * qz - g * qx, f * qx - e * qy))
    J[2, 0] = J[3, 1] = J[4, 2] = 1.0
    J[2, 4], J[2, 5], J[3, 3], J[3, 5], J[4, 3], J[4, 4] = -t[2], t[1], t[2], -t[0], -t[1], t[0]
    moved = np.zeros((5, 6))
    for i in range(5):
        for j in range(6):
            for k in range(6):
                moved[i, j] += J[i, k] * spread[k, j]
    sigma = math.hypot(point_sigma, rules.target_center_sigma_m)
    point, pixel = sigma * sigma, rules.pixel_sigma_px**2
    uu, uv = point * (a * a + b * b + d * d) + pixel, point * (a * e + b * f + d * g)
    vv = point * (e * e + f * f + g * g) + pixel
    place = 0.0
    for k in range(6):
        uu += moved[0, k] * J[0, k]
        uv += moved[0, k] * J[1, k]
        vv += moved[1, k] * J[1, k]
        place += moved[2, k] * J[2, k] + moved[3, k] * J[3, k] + moved[4, k] * J[4, k]
    out[POSE_SIGMA] = math.sqrt(max(0.0, place) / 3.0)
    half_u, half_v = rules.search_sigmas * math.sqrt(uu), rules.search_sigmas * math.sqrt(vv)
    if out[POSE_SIGMA] > rules.max_pose_sigma_m or max(half_u, half_v) > rules.max_search_px:
        return POSE_UNCERTAIN
    out[U], out[V], out[DEPTH], out[UU], out[UV], out[VV] = u, v, c[2], uu, uv, vv
    out[HALF_U] = max(half_u + 0.5 * size_1m[0] / c[2], rules.min_search_px)
    out[HALF_V] = max(half_v + 0.5 * size_1m[1] / c[2], rules.min_search_px)
    return NONE


@kernel
def choose(found, many, prior, rules):
    """``ReceiverCycle._choose``: row of the detection, or -1 - reason."""
    best, nearest = -1, np.inf
    distances = np.empty(many)
    for i in range(many):
        u, v = found[i, 0] + found[i, 2] / 2.0, found[i, 1] + found[i, 3] / 2.0
        du, dv = u - prior[U], v - prior[V]
        distances[i] = np.inf
        if not (-prior[HALF_U] <= du < prior[HALF_U] and -prior[HALF_V] <= dv < prior[HALF_V]):
            continue
        distance = prior[VV] * du * du - 2.0 * prior[UV] * du * dv + prior[UU] * dv * dv
        distance /= prior[UU] * prior[VV] - prior[UV] ** 2
        if distance <= rules.search_sigmas**2:
            distances[i] = distance
            if distance < nearest:
                nearest, best = distance, i
    if best < 0:
        return -1 - NO_CANDIDATE
    for i in range(many):
        near = i != best and distances[i] - nearest < rules.ambiguity_margin
        if near and overlap(found[best, :4], found[i, :4]) < rules.same_iou:
            return -1 - AMBIGUOUS
    return best


# --- agreement ----------------------------------------------------------------------------------------------------


@kernel
def overlap(a, b):
    """IoU of two boxes x y w h."""
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if not (width > 0.0 and height > 0.0):
        return 0.0
    common = width * height
    return min(1.0, common / (a[2] * a[3] + b[2] * b[3] - common))


@kernel
def compare(sample, box, R, t, mount, lens_1, lens_2, iou):
    """``path.agreement.compare`` with both mappings, centre and corner, into ``iou`` (2,); False when outside.

    Args:
        sample: D1's track at the instant. R, t: of ``T_c2_v``. mount: ``T_v_c1`` (3, 4).
    """
    p = sample[POINT : POINT + 3]
    z2 = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2]
    if not z2 > 0.0:
        return False
    z1 = sample[DEPTH_1]
    mapped, c, v_point = np.empty(4), np.empty(3), np.empty(3)
    mapped[2] = box[2] * (lens_1[0] / lens_2[0]) * (z2 / z1)
    mapped[3] = box[3] * (lens_1[1] / lens_2[1]) * (z2 / z1)
    for mapping in range(2):
        shift = 0.5 if mapping == 0 else 0.0
        x, y = ray(lens_2, box[0] + shift * box[2], box[1] + shift * box[3])
        c[0], c[1], c[2] = z2 * x - t[0], z2 * y - t[1], z2 - t[2]
        for i in range(3):
            v_point[i] = R[0, i] * c[0] + R[1, i] * c[1] + R[2, i] * c[2] - mount[i, 3]
        x1 = mount[0, 0] * v_point[0] + mount[1, 0] * v_point[1] + mount[2, 0] * v_point[2]
        y1 = mount[0, 1] * v_point[0] + mount[1, 1] * v_point[1] + mount[2, 1] * v_point[2]
        w1 = mount[0, 2] * v_point[0] + mount[1, 2] * v_point[1] + mount[2, 2] * v_point[2]
        if not w1 > 0.0:
            return False
        u, v = distorted(lens_1, x1 / w1, y1 / w1)
        mapped[0], mapped[1] = u - shift * mapped[2], v - shift * mapped[3]
        iou[mapping] = overlap(sample[:4], mapped)
    return True
