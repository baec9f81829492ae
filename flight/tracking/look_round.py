"""Looking at a designated place from other sides: a detector may not know its object from the first
one.
"""

from __future__ import annotations

import math

from flight.config import MissionConfig
from flight.guidance import Vec3, add, bearing, from_heading, subtract
from path.geometry.rotation import wrapped

WIDEST_RAD = 0.5 * math.pi  # from the heading it came with, to either side
_THERE_M = 0.5  # from its first place: it has come there
_SLOW_MPS = 0.25
_INSIDE_FENCE_M = 1.0
# of the acceleration, for the turn: wind, and coming to rest where something is found, want more
_ACCEL_SHARE = 0.25
_LONGEST_STEP_S = 0.2  # a program that slept does not leap


class LookRound:
    """The heading from which a drone looks at the designated place while it has not acquired what
    is there.

    It is the mission's at first. A drone that hung there for ``look_round_s`` without acquiring
    anything goes round the place, a quarter to one side, then to the other, and so on, as far off
    and as high, inside its fence. It goes no farther once it saw two that may be the designated
    one: from the side one may hide the other, or be missed. And it goes not round what flies:
    others may fly where it would go.
    """

    def __init__(self, config: MissionConfig) -> None:
        follow = config.follow
        self._first_rad = math.radians(config.heading_deg)
        self._wait_s = follow.look_round_s
        self._behind_m = follow.behind_m
        self._ended = follow.look_round_s <= 0.0 or follow.behind_m <= 0.0 or config.target.flies
        self._fence = config.fence
        self._speed_mps = min(
            follow.max_speed_mps,
            math.sqrt(_ACCEL_SHARE * config.max_accel_mps2 * max(0.0, follow.behind_m)),
        )
        self._round_rad = 0.0
        self._side = 1.0
        self._there_ns: int | None = None
        self._stepped_ns = 0
        self._settled = False

    @property
    def heading_rad(self) -> float:
        return self._first_rad + self._round_rad

    @property
    def going(self) -> bool:
        """Return whether it has left its first heading."""
        return self._round_rad != 0.0

    def hold(self) -> None:
        """Two were seen that may be the designated one: once it is there it goes round no
        farther.
        """
        self._ended = self._ended or self._there_ns is not None

    def step(
        self,
        now_ns: int,
        off_m: float,
        place_n_m: Vec3,
    ) -> None:
        """One tick. ``off_m``: from where it should be by now. ``place_n_m``: the designated
        one.
        """
        if self._there_ns is None:
            if off_m > _THERE_M:
                return
            self._there_ns = now_ns
        step_s = min((now_ns - self._stepped_ns) * 1e-9, _LONGEST_STEP_S)
        self._stepped_ns = now_ns
        if self._ended or now_ns - self._there_ns < self._wait_s * 1e9:
            return
        round_rad = self._round_rad + self._side * step_s * self._speed_mps / self._behind_m
        behind = add(
            place_n_m, from_heading((-self._behind_m, 0.0, 0.0), self._first_rad + round_rad)
        )
        if abs(round_rad) > WIDEST_RAD or not self._fits(behind):
            self._side = -self._side
        else:
            self._round_rad = round_rad

    def _fits(self, place_n_m: Vec3) -> bool:
        """Return whether a drone has room at a place, however high."""
        north, east, _ = place_n_m
        return self._fence.nearest((north, east, 0.0), _INSIDE_FENCE_M) == (north, east, 0.0)

    @property
    def velocity_n_mps(self) -> Vec3:
        """The velocity of the place behind the designated one, as it goes round."""
        if not self.going or self._ended:
            return 0.0, 0.0, 0.0
        return from_heading((0.0, -self._side * self._speed_mps, 0.0), self.heading_rad)

    def yaw_rad(self, position_n_m: Vec3, place_n_m: Vec3) -> float:
        """The yaw at a position: to the place where it has left its first heading, however far it
        lags behind.
        """
        return (
            bearing(subtract(place_n_m, position_n_m))
            if self.going and not self._settled
            else self.heading_rad
        )

    def found(self, position_n_m: Vec3, target_n_m: Vec3) -> float:
        """Ends it: returns the heading from which the target was found, to keep."""
        self._ended, self._round_rad = (
            True,
            wrapped(self.yaw_rad(position_n_m, target_n_m) - self._first_rad),
        )
        return self.heading_rad

    def settle(self, off_m: float, speed_mps: float) -> None:
        """It follows what it found: it comes to rest past its place first, and looks along its
        heading once it is back.

        Args:
            off_m, speed_mps: of its place, and relative to that.
        """
        self._settled = self._settled or (off_m < _THERE_M and speed_mps < _SLOW_MPS)
