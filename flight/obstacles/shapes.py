"""Obstacles as rows of numbers: how near they are, and what they hide. Pure.

Every obstacle is a rectangle that is grown by a radius: a round one has no sides, a box no radius.
Places are north, east, down in the local frame; ``level`` is along the ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from drivers.rig.obstacle import Obstacle
from flight.guidance import Vec3
from path.arrays import Array, Flags

# Columns of a row.
NORTH, EAST, COS, SIN, ALONG, ACROSS, RADIUS, FLOOR, TOP = range(9)
COLUMNS = 9
ROUND_CORNERS = 8
OUTSIDE = 1.02
"""Times the clearance: corners of ways are so far off that the sides between them are clear."""


@lru_cache(32)
def rows_of(obstacles: tuple[Obstacle, ...]) -> Array:
    """Return obstacles as rows (m, COLUMNS). Shared: do not change them."""
    rows = np.zeros((len(obstacles), COLUMNS))
    for row, each in zip(rows, obstacles, strict=True):
        heading_rad = math.radians(each.heading_deg)
        row[NORTH], row[EAST] = each.place_m
        row[COS] = math.cos(heading_rad)
        row[SIN] = math.sin(heading_rad)
        half_m = 0.5 * np.array(each.size_m)
        if each.round:
            row[RADIUS] = half_m[0]
        else:
            row[ALONG], row[ACROSS] = half_m
        row[FLOOR] = each.floor_m
        row[TOP] = each.top_m
    return rows


def walls_of(corners_m: Sequence[tuple[float, float]]) -> Array:
    """Return the edges of a site as rows, as high as anything."""
    rows = np.zeros((len(corners_m), COLUMNS))
    firsts = np.array(corners_m).reshape(-1, 2)
    along = np.roll(firsts, -1, axis=0) - firsts
    length_m = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
    rows[:, [NORTH, EAST]] = firsts + 0.5 * along
    rows[:, [COS, SIN]] = along / length_m[:, None]
    rows[:, ALONG] = 0.5 * length_m
    rows[:, FLOOR] = -np.inf
    rows[:, TOP] = np.inf
    return rows


def between(rows: Array, low_m: float, high_m: float, clear_m: float) -> Array:
    """Return those that are in the way of what flies between two heights."""
    return rows[(rows[:, FLOOR] - clear_m < high_m) & (rows[:, TOP] + clear_m > low_m)]


def _local(rows: Array, places: Array) -> tuple[Array, Array]:
    """Return places (k, 2) along and across each of the shapes, twice (k, m)."""
    north = places[:, :1] - rows[:, NORTH]
    east = places[:, 1:2] - rows[:, EAST]
    return rows[:, COS] * north + rows[:, SIN] * east, rows[:, COS] * east - rows[:, SIN] * north


def level_m(rows: Array, places: Array) -> Array:
    """Return how far places (k, 2) are from each shape along the ground, (k, m); below 0 inside.

    Of a box that is the distance to the line of its nearest side: its grown shape is a box too.
    """
    along, across = _local(rows, places)
    of_box = np.maximum(np.abs(along) - rows[:, ALONG], np.abs(across) - rows[:, ACROSS])
    of_round = np.hypot(along, across) - rows[:, RADIUS]
    return np.where(rows[:, RADIUS] > 0.0, of_round, of_box)


def to_nearest(rows: Array, place_n_m: Vec3) -> Array:
    """Return the ways from a place to the nearest point of each shape, (m, 3): north, east, down; 0
    inside.
    """
    north, east, down = place_n_m
    along, across = _local(rows, np.array([[north, east]]))
    ahead = np.clip(along[0], -rows[:, ALONG], rows[:, ALONG]) - along[0]
    aside = np.clip(across[0], -rows[:, ACROSS], rows[:, ACROSS]) - across[0]
    level = np.hypot(ahead, aside)
    share = np.maximum(level - rows[:, RADIUS], 0.0) / np.maximum(level, 1e-9)
    ahead *= share
    aside *= share
    height = np.clip(-down, rows[:, FLOOR], rows[:, TOP])
    return np.stack(
        (
            rows[:, COS] * ahead - rows[:, SIN] * aside,
            rows[:, SIN] * ahead + rows[:, COS] * aside,
            -height - down,
        ),
        axis=1,
    )


def pushed_off(rows: Array, place: Array, clear_m: float) -> Array:
    """Return places (m, 2): a place (1, 2) moved square off the nearest side of each shape, until
    it is clear of it.
    """
    along, across = (each[0] for each in _local(rows, place))
    level = np.maximum(np.hypot(along, across), 1e-9)
    outward = np.maximum((rows[:, RADIUS] + clear_m) / level, 1.0)
    reach_along = np.copysign(rows[:, ALONG] + clear_m, along)
    reach_across = np.copysign(rows[:, ACROSS] + clear_m, across)
    by_end = np.abs(along) - rows[:, ALONG] > np.abs(across) - rows[:, ACROSS]
    is_round = rows[:, RADIUS] > 0.0
    along = np.where(is_round, along * outward, np.where(by_end, reach_along, along))
    across = np.where(is_round, across * outward, np.where(by_end, across, reach_across))
    return _in_n(rows, along, across)


def _in_n(rows: Array, along: Array, across: Array) -> Array:
    """Return places (m, 2) from those along and across each shape."""
    north = rows[:, NORTH] + rows[:, COS] * along - rows[:, SIN] * across
    east = rows[:, EAST] + rows[:, SIN] * along + rows[:, COS] * across
    return np.stack((north, east), axis=1)


def crossed(rows: Array, clear_m: Array, starts: Array, ends: Array) -> Flags:
    """Return which straight lines (k, 2) to (k, 2) come nearer to a shape than its clearance (m,),
    as ``level_m`` has it.
    """
    start_along, start_across = _local(rows, starts)
    end_along, end_across = _local(rows, ends)
    half_along = rows[:, ALONG] + clear_m
    half_across = rows[:, ACROSS] + clear_m
    enter = np.zeros_like(start_along)
    leave = np.ones_like(start_along)
    apart = np.zeros(start_along.shape, bool)
    for start, end, half in (
        (start_along, end_along, half_along),
        (start_across, end_across, half_across),
    ):
        step = end - start
        still = np.abs(step) < 1e-12
        apart |= still & (np.abs(start) >= half)
        safe = np.where(still, 1.0, step)
        first = (-half - start) / safe
        last = (half - start) / safe
        enter = np.maximum(enter, np.where(still, 0.0, np.minimum(first, last)))
        leave = np.minimum(leave, np.where(still, 1.0, np.maximum(first, last)))
    through_box = ~apart & (enter < leave)
    step_along = end_along - start_along
    step_across = end_across - start_across
    square = np.maximum(step_along**2 + step_across**2, 1e-12)
    share = np.clip(-(start_along * step_along + start_across * step_across) / square, 0.0, 1.0)
    nearest = np.hypot(start_along + share * step_along, start_across + share * step_across)
    through_round = nearest < rows[:, RADIUS] + clear_m
    return np.any(np.where(rows[:, RADIUS] > 0.0, through_round, through_box), axis=1)


def hidden(rows: Array, eye_n_m: Vec3, things_n_m: Array) -> Flags:
    """Return which things (k, 3) a shape hides from an eye."""
    if not len(rows):
        return np.zeros(len(things_n_m), bool)
    shares = np.linspace(0.0, 1.0, 33)[1:-1, None, None]
    eye = np.array(eye_n_m)
    points = (eye + shares * (things_n_m - eye)).reshape(-1, 3)
    inside = level_m(rows, points[:, :2]) < 0.0
    height = -points[:, 2:]
    inside &= (height > rows[:, FLOOR]) & (height < rows[:, TOP])
    return np.any(inside.any(axis=1).reshape(len(shares), -1), axis=0)


def corners(rows: Array, clear_m: float) -> Array:
    """Return places (v, 2) round each shape that are clear of it: where ways bend."""
    reach_m = OUTSIDE * clear_m
    found: list[Array] = []
    for row in rows:
        if row[RADIUS] > 0.0:
            angles = np.arange(ROUND_CORNERS) * (math.tau / ROUND_CORNERS)
            radius_m = (row[RADIUS] + reach_m) / math.cos(math.pi / ROUND_CORNERS)
            along, across = radius_m * np.cos(angles), radius_m * np.sin(angles)
        else:
            along = np.array([1.0, 1.0, -1.0, -1.0]) * (row[ALONG] + reach_m)
            across = np.array([1.0, -1.0, -1.0, 1.0]) * (row[ACROSS] + reach_m)
        north = row[NORTH] + row[COS] * along - row[SIN] * across
        east = row[EAST] + row[SIN] * along + row[COS] * across
        found.append(np.stack((north, east), axis=1))
    return np.concatenate(found) if found else np.empty((0, 2))
