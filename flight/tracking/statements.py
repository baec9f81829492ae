"""What was said of the object that is meant, as probabilities of where it is.

Theory. A priori the object is any one of those that are there, each as likely as the other: one of
the n that D1 sees, or one that it does not see, of which there are lambda per square metre, as many
as it sees where it looks. A statement z says with which density the object is at a place x. So,
with L_i the density at the place of object i,

    P(i) = L_i / (sum over j of L_j + L_0),     L_0 = lambda * integral over x of density(x) * miss(x)

where miss(x) is 1 where D1 did not look and MISSED where it did. The integral is a sum over a grid.

Where the object was at the statement's instant counts, not where it is now: D1 remembers where
those that it sees were. Of the time before it saw an object nothing is known but how fast such a
thing can be; the density widens by that.

Several places of one source err together (a map that is off, a person who looks along a slope), so
their mean residual counts once, with the error of one: r ~ N(0, e^2 + s^2), where s is how far off
the drone takes itself to be, which lasts as well. How the residuals scatter about that mean counts
for each, and tells apart what moves from what stands. Of an object that is not seen they scatter as
little as of any that is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.operator.interfaces import BearingTold, PlaceTold, RegionTold, Told
from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.tracking.candidates import Candidate
from path.camera.model import CameraModel
from path.geometry.transforms import Pose

Array = NDArray[np.float64]

# of the objects in view: those that a detector does not show in any frame while D1 looks
MISSED = 0.002
KEPT_S = 15.0
# of how far off the drone's own position is by a minute: what that walks by within KEPT_S, once
# flight.own_walk has taken its part out
WALKED = 0.13
APART_S = 1.0  # places that come more often do not err independently of each other
_CELLS = 32
_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class Motion:
    """What such an object may do: the most along the ground, m/s and m/s^2.

    ``farthest_m``: from where somebody stands who points at it. ``down_m``: of its middle, where
    nothing else is said. ``flies_to_m``: height above the ground, if it flies.
    """

    fastest_mps: float
    accel_mps2: float
    farthest_m: float
    down_m: float
    flies_to_m: float | None = None
    # how far off the drone's own position may be by now, besides what its home tells
    own_m: float = 0.0

    @classmethod
    def of(cls, mission: MissionConfig) -> Self:
        """The motion of the mission's target, within its fence."""
        target = mission.target
        guard = mission.guard
        flies_to_m = guard.fence_height_m if target.flies else None
        return cls(
            target.fastest_mps,
            mission.follow.target_accel_mps2,
            2.0 * guard.fence_radius_m,
            -target.height_m,
            flies_to_m,
            target.own_m,
        )


@dataclass(frozen=True, slots=True)
class Look:
    """The camera at an instant."""

    stamp_ns: int
    T_n_c: Pose


@dataclass(frozen=True, slots=True)
class Shares:
    """The probability that an object is the one meant, by its number; ``elsewhere``: that it is
    none of them.
    """

    of: Mapping[int, float]
    elsewhere: float


class Statements:
    """All that was said lately."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._places: list[PlaceTold] = []
        self._bearing: BearingTold | None = None
        self._region: RegionTold | None = None
        self._known_hidden: tuple[tuple[int, int], float] | None = None

    def tell(self, told: Told) -> None:
        """Take up a statement."""
        self._known_hidden = None
        if isinstance(told, BearingTold):
            self._bearing = told
        elif isinstance(told, RegionTold):
            self._region = told
        else:
            places = self._places
            # the newest one is always kept, and goes when another comes where it came too soon
            if len(places) > 1 and places[-1].stamp_ns - places[-2].stamp_ns < APART_S * 1e9:
                places.pop()
            places.append(told)
            self._places = [
                each for each in places if told.stamp_ns - each.stamp_ns <= KEPT_S * 1e9
            ]

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest statement."""
        stamps = [
            each.stamp_ns
            for each in (*self._places[-1:], self._bearing, self._region)
            if each is not None
        ]
        return max(stamps, default=None)

    def where(self, stamp_ns: int) -> tuple[Vec3, float] | None:
        """Return where to look at a stamp: the middle of where the object can be, and how far off
        it may be.

        None where nothing but a bearing was said, which has no middle.
        """
        if self._places:
            told = self._places[-1]
            north, east, sigma_m = self._expected(told, stamp_ns)
            return (north, east, told.place_n_m[2]), 3.0 * sigma_m
        if self._region is not None:
            corners = np.array(self._region.corners_n_m)
            middle = corners.mean(axis=0)
            reach_m = float(np.linalg.norm(corners - middle, axis=1).max())
            gap_s = abs(stamp_ns - self._region.stamp_ns) * 1e-9
            north, east = middle.tolist()
            reach_m += self._motion.fastest_mps * gap_s + 3.0 * self._motion.own_m
            return (north, east, self._motion.down_m), reach_m
        return None

    def shares(
        self, seen: Sequence[Candidate], looks: Sequence[Look], camera: CameraModel
    ) -> Shares:
        """Return how likely each object is the one meant.

        Args:
            looks: the poses that the camera had, the oldest first.
        """
        if not seen or not looks or self.newest_ns is None:
            return Shares({each.number: 0.0 for each in seen}, 1.0)
        scatters = {each.number: self._scatter(each) for each in seen}
        usual = min((scatter for scatter, count in scatters.values() if count), default=0.0)
        usual = min(usual, 2.0)
        logs = np.array([self._log_density(each, scatters[each.number], usual) for each in seen])
        logs = np.append(logs, self._log_elsewhere(seen, looks, camera, usual))
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        shares = weights.tolist()
        return Shares(
            {each.number: share for each, share in zip(seen, shares, strict=False)}, shares[-1]
        )

    # --- of one object ---

    def _scatter(self, one: Candidate) -> tuple[float, int]:
        """Mean square of the residuals about their mean, in squared errors of one; and of how many
        differences.
        """
        tracked = [told for told in self._places if one.unknown_s(told.stamp_ns) == 0.0]
        if len(tracked) < 2:
            return 0.0, 0
        off = self._residuals(one, tracked)
        walked_m = WALKED * self._motion.own_m
        errors = np.array([math.hypot(told.error_m, walked_m) for told in tracked])
        about = off - np.average(off, axis=0, weights=errors**-2)
        count = len(tracked) - 1
        return float(((about / errors[:, None]) ** 2).sum()) / count, count

    def _residuals(self, one: Candidate, tracked: Sequence[PlaceTold]) -> Array:
        return np.array(
            [[told.place_n_m[k] - one.at(told.stamp_ns)[k] for k in (0, 1)] for told in tracked]
        )

    def _log_density(self, one: Candidate, scatter: tuple[float, int], usual: float) -> float:
        total = 0.0
        if self._places:
            mean_square, count = scatter
            expected = len(self._places) - 1 - count
            total += self._log_place(one) - 0.5 * (mean_square * count + usual * expected)
        point = np.array([[0.0, 0.0]])
        for told in (self._bearing, self._region):
            if told is not None:
                north, east, _ = one.at(told.stamp_ns)
                point[0] = north, east
                gap_s = one.unknown_s(told.stamp_ns)
                total += _log(float(self._density(told, point, gap_s)[0]))
        return total

    def _log_place(self, one: Candidate) -> float:
        """Of the mean residual of the places since it is known; or of the last place before."""
        tracked = [told for told in self._places if one.unknown_s(told.stamp_ns) == 0.0]
        last = self._places[-1]
        if tracked:
            north, east = self._residuals(one, tracked).mean(axis=0).tolist()
            told_m = math.sqrt(sum(told.error_m**2 for told in tracked) / len(tracked))
            sigma_m = math.hypot(told_m, self._motion.own_m)
        else:
            there = one.at(last.stamp_ns)
            known_ns = max(one.since_ns, min(last.stamp_ns, one.stamp_ns))
            expected_north, expected_east, sigma_m = self._expected(last, known_ns)
            north = expected_north - there[0]
            east = expected_east - there[1]
        total = _log_normal2(math.hypot(north, east), sigma_m)
        if self._motion.flies_to_m is not None and last.height_told:
            down = last.place_n_m[2] - one.at(last.stamp_ns)[2]
            density = math.exp(-0.5 * (down / sigma_m) ** 2) / (math.sqrt(2.0 * math.pi) * sigma_m)
            total += _log(density * self._motion.flies_to_m)
        if last.velocity_n_mps is not None and last.velocity_n_mps != (0.0, 0.0):
            total += self._log_velocity(one, last)
        return total

    def _log_velocity(self, one: Candidate, told: PlaceTold) -> float:
        """Of its velocity, against any velocity that such an object may have."""
        assert told.velocity_n_mps is not None
        (north, east), (own_north, own_east, _) = told.velocity_n_mps, one.velocity_n_mps
        gap_s = abs(one.stamp_ns - told.stamp_ns) * 1e-9
        sigma = math.sqrt(
            0.25 * (north**2 + east**2) + (self._motion.accel_mps2 * gap_s) ** 2 + one.vv
        )
        usual = math.pi * self._motion.fastest_mps**2
        return _log_normal2(math.hypot(north - own_north, east - own_east), sigma) + _log(usual)

    # --- of all that is not seen ---

    def _log_elsewhere(
        self, seen: Sequence[Candidate], looks: Sequence[Look], camera: CameraModel, usual: float
    ) -> float:
        newest_ns = self.newest_ns
        assert newest_ns is not None
        look = min(looks, key=lambda each: abs(each.stamp_ns - newest_ns))
        hidden = self._hidden(look, max(newest_ns, looks[0].stamp_ns), camera)
        range_m = min(math.dist(each.position_n_m, look.T_n_c.t.tolist()) for each in seen)
        per_m2 = len(seen) * camera.fx * camera.fy / (camera.width * camera.height * range_m**2)
        scattered = 0.5 * usual * max(0, len(self._places) - 1)
        return _log(per_m2 * hidden) - scattered

    def _hidden(self, look: Look, at_ns: int, camera: CameraModel) -> float:
        """The density of the object, summed over all places where that look does not show it."""
        key = look.stamp_ns, at_ns
        if self._known_hidden is not None and self._known_hidden[0] == key:
            return self._known_hidden[1]
        cells, area_m2, down_m = self._grid(at_ns)
        density = np.ones(len(cells))
        if self._places:
            north, east, sigma_m = self._expected(self._places[-1], at_ns)
            off = np.hypot(cells[:, 0] - north, cells[:, 1] - east)
            density *= np.exp(-0.5 * (off / sigma_m) ** 2) / (2.0 * math.pi * sigma_m**2)
        for told in (self._bearing, self._region):
            if told is not None:
                density *= self._density(told, cells, max(0.0, (at_ns - told.stamp_ns) * 1e-9))
        in_view = _seen_from(
            look.T_n_c, np.column_stack((cells, np.full(len(cells), down_m))), camera
        )
        hidden = float((density * np.where(in_view, MISSED, 1.0)).sum()) * area_m2
        self._known_hidden = key, hidden
        return hidden

    def _grid(self, at_ns: int) -> tuple[Array, float, float]:
        """Places that cover where the object can be, what each stands for in m^2, and down of
        them.
        """
        down_m = self._places[-1].place_n_m[2] if self._places else self._motion.down_m
        if self._places:
            north, east, sigma_m = self._expected(self._places[-1], at_ns)
            low = np.array((north, east)) - _SIGMAS * sigma_m
            high = np.array((north, east)) + _SIGMAS * sigma_m
        else:
            told = self._region or self._bearing
            assert told is not None
            if isinstance(told, RegionTold):
                corners = np.array(told.corners_n_m)
                reach_m = 0.0
            else:
                corners = np.array([told.from_n_m])
                reach_m = self._motion.farthest_m
            reach_m += self._motion.fastest_mps * max(0.0, (at_ns - told.stamp_ns) * 1e-9)
            reach_m += _SIGMAS * self._motion.own_m
            low = corners.min(axis=0) - reach_m
            high = corners.max(axis=0) + reach_m
        side = (high - low) / _CELLS
        axes = [low[k] + side[k] * (np.arange(_CELLS) + 0.5) for k in (0, 1)]
        north_m, east_m = np.meshgrid(*axes, indexing="ij")
        return np.column_stack((north_m.ravel(), east_m.ravel())), float(side[0] * side[1]), down_m

    # --- densities ---

    def _expected(self, told: PlaceTold, stamp_ns: int) -> tuple[float, float, float]:
        """North, east and the standard deviation per axis of where the object is at a stamp, by one
        place.
        """
        gap_s = (stamp_ns - told.stamp_ns) * 1e-9
        free_s = abs(gap_s) if gap_s < 0.0 else max(0.0, gap_s - told.holds_s)
        north, east, _ = told.place_n_m
        spread_m = self._motion.fastest_mps * free_s
        if told.velocity_n_mps is not None:
            v_north, v_east = told.velocity_n_mps
            north = north + v_north * gap_s
            east = east + v_east * gap_s
            faster_m = (self._motion.fastest_mps + math.hypot(v_north, v_east)) * free_s
            spread_m = min(0.5 * self._motion.accel_mps2 * free_s**2, faster_m)
        # A disc's is half its radius.
        return north, east, math.hypot(told.error_m, self._motion.own_m, 0.5 * spread_m)

    def _density(self, told: BearingTold | RegionTold, points: Array, gap_s: float) -> Array:
        """Per square metre, at points (n, 2)."""
        spread_m = self._motion.fastest_mps * gap_s
        own_m = self._motion.own_m
        if isinstance(told, BearingTold):
            off = points - np.array(told.from_n_m)
            range_m = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-6)
            angle = np.arctan2(off[:, 1], off[:, 0]) - told.bearing_rad
            angle = (angle + math.pi) % (2.0 * math.pi) - math.pi
            off_m = math.hypot(0.5 * spread_m, own_m)
            sigma = np.hypot(told.error_rad, off_m / range_m)
            across = np.exp(-0.5 * (angle / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)
            return across / (range_m * self._motion.farthest_m)
        corners = np.array(told.corners_n_m)
        spread_m = math.hypot(spread_m, 2.0 * own_m)
        outside_m = outside(corners, points)
        soft = (
            outside_m <= 0.0
            if spread_m <= 0.0
            else np.exp(-0.5 * (np.maximum(outside_m, 0.0) / spread_m * 2.0) ** 2)
        )
        around_m = float(np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).sum())
        # along its sides, and at its corners a whole turn together
        beside_m2 = math.sqrt(math.pi / 8.0) * spread_m * around_m + 0.5 * math.pi * spread_m**2
        return soft / (_area_m2(corners) + beside_m2)


def outside(corners: Array, points: Array) -> Array:
    """Return how far points (n, 2) are outside a polygon (k, 2), m: negative inside."""
    inside = np.zeros(len(points), bool)
    nearest = np.full(len(points), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = b - a
        share = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - (a + share[:, None] * along), axis=1))
        crosses = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
        rise = b[1] - a[1]
        at = a[0] + (points[:, 1] - a[1]) / (rise if rise != 0.0 else 1.0) * along[0]
        inside ^= crosses & (points[:, 0] < at)
    return np.where(inside, -nearest, nearest)


def _area_m2(corners: Array) -> float:
    x = corners[:, 0]
    y = corners[:, 1]
    return max(1e-6, 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))))


def _seen_from(T_n_c: Pose, points_n: Array, camera: CameraModel) -> NDArray[np.bool_]:
    """Whether points (n, 3) are in the image."""
    points_c = T_n_c.inverse().apply(points_n)
    z = points_c[:, 2]
    ahead = (z > 0.0) & (
        np.hypot(points_c[:, 0], points_c[:, 1]) <= camera.max_radius * np.where(z > 0.0, z, 1.0)
    )
    pixels = camera.project(points_c)
    with np.errstate(invalid="ignore"):
        inside = (pixels > -0.5).all(axis=1) & (
            pixels < (camera.width - 0.5, camera.height - 0.5)
        ).all(axis=1)
    return ahead & inside


def _log_normal2(off: float, sigma: float) -> float:
    return -0.5 * (off / sigma) ** 2 - math.log(2.0 * math.pi * sigma**2)


def _log(value: float) -> float:
    return math.log(max(value, 1e-300))
