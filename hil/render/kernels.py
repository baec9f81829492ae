"""Compiled passes over the image: visibility, interior of the faces, rotor discs.

All images are planes of shape (h, w); colour is (3, h, w) in the order B, G, R. ``ray_x`` and
``ray_y`` are the undistorted normalised coordinates of every pixel centre. Long rows are float32 so
that they vectorise.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import numpy as np

from hil.render.primitives import (
    BLADE_COS,
    BLADE_SIN,
    CELLS,
    CENTER_Z,
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
    SHARPNESS,
    SPIN,
)
from hil.render.scene import INK, MARKER, PAPER, PATTERN, PLATE_SCALE, PRINT, ROTOR
from path.compiled import inner, kernel

F = np.float32
ZERO = F(0.0)
HALF = F(0.5)
ONE = F(1.0)
TWO = F(2.0)
TINY = F(1e-6)

# edge buffer
INTERIOR = 0
EDGE = 1
MARKER_EDGE = 2

# columns of the tables of shades
FIRST = 0
ROWS = 1
TABLE_COLUMNS = 2

# opacity of a turning rotor: everywhere, and more where its blades are
FAINT = F(0.22)
LOBE = F(0.26)
BLADE_HALF = F(0.11)  # half the width of a blade at rest, in radii of the disc
HIDDEN = F(0.97)  # an edge this much deeper than what is drawn already, does not show


@kernel
def draw_faces(primitives, tags, count, ray_x, ray_y, inverse_z, owner, edges):
    """Visibility: 1/z and index of the nearest face (-1: none) at every pixel centre; which pixels
    an edge crosses.

    Nearer bodies should come first: the edges they hide are then left out.
    """
    inside = np.empty(ray_x.shape[1], np.float32)
    w_row = np.empty(ray_x.shape[1], np.float32)
    for p in range(count):
        if tags[p, KIND] == ROTOR:
            continue
        f = primitives[p].astype(np.float32)
        a0 = f[EDGES]
        a1 = f[EDGES + 1]
        a2 = f[EDGES + 2]
        b0 = f[EDGES + 3]
        b1 = f[EDGES + 4]
        b2 = f[EDGES + 5]
        c0 = f[EDGES + 6]
        c1 = f[EDGES + 7]
        c2 = f[EDGES + 8]
        d0 = f[EDGES + 9]
        d1 = f[EDGES + 10]
        d2 = f[EDGES + 11]
        w0 = f[INVERSE_Z]
        w1 = f[INVERSE_Z + 1]
        w2 = f[INVERSE_Z + 2]
        low = tags[p, COLUMN_0]
        high = tags[p, COLUMN_1]
        for r in range(tags[p, ROW_0], tags[p, ROW_1]):
            rx = ray_x[r, low:high]
            ry = ray_y[r, low:high]
            for c in range(rx.size):  # on its own, so that it vectorises
                x = rx[c]
                y = ry[c]
                inside[c] = min(
                    a0 * x + a1 * y + a2,
                    b0 * x + b1 * y + b2,
                    c0 * x + c1 * y + c2,
                    d0 * x + d1 * y + d2,
                )
                w_row[c] = w0 * x + w1 * y + w2
            for c in range(low, high):
                within = inside[c - low]
                w = w_row[c - low]
                if within < -ONE:
                    continue
                if within < ONE and w > HIDDEN * inverse_z[r, c]:
                    edges[r, c] = EDGE
                if within >= ZERO and w > inverse_z[r, c]:
                    inverse_z[r, c] = w
                    owner[r, c] = p


@inner
def marker_is_white(table, side, u, v):
    """Return whether the plate is white at (u, v), both 0..1 over the plate."""
    column = int(np.floor((u - 0.5) * (PLATE_SCALE * side) + 0.5 * side))
    row = int(np.floor((v - 0.5) * (PLATE_SCALE * side) + 0.5 * side))
    if column < 0 or row < 0 or column >= side or row >= side:
        return True
    return table[row, column] != 0


@inner
def _under_pixel(primitive, x, y, pixel):
    """The place where a ray meets a face, (u, v), and how far its pixel reaches from there over u
    and v.
    """
    over_x = primitive[INVERSE_Z]
    over_y = primitive[INVERSE_Z + 1]
    z = 1.0 / (over_x * x + over_y * y + primitive[INVERSE_Z + 2])
    u = (primitive[OVER_U] * x + primitive[OVER_U + 1] * y + primitive[OVER_U + 2]) * z
    v = (primitive[OVER_V] * x + primitive[OVER_V + 1] * y + primitive[OVER_V + 2]) * z
    reach_u = (abs(primitive[OVER_U] - u * over_x) + abs(primitive[OVER_U + 1] - u * over_y)) * (
        0.51 * z * pixel
    )
    reach_v = (abs(primitive[OVER_V] - v * over_x) + abs(primitive[OVER_V + 1] - v * over_y)) * (
        0.51 * z * pixel
    )
    return u, v, reach_u, reach_v


@inner
def _marker_pixel(primitive, table, side, x, y, pixel):
    """Colour of the plate at a ray when it is one over the whole pixel: 1 white, 0 black; -1 when
    it is not.
    """
    u, v, reach_u, reach_v = _under_pixel(primitive, x, y, pixel)
    if max(reach_u, reach_v) * PLATE_SCALE * side > 0.5:
        border = 0.5 + 0.5 / PLATE_SCALE
        outside = abs(u - 0.5) - reach_u > border - 0.5 or abs(v - 0.5) - reach_v > border - 0.5
        return 1 if outside else -1
    white = marker_is_white(table, side, u - reach_u, v - reach_v)
    for corner in range(1, 4):
        du = reach_u if corner & 1 else -reach_u
        dv = reach_v if corner >> 1 else -reach_v
        if marker_is_white(table, side, u + du, v + dv) != white:
            return -1
    return 1 if white else 0


@inner
def shade_at(shades, table, u, v):
    """Shade (0..255) of a pattern or print at (u, v), both 0..1 over it. ``table``: its row of the
    tables of shades.
    """
    rows = table[ROWS]
    columns = table[TABLE_COLUMNS]
    row = min(max(int(np.floor(v * rows)), 0), rows - 1)
    column = min(max(int(np.floor(u * columns)), 0), columns - 1)
    return int(shades[table[FIRST] + row * columns + column])


@inner
def _shaded_pixel(primitive, shades, table, x, y, pixel):
    """Shade of a pattern at a ray when it is one over the whole pixel; -1 when it is not."""
    u, v, reach_u, reach_v = _under_pixel(primitive, x, y, pixel)
    if reach_u * table[TABLE_COLUMNS] > 0.5 or reach_v * table[ROWS] > 0.5:
        return -1
    shade = shade_at(shades, table, u - reach_u, v - reach_v)
    for corner in range(1, 4):
        du = reach_u if corner & 1 else -reach_u
        dv = reach_v if corner >> 1 else -reach_v
        if shade_at(shades, table, u + du, v + dv) != shade:
            return -1
    return shade


@inner
def active_in_row(tags, count, r, active):
    """Faces whose bounds the row meets, into ``active``; how many, and the columns they span."""
    actives = 0
    low = 1 << 30
    high = 0
    for p in range(count):
        if tags[p, KIND] != ROTOR and tags[p, ROW_0] <= r < tags[p, ROW_1]:
            active[actives] = p
            actives += 1
            low = min(low, tags[p, COLUMN_0])
            high = max(high, tags[p, COLUMN_1])
    return actives, low, high


@kernel
def shade_faces(primitives, tags, count, looks, ray_x, ray_y, pixel, owner, edges, image):
    """Colour the interior of every face; pixels a marker's or other pattern crosses become
    MARKER_EDGE.

    looks: cells (m, s, s) and cells_per_side (m,) of the markers; shades, flat, and their tables
    (k, 3).
    """
    cells, cells_per_side, shades, tables = looks
    active = np.empty(count, np.int64)
    palette = np.empty((2, count, 3), np.uint8)
    for p in range(count):
        for k in range(3):
            palette[0, p, k] = np.uint8(primitives[p, COLOR + k] * (INK[0] / PAPER[0]) + 0.5)
            palette[1, p, k] = np.uint8(primitives[p, COLOR + k] + 0.5)
    for r in range(owner.shape[0]):
        _, low, high = active_in_row(tags, count, r, active)
        for c in range(low, high):
            p = owner[r, c]
            if p < 0 or edges[r, c] != INTERIOR:
                continue
            white = 1
            if tags[p, KIND] == PATTERN or tags[p, KIND] == PRINT:
                shade = _shaded_pixel(
                    primitives[p], shades, tables[tags[p, SHADES]], ray_x[r, c], ray_y[r, c], pixel
                )
                if shade < 0:
                    edges[r, c] = MARKER_EDGE
                    continue
                first = shade / 255.0
                for k in range(3):
                    level = primitives[p, COLOR + k] * first + primitives[p, SECOND + k] * (
                        1.0 - first
                    )
                    image[k, r, c] = np.uint8(level + 0.5)
                continue
            if tags[p, KIND] == MARKER:
                table = cells[tags[p, CELLS]]
                side = cells_per_side[tags[p, CELLS]]
                white = _marker_pixel(primitives[p], table, side, ray_x[r, c], ray_y[r, c], pixel)
                if white < 0:
                    edges[r, c] = MARKER_EDGE
                    continue
            for k in range(3):
                image[k, r, c] = palette[white, p, k]


@inner
def rotor_terms(primitives, p):
    """Return a rotor's terms for ``rotor_opacity``: u/z, v/z, 1/z (3 x 3), blades' direction,
    turning, sharpness.
    """
    return (
        (F(primitives[p, OVER_U]), F(primitives[p, OVER_U + 1]), F(primitives[p, OVER_U + 2])),
        (F(primitives[p, OVER_V]), F(primitives[p, OVER_V + 1]), F(primitives[p, OVER_V + 2])),
        (
            F(primitives[p, INVERSE_Z]),
            F(primitives[p, INVERSE_Z + 1]),
            F(primitives[p, INVERSE_Z + 2]),
        ),
        (F(primitives[p, BLADE_COS]), F(primitives[p, BLADE_SIN])),
        F(primitives[p, SPIN]),
        F(primitives[p, SHARPNESS]),
    )


@inner
def rotor_opacity(terms, x, y):
    """(opacity, 1/z) of a rotor at a ray; antialiased by itself. Turning: a faint disc with two
    blurred lobes.
    """
    u, v, w, blades, spin, sharpness = terms
    inverse_z = w[0] * x + w[1] * y + w[2]
    twice = TWO / max(inverse_z, TINY)
    a = twice * (u[0] * x + u[1] * y + u[2]) - ONE
    b = twice * (v[0] * x + v[1] * y + v[2]) - ONE
    radius2 = a * a + b * b
    sharp = sharpness * inverse_z
    # 1 - radius, to first order at the rim
    rim = min(max(HALF * (ONE - radius2) * sharp, ZERO), ONE)
    along = a * blades[0] + b * blades[1]
    across = abs(b * blades[0] - a * blades[1])
    lobe = along * along / max(radius2, TINY)
    turning = FAINT + LOBE * lobe * lobe * lobe * lobe
    still = min(max((BLADE_HALF - across) * sharp + HALF, ZERO), ONE)
    return rim * (turning if spin > ZERO else still), inverse_z


@inner
def _blend(color, opacity, out):
    for c in range(out.size):
        below = F(out[c])
        out[c] = np.uint8(np.int32(below + opacity[c] * (color - below) + HALF))


@kernel
def draw_rotors(primitives, order, rotors, tags, ray_x, ray_y, inverse_z, edges, image):
    """Blend the rotors (indices ``order[:rotors]``, farthest first) over what is behind them, edge
    pixels excepted.
    """
    row = np.empty(ray_x.shape[1], np.float32)
    for i in range(rotors):
        p = order[i]
        terms = rotor_terms(primitives, p)
        low = tags[p, COLUMN_0]
        high = tags[p, COLUMN_1]
        opacities = row[: high - low]
        for r in range(tags[p, ROW_0], tags[p, ROW_1]):
            rx = ray_x[r, low:high]
            ry = ray_y[r, low:high]
            before = inverse_z[r, low:high]
            edge = edges[r, low:high]
            for c in range(rx.size):
                opacity, w = rotor_opacity(terms, rx[c], ry[c])
                opacities[c] = opacity if (w > before[c]) & (edge[c] == INTERIOR) else ZERO
            for k in range(3):
                _blend(F(primitives[p, COLOR + k]), opacities, image[k, r, low:high])


@kernel
def order_rotors(primitives, tags, count, order):
    """Indices of the rotors, farthest centre first, into ``order``; returns how many."""
    rotors = 0
    for p in range(count):
        if tags[p, KIND] != ROTOR:
            continue
        i = rotors
        while i > 0 and primitives[order[i - 1], CENTER_Z] < primitives[p, CENTER_Z]:
            order[i] = order[i - 1]
            i -= 1
        order[i] = p
        rotors += 1
    return rotors
