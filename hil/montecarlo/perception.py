"""The detections of both cameras, frame by frame: the kernels of the geometric perception in loops.

The same kernels, noise and rules as ``hil.geometric.perception``; D1 follows by ``hil.montecarlo.follower``.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flight.tracking.association import AMBIGUITY, MIN_DESCENT, RIVAL_REACH_M, UNSEEN_S
from flight.tracking.target_track import RIVAL_S
from hil.geometric.kernels import BOX_COLUMNS, EXTENT_COLUMNS, FRAME_COLUMNS, distorted, fold, place
from hil.geometric.markers import LARGEST_SCALE, MarkerNoise, marker
from hil.geometric.perception import DEPTH, MARKERS, SLOW_FRAMES, SLOW_MARKERS, SLOW_TARGETS, TARGETS
from hil.geometric.targets import (
    DETECTION_COLUMNS,
    SEEN_COLUMNS,
    SHARE,
    DepthSettings,
    TargetNoise,
    depth_over,
    detections,
    outlines,
)
from hil.montecarlo.follower import (
    AT,
    BEGUN,
    FOUND_COLUMNS,
    NOTHING,
    POSITION,
    RIVAL,
    RIVAL_AT,
    WHOSE,
    chosen_row,
    depth_shows,
    designated_row,
    gate_of,
    others_near,
    predicted,
    reach_of,
    rival_px,
    update,
)
from path.compiled import inner, kernel
from path.marker.kernels import undistort

# Columns of what D1 has of a frame: status, box, depth and its standard deviation, whose box it is.
STATUS, BOX, Z, SIGMA, WHO = 0, 1, 5, 6, 7
# And of the objects nearest to that: box, depth (negative: none) and its standard deviation; width 0: there is none.
OTHERS, OTHERS_MOST, OTHER_COLUMNS = 8, 3, 6
OTHERS_REACH_M = 1.0
OWN_COLUMNS = OTHERS + OTHERS_MOST * OTHER_COLUMNS
SEEN, LOST, UNCLEAR = 0.0, 1.0, 2.0
# Columns of a found marker: corners u v, claimed standard deviation; whether there is one.
CLAIMED, FOUND = 8, 9
MARKER_COLUMNS = 10
NOBODY = -1.0


class MonteCarloCamera(NamedTuple):
    """One camera and its perception: the truth of it.

    Attributes:
        R_b_c, t_b_c: on its drone. lens: as in ``hil.geometric.kernels``.
        target, drone: boxes of a target and of the other drone.
        seed: of its random numbers.
    """

    R_b_c: np.ndarray
    t_b_c: np.ndarray
    lens: np.ndarray
    target: np.ndarray
    drone: np.ndarray
    noise: TargetNoise
    seed: int


class Depths(NamedTuple):
    """The depth camera; ``scale``, ``bias_m``: how much too far it measures."""

    settings: DepthSettings
    sigma_m: float
    common_sigma_m: float
    scale: float
    bias_m: float


class CameraPath(NamedTuple):
    """Frames of one drone: number (n,), poses of both drones in the world, everything on the ground (n, m, 4)."""

    frame: np.ndarray
    R: np.ndarray
    t: np.ndarray
    other_R: np.ndarray
    other_t: np.ndarray
    things: np.ndarray


@inner
def _before(camera, flown, k, things, ids, boxes, extents, frame):
    """Put everything before the camera; how many things there are."""
    count = 0
    for i in range(flown.things.shape[1]):
        if not math.isnan(flown.things[k, i, 0]):
            things[count] = flown.things[k, i]
            ids[count] = i
            count += 1
    place(
        flown.R[k], flown.t[k], camera.R_b_c, camera.t_b_c, camera.lens, things[:count], camera.target,
        flown.other_R[k], flown.other_t[k], camera.drone,
        boxes[: count * camera.target.shape[0] + camera.drone.shape[0]], extents[: count + 1], frame,
    )  # fmt: skip
    return count


@inner
def _boxes_of(camera, number, count, ids, boxes, extents, region, seen, rows, found):
    """The detector's boxes of a frame and whose they are: that object's whose outline is the nearest."""
    bodies = boxes[: count * camera.target.shape[0] + camera.drone.shape[0]]
    outlines(bodies, extents[: count + 1], camera.target.shape[0], camera.lens, seen[:count])
    key = fold(fold(camera.seed, number), TARGETS)
    slow_key = fold(fold(camera.seed, number // SLOW_FRAMES), SLOW_TARGETS)
    many = detections(seen[:count], camera.lens, region, camera.noise, key, slow_key, rows)
    for i in range(many):
        found[i, :DETECTION_COLUMNS] = rows[i]
        u, v = rows[i, 0] + 0.5 * rows[i, 2], rows[i, 1] + 0.5 * rows[i, 3]
        best = np.inf
        for j in range(count):
            if seen[j, SHARE] > 0.0:
                off = math.hypot(0.5 * (seen[j, 0] + seen[j, 2]) - u, 0.5 * (seen[j, 1] + seen[j, 3]) - v)
                if off < best:
                    best, found[i, WHOSE] = off, ids[j]
    return many


@inner
def _tell_others(camera, depths, number, bodies, extents, frame, hidden, found, row, reach, out):
    """Boxes and depths of the detections nearest to the chosen one, into D1's row of a frame."""
    picked = np.empty(OTHERS_MOST, np.int64)
    others_near(found, found.shape[0], row, reach, picked)
    for j in range(OTHERS_MOST):
        if picked[j] == NOTHING:
            return
        at, other = OTHERS + j * OTHER_COLUMNS, found[picked[j]]
        out[at : at + 4] = other[:4]
        box = (other[0], other[1], other[2], other[3])
        key = fold(fold(fold(fold(camera.seed, number), DEPTH), int(16.0 * box[0])), int(16.0 * box[1]))
        noise = (depths.sigma_m, depths.common_sigma_m)
        depth, out[at + 5] = depth_over(
            bodies, extents, camera.target.shape[0], frame, camera.lens, hidden, box, depths.settings, noise, key
        )
        out[at + 4] = depth * depths.scale + depths.bias_m if depth > 0.0 else depth


@kernel
def sees(lens, x, y, z):
    """Returns whether the camera sees a point, and its pixel."""
    if not z > 0.1 or x * x + y * y > (lens[11] * z) ** 2:
        return False, 0.0, 0.0
    u, v = distorted(lens, x / z, y / z)
    return -0.5 <= u < lens[9] - 0.5 and -0.5 <= v < lens[10] - 0.5, u, v


@kernel
def sender_sees(first, last, camera, flown, depths, holes, times, lost_s, R_n_c, t_n_c, lens, follower, own):
    """D1's frames ``first`` to ``last``: its detector, its follower, its depth camera.

    Args:
        holes: (n,) whether nothing is measured on objects.
        times: (n,) s. lost_s: a target that was not seen for longer is given up.
        R_n_c, t_n_c: the camera as D1 believes it to be, (n, 3, 3) and (n, 3); lens: as it believes.
        follower: (FOLLOWER_SIZE,), changed.
        own: (n, OWN_COLUMNS), filled.
    """
    most = flown.things.shape[1]
    things, ids = np.empty((most, 4)), np.empty(most, np.int64)
    boxes, extents = (
        np.empty((most * camera.target.shape[0] + camera.drone.shape[0], BOX_COLUMNS)),
        np.empty((most + 1, 6)),
    )
    frame, region, point, measured = np.empty(FRAME_COLUMNS), np.empty(4), np.empty(3), np.empty(3)
    seen, rows = np.empty((most, SEEN_COLUMNS)), np.empty((most, DETECTION_COLUMNS))
    found = np.empty((most, FOUND_COLUMNS))
    for k in range(first, last):
        out = own[k]
        out[STATUS], out[Z], out[WHO] = LOST, -1.0, NOBODY
        sigma = predicted(follower, times[k], point)
        x, y, z = _in_camera(R_n_c[k], t_n_c[k], point)
        visible, u, v = sees(lens, x, y, z)
        if not visible or (follower[BEGUN] and times[k] - follower[AT] > lost_s):
            continue
        gate_m, scale = gate_of(follower, sigma, times[k]), lens[0] / z
        unseen = times[k] - follower[AT] > UNSEEN_S
        gate = scale * gate_m
        reach = scale * max(reach_of(follower, times[k]) if unseen else 0.0, gate_m / AMBIGUITY, RIVAL_REACH_M)
        region[0], region[1], region[2], region[3] = u - reach, v - reach, u + reach, v + reach
        count = _before(camera, flown, k, things, ids, boxes, extents, frame)
        many = _boxes_of(camera, flown.frame[k], count, ids, boxes, extents, region, seen, rows, found)
        row, unsure = chosen_row(found, many, u, v, gate, unseen) if follower[BEGUN] else designated_row(found, many)
        if row != NOTHING:
            rival = rival_px(found, many, row)
            if rival < np.inf and (rival / scale <= follower[RIVAL] or times[k] - follower[RIVAL_AT] > RIVAL_S):
                follower[RIVAL], follower[RIVAL_AT] = rival / scale, times[k]
        if row == NOTHING or unsure:
            out[STATUS] = UNCLEAR if unsure else LOST
            continue
        out[STATUS], out[WHO] = SEEN, found[row, WHOSE]
        box = (found[row, 0], found[row, 1], found[row, 2], found[row, 3])
        out[BOX], out[BOX + 1], out[BOX + 2], out[BOX + 3] = box
        key = fold(fold(fold(fold(camera.seed, flown.frame[k]), DEPTH), int(16.0 * box[0])), int(16.0 * box[1]))
        bodies = boxes[: count * camera.target.shape[0] + camera.drone.shape[0]]
        depth, out[SIGMA] = depth_over(
            bodies,
            extents[: count + 1],
            camera.target.shape[0],
            frame,
            camera.lens,
            holes[k],
            box,
            depths.settings,
            (depths.sigma_m, depths.common_sigma_m),
            key,
        )
        ray_x, ray_y = _ray(lens, box[0] + 0.5 * box[2], box[1] + 0.5 * box[3])
        depth = depth * depths.scale + depths.bias_m if depth > 0.0 else depth
        _tell_others(
            camera, depths, flown.frame[k], bodies, extents[: count + 1], frame, holes[k], found[:many], row,
            OTHERS_REACH_M * scale, out,
        )  # fmt: skip
        if depth > 0.0 and (
            not follower[BEGUN] or depth_shows(depth, out[SIGMA], ray_x, ray_y, R_n_c[k], t_n_c[k], point, sigma)
        ):
            out[Z] = depth
        else:  # it is taken to be as high as it was
            falling = R_n_c[k, 2, 0] * ray_x + R_n_c[k, 2, 1] * ray_y + R_n_c[k, 2, 2]
            if falling < MIN_DESCENT:
                continue
            depth = (follower[POSITION + 2] - t_n_c[k, 2]) / falling
        for i in range(3):
            along = R_n_c[k, i, 0] * ray_x + R_n_c[k, i, 1] * ray_y + R_n_c[k, i, 2]
            measured[i] = t_n_c[k, i] + depth * along
        if follower[BEGUN] == 0.0:  # its own errors are in what it has followed
            follower[BEGUN], follower[POSITION : POSITION + 3] = 1.0, measured
        update(follower, measured, times[k])


@inner
def _in_camera(R_n_c, t_n_c, point):
    dx, dy, dz = point[0] - t_n_c[0], point[1] - t_n_c[1], point[2] - t_n_c[2]
    return (
        R_n_c[0, 0] * dx + R_n_c[1, 0] * dy + R_n_c[2, 0] * dz,
        R_n_c[0, 1] * dx + R_n_c[1, 1] * dy + R_n_c[2, 1] * dz,
        R_n_c[0, 2] * dx + R_n_c[1, 2] * dy + R_n_c[2, 2] * dz,
    )


@inner
def _ray(lens, u, v):
    return undistort(u, v, lens, (u - lens[2]) / lens[0], (v - lens[3]) / lens[1])


@kernel
def receiver_sees(first, last, camera, flown, corners_b, print_noise, hidden, swapped, markers, found, many):
    """D2's frames ``first`` to ``last``: the sender's marker and the detector's boxes of the whole image.

    Args:
        corners_b: (4, 3) of the marker in the sender's body; print_noise: ``MarkerNoise``.
        hidden, swapped: (n,) whether the marker is covered, whether the detector is blind for the target.
        markers: (n, MARKER_COLUMNS), found: (n, m, FOUND_COLUMNS), many: (n,): filled.
    """
    most = flown.things.shape[1]
    things, ids = np.empty((most, 4)), np.empty(most, np.int64)
    boxes = np.empty((most * camera.target.shape[0] + camera.drone.shape[0], BOX_COLUMNS))
    extents, frame = np.empty((most + 1, EXTENT_COLUMNS)), np.empty(FRAME_COLUMNS)
    everywhere = np.array((-np.inf, -np.inf, np.inf, np.inf))
    seen, rows = np.empty((most, SEEN_COLUMNS)), np.empty((most, DETECTION_COLUMNS))
    for k in range(first, last):
        number = flown.frame[k]
        count = _before(camera, flown, k, things, ids, boxes, extents, frame)
        bodies, bounds = boxes[: count * camera.target.shape[0] + camera.drone.shape[0]], extents[: count + 1]
        markers[k, FOUND] = 0.0
        key, slow_key = fold(camera.seed, number), fold(camera.seed, number // SLOW_FRAMES)
        if not hidden[k] and marker(
            bodies, bounds, camera.target.shape[0], frame, camera.lens, flown.other_R[k], flown.other_t[k], corners_b,
            everywhere, LARGEST_SCALE, print_noise, fold(key, MARKERS), fold(slow_key, SLOW_MARKERS), markers[k, :9],
        ):  # fmt: skip
            markers[k, FOUND] = 1.0
        total = _boxes_of(camera, number, count, ids, boxes, extents, everywhere, seen, rows, found[k])
        if swapped[k]:
            kept = 0
            for i in range(total):
                if found[k, i, WHOSE] != 0.0:
                    found[k, kept] = found[k, i]
                    kept += 1
            total = kept
        many[k] = total


def with_lapses(noise: MarkerNoise, rate: float) -> MarkerNoise:
    """The marker missed more often."""
    return noise._replace(lapse_rate=noise.lapse_rate + rate)
