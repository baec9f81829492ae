"""The space in which drones may be: a circle with a ceiling, and inside it a polygon where the site
has edges. Pure.

Script, guard and monitors ask the same fence. A polygon has walls: besides ending a flight that
crosses one, it slows every setpoint so that the drone can stop before it.
"""

from __future__ import annotations

import math

from flight.guidance import Vec3, within_fence
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
        body_m: radius of a drone: its middle stays so far from an edge, and from the ceiling of a
            site that has edges.
    """

    radius_m: float
    height_m: float
    corners_m: tuple[Corner, ...] = ()
    body_m: float = 0.0

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

    def nearest(self, place_n_m: Vec3, clear_m: float = 0.0) -> Vec3:
        """Return the nearest place that is inside, and so far from its limits as far as there is
        room.
        """
        height_m = self.highest_m - clear_m
        north, east, down = within_fence(place_n_m, self.radius_m - clear_m, height_m)
        wanted_m = self.body_m + clear_m
        for _ in range(_ROUNDS if self.corners_m else 0):
            room_m = self.room_m(north, east)
            if room_m >= wanted_m - 1e-9:
                break
            north, east = self._moved_in(north, east, room_m, wanted_m - room_m)
        return north, east, down

    def stoppable(
        self,
        velocity_n_mps: Vec3,
        position_n_m: Vec3,
        accel_mps2: float,
        response_s: float,
    ) -> Vec3:
        """Return a velocity without what would take a drone to an edge, or to the ceiling of a site
        that has edges, faster than it can stop.

        Towards an edge with room d the drone may have v with d = 2 v response + v^2 / (2 accel): a
        setpoint that is slowed is answered late all the way.
        """
        if not self.corners_m:
            return velocity_n_mps
        north_mps, east_mps, down_mps = velocity_n_mps
        north_m, east_m, down_m = position_n_m
        climb_mps = _stopping_mps(self.highest_m + down_m, accel_mps2, response_s)
        down_mps = max(down_mps, -climb_mps)
        walls: list[tuple[float, float, float]] = []
        for point in self._on_edges(north_m, east_m):
            way_m = max(math.dist((north_m, east_m), point), 1e-6)
            most_mps = _stopping_mps(way_m - self.body_m, accel_mps2, response_s)
            walls.append(((point[0] - north_m) / way_m, (point[1] - east_m) / way_m, most_mps))
        for ahead, aside, most_mps in walls:
            too_fast_mps = north_mps * ahead + east_mps * aside - most_mps
            if too_fast_mps > 0.0:
                north_mps -= too_fast_mps * ahead
                east_mps -= too_fast_mps * aside
        # what was turned away from one wall may lead to another: then all of it is slowed
        share = 1.0
        for ahead, aside, most_mps in walls:
            closing_mps = north_mps * ahead + east_mps * aside
            if closing_mps > most_mps:
                share = min(share, most_mps / closing_mps)
        return share * north_mps, share * east_mps, down_mps

    def _edges(self) -> list[tuple[Corner, Corner]]:
        return list(zip(self.corners_m, (*self.corners_m[1:], self.corners_m[0]), strict=True))

    def _on_edges(self, north_m: float, east_m: float) -> list[Corner]:
        """Return the nearest point of every edge."""
        return [_on_edge((north_m, east_m), first, second) for first, second in self._edges()]

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


def _on_edge(
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
