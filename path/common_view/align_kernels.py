"""Alignment of two keyframes, compiled: how well a pose fits, and the step that betters it.

``R, t`` lead from the second levelled frame to the first: ``p1 = R p2 + t``. A step is six numbers:
a small turn from the left, then a translation. Lengths are compared as shares of the distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from path.arrays import Array, Singles, Whole
from path.compiled import inner, kernel


class View(NamedTuple):
    """A keyframe's depth in its levelled frame.

    Attributes:
        points, normals: (h * w, 3); a normal is zero where there is no plane.
        depth: (h, w) along the optical axis, m, 0 where unknown. ``lens``: (4,) in cells.
        R: (3, 3) from the camera's frame to the levelled one.
        samples: (n,) cells whose points are compared with the other view.
        law: standard deviation of depth at 1 m.
    """

    points: Array
    normals: Array
    depth: Singles
    lens: Array
    R: Array
    samples: Whole
    law: float


@inner
def seen_at(view: View, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return column, row and depth of a point of the levelled frame; depth -1 when not in view."""
    R = view.R
    forward = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    if not forward > 0.05:
        return 0.0, 0.0, -1.0
    right = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    down = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    u = view.lens[0] * right / forward + view.lens[2]
    v = view.lens[1] * down / forward + view.lens[3]
    height, width = view.depth.shape
    if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
        return 0.0, 0.0, -1.0
    return u, v, forward


@inner
def beyond(view: View, u: float, v: float, forward: float) -> float:
    """Return by which share of the measured depth a point lies behind it, negative in front; NaN
    where depth is unknown. Between two surfaces a point lies on neither, and counts as on one.
    """
    height, width = view.depth.shape
    i = min(int(u), width - 2)
    j = min(int(v), height - 2)
    a = float(view.depth[j, i])
    b = float(view.depth[j, i + 1])
    c = float(view.depth[j + 1, i])
    d = float(view.depth[j + 1, i + 1])
    least = min(a, b, c, d)
    if not least > 0.0:
        return math.nan
    most = max(a, b, c, d)
    if most < 1.1 * least:
        x = u - i
        y = v - j
        q = (1.0 - y) * ((1.0 - x) / a + x / b) + y * ((1.0 - x) / c + x / d)
        return forward * q - 1.0
    if forward < least:
        return forward / least - 1.0
    if forward > most:
        return forward / most - 1.0
    return 0.0


@kernel
def residuals(source: View, target: View, R: Array, t: Array, out: Array) -> None:
    """Write ``beyond`` of each sample of ``source`` into ``out``; NaN where it is not in view.
    ``R, t`` from the source's levelled frame to the target's.
    """
    for k in range(len(source.samples)):
        p = source.points[source.samples[k]]
        x = R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2] + t[0]
        y = R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2] + t[1]
        z = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2]
        u, v, forward = seen_at(target, x, y, z)
        out[k] = beyond(target, u, v, forward) if forward > 0.0 else math.nan


@inner
def fit_of(r: float) -> float:
    """Return the log-likelihood ratio of one residual: of the right pose to any other in the prior.

    Near zero as measured on a kitchen, where it was the same from 15 to 90 degrees between the
    views: right ones are within 1.3 % of the distance, or hidden behind something nearer. In front,
    -3.2 was measured against any pose of the prior; what competes here fits nearly everywhere
    already, and is told by this: -6 was better on the tuned half of the frames.
    """
    near = 3.2 - 0.5 * (r / 0.013) ** 2
    if r < 0.0:
        return max(near, -6.0)
    if r < 0.4:
        return max(near, -3.0)
    return -1.1


@inner
def compared(source: View, target: View, R: Array, t: Array) -> tuple[float, int, int, int]:
    """Return the sum of ``fit_of`` over a view's samples, how many are in the other view, agree
    within 2.5 % of the distance, and lie in front of what was measured by more than 5 %.
    """
    total = 0.0
    seen = 0
    agree = 0
    conflict = 0
    for k in range(len(source.samples)):
        p = source.points[source.samples[k]]
        x = R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2] + t[0]
        y = R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2] + t[1]
        z = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2]
        u, v, forward = seen_at(target, x, y, z)
        if not forward > 0.0:
            continue
        r = beyond(target, u, v, forward)
        if math.isnan(r):
            continue
        total += fit_of(r)
        seen += 1
        agree += 1 if abs(r) < 0.025 else 0
        conflict += 1 if r < -0.05 else 0
    return total, seen, agree, conflict


@inner
def turned_back(R: Array, t: Array, back: Array, origin: Array) -> None:
    """Write the inverse of a pose into ``back`` (3, 3) and ``origin`` (3,)."""
    for i in range(3):
        origin[i] = 0.0
        for j in range(3):
            back[i, j] = R[j, i]
            origin[i] -= R[j, i] * t[j]


@kernel
def depth_fit(one: View, two: View, R: Array, t: Array) -> tuple[float, int, int, int]:
    """Return ``compared`` of both ways together."""
    back = np.empty((3, 3))
    origin = np.empty(3)
    turned_back(R, t, back, origin)
    a, b, c, d = compared(two, one, R, t)
    e, f, g, h = compared(one, two, back, origin)
    return a + e, b + f, c + g, d + h


class Matches(NamedTuple):
    """Loose matches of corners, ordered by the first keyframe's corner.

    Attributes:
        first, second: (n, 3) in both levelled frames.
        corner: (n,) number of the first's corner.
        gain: (n,) likelihood ratio of the descriptors' distance.
    """

    first: Array
    second: Array
    corner: Whole
    gain: Array


@inner
def share_of(matches: Matches, k: int, R: Array, t: Array, sigma: float) -> float:
    """Return how well a match fits a pose, 0..1, and nothing beyond three sigma.

    ``sigma``: as a share of the distance.
    """
    p = matches.second[k]
    q = matches.first[k]
    square = 0.0
    far = 0.0
    for i in range(3):
        off = R[i, 0] * p[0] + R[i, 1] * p[1] + R[i, 2] * p[2] + t[i] - q[i]
        square += off * off
        far += q[i] * q[i]
    square /= sigma * sigma * far
    return math.exp(-0.5 * square) if square < 9.0 else 0.0


@kernel
def corner_fit(
    matches: Matches, R: Array, t: Array, sigma: float, repeated: float
) -> tuple[float, int]:
    """Return the log-likelihood ratio of all corners, and how many have a match that fits.

    Args:
        repeated: how many of one keyframe's corners are corners in the other, 0..1.
    """
    total = 0.0
    count = 0
    k = 0
    n = len(matches.corner)
    while k < n:
        corner = matches.corner[k]
        gain = 0.0
        while k < n and matches.corner[k] == corner:
            gain += share_of(matches, k, R, t, sigma) * matches.gain[k]
            k += 1
        total += math.log(1.0 - repeated + repeated * gain)
        count += 1 if repeated * gain > 1.0 else 0
    return total, count


@inner
def add_row(A: Array, b: Array, row: Array, r: float, weight: float) -> None:
    """Add one residual with its row of derivatives to the normal equations."""
    for i in range(6):
        b[i] -= weight * row[i] * r
        for j in range(i + 1):
            A[i, j] += weight * row[i] * row[j]


@inner
def add_planes(
    source: View, target: View, R: Array, t: Array, ways: int, bound: float, share: float, A: Array, b: Array
) -> int:  # fmt: skip
    """Add point-to-plane residuals of a view's samples on the other's planes; return how many.

    Args:
        R, t: from the second frame to the first. ``ways``: 1 when the source is the second view,
            -1 when it is the first.
        bound: of a residual, as a share of the distance. ``share``: of a residual's information
            that counts, for neighbours err together.
    """
    row = np.empty(6)
    p = np.empty(3)
    width = target.depth.shape[1]
    used = 0
    for k in range(len(source.samples)):
        own = source.points[source.samples[k]]
        for i in range(3):
            p[i] = own[i] - t[i]
        if ways > 0:
            x = R[0, 0] * own[0] + R[0, 1] * own[1] + R[0, 2] * own[2] + t[0]
            y = R[1, 0] * own[0] + R[1, 1] * own[1] + R[1, 2] * own[2] + t[1]
            z = R[2, 0] * own[0] + R[2, 1] * own[1] + R[2, 2] * own[2] + t[2]
        else:
            x = R[0, 0] * p[0] + R[1, 0] * p[1] + R[2, 0] * p[2]
            y = R[0, 1] * p[0] + R[1, 1] * p[1] + R[2, 1] * p[2]
            z = R[0, 2] * p[0] + R[1, 2] * p[1] + R[2, 2] * p[2]
        u, v, forward = seen_at(target, x, y, z)
        if not forward > 0.0:
            continue
        cell = round(v) * width + round(u)
        s = target.points[cell]
        n = target.normals[cell]
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            continue
        off = n[0] * (x - s[0]) + n[1] * (y - s[1]) + n[2] * (z - s[2])
        if abs(off) > bound * forward:
            continue
        apart2 = (x - s[0]) ** 2 + (y - s[1]) ** 2 + (z - s[2]) ** 2
        if apart2 > (2.0 * bound + 1.5 / target.lens[0]) ** 2 * forward * forward:
            continue
        sigma2 = (0.005 * forward) ** 2 + 2.0 * (target.law * forward * forward) ** 2
        relative = off / (bound * forward)
        weight = share * (1.0 - relative * relative) ** 2 / sigma2
        if ways > 0:
            for i in range(3):
                row[3 + i] = n[i]
            ax = x - t[0]
            ay = y - t[1]
            az = z - t[2]
            r = off
        else:
            # The plane moves, and the point stays.
            for i in range(3):
                row[3 + i] = R[i, 0] * n[0] + R[i, 1] * n[1] + R[i, 2] * n[2]
            ax = R[0, 0] * s[0] + R[0, 1] * s[1] + R[0, 2] * s[2]
            ay = R[1, 0] * s[0] + R[1, 1] * s[1] + R[1, 2] * s[2]
            az = R[2, 0] * s[0] + R[2, 1] * s[1] + R[2, 2] * s[2]
            r = -off
        row[0] = ay * row[5] - az * row[4]
        row[1] = az * row[3] - ax * row[5]
        row[2] = ax * row[4] - ay * row[3]
        add_row(A, b, row, r, weight)
        used += 1
    return used


@inner
def add_corners(
    matches: Matches, R: Array, t: Array, sigma: float, gate: float, repeated: float, independent: float,
    A: Array, b: Array,
) -> None:  # fmt: skip
    """Add corners by their matches, each with the probability that it is right.

    Args:
        sigma: of a match; ``gate``: what decides which are right: both shares of the distance.
        independent: corners that may count as independent.
    """
    row = np.empty(6)
    own_A = np.zeros((6, 6))
    own_b = np.zeros(6)
    right = 0.0
    a = np.empty(3)
    n = len(matches.corner)
    k = 0
    while k < n:
        first = k
        gain = 0.0
        while k < n and matches.corner[k] == matches.corner[first]:
            gain += share_of(matches, k, R, t, gate) * matches.gain[k]
            k += 1
        if not gain > 0.0:
            continue
        for m in range(first, k):
            part = share_of(matches, m, R, t, gate) * matches.gain[m]
            part *= repeated / (1.0 - repeated + repeated * gain)
            if part < 0.01:
                continue
            q = matches.first[m]
            p = matches.second[m]
            far2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
            weight = part / (sigma * sigma * far2)
            right += part
            for i in range(3):
                a[i] = R[i, 0] * p[0] + R[i, 1] * p[1] + R[i, 2] * p[2]
            for i in range(3):
                row[:] = 0.0
                row[3 + i] = 1.0
                # d(turn x a): e_i . (w x a) = w . (a x e_i)
                j = (i + 1) % 3
                last = (i + 2) % 3
                row[j] = a[last]
                row[last] = -a[j]
                add_row(own_A, own_b, row, a[i] + t[i] - q[i], weight)
    share = min(1.0, independent / max(right, 1e-9))
    for i in range(6):
        b[i] += share * own_b[i]
        for j in range(i + 1):
            A[i, j] += share * own_A[i, j]


class Known(NamedTuple):
    """What is known before: yaw and translation with their information, and that of a tilt."""

    yaw: float
    t: Array
    of_yaw: float
    of_t: Array
    of_tilt: float


@inner
def add_known(known: Known, R: Array, t: Array, A: Array, b: Array) -> None:
    """Add what is known before to the normal equations."""
    row = np.zeros(6)
    row[0] = 1.0
    add_row(A, b, row, -R[1, 2], known.of_tilt)
    row[0], row[1] = 0.0, 1.0
    add_row(A, b, row, R[0, 2], known.of_tilt)
    row[1], row[2] = 0.0, 1.0
    off = math.atan2(R[1, 0], R[0, 0]) - known.yaw
    off = math.atan2(math.sin(off), math.cos(off))
    add_row(A, b, row, off, known.of_yaw)
    row[2] = 0.0
    for i in range(3):
        row[3 + i] = 1.0
        add_row(A, b, row, t[i] - known.t[i], known.of_t[i])
        row[3 + i] = 0.0
