"""Compiled antialiasing: pixels that an edge crosses are sampled 16 times, or 64 times where a
marker is in them.

An edge is that of a face, or one between two cells of a marker or of another pattern.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import numpy as np

from hil.render.kernels import (
    INTERIOR,
    active_in_row,
    marker_is_white,
    rotor_opacity,
    rotor_terms,
    shade_at,
)
from hil.render.primitives import (
    CELLS,
    COLOR,
    COLUMN_0,
    COLUMN_1,
    EDGES,
    INVERSE_Z,
    KIND,
    OVER_U,
    OVER_V,
    ROW_0,
    ROW_1,
    SECOND,
    SHADES,
)
from hil.render.scene import INK, MARKER, PAPER, PATTERN, PRINT
from path.arrays import Array
from path.compiled import inner, kernel

MOST = 48  # primitives that are looked at in one pixel; more than any view of the scene has


def hammersley(count: int) -> Array:
    """Hammersley's points in a pixel, shape (2, count), within -0.5..0.5; ``count`` is a power of
    two.
    """
    index = np.arange(count)
    reversed_bits = np.zeros(count)
    for bit in range(count.bit_length() - 1):
        reversed_bits += ((index >> bit) & 1) * 0.5 ** (bit + 1)
    return np.stack(((index + 0.5) / count, reversed_bits + 0.5 / count)) - 0.5


@inner
def _at(primitives, p, k, ray):
    """The linear function at column ``k`` of a primitive, at a pixel's centre."""
    return primitives[p, k] * ray[0] + primitives[p, k + 1] * ray[1] + primitives[p, k + 2]


@inner
def _gather(primitives, tags, active, actives, c, ray, found, local):
    """Faces that may cover some of a pixel, into ``found``; returns how many.

    ray (6,): x, y and their derivatives dx/du, dx/dv, dy/du, dy/dv. local (MOST, 5, 3): of the four
    edges and of 1/z, the value at the pixel's centre and its change per column and row.
    """
    number = 0
    for i in range(actives):
        p = active[i]
        if c < tags[p, COLUMN_0] or c >= tags[p, COLUMN_1] or number == MOST:
            continue
        e = 0
        while e < 4 and _at(primitives, p, EDGES + 3 * e, ray) >= -1.0:
            e += 1
        if e < 4:
            continue
        for e in range(5):
            k = EDGES + 3 * e if e < 4 else INVERSE_Z
            local[number, e, 0] = _at(primitives, p, k, ray)
            local[number, e, 1] = primitives[p, k] * ray[2] + primitives[p, k + 1] * ray[4]
            local[number, e, 2] = primitives[p, k] * ray[3] + primitives[p, k + 1] * ray[5]
        found[number] = p
        number += 1
    return number


@inner
def _nearest(local, number, ground_w, ray, du, dv, best, nearest):
    """Index of the nearest face and its 1/z at every sample; ``number`` and the ground's where
    there is none.
    """
    local[number, 4, 0] = max(0.0, ground_w[0] * ray[0] + ground_w[1] * ray[1] + ground_w[2])
    along_u = ground_w[0] * ray[2] + ground_w[1] * ray[4]
    along_v = ground_w[0] * ray[3] + ground_w[1] * ray[5]
    for s in range(du.size):
        best[s] = number
        nearest[s] = local[number, 4, 0] + along_u * du[s] + along_v * dv[s]
    for i in range(number):
        a = local[i, 0, 0]
        ax = local[i, 0, 1]
        ay = local[i, 0, 2]
        b = local[i, 1, 0]
        bx = local[i, 1, 1]
        by = local[i, 1, 2]
        c = local[i, 2, 0]
        cx = local[i, 2, 1]
        cy = local[i, 2, 2]
        d = local[i, 3, 0]
        dx = local[i, 3, 1]
        dy = local[i, 3, 2]
        w0 = local[i, 4, 0]
        wx = local[i, 4, 1]
        wy = local[i, 4, 2]
        for s in range(du.size):
            u = du[s]
            v = dv[s]
            inside = min(
                a + ax * u + ay * v, b + bx * u + by * v, c + cx * u + cy * v, d + dx * u + dy * v
            )
            w = w0 + wx * u + wy * v
            better = (inside >= 0.0) & (w > nearest[s])
            nearest[s] = w if better else nearest[s]
            best[s] = i if better else best[s]


@inner
def _over(primitives, p, x, y):
    """Return the place on a face where a ray meets it: (u, v)."""
    z = 1.0 / (
        primitives[p, INVERSE_Z] * x
        + primitives[p, INVERSE_Z + 1] * y
        + primitives[p, INVERSE_Z + 2]
    )
    u = (primitives[p, OVER_U] * x + primitives[p, OVER_U + 1] * y + primitives[p, OVER_U + 2]) * z
    v = (primitives[p, OVER_V] * x + primitives[p, OVER_V + 1] * y + primitives[p, OVER_V + 2]) * z
    return u, v


@inner
def _shares(primitives, tags, found, number, looks, ray, du, dv, best, shares, light):
    """Share of the pixel that every face shows (last: the ground), and the share times what its
    colour is taken at.
    """
    cells, cells_per_side, shade_texels, tables = looks
    for i in range(number + 1):
        samples = 0
        for s in range(best.size):
            samples += best[s] == i
        shares[i] = samples / best.size
        light[i] = shares[i]
        if samples == 0 or i == number:
            continue
        p = found[i]
        inked = 0
        if tags[p, KIND] == PATTERN or tags[p, KIND] == PRINT:
            total = 0
            shade_table = tables[tags[p, SHADES]]
            for s in range(best.size):
                if best[s] == i:
                    x = ray[0] + ray[2] * du[s] + ray[3] * dv[s]
                    y = ray[1] + ray[4] * du[s] + ray[5] * dv[s]
                    u, v = _over(primitives, p, x, y)
                    total += shade_at(shade_texels, shade_table, u, v)
            light[i] = total / (255.0 * best.size)
            continue
        if tags[p, KIND] != MARKER:
            continue
        table = cells[tags[p, CELLS]]
        side = cells_per_side[tags[p, CELLS]]
        for s in range(best.size):
            if best[s] == i:
                x = ray[0] + ray[2] * du[s] + ray[3] * dv[s]
                y = ray[1] + ray[4] * du[s] + ray[5] * dv[s]
                u, v = _over(primitives, p, x, y)
                inked += not marker_is_white(table, side, u, v)
        light[i] -= inked / best.size * (1.0 - INK[0] / PAPER[0])


@inner
def _rotors_at(primitives, tags, order, rotors, r, c, ray, opacity, rotor_w):
    """Opacity and 1/z of every rotor at a pixel's centre; whether any is there."""
    there = False
    for i in range(rotors):
        p = order[i]
        opacity[i], rotor_w[i] = 0.0, 0.0
        if tags[p, ROW_0] <= r < tags[p, ROW_1] and tags[p, COLUMN_0] <= c < tags[p, COLUMN_1]:
            opacity[i], rotor_w[i] = rotor_opacity(
                rotor_terms(primitives, p), np.float32(ray[0]), np.float32(ray[1])
            )
            there = there or opacity[i] > 0.0
    return there


@inner
def _under_rotors(primitives, k, level, share, w, order, rotors, opacity, rotor_w):
    """``level`` (channel k, already times ``share``) of something at 1/z = w, seen through the
    rotors before it.
    """
    for i in range(rotors):
        if opacity[i] > 0.0 and rotor_w[i] > w:
            level += opacity[i] * (share * primitives[order[i], COLOR + k] - level)
    return level


@kernel
def draw_edges(
    primitives, tags, count, order, rotors, looks, ground_w, rays, samples, edges, image
):
    """Sample every pixel that ``edges`` marks. ``image`` holds the ground there.

    looks: as in ``kernels.shade_faces``. ground_w (3,): coefficients of the ground's 1/z. rays: x,
    y and their derivatives dx/du, dx/dv, dy/du, dy/dv, each (h, w). samples: (few, many), each (2,
    n).
    """
    few, many = samples
    active = np.empty(count, np.int64)
    found = np.empty(MOST, np.int64)
    local = np.empty((MOST + 1, 5, 3))
    opacity = np.empty(rotors)
    rotor_w = np.empty(rotors)
    every_best = np.empty(many.shape[1], np.int64)
    every_w = np.empty(many.shape[1])
    shares = np.empty(MOST + 1)
    light = np.empty(MOST + 1)
    ray = np.empty(6)
    for r in range(edges.shape[0]):
        actives, low, high = active_in_row(tags, count, r, active)
        for c in range(low, high):
            if edges[r, c] == INTERIOR:
                continue
            for k in range(6):
                ray[k] = rays[k][r, c]
            number = _gather(primitives, tags, active, actives, c, ray, found, local)
            points = few
            for i in range(number):
                if tags[found[i], KIND] == MARKER or tags[found[i], KIND] == PRINT:
                    points = many
            du = points[0]
            dv = points[1]
            n = points.shape[1]
            best = every_best[:n]
            nearest = every_w[:n]
            _nearest(local, number, ground_w, ray, du, dv, best, nearest)
            _shares(primitives, tags, found, number, looks, ray, du, dv, best, shares, light)
            blended = _rotors_at(primitives, tags, order, rotors, r, c, ray, opacity, rotor_w)
            for k in range(3):
                total = 0.0
                for i in range(number + 1):
                    color = primitives[found[i], COLOR + k] if i < number else float(image[k, r, c])
                    level = color * light[i]
                    # the second colour; black for a marker
                    if i < number and light[i] != shares[i]:
                        level += primitives[found[i], SECOND + k] * (shares[i] - light[i])
                    if blended:
                        w = local[i, 4, 0]
                        level = _under_rotors(
                            primitives, k, level, shares[i], w, order, rotors, opacity, rotor_w
                        )
                    total += level
                image[k, r, c] = np.uint8(total + 0.5)
