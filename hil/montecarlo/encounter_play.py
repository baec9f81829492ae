"""One encounter in one kernel: frames, messages and arrivals in the order of time, through both compiled cycles.

Stamps are ns of D1's clock; ``clock_ns`` is how much later D2's stamps read there than they were taken.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math

import numpy as np

from flight.encounter import MISS, OWN_MISS, PAIR
from hil.geometric.kernels import kernel
from hil.montecarlo.encounter_method import (
    FLIPPED,
    NO_MARKER,
    NO_TRACK,
    NONE,
    OBLIQUE,
    POINT,
    POSE_SIGMA,
    POSE_UNCERTAIN,
    PRIOR_SIZE,
    SAMPLE,
    SILENT,
    SPREAD,
    STALE,
    ahead,
    at,
    choose,
    compare,
    gravity,
    observe,
    predict,
)
from hil.montecarlo.encounter_method import OUTSIDE as PRIOR_OUTSIDE
from hil.montecarlo.encounter_method import S as SECONDS
from hil.montecarlo.encounter_pose import POSE, UNCERTAIN, estimate
from hil.montecarlo.encounter_relative import (
    ACCEPTED,
    FUSED,
    HAS,
    STAMP,
    TURNED,
    expected,
    levelled,
    update,
)
from hil.montecarlo.encounter_sight import CLAIMED, FOUND, SIGMA, WHO, WHOSE
from hil.montecarlo.encounter_state import (
    CAPTURE,
    DONE,
    ENTRIES,
    FRAMES,
    IOU,
    KIND,
    MAX_PENDING,
    NEXT,
    NOW,
    OWN_FRAMES,
    PENDING,
    POSE_SIGMA_2,
    REASON,
    RECEIVER_FRAME,
    RIGHT,
    SAME,
    SENDER_FRAME,
    SEQUENCE,
    SIGMA_M,
    TARGET,
    TARGET_HEARD,
    TARGETS,
    WHOSE_2,
    Z_M,
)
from hil.montecarlo.encounter_window import PEER, complete, count, expire, restart, threshold


@kernel
def play(kinds, which, now, until_ns, clock_ns, setup, hold, whole, seen, state):
    """Everything that happens before ``until_ns``; ``counters[DONE]`` is set when the window is complete.

    Args:
        kinds, which, now: (e,) what happens, to which frame, and when: in the order of time.
    """
    counters = state.counters
    while counters[NEXT] < kinds.size and now[counters[NEXT]] < until_ns:
        event = counters[NEXT]
        counters[NEXT] += 1
        k, now_ns = which[event], now[event]
        if kinds[event] == SENDER_FRAME:
            _sender_frame(k, now_ns, setup, hold, seen, state)
            if complete(state.window, hold) and not counters[DONE]:
                counters[DONE] = 1
                if not whole:
                    return
        elif kinds[event] == TARGET_HEARD:
            _on_target(k, now_ns + clock_ns, setup.rules, seen, state)
        elif kinds[event] == RECEIVER_FRAME:
            _receiver_frame(k, setup, seen, state)
        else:
            _offer(k, now_ns, setup.rules, seen, state)


# --- D2 -----------------------------------------------------------------------------------------------------------


@kernel
def _on_target(k, now_ns, rules, seen, state):
    if not state.valid_1[k]:
        return
    count, stamp = state.counters[TARGETS], seen.stamp_1[k]
    if count and (seen.number_1[k] <= state.target_number[count - 1] or stamp <= state.target_stamp[count - 1]):
        return
    if stamp - now_ns > rules.max_future_ns or now_ns - stamp > rules.max_age_ns:
        return
    state.target_number[count], state.target_stamp[count] = seen.number_1[k], stamp
    values = state.target_values[count]
    values[:3] = state.samples[k, POINT : POINT + 3]
    values[3:6] = seen.gravity_v[k]
    values[6] = state.samples[k, SPREAD]
    state.counters[TARGETS] = count + 1


@kernel
def _receiver_frame(k, setup, seen, state):
    """D2's cycle: marker, pose, prior, box."""
    rules, stamp, count = setup.rules, seen.stamp_2[k], state.counters[TARGETS]
    stamps, values = state.target_stamp, state.target_values
    carried, down, spread = np.empty(TARGET), np.zeros(6), np.empty((6, 6))
    R, t, prior = state.pose_R[k], state.pose_t[k], np.empty(PRIOR_SIZE)
    level = gravity(stamps, state.target_valid, values, count, stamp, rules, carried, down)
    if level:
        down[3:] = seen.gravity_c[k]
    reason = _look(k, down, level, setup, seen, state, spread)
    if reason == NONE:
        _biased(R, t, seen)
        reason = _prior(stamp, count, spread, setup, state, R, t, carried, prior)
    out = state.candidate[k]
    if reason == NONE:
        row = choose(seen.found[k], seen.many[k], prior, rules)
        out[POSE_SIGMA_2] = prior[POSE_SIGMA]
        state.answered[k] = count - 1
        if row < 0:
            reason = -1 - row
        else:
            out[:4], out[WHOSE_2] = seen.found[k, row, :4], seen.found[k, row, WHOSE]
            state.size_1m[0], state.size_1m[1] = out[2] * prior[2], out[3] * prior[2]
    state.candidate_reason[k] = reason


@kernel
def _look(k, down, level, setup, seen, state, spread):
    """``MarkerView.look``: D2's pose, or why there is none."""
    stamp, f, row, heard = seen.stamp_2[k], state.filter, seen.markers[k], seen.heard[k]
    R_n_v = np.empty((3, 3))
    if level:
        levelled(down[:3], setup.R_b_v, seen.peer_yaw[heard - 1], R_n_v)
    known = f.ints[ACCEPTED, HAS] == 1 and stamp - f.ints[ACCEPTED, STAMP] <= setup.believes.coast_ns
    if known:
        known, u, v, half = expected(
            f, stamp, seen.R_n_c[k], R_n_v, level, seen.own_moves, k + 1, seen.peer_moves, heard, setup.lens_2,
            setup.reach_m, setup.believes,
        )  # fmt: skip
        if known:
            for i in range(4):
                if not (-half <= row[2 * i] - u < half and -half <= row[2 * i + 1] - v < half):
                    return NO_MARKER
    if not known:
        if stamp - state.searched[0] < setup.rules.search_period_ns:
            return NO_MARKER
        state.searched[0] = stamp
    if row[FOUND] == 0.0:
        return NO_MARKER
    R, t = state.pose_R[k], state.pose_t[k]
    corners = row[:8].reshape(4, 2)
    status = estimate(corners, row[CLAIMED], setup.printed, setup.lens_2, down, setup.limits, R, t, spread)
    if status != POSE:
        return POSE_UNCERTAIN if status == UNCERTAIN else OBLIQUE
    status = update(
        f, stamp, R, t, spread, seen.R_n_c[k], R_n_v, level, seen.own_moves, k + 1, seen.peer_moves, heard,
        setup.believes,
    )  # fmt: skip
    if status != FUSED:
        return FLIPPED if status == TURNED else POSE_UNCERTAIN
    return NONE


@kernel
def _biased(R, t, seen):
    turned = np.zeros((3, 3))
    for i in range(3):
        t[i] += seen.shift_c[i]
        for j in range(3):
            for m in range(3):
                turned[i, j] += seen.turn[i, m] * R[m, j]
    R[:] = turned


@kernel
def _prior(stamp, count, spread, setup, state, R, t, carried, prior):
    """``ReceiverCycle.prior``."""
    rules, stamps = setup.rules, state.target_stamp
    if count == 0:
        return SILENT
    if stamp <= stamps[count - 1]:
        if at(stamps, state.target_valid, state.target_values, count, stamp, rules.max_bracket_ns, carried)[0] < 0:
            return NO_TRACK
        sigma, beyond_s = carried[6], 0.0
    else:
        if not ahead(stamps, state.target_values, count, stamp, rules, carried):
            return SILENT
        sigma, beyond_s = state.target_values[count - 1, 6], (stamp - stamps[count - 1]) * SECONDS
    drift = 0.5 * rules.relative_accel_mps2 * beyond_s * beyond_s
    sigma = math.sqrt(sigma * sigma + rules.skew_m**2 + drift * drift)
    return predict(setup.lens_2, R, t, spread, carried[:3], sigma, rules, state.size_1m, prior)


# --- D1 -----------------------------------------------------------------------------------------------------------


@kernel
def _sender_frame(k, now_ns, setup, hold, seen, state):
    """D1's cycle: its own sample, then every candidate whose instant it has passed."""
    counters, pending = state.counters, state.pending
    counters[FRAMES] = k + 1
    depth_sigma = seen.own[k, SIGMA]
    reason = observe(seen.own[k], depth_sigma, setup.mount, setup.lens_1, setup.rules, state.samples[k])
    state.valid_1[k] = reason == NONE
    if reason != NONE:
        restart(state.window, seen.stamp_1[k])
        ints, _ = _entry(OWN_MISS, reason, now_ns, 0, seen.stamp_1[k], state)
        ints[OWN_FRAMES], ints[OWN_FRAMES + 1] = seen.number_1[k], seen.stamp_1[k]
    newest = max(seen.stamp_1[k], now_ns - setup.rules.max_age_ns)
    while counters[PENDING] and seen.stamp_2[pending[0]] <= newest:
        first = pending[0]
        counters[PENDING] -= 1
        pending[: counters[PENDING]] = pending[1 : counters[PENDING] + 1].copy()
        _judge(first, now_ns, setup, hold, seen, state)
    if not counters[PENDING]:
        expire(state.window, now_ns - setup.rules.max_age_ns, hold.max_gap_ns)


@kernel
def _offer(k, now_ns, rules, seen, state):
    counters, pending, capture = state.counters, state.pending, seen.stamp_2[k]
    if capture - now_ns > rules.max_future_ns or now_ns - capture > rules.max_age_ns:
        return
    if counters[PENDING] >= MAX_PENDING or seen.number_2[k] <= state.window[PEER]:
        return
    place = counters[PENDING]
    while place > 0 and seen.number_2[pending[place - 1]] > seen.number_2[k]:
        pending[place] = pending[place - 1]
        place -= 1
    pending[place] = k
    counters[PENDING] += 1


@kernel
def _judge(k, now_ns, setup, hold, seen, state):
    capture, candidate = seen.stamp_2[k], state.candidate[k]
    expire(state.window, capture, hold.max_gap_ns)
    sample, iou = np.empty(SAMPLE), np.zeros(2)
    before, after = at(
        seen.stamp_1, state.valid_1, state.samples, state.counters[FRAMES], capture, setup.rules.max_bracket_ns, sample
    )
    reason = state.candidate_reason[k]
    if reason == NONE and candidate[POSE_SIGMA_2] > setup.rules.max_pose_sigma_m:
        reason = POSE_UNCERTAIN
    if reason == NONE and abs(capture - state.target_stamp[state.answered[k]]) > setup.rules.max_age_ns:
        reason = STALE
    if reason == NONE and before < 0:
        reason = NO_TRACK
    if reason == NONE and not compare(
        sample, candidate, state.pose_R[k], state.pose_t[k], setup.mount, setup.lens_1, setup.lens_2, iou
    ):
        reason = PRIOR_OUTSIDE
    ints, floats = _entry(PAIR if reason == NONE else MISS, reason, now_ns, seen.number_2[k], capture, state)
    agrees = False
    if reason == NONE:
        z = sample[7]
        floats[IOU], floats[IOU + 1], floats[Z_M], floats[SIGMA_M] = iou[0], iou[1], z, candidate[POSE_SIGMA_2]
        ints[OWN_FRAMES], ints[OWN_FRAMES + 1] = seen.number_1[before], seen.stamp_1[before]
        ints[OWN_FRAMES + 2], ints[OWN_FRAMES + 3] = seen.number_1[after], seen.stamp_1[after]
        ints[RIGHT] = candidate[WHOSE_2] == 0.0
        ints[SAME] = candidate[WHOSE_2] == seen.own[before, WHO]
        agrees = iou[hold.mapping] >= threshold(z, hold.tau_min, hold.tau_max, hold.z0_m)
    count(state.window, hold, agrees, seen.number_2[k], capture, ints[OWN_FRAMES : OWN_FRAMES + 4])


@kernel
def _entry(kind, reason, now_ns, number, capture, state):
    row = state.counters[ENTRIES]
    state.counters[ENTRIES] += 1
    ints = state.ints[row]
    ints[KIND], ints[REASON], ints[NOW], ints[SEQUENCE], ints[CAPTURE] = kind, reason, now_ns, number, capture
    return ints, state.floats[row]
