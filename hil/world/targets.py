"""The target and its look-alikes: of which kind, and where they are, as functions of time fixed by
the seed.

The target drives round a smooth closed loop, and stands now and then. Some look-alikes drive the
same loop a fixed way ahead or behind, the others are parked beside it; all keep their distance at
every time, which is checked when they are placed. Only a look-alike that is sent (a fault) comes
close, past the target but never through it. Cars and people are on the ground; drones fly, the
target and those on its loop up and down together, the others each at a height of its own. Positions
are (E, N) in metres, angles counter-clockwise from east.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hil.world.clutter import Crate, crates
from hil.world.gait import strides_of
from hil.world.snapshot import ObjectTruth, TargetKind, stretch_of
from path.arrays import Array
from path.bounds import Bounds
from path.messages import Vec3
from path.values import frozen

Point = tuple[float, float]

RAMP_S = 2.0  # from parked to full speed
FIRST_STANDS = 0.3  # share of those that stand at first
LOOP_POINTS = 1024
_WAY_POINTS = 16  # of them, one is enough to keep off the way
GAP_SHARE = 2.0 / 3.0  # of the least distance to the target: between two look-alikes
HOME_GAP_M = 1.5  # nothing is parked where drones stand
PLACEMENTS = 2000
CROSSING_MPS = 1.0  # relative to the target
CROSSING_START_M = 3.5
CROSSING_S = 2.0 * CROSSING_START_M / CROSSING_MPS
# between the centres, at the closest; two cars or drones side by side need 0.31 m at most, two
# people 0.7 m
CROSSING_PAST_M: dict[TargetKind, tuple[float, float]] = {
    "car": (0.36, 0.4),
    "drone": (0.36, 0.4),
    "person": (0.75, 0.8),
}
# to every other object
CROSSING_GAP_M: dict[TargetKind, float] = {"car": 0.45, "drone": 0.45, "person": 0.8}
# of what flies
LOWEST_M = 0.5
HIGHEST_M = 3.0


@frozen
class TargetConfig:
    """The target waits at ``start_m`` until ``start_time_s``, then moves, never leaving
    ``radius_m`` around it.

    Attributes:
        kind: of the target and its look-alikes: a robot car, a person who walks, or a micro-UAV
            that flies.
        drives_s, stands_s: at least and at most, in turns, by seed; whether it drives or stands
            first is drawn too. It never stands when ``stands_s`` is 0.
        to_and_fro_s: period of driving ahead and back along the loop, ``speed_mps`` being the
            fastest; 0: always ahead.
        height_m: above the ground, of the middle of one that flies, while it waits.
        size_m: length, width and height of the target and its look-alikes; None: as their kind has
            them. People keep their shape, and are as tall as that.
        climb_m, climb_s: by how much it flies up and down again once it moves, and the time both
            take.
    """

    kind: TargetKind = "car"

    start_m: Annotated[Point, Bounds(-1000, 1000)] = (0.0, 4.0)
    start_time_s: Annotated[float, Bounds(0.0, 3600.0)] = 0.0
    drives_s: Annotated[tuple[float, float], Bounds(1.0, 3600.0)] = (8.0, 25.0)
    stands_s: Annotated[tuple[float, float], Bounds(0.0, 3600.0)] = (1.0, 5.0)
    speed_mps: Annotated[float, Bounds(0.0, 15.0)] = 0.3
    radius_m: Annotated[float, Bounds(1.0, 500.0)] = 4.0
    # from the start to the middle of the loop, counter-clockwise from east
    loop_bearing_deg: Annotated[float, Bounds(-360.0, 360.0)] = 90.0
    loop_bearing_sigma_deg: Annotated[float, Bounds(0.0, 360.0)] = 20.0
    to_and_fro_s: Annotated[float, Bounds(0.0, 3600.0)] = 0.0
    height_m: Annotated[float, Bounds(LOWEST_M, HIGHEST_M)] = 1.0
    climb_m: Annotated[float, Bounds(0.0, HIGHEST_M - LOWEST_M)] = 1.2
    climb_s: Annotated[float, Bounds(5.0, 600.0)] = 20.0

    size_m: Annotated[tuple[float, float, float] | None, Bounds(0.02, 50.0)] = None

    @property
    def stretch(self) -> Vec3:
        """Return times how much the body is as long, wide and high as its kind."""
        return stretch_of(self.kind, self.size_m)

    def __post_init__(self) -> None:
        for name in ("drives_s", "stands_s"):
            least_s, most_s = getattr(self, name)
            if least_s > most_s:
                raise ValueError(f"{name}: the least comes first")
        if self.drives_s[0] < 2.0 * RAMP_S:
            raise ValueError(f"drives_s: at least {2.0 * RAMP_S:g} s, to start and to stop in")
        if self.height_m + self.climb_m > HIGHEST_M:
            raise ValueError(f"height_m and climb_m together must not be above {HIGHEST_M:g} m")


@frozen
class LookAlikeConfig:
    """``count`` look-alikes, ``driving`` of them on the target's loop, the others parked beside
    it.
    """

    count: Annotated[int, Bounds(0, 50, "objects")] = 3
    driving: Annotated[int, Bounds(0, 50, "objects")] = 1
    min_distance_m: Annotated[float, Bounds(1.0, 100.0)] = 1.2
    max_distance_m: Annotated[float, Bounds(1.0, 100.0)] = 2.0

    def __post_init__(self) -> None:
        if not 0 <= self.driving <= self.count:
            raise ValueError("driving must be within 0..count")
        if not 1.0 <= self.min_distance_m < self.max_distance_m:
            raise ValueError("min_distance_m must be at least 1.0 and below max_distance_m")


class Pace:
    """How far something has driven that drives and stands in turns, and how fast it is. A pure
    function of time.

    It starts and stops within ``RAMP_S``, without a jerk.
    """

    def __init__(self, target: TargetConfig, rng: np.random.Generator) -> None:
        self._speed_mps = target.speed_mps
        self._drives_s = target.drives_s
        self._stands_s = target.stands_s
        self._rng = rng
        self._ever_stands = target.stands_s[1] > 0.0
        begin_s = 0.0
        if self._ever_stands and rng.random() < FIRST_STANDS:
            begin_s = float(rng.uniform(*target.stands_s))
        # begin and end, and how far it had come
        self._drives: list[tuple[float, float, float]] = []
        self._add(begin_s, 0.0)

    def _add(self, begin_s: float, driven_m: float) -> None:
        lasts_s = float(self._rng.uniform(*self._drives_s)) if self._ever_stands else math.inf
        self._drives.append((begin_s, begin_s + lasts_s, driven_m))

    def at(self, time_s: float) -> tuple[float, float]:
        """Metres and m/s."""
        while (last := self._drives[-1])[1] < time_s:
            driven_m = last[2] + self._speed_mps * (last[1] - last[0] - RAMP_S)
            self._add(last[1] + float(self._rng.uniform(*self._stands_s)), driven_m)
        begin_s, end_s, before_m = next(
            (drive for drive in reversed(self._drives) if drive[0] <= time_s),
            (math.inf, math.inf, 0.0),
        )
        if time_s <= begin_s:
            return 0.0, 0.0
        ramp_m, ramp_mps = _ramped((time_s - begin_s) / RAMP_S)
        stopped_m, stopped_mps = _ramped((time_s - (end_s - RAMP_S)) / RAMP_S)
        return before_m + self._speed_mps * (ramp_m - stopped_m), self._speed_mps * (
            ramp_mps - stopped_mps
        )


def _ramped(share: float) -> tuple[float, float]:
    """Metres and m/s of something that comes to 1 m/s within ``RAMP_S``, at a share of that time
    and after.
    """
    if share <= 0.0:
        return 0.0, 0.0
    if share < 1.0:
        return RAMP_S * (share**3 - 0.5 * share**4), 3.0 * share**2 - 2.0 * share**3
    return RAMP_S * (share - 0.5), 1.0


class Loop:
    """A closed smooth curve by arc length. ``points`` (n, 2) are evenly spaced along it."""

    def __init__(self, config: TargetConfig, rng: np.random.Generator) -> None:
        """A circle bent by its second and third harmonic: convex, its tightest turn about half its
        mean radius.
        """
        angle = np.linspace(0.0, 2.0 * math.pi, 4 * LOOP_POINTS + 1)
        bend = rng.uniform(0.03, (0.12, 0.05)), rng.uniform(0.0, 2.0 * math.pi, 2)
        ripple = sum(bend[0][k] * np.cos((k + 2) * angle + bend[1][k]) for k in range(2))
        mean_radius_m = config.radius_m / 2.4
        radius = mean_radius_m * (1.0 + ripple)
        bearing = math.radians(
            config.loop_bearing_deg + config.loop_bearing_sigma_deg * rng.standard_normal()
        )
        turn = 1.0 if rng.random() < 0.5 else -1.0
        heading = bearing + math.pi + turn * angle
        curve = np.column_stack((radius * np.cos(heading), radius * np.sin(heading)))
        curve += np.array(config.start_m) - curve[0]
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))))
        self.length_m = float(along[-1])
        even = np.arange(LOOP_POINTS + 1) * (self.length_m / LOOP_POINTS)
        self.points: Array = np.column_stack(
            [np.interp(even, along, curve[:, k]) for k in range(2)]
        )
        step = np.diff(self.points, axis=0)
        middle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        turned = 2.0 * math.pi * turn
        yaw = 0.5 * (middle + np.concatenate(([middle[-1] - turned], middle[:-1])))
        self._x, self._y = self.points[:, 0].tolist(), self.points[:, 1].tolist()
        self._yaw = [*yaw.tolist(), float(yaw[0]) + turned]

    def at(self, along_m: float) -> tuple[float, float, float]:
        """(E, N, yaw) a way along the loop, in either direction."""
        place = (along_m / self.length_m) % 1.0 * LOOP_POINTS
        k = min(int(place), LOOP_POINTS - 1)
        f = place - k
        x = self._x
        y = self._y
        yaw = self._yaw
        return (
            x[k] + f * (x[k + 1] - x[k]),
            y[k] + f * (y[k + 1] - y[k]),
            yaw[k] + f * (yaw[k + 1] - yaw[k]),
        )

    def closest(self, point: Point) -> float:
        """Distance in m from a point to the loop."""
        return float(np.min(np.hypot(self.points[:, 0] - point[0], self.points[:, 1] - point[1])))

    def closest_chord(self, apart_m: float) -> float:
        """Shortest distance between two objects that stay ``apart_m`` apart along the loop."""
        shift = round(apart_m / self.length_m * LOOP_POINTS)
        away = self.points[:-1] - np.roll(self.points[:-1], shift, axis=0)
        return float(np.min(np.hypot(away[:, 0], away[:, 1])))


@frozen
class Crossing:
    """A straight pass, relative to the target: along ``along``, at ``beside`` from it (unit vectors
    times metres).
    """

    object_id: int
    start_s: float
    along: Point
    beside: Point


class GroundVehicles:
    """The target and its look-alikes, also those that fly. ``at`` is a pure function of time, but
    for those sent.
    """

    def __init__(
        self,
        target: TargetConfig,
        look_alikes: LookAlikeConfig,
        keep_clear: Sequence[Point],
        seed: np.random.SeedSequence,
        first_id: int = 0,
    ) -> None:
        """Place everything. Raises ValueError when there is no room.

        Args:
            keep_clear: where the drones stand.
            first_id: number of the target; its look-alikes' follow.
        """
        self._first_id = first_id
        loop_seed, place_seed, crossing_seed, pace_seed = seed.spawn(4)
        self._config = target
        self._loop = Loop(target, np.random.default_rng(loop_seed))
        self._pace = Pace(target, np.random.default_rng(pace_seed))
        self._crossing_rng = np.random.default_rng(crossing_seed)
        self._crossings: list[Crossing] = []
        self._apart = _driving(self._loop, look_alikes)
        place_rng = np.random.default_rng(place_seed)
        parked = _parked(self._loop, look_alikes, keep_clear, self._apart, place_rng)
        flies = target.kind == "drone"
        heights = (
            place_rng.uniform(LOWEST_M, HIGHEST_M, len(parked)).tolist()
            if flies
            else [0.0] * len(parked)
        )
        self._parked = tuple(
            ObjectTruth(first_id + 1 + len(self._apart) + k, (x, y, z), yaw, 0.0)
            for k, ((x, y, yaw), z) in enumerate(zip(parked, heights, strict=True))
        )

    @property
    def ways(self) -> Array:
        """Return places (n, 2), E and N, of where anything drives or is parked."""
        parked = [each.position_w_m[:2] for each in self._parked]
        return np.vstack([self._loop.points[::_WAY_POINTS], *parked])

    def crates(self, count: int, homes: Sequence[Point], seed: int) -> tuple[Crate, ...]:
        """Return crates beside the target's way."""
        middle = self._loop.points.mean(axis=0)
        parked = [each.position_w_m[:2] for each in self._parked]
        rng = np.random.default_rng([seed, 0x637274])
        east, north = middle.tolist()
        return crates(count, (east, north), self._loop.closest, [*homes, *parked], rng)

    def _driven(self, time_s: float) -> tuple[float, float]:
        """Return how far along the loop everything has driven, and how fast.

        A smooth start, then steadily, or to and fro.
        """
        since_s = time_s - self._config.start_time_s
        if since_s <= 0.0:
            return 0.0, 0.0
        if self._config.to_and_fro_s > 0.0:
            turn = 2.0 * math.pi / self._config.to_and_fro_s
            speed = self._config.speed_mps
            angle = turn * since_s
            return speed / turn * (1.0 - math.cos(angle)), speed * math.sin(angle)
        return self._pace.at(since_s)

    def _risen(self, time_s: float) -> tuple[float, float]:
        """Return the height of the target and of those on its loop, and how fast they climb."""
        own = self._config
        if own.kind != "drone":
            return 0.0, 0.0
        turn = 2.0 * math.pi / own.climb_s
        angle = turn * max(0.0, time_s - own.start_time_s)
        return own.height_m + 0.5 * own.climb_m * (
            1.0 - math.cos(angle)
        ), 0.5 * own.climb_m * turn * math.sin(angle)

    def at(self, time_s: float) -> tuple[ObjectTruth, ...]:
        """The target (first), its look-alikes, and those that are just passing."""
        along_m, speed = self._driven(time_s)
        z, climbing = self._risen(time_s)
        strides = self._strides(along_m, self._config.speed_mps)
        on_loop = [
            ObjectTruth(number, (x, y, z), yaw, speed, climbing, strides)
            for number, (x, y, yaw) in enumerate(
                (self._loop.at(along_m + apart) for apart in (0.0, *self._apart)), self._first_id
            )
        ]
        passing = [
            self._passing(crossing, time_s, on_loop[0])
            for crossing in self._crossings
            if 0.0 <= time_s - crossing.start_s <= CROSSING_S
        ]
        return (*on_loop, *self._parked, *passing)

    def _passing(self, crossing: Crossing, time_s: float, target: ObjectTruth) -> ObjectTruth:
        way = CROSSING_MPS * (time_s - crossing.start_s) - CROSSING_START_M
        (ax, ay), (bx, by), (x, y, z) = crossing.along, crossing.beside, target.position_w_m
        vx = CROSSING_MPS * ax + target.speed_mps * math.cos(target.yaw_rad)
        vy = CROSSING_MPS * ay + target.speed_mps * math.sin(target.yaw_rad)
        position = (x + way * ax + bx, y + way * ay + by, z)
        speed = math.hypot(vx, vy)
        strides = self._strides(speed * (time_s - crossing.start_s), speed)
        return ObjectTruth(
            crossing.object_id, position, math.atan2(vy, vx), speed, target.climb_mps, strides
        )

    def _strides(self, way_m: float, speed_mps: float) -> float:
        return strides_of(way_m, speed_mps) if self._config.kind == "person" else 0.0

    def send_lookalike(self, now_s: float) -> None:
        """Drive one more look-alike across, ``CROSSING_PAST_M`` past the target; it is there for
        ``CROSSING_S``.
        """
        past_m = float(self._crossing_rng.uniform(*CROSSING_PAST_M[self._config.kind]))
        flip = 1.0 if self._crossing_rng.random() < 0.5 else -1.0
        heading = self.at(now_s + 0.5 * CROSSING_S)[0].yaw_rad
        number = self._first_id + 1 + len(self._apart) + len(self._parked) + len(self._crossings)
        choices: list[tuple[float, float, Crossing]] = []
        for k in range(-12, 12):  # square across first, then slanted ever more
            angle = heading + flip * (math.pi / 2.0 + math.pi * k / 12.0)
            for side in (past_m, -past_m):
                along = math.cos(angle), math.sin(angle)
                crossing = Crossing(number, now_s, along, (-side * along[1], side * along[0]))
                clear_m = min(self._clearance(crossing), CROSSING_GAP_M[self._config.kind])
                choices.append((clear_m, abs(math.sin(angle - heading)), crossing))
        self._crossings.append(max(choices, key=lambda choice: choice[:2])[2])

    def _clearance(self, crossing: Crossing) -> float:
        """Closest approach in m to anything but the target."""
        closest = math.inf
        for time_s in np.linspace(crossing.start_s, crossing.start_s + CROSSING_S, 71).tolist():
            target, *others = self.at(time_s)
            x, y, _ = self._passing(crossing, time_s, target).position_w_m
            closest = min(
                closest,
                *(math.hypot(x - o.position_w_m[0], y - o.position_w_m[1]) for o in others),
                closest,
            )
        return closest


def _driving(loop: Loop, config: LookAlikeConfig) -> list[float]:
    """Return how far along the loop from the target each driving look-alike keeps.

    Behind, ahead, further behind, ...
    """
    apart: list[float] = []
    for k in range(config.driving):
        side = -1.0 if k % 2 == 0 else 1.0
        gap = config.min_distance_m * (1.2 + k // 2)
        while loop.closest_chord(side * gap) < config.min_distance_m:
            gap += 0.05
            if gap > 0.5 * loop.length_m:
                raise ValueError(
                    "look_alikes: no room on the target's loop; fewer driving, or a larger radius_m"
                )
        apart.append(side * gap)
    gap_m = GAP_SHARE * config.min_distance_m
    if any(loop.closest_chord(a - b) < gap_m for i, a in enumerate(apart) for b in apart[:i]):
        raise ValueError(
            "look_alikes: they do not fit on the target's loop; fewer driving, or a larger radius_m"
        )
    return apart


def _parked(
    loop: Loop,
    config: LookAlikeConfig,
    keep_clear: Sequence[Point],
    apart: Sequence[float],
    rng: np.random.Generator,
) -> list[tuple[float, float, float]]:
    """Places (E, N, yaw) beside the loop: the first near the start, the others anywhere along
    it.
    """
    placed: list[tuple[float, float, float]] = []
    gap_m = GAP_SHARE * config.min_distance_m
    for _ in range(PLACEMENTS):
        if len(placed) == config.count - len(apart):
            return placed
        reach = 1.5 if not placed else 0.5 * loop.length_m
        x, y, heading = loop.at(float(rng.uniform(-reach, reach)))
        aside = float(rng.uniform(config.min_distance_m, config.max_distance_m)) * (
            1.0 if rng.random() < 0.5 else -1.0
        )
        x = x - aside * math.sin(heading)
        y = y + aside * math.cos(heading)
        yaw = float(rng.uniform(-math.pi, math.pi))
        free = all(math.hypot(x - p[0], y - p[1]) >= gap_m for p in placed)
        clear = all(math.hypot(x - p[0], y - p[1]) >= HOME_GAP_M for p in keep_clear)
        if free and clear and loop.closest((x, y)) >= config.min_distance_m:
            placed.append((x, y, yaw))
    raise ValueError(
        "look_alikes: no room to park them all beside the target's loop; fewer, or a larger radius_m"
    )
