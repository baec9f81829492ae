"""The track of one object: a constant-velocity filter in NED, how far it can have come, and what to
fly by.

What errs is mostly a camera's direction, and what is told apart is so by its place in an image:
lengths are shares of the distance at which the object is, so that a world so many times as large is
followed the same.
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np

from flight.config import FollowConfig, MissionConfig
from flight.guidance import Vec3, add, scale, subtract
from flight.tracking.identity import Identity
from flight.tracking.largest_box import LargestBox
from flight.tracking.ranging import Ranging
from path.belief.motion import Motion
from path.target.size import RunningSize

ACCELERATION_SIGMA_MPS2 = 0.6
# Shares of the object's distance along the optical axis.
MEASUREMENT_SIGMA = 0.024
# of a place that was just acquired, and of what it moves by in a second
FIRST_SIGMA = 0.145
FIRST_SPEED = 0.24
GATE_FLOOR = 0.048  # a box's noise, and an attitude a degree off
GATE_MOST = 0.22  # a track that knows no better does not know which object it would find
GATE_LEAST = 0.024
UNSEEN_REACH = 0.96  # no object is looked for farther off
_CUT_SIGMA = 0.072  # of the place that such a box gives
# of the place by depth alone: a fifth of that, the same for as long as a miss lasts
_CARRIED_SIGMA = 0.072
# of the way to the nearest other object: where that is known to be, the gate ends before it
RIVAL_SHARE = 0.4
RIVAL_S = 3.0  # for so long an object that was seen beside the target is taken to be there still
FASTEST_SIGMAS = 2.0
_USUAL_M = math.hypot(FollowConfig().behind_m, FollowConfig().height_m)
# of the logarithm of a box's side, and how many of them are of something else
_GROWTH_SIGMA = 0.08
_GROWN = 4.0


class TargetTrack:
    """Position and velocity of one object in ``n``; the same filter on each axis (Kalman, constant
    velocity).

    ``accel_mps2``: how hard it may be expected to speed up, brake and turn. ``flies``: it moves up
    and down too; of one that does not, what seems to is its box. ``ranging``: what tells its range
    besides depth. ``largest``: the largest box that it can have, where that is stated.
    ``carry_s``: for so long after it was seen its depth alone carries it. ``range_m``: about how
    far off it is. ``stamp_ns`` is of what the track rests on, ``seen_ns`` of the last box.
    """

    def __init__(
        self,
        position_n_m: Vec3,
        stamp_ns: int,
        accel_mps2: float = ACCELERATION_SIGMA_MPS2,
        *,
        flies: bool = False,
        ranging: Ranging | None = None,
        largest: LargestBox | None = None,
        carry_s: float = 0.0,
        identity: Identity | None = None,
        range_m: float = _USUAL_M,
    ) -> None:
        self.position_n_m = position_n_m
        self.largest = largest
        self.identity = identity
        self.ranging = ranging
        self.velocity_n_mps: Vec3 = (0.0, 0.0, 0.0)
        self.stamp_ns = stamp_ns
        self.seen_ns = stamp_ns
        self.rival_m = math.inf  # from the target to the nearest other object
        self.rival_ns = stamp_ns
        # when another one than the target was last as far as it can have come
        self._company_ns: int | None = None
        self._accel_mps2 = accel_mps2
        self._flies = flies
        self._carry_ns = round(carry_s * 1e9)
        self._sizes = RunningSize(sure_s=0.0)
        self.range_m = range_m  # along the optical axis, to be kept up by whoever looks
        self._pp = (FIRST_SIGMA * range_m) ** 2
        self._pv = 0.0
        self._vv = (FIRST_SPEED * range_m) ** 2
        self.size_m: tuple[float, float] | None = None  # of its box, where it was last seen whole
        self.whole_ns = stamp_ns

    @classmethod
    def of(
        cls,
        mission: MissionConfig,
        position_n_m: Vec3,
        stamp_ns: int,
        largest: LargestBox | None = None,
        ranging: Ranging | None = None,
    ) -> Self:
        """The track of the mission's target, first seen there."""
        accel_mps2 = mission.follow.target_accel_mps2
        flies = mission.target.flies
        carry_s = mission.follow.carry_s
        return cls(
            position_n_m, stamp_ns, accel_mps2, flies=flies, ranging=ranging, largest=largest, carry_s=carry_s,
            identity=Identity(mission, largest),
            range_m=math.hypot(mission.follow.behind_m, mission.follow.height_m),
        )  # fmt: skip

    def predict(self, stamp_ns: int) -> tuple[Vec3, float]:
        """Position (m) and its standard deviation per axis at a stamp, the filter left as it is."""
        dt = max(0.0, (stamp_ns - self.stamp_ns) * 1e-9)
        variance = (
            self._pp
            + 2.0 * dt * self._pv
            + dt * dt * self._vv
            + (self._accel_mps2 * dt * dt / 2) ** 2
        )
        return add(self.position_n_m, scale(self.velocity_n_mps, dt)), math.sqrt(variance)

    def reach_m(self, stamp_ns: int) -> float:
        """The most that the object can be from its prediction at a stamp: by what is not known of
        it, and by driving.

        ``accel_mps2`` is a bound here: what is farther off is another object.
        """
        dt = max(0.0, (stamp_ns - self.stamp_ns) * 1e-9)
        sigma_m = math.sqrt(self._pp + 2.0 * dt * self._pv + dt * dt * self._vv)
        return min(
            GATE_FLOOR * self.range_m + 3.0 * sigma_m + 0.5 * self._accel_mps2 * dt * dt,
            UNSEEN_REACH * self.range_m,
        )

    def believed(self, stamp_ns: int) -> tuple[Vec3, Vec3]:
        """Position (m) and velocity to fly by: the velocity counts as far as it is known, and less
        the longer ago.

        It counts v^4 / (v^4 + s^4), where s is its standard deviation, and after t seconds v^2 /
        (v^2 + (a t)^2) of that, where a is ``accel_mps2``: an object that is out of sight may
        brake.
        """
        dt = max(0.0, (stamp_ns - self.stamp_ns) * 1e-9)
        speed2 = sum(v * v for v in self.velocity_n_mps)
        known = speed2 * speed2 / (speed2 * speed2 + self._vv * self._vv)
        braked = self._accel_mps2 * dt / math.sqrt(speed2) if speed2 > 1e-9 else 0.0
        driven_s = dt * known * (math.atan(braked) / braked if braked > 1e-6 else 1.0)
        share = known / (1.0 + braked * braked)
        return add(self.position_n_m, scale(self.velocity_n_mps, driven_s)), scale(
            self.velocity_n_mps, share
        )

    def fastest_mps(self, stamp_ns: int) -> float:
        """The speed along the ground that the object may have at a stamp: to keep out of its way,
        not to fly by.
        """
        dt = max(0.0, (stamp_ns - self.stamp_ns) * 1e-9)
        north, east, _ = self.velocity_n_mps
        return math.hypot(north, east) + FASTEST_SIGMAS * math.sqrt(
            self._vv + (self._accel_mps2 * dt) ** 2
        )

    def gate_m(self, sigma_m: float, stamp_ns: int) -> float:
        """The farthest from its prediction, with this standard deviation, that the object may be
        found at a stamp.
        """
        most_m = GATE_MOST * self.range_m
        if self._rival_known(stamp_ns):
            most_m = min(most_m, RIVAL_SHARE * self.rival_m)
        return max(
            GATE_LEAST * self.range_m, min(3.0 * sigma_m + GATE_FLOOR * self.range_m, most_m)
        )

    def note_rival(self, distance_m: float, stamp_ns: int) -> None:
        """Another object was seen that far from this one; a nearer one is remembered for a
        while.
        """
        if distance_m <= self.rival_m or not self._rival_known(stamp_ns):
            self.rival_m = distance_m
            self.rival_ns = stamp_ns

    def note_company(self, stamp_ns: int) -> None:
        """While the target was out of sight, more than one object was as far as it can have
        come.
        """
        self._company_ns = stamp_ns

    def accompanied(self, stamp_ns: int) -> bool:
        """Return whether that is so, or lately was."""
        return self._company_ns is not None and stamp_ns - self._company_ns <= RIVAL_S * 1e9

    def note_size(self, sides_m: tuple[float, float], stamp_ns: int) -> None:
        """The object was seen whole, and alone in its box."""
        self.size_m = sides_m
        self.whole_ns = stamp_ns

    @property
    def usual_m(self) -> tuple[float, float] | None:
        """Width and height of its box over the last frames: a detector at times gives a part of
        it.
        """
        return self._sizes.sides_m

    def outgrown(
        self,
        sides_m: tuple[float, float],
        noise: float,
        stamp_ns: int,
    ) -> bool:
        """Return whether a box is so much larger than the object's was a moment ago that there is
        more in it.

        One that is not is remembered. ``noise``: standard deviation of a side, relative.
        """
        return (
            self._sizes.note(stamp_ns, sides_m, math.hypot(noise, _GROWTH_SIGMA), _GROWN) > _GROWN
        )

    def _rival_known(self, stamp_ns: int) -> bool:
        return stamp_ns - self.rival_ns <= RIVAL_S * 1e9

    def carriable(self, stamp_ns: int) -> bool:
        """Return whether depth alone may carry the track at a stamp: its box's size is known, and
        was seen lately.

        One that flies is not carried: depth along one row of the image does not say how high it is.
        """
        return (
            self.size_m is not None
            and not self._flies
            and stamp_ns - self.seen_ns <= self._carry_ns
        )

    def update(
        self,
        measured_n_m: Vec3,
        stamp_ns: int,
        *,
        cut: bool = False,
    ) -> None:
        """Fuse one measured position; older stamps than the newest are ignored.

        ``cut``: from a box that the image's border cuts, or that has more in it; it bounds the
        position, and says nothing of the velocity.
        """
        if stamp_ns >= self.stamp_ns:
            sigma_m = self.range_m * (_CUT_SIGMA if cut else MEASUREMENT_SIGMA)
            self._fuse(measured_n_m, stamp_ns, sigma_m, moves=not cut)
            self.seen_ns = stamp_ns

    @property
    def motion(self) -> Motion:
        """Return its place and velocity as of ``stamp_ns``."""
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = self._pp * np.eye(3)
        covariance[:3, 3:] = covariance[3:, :3] = self._pv * np.eye(3)
        covariance[3:, 3:] = self._vv * np.eye(3)
        mean = np.array((*self.position_n_m, *self.velocity_n_mps))
        return Motion(mean, covariance, self.stamp_ns)

    def found_again(self, motion: Motion) -> None:
        """Begin anew where the object surely is."""
        north, east, down, v_north, v_east, v_down = motion.mean.tolist()
        self.position_n_m = north, east, down if self._flies else self.position_n_m[2]
        self.velocity_n_mps = v_north, v_east, v_down if self._flies else 0.0
        P = motion.covariance
        self._pp, self._pv, self._vv = (
            float(np.trace(each)) / 3.0 for each in (P[:3, :3], P[:3, 3:], P[3:, 3:])
        )
        self.stamp_ns = motion.stamp_ns

    def carry(self, measured_n_m: Vec3, stamp_ns: int) -> None:
        """Fuse where the object's depth is, along the ground: it was not seen."""
        north, east, _ = measured_n_m
        self._fuse(
            (north, east, self.position_n_m[2]),
            stamp_ns,
            _CARRIED_SIGMA * self.range_m,
            moves=True,
        )

    def _fuse(
        self,
        measured_n_m: Vec3,
        stamp_ns: int,
        sigma_m: float,
        *,
        moves: bool,
    ) -> None:
        dt = (stamp_ns - self.stamp_ns) * 1e-9
        q = self._accel_mps2**2
        position = add(self.position_n_m, scale(self.velocity_n_mps, dt))
        pp = self._pp + 2.0 * dt * self._pv + dt * dt * self._vv + q * dt**4 / 4.0
        pv = self._pv + dt * self._vv + q * dt**3 / 2.0
        vv = self._vv + q * dt * dt
        noise = sigma_m**2
        gain_p = pp / (pp + noise)
        gain_v = pv / (pp + noise) if moves else 0.0
        innovation = subtract(measured_n_m, position)
        self.position_n_m = add(position, scale(innovation, gain_p))
        north, east, down = add(self.velocity_n_mps, scale(innovation, gain_v))
        self.velocity_n_mps = north, east, down if self._flies else 0.0
        self._pp = (1.0 - gain_p) * pp
        self._pv = (1.0 - gain_p) * pv
        self._vv = vv - gain_v * pv
        self.stamp_ns = stamp_ns
