"""Steps of an estimator: a place, height or heading that moved faster than the reported velocity
and rate allow.

An autopilot's estimate of its place, height or heading may step: it goes over to another estimator,
or its GPS or its compass is believed again. The vehicle has not moved. ``StepWatch`` sees such a
step in the states of one vehicle; ``flight.steady_vehicle`` takes it out of them.

A step is what the velocity and the heading's rate do not explain. Between two states dt apart a
vehicle moves by the mean of its two velocities, but for what an acceleration g can add (g dt²/4),
an error of the velocity as large as the speed that is flown (v dt), and stamps that are late. What
the estimator's noise adds besides is learned in flight. An estimator that walks a glitch off is
slower than all that: it is followed, unless it walks all the time (``flight.own_walk``). Where the
autopilot counts its resets, half of it is enough for a step shortly after the count has changed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from drivers.interfaces import VehicleState
from flight.guidance import GRAVITY_MPS2, Vec3, add, norm, scale, subtract
from flight.own_walk import OwnWalk
from path.geometry.rotation import wrapped, yaw_of
from path.values import value

SIGMAS = 5.0
# of that is enough, shortly after the autopilot's own count of its resets has changed
COUNTED_SHARE = 0.5
COUNTED_NS = 500_000_000  # for so long: the count comes in another message than the place
TURN_RPS2 = 10.0  # no multicopter turns its nose harder
LATE_S = 0.04  # what a state's stamp may be late by more than the one before
# states nearer to each other came in one burst: the older one is compared with the next
LEAST_NS = 10_000_000
LATELY_NS = 150_000_000  # the last moments: what came late is here by then
SETTLED_NS = 1_000_000_000  # after arming: the height is counted anew when a vehicle arms
MADE_UP = 0.3  # of a leap: so much was missing before, and it is none
LEARNED = 20  # residuals, before one may be a step
FORGET = 0.02  # of the noise, by each residual


@value
class Step:
    """What an estimator stepped by.

    Attributes:
        before_ns, stamp_ns: of the last state before it and the first one after it, role clock.
        shift_n_m: by how much the reported place is farther north, east and down since then.
        turn_rad: by how much the reported heading is farther clockwise.
        counted: the autopilot's count of its resets has changed too.
    """

    before_ns: int
    stamp_ns: int
    shift_n_m: Vec3
    turn_rad: float
    counted: bool

    def __str__(self) -> str:
        """Words for the crew."""
        north, east, down = self.shift_n_m
        said: list[str] = []
        if north or east:
            said.append(f"its place by {math.hypot(north, east):.2f} m")
        if down:
            said.append(f"its height by {-down:+.2f} m")
        if self.turn_rad:
            said.append(f"its heading by {math.degrees(self.turn_rad):+.0f} degrees")
        return " and ".join(said)


class _Residuals:
    """What a quantity moves by beside its rate: its usual size, and what it was lately."""

    def __init__(self) -> None:
        self._square = 0.0  # its mean, which forgets
        self._noted = 0
        self._lately: deque[tuple[int, Sequence[float]]] = deque()

    def is_step(
        self,
        stamp_ns: int,
        residual: Sequence[float],
        explained: float,
        share: float,
    ) -> bool:
        """Return whether a residual is a step: more than what explains it, and than noise.

        ``share``: of that which is enough.
        """
        while self._lately and stamp_ns - self._lately[0][0] > LATELY_NS:
            self._lately.popleft()
        size = math.hypot(*residual)
        known = self._noted >= LEARNED
        enough = share * (explained + SIGMAS * math.sqrt(self._square))
        if known and size > enough and self._stays(residual, size):
            # Little is learned from a step; but where all are, the noise has grown.
            self._learn(enough)
            self._lately.clear()
            return True
        self._learn(size)
        self._lately.append((stamp_ns, residual))
        return False

    def _learn(self, size: float) -> None:
        self._noted += 1
        weight = max(FORGET, 1.0 / self._noted)
        self._square += weight * (size * size - self._square)

    def _stays(self, residual: Sequence[float], size: float) -> bool:
        """Return whether it does not just make up for what was missing before.

        Telemetry that comes late and then at once stands still first and leaps then.
        """
        along = [
            sum(a * b for a, b in zip(earlier, residual, strict=True))
            for _, earlier in self._lately
        ]
        return min(along, default=0.0) > -MADE_UP * size * size


class StepWatch:
    """Sees the steps in the states of one vehicle. Pure: states come in, steps go out.

    A vehicle that was never armable is still finding its place: that is followed. So is the height
    of one that stands on the ground, where autopilots begin to count it anew.

    Args:
        fastest_mps: the highest speed that is flown.

    Attributes:
        walked_n_m: what the reported place has moved by that is neither a step nor motion.
    """

    def __init__(self, fastest_mps: float) -> None:
        self.walked_n_m: Vec3 = (0.0, 0.0, 0.0)
        self._walk_across = OwnWalk(2)
        self._walk_height = OwnWalk(1)
        self._fastest_mps = fastest_mps
        self._before: VehicleState | None = None
        self._across = _Residuals()
        self._height = _Residuals()
        self._turn = _Residuals()
        self._headings: deque[tuple[int, float]] = deque()  # of the last moments: stamp, rad
        self._counted_ns: int | None = None
        self._armed_ns: int | None = None
        self._flew = False  # since it was armed
        self._ready = False

    @property
    def counts_height(self) -> bool:
        """Return whether the newest state's height is one over a ground that stays."""
        newest = self._before
        if newest is None or self._armed_ns is None:
            return False
        return newest.in_air or newest.stamp_ns - self._armed_ns > SETTLED_NS

    def look(self, state: VehicleState) -> Step | None:
        """Return the step between the state that was looked at before and this one; None where
        there is none.
        """
        before = self._before
        if before is not None and state.stamp_ns - before.stamp_ns < LEAST_NS:
            return None
        self._before = state
        self._ready = self._ready or state.armable or state.armed
        self._note_arming(state)
        if before is None or not (_is_finite(before) and _is_finite(state)):
            self._headings.clear()
            return None
        self._note_count(before, state)
        mean_mps = scale(add(before.velocity_n_mps, state.velocity_n_mps), 0.5)
        residual_n_m = _residual(before, state, mean_mps)
        shift_n_m = self._shift(before, state, residual_n_m, norm(mean_mps))
        turn_rad = self._turned(before, state)
        if self._ready:
            self._note_walk(subtract(residual_n_m, shift_n_m), before, state)
        if not self._ready or not (any(shift_n_m) or turn_rad):
            return None
        return Step(before.stamp_ns, state.stamp_ns, shift_n_m, turn_rad, self._counted(state))

    def _note_arming(self, state: VehicleState) -> None:
        self._flew = state.armed and (self._flew or state.in_air)
        if not state.armed:
            self._armed_ns = None
        elif self._armed_ns is None:
            self._armed_ns = state.stamp_ns

    def _note_count(self, before: VehicleState, state: VehicleState) -> None:
        known = before.resets is not None and state.resets is not None
        if known and before.resets != state.resets:
            self._counted_ns = state.stamp_ns

    def _counted(self, state: VehicleState) -> bool:
        """Return whether the autopilot said lately that it reset its estimate."""
        return self._counted_ns is not None and state.stamp_ns - self._counted_ns <= COUNTED_NS

    def _note_walk(
        self,
        residual_n_m: Vec3,
        before: VehicleState,
        state: VehicleState,
    ) -> None:
        dt_s = (state.stamp_ns - before.stamp_ns) * 1e-9
        north, east, down = residual_n_m
        out_north, out_east = self._walk_across.taken_out((north, east), dt_s)
        (out_down,) = self._walk_height.taken_out((down,), dt_s)
        walked_n_m = add(self.walked_n_m, (out_north, out_east, out_down))
        if not self.counts_height:
            # On the ground its height is counted anew, and is right.
            walked_n_m = walked_n_m[0], walked_n_m[1], 0.0
        self.walked_n_m = walked_n_m

    def _shift(
        self, before: VehicleState, state: VehicleState, residual_n_m: Vec3, speed_mps: float
    ) -> Vec3:
        dt_s = (state.stamp_ns - before.stamp_ns) * 1e-9
        north, east, down = residual_n_m
        explained_m = (
            0.25 * GRAVITY_MPS2 * dt_s * dt_s + self._fastest_mps * dt_s + speed_mps * LATE_S
        )
        share = COUNTED_SHARE if self._counted(state) else 1.0
        # some vehicles take the ground for their height then
        landed = self._flew and not state.in_air
        across = self._across.is_step(state.stamp_ns, (north, east), explained_m, share)
        high = self._height.is_step(state.stamp_ns, (down,), explained_m, share)
        return (
            north if across else 0.0,
            east if across else 0.0,
            down if high and self.counts_height and not landed else 0.0,
        )

    def _turned(self, before: VehicleState, state: VehicleState) -> float:
        dt_ns = state.stamp_ns - before.stamp_ns
        dt_s = dt_ns * 1e-9
        rate_rps, since_s = self._rate()
        yaw_rad = yaw_of(state.q_n_b)
        turned_rad = wrapped(yaw_rad - yaw_of(before.q_n_b))
        step_rad = 0.0
        if dt_ns > LATELY_NS:
            self._headings.clear()  # the rate of before says nothing any more
        elif rate_rps is not None:
            left_rad = wrapped(turned_rad - rate_rps * dt_s)
            share = COUNTED_SHARE if self._counted(state) else 1.0
            explained_rad = TURN_RPS2 * (0.5 * since_s + dt_s) * dt_s + abs(rate_rps) * LATE_S
            if self._turn.is_step(state.stamp_ns, (left_rad,), explained_rad, share):
                step_rad = left_rad
        self._note_heading(state.stamp_ns, yaw_rad, step_rad)
        return step_rad

    def _rate(self) -> tuple[float | None, float]:
        """The rate of turning over the last moments, rad/s, and how long these are, s."""
        if len(self._headings) < 2:
            return None, 0.0
        first_ns, first_rad = self._headings[0]
        last_ns, last_rad = self._headings[-1]
        since_s = (last_ns - first_ns) * 1e-9
        return wrapped(last_rad - first_rad) / since_s, since_s

    def _note_heading(
        self,
        stamp_ns: int,
        yaw_rad: float,
        step_rad: float,
    ) -> None:
        if step_rad:
            self._headings = deque((at_ns, before + step_rad) for at_ns, before in self._headings)
        while len(self._headings) > 2 and stamp_ns - self._headings[0][0] > LATELY_NS:
            self._headings.popleft()
        self._headings.append((stamp_ns, yaw_rad))


def _residual(before: VehicleState, state: VehicleState, mean_mps: Vec3) -> Vec3:
    """What the velocity does not explain of the way between two states."""
    dt_s = (state.stamp_ns - before.stamp_ns) * 1e-9
    moved_m = subtract(state.position_n_m, before.position_n_m)
    return subtract(moved_m, scale(mean_mps, dt_s))


def _is_finite(state: VehicleState) -> bool:
    return math.isfinite(sum(state.position_n_m) + sum(state.velocity_n_mps) + sum(state.q_n_b))
