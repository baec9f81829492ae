"""What stands in the way at a site, as a crew measures it. Pure."""

from __future__ import annotations

import math
from typing import Annotated

from path.bounds import Bounds
from path.values import frozen

Vec3 = tuple[float, float, float]


@frozen
class Obstacle:
    """Something upright: a box, or a round one.

    [[site.obstacles]]
    place_m = [6.0, -1.5]
    size_m = [4.2, 1.8]
    heading_deg = 30.0
    top_m = 1.5

    Attributes:
        place_m: north and east of its middle.
        size_m: along its heading, and across; of a round one its diameter, twice.
        floor_m, top_m: from where to where it reaches, above the ground.
        heading_deg: clockwise from north.
    """

    place_m: Annotated[tuple[float, float], Bounds(-1000.0, 1000.0)]
    size_m: Annotated[tuple[float, float], Bounds(0.02, 200.0)]
    top_m: Annotated[float, Bounds(0.02, 120.0)]
    floor_m: Annotated[float, Bounds(0.0, 120.0)] = 0.0
    heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    round: bool = False

    def __post_init__(self) -> None:
        if self.floor_m >= self.top_m:
            raise ValueError(f"floor_m: {self.floor_m!r} is not below top_m = {self.top_m!r}")
        if self.round and self.size_m[0] != self.size_m[1]:
            raise ValueError("size_m: of a round one both are its diameter")

    @property
    def reach_m(self) -> float:
        """Return how far it reaches from its middle along the ground."""
        return 0.5 * (self.size_m[0] if self.round else math.hypot(*self.size_m))

    def distance_m(self, position_n_m: Vec3) -> float:
        """Return how far a place (north, east, down) is from it; 0 inside."""
        north, east, down = position_n_m
        north -= self.place_m[0]
        east -= self.place_m[1]
        if self.round:
            across_m = max(0.0, math.hypot(north, east) - self.reach_m)
        else:
            c = math.cos(math.radians(self.heading_deg))
            s = math.sin(math.radians(self.heading_deg))
            along = abs(c * north + s * east) - 0.5 * self.size_m[0]
            aside = abs(c * east - s * north) - 0.5 * self.size_m[1]
            across_m = math.hypot(max(0.0, along), max(0.0, aside))
        above_m = max(0.0, self.floor_m + down, -down - self.top_m)
        return math.hypot(across_m, above_m)
