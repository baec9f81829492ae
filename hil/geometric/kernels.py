"""The arithmetic of the geometric perception: bodies made of boxes, projected and hit by rays.
Compiled.

A body is a car or the other drone. Camera coordinates throughout (x right, y down, z forward,
metres), pixels distorted.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math

import numpy as np

from path.compiled import inner, kernel

# Columns of a placed box: rotation camera -> box (3 x 3), the camera's centre in box coordinates,
# half sides; x0 y0 x1 y1 in the image, with a margin for edges that the lens bends.
TURN = 0
CENTRE = 9
HALF = 12
RECT = 15
BOX_COLUMNS = 19
MARGIN_PX = 4.0
# Columns of a body's extent in the image: corners of its bounding box, nearest depth, whether it
# can be drawn.
X0 = 0
Y0 = 1
X1 = 2
Y1 = 3
NEAR = 4
DRAWN = 5
EXTENT_COLUMNS = 6
# The camera in the world: rotation world -> camera by rows, then its centre.
EYE = 9
FRAME_COLUMNS = 12
# The lens: fx fy cx cy k1 k2 p1 p2 k3 width height, largest radius at which the distortion is
# one-to-one.
NEAREST_M = 0.05
UNDISTORT_STEPS = 8


@inner
def distorted(lens, x, y):
    """Pixel of normalised coordinates."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
    u = x * radial + 2.0 * lens[6] * x * y + lens[7] * (r2 + 2.0 * x * x)
    v = y * radial + lens[6] * (r2 + 2.0 * y * y) + 2.0 * lens[7] * x * y
    return lens[0] * u + lens[2], lens[1] * v + lens[3]


@inner
def ray(lens, u, v):
    """Normalised coordinates of a pixel, by Newton's method with the derivative of the radial part
    only.
    """
    xd = (u - lens[2]) / lens[0]
    yd = (v - lens[3]) / lens[1]
    x = xd
    y = yd
    for _ in range(UNDISTORT_STEPS):
        pu, pv = distorted(lens, x, y)
        r2 = x * x + y * y
        slope = 1.0 + r2 * (3.0 * lens[4] + r2 * (5.0 * lens[5] + r2 * 7.0 * lens[8]))
        x -= ((pu - lens[2]) / lens[0] - xd) / slope
        y -= ((pv - lens[3]) / lens[1] - yd) / slope
    return x, y


@inner
def _place_box(R, t, parts, part, lens, boxes, k, extents, body):
    """Box ``part`` of a body with pose R, t (body to camera): fills its row ``k`` and widens the
    body's extent, unless a corner is behind the camera or beyond its lens. Returns how many are
    behind, and how many beyond.
    """
    for i in range(3):  # box coordinates = axes^T R^T (p_c - t) - axes^T centre
        for j in range(3):
            boxes[k, TURN + 3 * i + j] = (
                R[j, 0] * parts[part, 6 + i]
                + R[j, 1] * parts[part, 9 + i]
                + R[j, 2] * parts[part, 12 + i]
            )
        along = (
            parts[part, 6 + i] * parts[part, 0] + parts[part, 9 + i] * parts[part, 1]
            + parts[part, 12 + i] * parts[part, 2]
        )  # fmt: skip
        turned = (
            boxes[k, TURN + 3 * i] * t[0]
            + boxes[k, TURN + 3 * i + 1] * t[1]
            + boxes[k, TURN + 3 * i + 2] * t[2]
        )
        boxes[k, CENTRE + i] = -turned - along
        boxes[k, HALF + i] = parts[part, 3 + i]
    xx = boxes[k, TURN]
    xy = boxes[k, TURN + 1]
    xz = boxes[k, TURN + 2]
    yx = boxes[k, TURN + 3]
    yy = boxes[k, TURN + 4]
    yz = boxes[k, TURN + 5]
    zx = boxes[k, TURN + 6]
    zy = boxes[k, TURN + 7]
    zz = boxes[k, TURN + 8]
    ex = boxes[k, CENTRE]
    ey = boxes[k, CENTRE + 1]
    ez = boxes[k, CENTRE + 2]
    half_x = parts[part, 3]
    half_y = parts[part, 4]
    half_z = parts[part, 5]
    widest = lens[11] * lens[11]
    x0 = y0 = np.inf
    x1 = y1 = -np.inf
    near = extents[body, NEAR]
    behind = outside = 0
    for corner in range(8):
        p = (half_x if corner & 1 else -half_x) - ex
        q = (half_y if corner & 2 else -half_y) - ey
        r = (half_z if corner & 4 else -half_z) - ez
        z = xz * p + yz * q + zz * r
        if z < NEAREST_M:
            behind += 1
            continue
        x = (xx * p + yx * q + zx * r) / z
        y = (xy * p + yy * q + zy * r) / z
        if x * x + y * y > widest:
            outside += 1
            continue
        u, v = distorted(lens, x, y)
        x0 = min(x0, u)
        y0 = min(y0, v)
        x1 = max(x1, u)
        y1 = max(y1, v)
        near = min(near, z)
    if behind + outside > 0:
        return behind, outside
    extents[body, NEAR] = near
    extents[body, X0], extents[body, Y0] = min(extents[body, X0], x0), min(extents[body, Y0], y0)
    extents[body, X1], extents[body, Y1] = max(extents[body, X1], x1), max(extents[body, Y1], y1)
    boxes[k, RECT], boxes[k, RECT + 1] = x0 - MARGIN_PX, y0 - MARGIN_PX
    boxes[k, RECT + 2], boxes[k, RECT + 3] = x1 + MARGIN_PX, y1 + MARGIN_PX
    return behind, outside


@inner
def _place_body(R_c_w, eye, R_w, at, row, parts, lens, boxes, first, extents, body, R, t):
    """The boxes of one body with orientation R_w and position ``at[row]`` in the world; its pose R,
    t is worked out.
    """
    extents[body, X0] = extents[body, Y0] = extents[body, NEAR] = np.inf
    extents[body, X1] = extents[body, Y1] = -np.inf
    extents[body, DRAWN] = 1.0 if parts.shape[0] > 0 else 0.0
    for i in range(3):
        t[i] = 0.0
        for j in range(3):
            R[i, j] = R_c_w[i, 0] * R_w[0, j] + R_c_w[i, 1] * R_w[1, j] + R_c_w[i, 2] * R_w[2, j]
            t[i] += R_c_w[i, j] * (at[row, j] - eye[j])
    for part in range(parts.shape[0]):
        behind, outside = _place_box(R, t, parts, part, lens, boxes, first + part, extents, body)
        if behind + outside > 0:
            extents[body, DRAWN] = 0.0


@inner
def _place_standing(R_c_w, eye, standing, lens, boxes, first, extents, body, drone):
    """Add boxes of the world to the last body, the other drone, which has ``drone`` boxes before
    them. One that surrounds the camera in part may be anywhere in the image.
    """
    if extents[body, DRAWN] == 0.0:
        for k in range(first - drone, first):
            boxes[k, RECT] = np.inf
    extents[body, DRAWN] = 1.0
    t = np.empty(3)
    for i in range(3):
        t[i] = -(R_c_w[i, 0] * eye[0] + R_c_w[i, 1] * eye[1] + R_c_w[i, 2] * eye[2])
    for part in range(standing.shape[0]):
        k = first + part
        behind, outside = _place_box(R_c_w, t, standing, part, lens, boxes, k, extents, body)
        if behind == 8:
            boxes[k, RECT] = np.inf
        elif behind + outside > 0:
            for side in range(2):
                boxes[k, RECT + side] = extents[body, X0 + side] = -np.inf
                boxes[k, RECT + 2 + side] = extents[body, X1 + side] = np.inf


@kernel
def place(
    R_w_b,
    t_w_b,
    R_b_c,
    t_b_c,
    lens,
    things,
    car,
    other_R,
    other_t,
    drone,
    standing,
    boxes,
    extents,
    frame,
):
    """Put every body before the camera.

    Args:
        R_w_b, t_w_b, R_b_c, t_b_c: the camera's drone in the world, the camera on it.
        things: (n, 4) position (m, world) and yaw of each car; car: (b, 15) centre, half sides,
            axes of its boxes, or (n b, 15) when each has its own.
        other_R, other_t: the other drone in the world; drone: (d, 15) its boxes, none when there is
            no other drone.
        standing: (m, 15) boxes of the world, none of them an object.
        boxes: (n b + d + m, BOX_COLUMNS), extents: (n + 1, EXTENT_COLUMNS): filled, car by car, the
            other drone last, and with it what stands there.
        frame: (12,) filled: rotation world to camera by rows, the camera's centre in the world.
    """
    R_c_w = np.empty((3, 3))
    eye = np.empty(3)
    for i in range(3):
        for j in range(3):
            R_c_w[i, j] = (
                R_w_b[j, 0] * R_b_c[0, i] + R_w_b[j, 1] * R_b_c[1, i] + R_w_b[j, 2] * R_b_c[2, i]
            )
            frame[3 * i + j] = R_c_w[i, j]
        eye[i] = R_w_b[i, 0] * t_b_c[0] + R_w_b[i, 1] * t_b_c[1] + R_w_b[i, 2] * t_b_c[2] + t_w_b[i]
        frame[EYE + i] = eye[i]
    turn = np.zeros((3, 3))
    R = np.empty((3, 3))
    t = np.empty(3)
    turn[2, 2] = 1.0
    cars = things.shape[0]
    per_car = (boxes.shape[0] - drone.shape[0] - standing.shape[0]) // max(cars, 1)
    for body in range(cars):
        turn[0, 0] = turn[1, 1] = math.cos(things[body, 3])
        turn[1, 0] = math.sin(things[body, 3])
        turn[0, 1] = -turn[1, 0]
        first = body * per_car
        own = first if car.shape[0] > per_car else 0
        shape = car[own : own + per_car]
        _place_body(R_c_w, eye, turn, things, body, shape, lens, boxes, first, extents, body, R, t)
    _place_body(
        R_c_w, eye, other_R, other_t.reshape(1, 3), 0, drone, lens, boxes, cars * per_car, extents, cars, R, t
    )  # fmt: skip
    if standing.shape[0] > 0:
        first = boxes.shape[0] - standing.shape[0]
        _place_standing(R_c_w, eye, standing, lens, boxes, first, extents, cars, drone.shape[0])


@inner
def _hit(boxes, k, x, y):
    """Depth at which the ray (x, y, 1) enters a box; inf when it misses."""
    enter = 0.0
    leave = np.inf
    for i in range(3):
        speed = (
            boxes[k, TURN + 3 * i] * x + boxes[k, TURN + 3 * i + 1] * y + boxes[k, TURN + 3 * i + 2]
        )
        start = boxes[k, CENTRE + i]
        half = boxes[k, HALF + i]
        if abs(speed) < 1e-12:
            if abs(start) > half:
                return np.inf
            continue
        a = (-half - start) / speed
        b = (half - start) / speed
        enter = max(enter, min(a, b))
        leave = min(leave, max(a, b))
        if enter > leave:
            return np.inf
    return enter if enter > 0.0 else np.inf


@inner
def nearest(boxes, extents, per_car, x, y, u, v, only):
    """Depth and body of the first box that the ray of pixel (u, v) meets; inf and -1 for none.

    ``per_car``: boxes of a car; those of the other drone come after all cars'. ``only``: look at
    this body alone; -1 for all.
    """
    best = np.inf
    who = -1
    cars = extents.shape[0] - 1
    for body in range(cars + 1) if only < 0 else range(only, only + 1):
        if extents[body, DRAWN] == 0.0:
            continue
        if (
            u < extents[body, X0]
            or u > extents[body, X1]
            or v < extents[body, Y0]
            or v > extents[body, Y1]
        ):
            continue
        for k in range(body * per_car, (body + 1) * per_car if body < cars else boxes.shape[0]):
            if (
                u < boxes[k, RECT]
                or u > boxes[k, RECT + 2]
                or v < boxes[k, RECT + 1]
                or v > boxes[k, RECT + 3]
            ):
                continue
            z = _hit(boxes, k, x, y)
            if z < best:
                best = z
                who = body
    return best, who


@inner
def sample_rays(lens, x0, y0, x1, y1, n, pixels, rays):
    """Centres of n x n cells of a rectangle: pixels and rays (n * n, 2), rays interpolated between
    its corners.
    """
    corners = np.empty((4, 2))
    corners[0, 0], corners[0, 1] = ray(lens, x0, y0)
    corners[1, 0], corners[1, 1] = ray(lens, x1, y0)
    corners[2, 0], corners[2, 1] = ray(lens, x0, y1)
    corners[3, 0], corners[3, 1] = ray(lens, x1, y1)
    for i in range(n):
        b = (i + 0.5) / n
        for j in range(n):
            a = (j + 0.5) / n
            k = i * n + j
            pixels[k, 0], pixels[k, 1] = x0 + a * (x1 - x0), y0 + b * (y1 - y0)
            for m in range(2):
                top = (1.0 - a) * corners[0, m] + a * corners[1, m]
                rays[k, m] = (1.0 - b) * top + b * ((1.0 - a) * corners[2, m] + a * corners[3, m])


# --- random numbers ---
# A hash of seed, frame and question: no question changes the answer to another, and the same
# question has the same answer however often it is asked.


@inner
def mix(state, value):
    """Fold an integer into a 64-bit state (the finaliser of splitmix64)."""
    z = (np.uint64(state) ^ np.uint64(value)) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@kernel
def fold(key, value):
    """Mixes a value into a key as ``mix``, but in 63 bits: a key that can go through Python."""
    return np.int64(mix(key, value) >> np.uint64(1))


@kernel
def fold_both(key, value, other):
    """Mixes one value into a key, and then another."""
    return np.int64(mix(np.int64(mix(key, value) >> np.uint64(1)), other) >> np.uint64(1))


@kernel
def uniform(state):
    """Return a number in (0, 1) from a mixed state."""
    return (float(state >> np.uint64(11)) + 0.5) / 9007199254740992.0


@inner
def gauss(key, out):
    """Fill with standard normal numbers (Box-Muller)."""
    for i in range(0, out.size, 2):
        radius = math.sqrt(-2.0 * math.log(uniform(mix(key, 2 * i))))
        angle = 2.0 * math.pi * uniform(mix(key, 2 * i + 1))
        out[i] = radius * math.cos(angle)
        if i + 1 < out.size:
            out[i + 1] = radius * math.sin(angle)
