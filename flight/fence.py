"""The space in which drones may be: a circle with a ceiling, inside it a polygon where the site has
edges, and in that what stands in the way. Pure.

Script, guard and monitors ask the same fence. A polygon has walls: besides ending a flight that
crosses one, it slows every setpoint so that the drone can stop before it. Obstacles slow it alike.
Every way that is flown is a ``Way``: ``towards`` leads around what is in between.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.rig.obstacle import Obstacle
from flight.guidance import Vec3, dot, norm, scale, subtract, within_fence
from flight.obstacles.shapes import (
    between,
    corners,
    hidden,
    level_m,
    pushed_off,
    rows_of,
    to_nearest,
    walls_of,
)
from flight.obstacles.way import first_leg
from path.arrays import Array, Flags
from path.values import value

Corner = tuple[float, float]
_ROUNDS = 8  # of moving a place off one edge after the other: a corner takes two


@value
class Fence:
    """The limits of places in the local frame.

    Attributes:
        radius_m, height_m: of a circle around the origin, and of its ceiling.
        corners_m: (north, east) of the site's corners, in order either way; empty: the circle
            alone.
        body_m: radius of a drone: its middle stays so far from an edge, from an obstacle, and from
            the ceiling of a site that has edges.
        obstacles: what stands in it.
    """

    radius_m: float
    height_m: float
    corners_m: tuple[Corner, ...] = ()
    body_m: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()

    def holds(self, position_n_m: Vec3) -> bool:
        """Return whether a place is inside; False for NaN."""
        north, east, down = position_n_m
        round_about = math.hypot(north, east) <= self.radius_m and -down <= self.height_m
        return round_about and (not self.corners_m or self.room_m(north, east) >= 0.0)

    def room_m(self, north_m: float, east_m: float) -> float:
        """Return the distance to the nearest edge, negative outside; infinite without edges."""
        if not self.corners_m:
            return math.inf
        nearest_m = min(
            math.dist((north_m, east_m), point) for point in self._on_edges(north_m, east_m)
        )
        return nearest_m if self._inside(north_m, east_m) else -nearest_m

    @property
    def highest_m(self) -> float:
        """Return the height up to which a drone has room."""
        return self.height_m - self.body_m if self.corners_m else self.height_m

    def shifted(self, north_m: float, east_m: float) -> Fence:
        """Return the fence of a drone whose position is off by so much, as far as its obstacles
        go.
        """
        moved = [
            replace(each, place_m=(each.place_m[0] + north_m, each.place_m[1] + east_m))
            for each in self.obstacles
        ]
        return replace(self, obstacles=tuple(moved))

    @property
    def confines(self) -> bool:
        """Return whether there is more to keep off than the circle."""
        return bool(self.corners_m or self.obstacles)

    def nearest(self, place_n_m: Vec3, clear_m: float = 0.0, lowest_m: float = math.inf) -> Vec3:
        """Return the nearest place that is inside, and so far from its limits and from obstacles as
        far as there is room.

        Args:
            lowest_m: the height to which it goes down there.
        """
        return self._off_obstacles(self._inside_edges(place_n_m, clear_m), clear_m, lowest_m)

    def _inside_edges(self, place_n_m: Vec3, clear_m: float) -> Vec3:
        height_m = self.highest_m - clear_m
        north, east, down = within_fence(place_n_m, self.radius_m - clear_m, height_m)
        wanted_m = self.body_m + clear_m
        for _ in range(_ROUNDS if self.corners_m else 0):
            room_m = self.room_m(north, east)
            if room_m >= wanted_m - 1e-9:
                break
            north, east = self._moved_in(north, east, room_m, wanted_m - room_m)
        return north, east, down

    def _off_obstacles(self, place_n_m: Vec3, clear_m: float, lowest_m: float) -> Vec3:
        if not self.obstacles:
            return place_n_m
        north, east, down = place_n_m
        wanted_m = self.body_m + clear_m
        rows = between(rows_of(self.obstacles), min(lowest_m, -down), -down, wanted_m)
        place = np.array([[north, east]])
        choices = np.concatenate(
            (place, pushed_off(rows, place, wanted_m), corners(rows, wanted_m))
        )
        away_m = level_m(rows, choices).min(axis=1, initial=math.inf)
        room_m = np.array([self.room_m(*choice) for choice in choices.tolist()])
        missing_m = np.maximum(wanted_m - np.minimum(away_m, room_m), 0.0)
        missing_m[missing_m < 1e-6] = 0.0
        best = np.lexsort((np.hypot(*(choices - place).T), missing_m))[0]
        north, east = choices[best].tolist()
        return north, east, down

    def towards(self, place_n_m: Vec3, from_n_m: Vec3) -> Vec3:
        """Return what is left to a place, as long as the way to it and in the direction in which
        that begins: straight where nothing is in between.
        """
        straight = subtract(place_n_m, from_n_m)
        if not self.obstacles:
            return straight
        low_m, high_m = sorted((-place_n_m[2], -from_n_m[2]))
        rows = between(rows_of(self.obstacles), low_m, high_m, self.body_m)
        here = from_n_m[0], from_n_m[1]
        there = place_n_m[0], place_n_m[1]
        turn, way_m = first_leg(rows, here, there, self.body_m, walls_of(self.corners_m))
        leg_m = math.dist(here, turn)
        if turn == there:
            return straight
        share = way_m / max(leg_m, 1e-9)
        return share * (turn[0] - here[0]), share * (turn[1] - here[1]), straight[2]

    def short_m(self, places_n_m: Array) -> Array:
        """Return how much each of places (k, 3) is too near to an obstacle or an edge; 0 where
        there is room.
        """
        heights_m = -places_n_m[:, 2]
        low_m, high_m = float(heights_m.min()), float(heights_m.max())
        rows = between(rows_of(self.obstacles), low_m, high_m, self.body_m)
        room_m = level_m(rows, places_n_m[:, :2]).min(axis=1, initial=math.inf)
        if self.corners_m:
            edge_m = [self.room_m(north, east) for north, east, _ in places_n_m.tolist()]
            room_m = np.minimum(room_m, edge_m)
        return np.maximum(self.body_m - room_m, 0.0)

    def hides(self, eye_n_m: Vec3, things_n_m: Array) -> Flags:
        """Return which things (k, 3) an obstacle hides from an eye."""
        return hidden(rows_of(self.obstacles), eye_n_m, things_n_m)

    def stoppable(
        self,
        velocity_n_mps: Vec3,
        position_n_m: Vec3,
        accel_mps2: float,
        response_s: float,
    ) -> Vec3:
        """Return a velocity without what would take a drone to an edge, to an obstacle, or to the
        ceiling of a site that has edges, faster than it can stop.

        Towards an edge with room d the drone may have v with d = 2 v response + v^2 / (2 accel): a
        setpoint that is slowed is answered late all the way.
        """
        if not self.confines:
            return velocity_n_mps
        velocity = velocity_n_mps
        if self.corners_m:
            north_mps, east_mps, down_mps = velocity_n_mps
            climb_mps = _stopping_mps(self.highest_m + position_n_m[2], accel_mps2, response_s)
            velocity = (north_mps, east_mps, max(down_mps, -climb_mps))
        walls: list[tuple[Vec3, float]] = []
        for to_wall in self._to_walls(position_n_m):
            way_m = max(norm(to_wall), 1e-6)
            most_mps = _stopping_mps(way_m - self.body_m, accel_mps2, response_s)
            north, east, down = to_wall
            walls.append(((north / way_m, east / way_m, down / way_m), most_mps))
        for ahead, most_mps in walls:
            too_fast_mps = dot(velocity, ahead) - most_mps
            if too_fast_mps > 0.0:
                velocity = subtract(velocity, scale(ahead, too_fast_mps))
        # what was turned away from one wall may lead to another: then all of it is slowed
        share = 1.0
        for ahead, most_mps in walls:
            closing_mps = dot(velocity, ahead)
            if closing_mps > most_mps:
                share = min(share, most_mps / closing_mps)
        north_mps, east_mps, down_mps = velocity
        return share * north_mps, share * east_mps, down_mps

    def _to_walls(self, position_n_m: Vec3) -> Iterator[Vec3]:
        """Yield the way to the nearest point of every edge and obstacle."""
        north_m, east_m, _ = position_n_m
        for edge_north_m, edge_east_m in self._on_edges(north_m, east_m) if self.corners_m else ():
            yield edge_north_m - north_m, edge_east_m - east_m, 0.0
        yield from map(tuple, to_nearest(rows_of(self.obstacles), position_n_m).tolist())

    def _edges(self) -> list[tuple[Corner, Corner]]:
        return list(zip(self.corners_m, (*self.corners_m[1:], self.corners_m[0]), strict=True))

    def _on_edges(self, north_m: float, east_m: float) -> list[Corner]:
        """Return the nearest point of every edge."""
        return [on_edge((north_m, east_m), first, second) for first, second in self._edges()]

    def _inside(self, north_m: float, east_m: float) -> bool:
        """Return whether a place is inside the polygon: a ray from it crosses the edges an odd
        number of times.
        """
        crossings = 0
        for (n1, e1), (n2, e2) in self._edges():
            if (e1 > east_m) == (e2 > east_m):
                continue
            crossings += north_m < n1 + (east_m - e1) / (e2 - e1) * (n2 - n1)
        return crossings % 2 == 1

    def _moved_in(
        self,
        north_m: float,
        east_m: float,
        room_m: float,
        by_m: float,
    ) -> Corner:
        """Return a place moved inward, square to its nearest edge."""
        here = north_m, east_m
        points = self._on_edges(north_m, east_m)
        nearest = min(range(len(points)), key=lambda k: math.dist(points[k], here))
        point = points[nearest]
        away = north_m - point[0], east_m - point[1]
        length_m = math.hypot(*away)
        if length_m > 1e-9:
            inward = 1.0 if room_m >= 0.0 else -1.0
            return north_m + inward * by_m * away[0] / length_m, east_m + inward * by_m * away[
                1
            ] / length_m
        # on the edge itself: to that side of it which is inside
        first, second = self._edges()[nearest]
        edge_m = max(math.dist(first, second), 1e-9)
        square = (first[1] - second[1]) / edge_m, (second[0] - first[0]) / edge_m
        sides = [
            (north_m + way * by_m * square[0], east_m + way * by_m * square[1])
            for way in (1.0, -1.0)
        ]
        return max(sides, key=lambda side: self.room_m(*side))


def _stopping_mps(
    room_m: float,
    accel_mps2: float,
    response_s: float,
) -> float:
    """Return the speed from which a drone stops within a distance; 0 without room."""
    if room_m <= 0.0:
        return 0.0
    late_mps = 2.0 * accel_mps2 * response_s
    return math.sqrt(late_mps * late_mps + 2.0 * accel_mps2 * room_m) - late_mps


def on_edge(
    place: Corner,
    first: Corner,
    second: Corner,
) -> Corner:
    """Return the point of an edge that is nearest to a place."""
    along = second[0] - first[0], second[1] - first[1]
    square = along[0] * along[0] + along[1] * along[1]
    if square <= 0.0:
        return first
    share = ((place[0] - first[0]) * along[0] + (place[1] - first[1]) * along[1]) / square
    share = max(0.0, min(1.0, share))
    return first[0] + share * along[0], first[1] + share * along[1]
