"""Cars and depth of the geometric perception: visible outlines, noisy detections, depth over a box.
Compiled.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.geometric.kernels import (
    DRAWN,
    EYE,
    X0,
    X1,
    Y0,
    Y1,
    gauss,
    mix,
    nearest,
    sample_rays,
    uniform,
)
from path.compiled import inner, kernel
from path.target.kernels import MAD_TO_SIGMA, OUTLIER_SIGMAS, median
from path.target.place import CORRELATED_PIXELS, MEDIAN_TO_MEAN


class TargetNoise(NamedTuple):
    """The difference of the detector's boxes to the true visible outlines; see
    ``hil.geometric.noise``.
    """

    bias_left_px: float
    bias_top_px: float
    bias_right_px: float
    bias_bottom_px: float
    edge_sigma_px: float
    outlier_rate: float
    outlier_sigma_px: float
    cut_rate: float
    cut_px: float
    miss_rate: float
    score: float
    score_sigma: float
    odd_rate: float
    odd_score: float
    merge_contact: float
    merge_slope: float
    touching_odd_rate: float
    hidden_share: float
    occluded_sigma_px: float
    occluded_odd_rate: float
    border_score: float
    min_side_px: float
    max_side_px: float

    def shifted(self, edges_px: tuple[float, float, float, float]) -> TargetNoise:
        """Return the noise with a bias more on the left, top, right and bottom edge."""
        left, top, right, bottom = edges_px
        return self._replace(
            bias_left_px=self.bias_left_px + left,
            bias_top_px=self.bias_top_px + top,
            bias_right_px=self.bias_right_px + right,
            bias_bottom_px=self.bias_bottom_px + bottom,
        )


class DepthSettings(NamedTuple):
    """The method's settings about depth (``path.config``)."""

    min_m: float
    max_m: float
    center_fraction: float
    min_valid: float
    min_pixels: float
    max_spread_m: float
    sigma_at_1m_m: float


# Columns of what is seen of a car: visible box, share of it that is visible, its neighbour in the
# image and the length of their common border in cells over the cells across the box.
SHARE = 4
TOUCHED = 5
CONTACT = 6
SEEN_COLUMNS = 7
CELLS = 16  # across the box of a car that something may hide
NEIGHBOUR_PX = 4.0


@kernel
def outlines(boxes, extents, per_car, lens, seen):
    """Find the visible part of each car, others and the other drone in front of it taken into
    account.

    ``seen`` (cars, SEEN_COLUMNS) is filled; share 0: nothing is visible.
    """
    n = CELLS
    pixels = np.empty((n * n, 2))
    rays = np.empty((n * n, 2))
    own = np.empty(n * n, np.bool_)
    who = np.empty(n * n, np.int64)
    close = np.empty(extents.shape[0], np.int64)
    for car in range(seen.shape[0]):
        extent = extents[car]
        out = seen[car]
        x0 = max(extent[X0], -0.5)
        y0 = max(extent[Y0], -0.5)
        x1 = min(extent[X1], lens[9] - 0.5)
        y1 = min(extent[Y1], lens[10] - 0.5)
        out[X0], out[Y0], out[X1], out[Y1] = x0, y0, x1, y1
        out[SHARE], out[TOUCHED], out[CONTACT] = 1.0, -1.0, 0.0
        if extent[DRAWN] == 0.0 or x1 <= x0 or y1 <= y0:
            out[SHARE] = 0.0
            continue
        crowd = 0
        for body in range(extents.shape[0]):
            other = extents[body]
            if body != car and other[DRAWN] == 1.0:
                apart_x = max(other[X0] - x1, x0 - other[X1])
                apart_y = max(other[Y0] - y1, y0 - other[Y1])
                if max(apart_x, apart_y) < NEIGHBOUR_PX:
                    close[crowd] = body
                    crowd += 1
        if crowd == 0:
            continue
        wide = x1 - x0 + 2.0 * NEIGHBOUR_PX
        high = y1 - y0 + 2.0 * NEIGHBOUR_PX
        left = x0 - NEIGHBOUR_PX
        top = y0 - NEIGHBOUR_PX
        sample_rays(lens, left, top, left + wide, top + high, n, pixels, rays)
        for k in range(n * n):
            u = pixels[k, 0]
            v = pixels[k, 1]
            x = rays[k, 0]
            y = rays[k, 1]
            best, who[k] = nearest(boxes, extents, per_car, x, y, u, v, car)
            own[k] = who[k] == car
            for body in close[:crowd]:
                z = nearest(boxes, extents, per_car, x, y, u, v, body)[0]
                if z < best:
                    best = z
                    who[k] = body
        _visible_part(own, who, car, seen.shape[0], left, top, wide / n, high / n, out)


@inner
def _visible_part(own, who, car, cars, left, top, cell_w, cell_h, out):
    """Shrink a car's box to the cells where it is visible (``who``) of those it covers (``own``),
    and note contacts.
    """
    n = CELLS
    bounds = np.empty((2, 4))  # of all, of the visible: first and last column, first and last row
    for k in range(2):
        bounds[k, 0] = bounds[k, 2] = n
        bounds[k, 1] = bounds[k, 3] = -1.0
    total = 0
    visible = 0
    for k in range(n * n):
        i = k // n
        j = k % n
        if own[k]:
            total += 1
            _widen(bounds[0], i, j)
        if who[k] == car:
            visible += 1
            _widen(bounds[1], i, j)
    if total == 0:
        return
    out[SHARE] = visible / total
    if bounds[1, 0] > bounds[0, 0]:
        out[X0] = max(out[X0], left + bounds[1, 0] * cell_w)
    if bounds[1, 2] > bounds[0, 2]:
        out[Y0] = max(out[Y0], top + bounds[1, 2] * cell_h)
    if bounds[1, 1] < bounds[0, 1]:
        out[X1] = min(out[X1], left + (bounds[1, 1] + 1.0) * cell_w)
    if bounds[1, 3] < bounds[0, 3]:
        out[Y1] = min(out[Y1], top + (bounds[1, 3] + 1.0) * cell_h)
    _contacts(who, car, cars, out)


@inner
def _contacts(who, car, cars, out):
    """The car with the longest common border in the image."""
    n = CELLS
    border = np.zeros(cars)
    for k in range(n * n):
        if who[k] == car:
            if k % n > 0:
                _touch(border, who[k - 1], car)
            if k % n < n - 1:
                _touch(border, who[k + 1], car)
            if k >= n:
                _touch(border, who[k - n], car)
            if k < n * n - n:
                _touch(border, who[k + n], car)
    longest = 0
    for other in range(cars):
        if border[other] > border[longest]:
            longest = other
    out[TOUCHED] = longest if border[longest] > 0.0 else -1
    out[CONTACT] = border[longest] / n


@inner
def _widen(bounds, row, column):
    bounds[0], bounds[1] = min(bounds[0], column), max(bounds[1], column)
    bounds[2], bounds[3] = min(bounds[2], row), max(bounds[3], row)


@inner
def _touch(border, other, car):
    if other != car and 0 <= other < border.size:
        border[other] += 1.0


# --- detections ---

# Columns of a detection: x, y, w, h, score.
DETECTION_COLUMNS = 5
# questions, for the random numbers
TARGETS = 1
TOUCHING = 2


@kernel
def detections(seen, lens, region, noise, key, slow_key, found):
    """The detector's boxes from what is visible of each car (``outlines``).

    Args:
        region: x0 y0 x1 y1; only boxes centred in it.
        slow_key: changes only now and then: for what goes wrong for a while.
        found: (cars, DETECTION_COLUMNS): filled; the number of rows that are used is returned.
    """
    cars = seen.shape[0]
    count = 0
    taken = np.zeros(cars, np.bool_)
    draws = np.empty(6)
    off = np.empty(2)
    edges = np.empty(4)
    for car in range(cars):
        if taken[car] or seen[car, SHARE] <= noise.hidden_share:
            continue
        for k in range(4):
            edges[k] = seen[car, k]
        own = mix(mix(key, TARGETS), car)
        slow = mix(mix(slow_key, TARGETS), car)
        gauss(own, draws)
        odd = (
            _join(seen, car, taken, noise, slow_key, edges)
            or uniform(mix(slow, 100)) < noise.odd_rate
        )
        spread = noise.edge_sigma_px
        if seen[car, SHARE] < 1.0:
            spread = noise.occluded_sigma_px
            odd = odd or uniform(mix(slow, 101)) < noise.occluded_odd_rate
        if uniform(mix(own, 102)) < noise.miss_rate:
            continue
        if uniform(mix(slow, 103)) < noise.outlier_rate:
            gauss(slow, off)
            draws[int(4.0 * uniform(mix(slow, 104)))] = (
                off[0] * noise.outlier_sigma_px / max(spread, 1e-9)
            )
        if uniform(mix(slow, 105)) < noise.cut_rate:
            gauss(mix(slow, 105), off)
            draws[1] = abs(off[0]) * noise.cut_px / max(spread, 1e-9)
        whole = _shift(edges, lens, noise, spread, draws)
        w = edges[2] - edges[0]
        h = edges[3] - edges[1]
        u = edges[0] + 0.5 * w
        v = edges[1] + 0.5 * h
        if w <= 0.0 or h <= 0.0 or not noise.min_side_px <= max(w, h) <= noise.max_side_px:
            continue
        if region[0] <= u < region[2] and region[1] <= v < region[3]:
            score = min(max(noise.score + noise.score_sigma * draws[4], 0.0), 1.0)
            score *= (noise.odd_score if odd else 1.0) * (1.0 if whole else noise.border_score)
            row = found[count]
            row[0], row[1], row[2], row[3], row[4] = edges[0], edges[1], w, h, score
            count += 1
    return count


@inner
def _join(seen, car, taken, noise, key, edges):
    """Widen ``edges`` to both cars when two that touch in the image are taken for one; whether that
    one looks odd.
    """
    other = int(seen[car, TOUCHED])
    cars = seen.shape[0]
    if other < 0 or taken[other] or seen[other, SHARE] <= noise.hidden_share:
        return False
    contact = max(seen[car, CONTACT], seen[other, CONTACT])
    unnoticed = 1.0 / (1.0 + math.exp(-noise.merge_slope * (contact - noise.merge_contact)))
    chance = uniform(mix(mix(key, TOUCHING), min(car, other) * cars + max(car, other)))
    if chance >= unnoticed + noise.touching_odd_rate:
        return False
    taken[other] = True
    edges[0], edges[1] = min(edges[0], seen[other, X0]), min(edges[1], seen[other, Y0])
    edges[2], edges[3] = max(edges[2], seen[other, X1]), max(edges[3], seen[other, Y1])
    return chance >= unnoticed


@inner
def _shift(edges, lens, noise, spread, draws):
    """Add bias and noise to the edges that the image's border does not cut; whether there are only
    such.
    """
    cut_0 = edges[0] <= -0.5
    cut_1 = edges[1] <= -0.5
    cut_2 = edges[2] >= lens[9] - 0.5
    cut_3 = edges[3] >= lens[10] - 0.5
    edges[0] += 0.0 if cut_0 else noise.bias_left_px + spread * draws[0]
    edges[1] += 0.0 if cut_1 else noise.bias_top_px + spread * draws[1]
    edges[2] += 0.0 if cut_2 else noise.bias_right_px + spread * draws[2]
    edges[3] += 0.0 if cut_3 else noise.bias_bottom_px + spread * draws[3]
    return not (cut_0 or cut_1 or cut_2 or cut_3)


# --- depth ---
DEPTH_CELLS = 10  # rays across the asked part of a box


@kernel
def depth_over(boxes, extents, per_car, frame, lens, hidden, box, settings, noise, key):
    """Return a registered depth camera's value over the middle of a box, as ``path.target.place``
    has it, on rays.

    Args:
        hidden: nothing is measured on cars.
        box: x y w h.
        settings: the method's, as ``DepthSettings``.
        noise: of one pixel, and of all together, at 1 m, in m; it grows with the square of the
            depth.

    Returns:
        Depth and its standard deviation in m; negative when there is none.
    """
    fraction = settings.center_fraction
    sigma_1m = settings.sigma_at_1m_m
    n = DEPTH_CELLS
    x0 = box[0] + 0.5 * (1.0 - fraction) * box[2]
    y0 = box[1] + 0.5 * (1.0 - fraction) * box[3]
    x1 = x0 + fraction * box[2]
    y1 = y0 + fraction * box[3]
    x0 = max(x0, -0.5)
    y0 = max(y0, -0.5)
    x1 = min(x1, lens[9] - 0.5)
    y1 = min(y1, lens[10] - 0.5)
    asked = (x1 - x0) * (y1 - y0)
    if x1 <= x0 or y1 <= y0:
        return -1.0, -1.0
    pixels = np.empty((n * n, 2))
    rays = np.empty((n * n, 2))
    draws = np.empty(n * n + 1)
    found = np.empty(n * n)
    off = np.empty(n * n)
    sample_rays(lens, x0, y0, x1, y1, n, pixels, rays)
    gauss(key, draws)
    count = 0
    for k in range(n * n):
        x = rays[k, 0]
        y = rays[k, 1]
        z, who = nearest(boxes, extents, per_car, x, y, pixels[k, 0], pixels[k, 1], -1)
        sinking = frame[2] * x + frame[5] * y + frame[8]
        floor = -frame[EYE + 2] / sinking if sinking < -1e-9 else np.inf
        if floor < z:
            z = floor
            who = -1
        z += noise[0] * z * z * draws[k]
        if settings.min_m <= z <= settings.max_m and not (
            hidden and 0 <= who < extents.shape[0] - 1
        ):
            found[count] = z
            count += 1
    valid = asked * count / (n * n)
    if count == 0 or valid < max(settings.min_pixels, settings.min_valid * asked):
        return -1.0, -1.0
    middle = median(found, count)
    for k in range(count):
        off[k] = abs(found[k] - middle)
    spread = max(MAD_TO_SIGMA * median(off, count), sigma_1m * middle * middle)
    if spread > settings.max_spread_m:
        return -1.0, -1.0
    kept = 0
    for k in range(count):
        if abs(found[k] - middle) <= OUTLIER_SIGMAS * spread:
            found[kept] = found[k]
            kept += 1
    z = median(found, kept)
    independent = max(1.0, valid / CORRELATED_PIXELS)
    sigma = math.hypot(sigma_1m * z * z, MEDIAN_TO_MEAN * spread / math.sqrt(independent))
    return z + noise[1] * z * z * draws[n * n], sigma
