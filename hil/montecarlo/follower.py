"""D1's follower in loops: the rules and limits of ``flight.tracking.association.follow``, compiled."""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math

import numpy as np

from flight.tracking.association import AMBIGUITY, DEPTH_FLOOR_M, DEPTH_SIGMAS, MIN_SCORE
from flight.tracking.target_track import (
    ACCELERATION_SIGMA_MPS2,
    GATE_FLOOR_M,
    GATE_LEAST_M,
    GATE_MOST_M,
    MEASUREMENT_SIGMA_M,
    RIVAL_S,
    RIVAL_SHARE,
    UNSEEN_REACH_M,
)
from path.compiled import inner

# Columns of a detection: x, y, w, h, score, whose box it is.
SCORE, WHOSE = 4, 5
FOUND_COLUMNS = 6
# The follower: position 3, velocity 3, variances pp, pv, vv, stamp in s; the nearest other object, m, and when, s;
# whether it has begun: D1 is given the right object, and has followed it for a while.
POSITION, VELOCITY, PP, PV, VV, AT, RIVAL, RIVAL_AT, BEGUN = 0, 3, 6, 7, 8, 9, 10, 11, 12
FOLLOWER_SIZE = 13
NOTHING = -1  # instead of a row


@inner
def predicted(follower, at_s, point):
    """Fills ``point`` with the followed object's place at an instant; returns its standard deviation per axis."""
    dt = max(0.0, at_s - follower[AT])
    for i in range(3):
        point[i] = follower[POSITION + i] + dt * follower[VELOCITY + i]
    spread = (ACCELERATION_SIGMA_MPS2 * dt * dt / 2.0) ** 2
    return math.sqrt(follower[PP] + 2.0 * dt * follower[PV] + dt * dt * follower[VV] + spread)


@inner
def update(follower, measured, at_s):
    dt = at_s - follower[AT]
    if dt < 0.0:
        return
    q, r = ACCELERATION_SIGMA_MPS2**2, MEASUREMENT_SIGMA_M**2
    pp = follower[PP] + 2.0 * dt * follower[PV] + dt * dt * follower[VV] + q * dt**4 / 4.0
    pv = follower[PV] + dt * follower[VV] + q * dt**3 / 2.0
    vv = follower[VV] + q * dt * dt
    gain_p, gain_v = pp / (pp + r), pv / (pp + r)
    for i in range(3):
        position = follower[POSITION + i] + dt * follower[VELOCITY + i]
        innovation = measured[i] - position
        follower[POSITION + i] = position + gain_p * innovation
        follower[VELOCITY + i] += gain_v * innovation
    follower[PP], follower[PV], follower[VV] = (1.0 - gain_p) * pp, (1.0 - gain_p) * pv, vv - gain_v * pv
    follower[AT] = at_s


@inner
def gate_of(follower, sigma, at_s):
    most = GATE_MOST_M
    if at_s - follower[RIVAL_AT] <= RIVAL_S:
        most = min(most, RIVAL_SHARE * follower[RIVAL])
    return max(GATE_LEAST_M, min(3.0 * sigma + GATE_FLOOR_M, most))


@inner
def reach_of(follower, at_s):
    dt = max(0.0, at_s - follower[AT])
    sigma = math.sqrt(follower[PP] + 2.0 * dt * follower[PV] + dt * dt * follower[VV])
    return min(GATE_FLOOR_M + 3.0 * sigma + 0.5 * ACCELERATION_SIGMA_MPS2 * dt * dt, UNSEEN_REACH_M)


@inner
def rival_px(found, many, row):
    """Distance of the nearest other detection from the chosen one."""
    nearest = np.inf
    for i in range(many):
        if i != row and found[i, SCORE] >= MIN_SCORE:
            off = math.hypot(
                found[i, 0] + 0.5 * found[i, 2] - found[row, 0] - 0.5 * found[row, 2],
                found[i, 1] + 0.5 * found[i, 3] - found[row, 1] - 0.5 * found[row, 3],
            )
            nearest = min(nearest, off)
    return nearest


@inner
def others_near(found, many, row, reach, picked):
    """Rows of the detections nearest to the chosen one, ``NOTHING`` where there is none, into ``picked``."""
    picked[:] = NOTHING
    before = 0.0
    for j in range(picked.size):
        best = reach
        for i in range(many):
            if i != row and found[i, SCORE] >= MIN_SCORE:
                off = math.hypot(
                    found[i, 0] + 0.5 * found[i, 2] - found[row, 0] - 0.5 * found[row, 2],
                    found[i, 1] + 0.5 * found[i, 3] - found[row, 1] - 0.5 * found[row, 3],
                )
                if before < off < best:
                    best, picked[j] = off, i
        if picked[j] == NOTHING:
            return
        before = best


@inner
def designated_row(found, many):
    """Row of the target's own detection, and no doubt about it."""
    for i in range(many):
        if found[i, WHOSE] == 0.0 and found[i, SCORE] >= MIN_SCORE:
            return i, False
    return NOTHING, False


@inner
def chosen_row(found, many, u, v, gate, alone):
    """Row of the detection nearest to a pixel, ``NOTHING`` when none is in the gate; whether another may be meant too.

    ``alone``: any other may.
    """
    first, second, row = np.inf, np.inf, -1
    for i in range(many):
        if found[i, SCORE] < MIN_SCORE:
            continue
        off = math.hypot(found[i, 0] + 0.5 * found[i, 2] - u, found[i, 1] + 0.5 * found[i, 3] - v)
        if off < first:
            first, second, row = off, first, i
        elif off < second:
            second = off
    if row < 0 or first > gate:
        return NOTHING, False
    return row, (alone and second < np.inf) or first > AMBIGUITY * second


@inner
def depth_shows(depth, depth_sigma, ray_x, ray_y, R_n_c, t_n_c, point, sigma):
    """Returns whether a depth on a ray puts the object where it can be."""
    off2 = 0.0
    for i in range(3):
        along = R_n_c[i, 0] * ray_x + R_n_c[i, 1] * ray_y + R_n_c[i, 2]
        off2 += (t_n_c[i] + depth * along - point[i]) ** 2
    return math.sqrt(off2) <= DEPTH_FLOOR_M + DEPTH_SIGMAS * math.hypot(sigma, depth_sigma)
