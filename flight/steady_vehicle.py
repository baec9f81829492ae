"""A vehicle whose estimator may step: its states go on in the frame in which the flight began.

Everything that a flight knows (the track of the target, the designated place, homes, the fence,
ways, what the other drone was told) was reckoned before the estimator stepped, and the vehicle has
not moved. So the step is taken out here, once, of every state and attitude, and put back into what
is commanded: above this seam nothing has moved. That is the same as to move all that is known by
the step, and to turn it about the vehicle.

    place of the autopilot = place of the flight + shift,   heading of the autopilot = heading of the flight + turn

A position that walks all the time (``flight.own_walk``) is a shift that grows from state to state.

``RoleSession`` wraps every vehicle so. The guard, which is a program of its own, and the
autopilot's own fence go by what the autopilot says: ``as_reported`` is for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from drivers.interfaces import Capability, Vehicle, VehicleState, VelocitySetpoint, lacking
from flight.config import MissionConfig
from flight.estimator_steps import Step, StepWatch
from flight.guidance import Vec3, add, subtract
from path.geometry.rotation import multiply, quat_from_rpy, slerp, wrapped
from path.messages import Quat


class SteadyVehicle:
    """A vehicle whose estimator's steps are taken out of its states. The Vehicle Protocol on
    another one.

    Attributes:
        steps: all that were seen so far.
    """

    def __init__(self, vehicle: Vehicle, config: MissionConfig) -> None:
        self._vehicle = vehicle
        self._watch = StepWatch(max(config.follow.max_speed_mps, config.rendezvous.max_speed_mps))
        self._raw: VehicleState | None = None
        self._steady: VehicleState | None = None
        self._shift_n_m: Vec3 = (0.0, 0.0, 0.0)
        self._turn_rad = 0.0
        self.steps: list[Step] = []
        # of each step: the attitudes before and after it, without it
        self._ends: list[tuple[Quat, Quat]] = []

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        config: MissionConfig,
    ) -> Self:
        """The vehicle, made steady where it is not."""
        return vehicle if isinstance(vehicle, cls) else cls(vehicle, config)

    async def __aenter__(self) -> Self:
        await self._vehicle.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        await self._vehicle.__aexit__(kind, error, trace)

    # --- states, as if nothing had stepped ---

    @property
    def state(self) -> VehicleState:
        raw = self._vehicle.state
        if raw is self._raw and self._steady is not None:
            return self._steady
        before = self._steady
        step = self._watch.look(raw)
        if step is not None:
            self._shift_n_m = add(self._shift_n_m, step.shift_n_m)
            self._turn_rad = wrapped(self._turn_rad + step.turn_rad)
        if not self._watch.counts_height:
            # On the ground its height is counted anew, and is right.
            north, east, _ = self._shift_n_m
            self._shift_n_m = north, east, 0.0
        steady = self._without_steps(raw)
        if step is not None and before is not None:
            self.steps.append(step)
            self._ends.append((before.q_n_b, steady.q_n_b))
        self._raw = raw
        self._steady = steady
        return steady

    def attitude_at(self, stamp_ns: int) -> Quat:
        """As the vehicle's own; between the states around a step, whose instant nobody knows, from
        one to the other.
        """
        turn_rad = self._turned_by_now()
        for step, ends in zip(reversed(self.steps), reversed(self._ends), strict=True):
            if stamp_ns >= step.stamp_ns:
                break
            if stamp_ns > step.before_ns:
                passed = (stamp_ns - step.before_ns) / (step.stamp_ns - step.before_ns)
                return slerp(*ends, passed)
            turn_rad -= step.turn_rad
        q_n_b = self._vehicle.attitude_at(stamp_ns)
        return _turned(q_n_b, -turn_rad) if turn_rad else q_n_b

    def _turned_by_now(self) -> float:
        """The turn, what has come since the last look included."""
        _ = self.state
        return self._turn_rad

    @property
    def _off_n_m(self) -> Vec3:
        """Return what the autopilot's place is off that of the flight: its steps, and its walk."""
        return add(self._shift_n_m, self._watch.walked_n_m)

    def _without_steps(self, raw: VehicleState) -> VehicleState:
        off_n_m = self._off_n_m
        if not (any(off_n_m) or self._turn_rad):
            return raw
        return replace(
            raw,
            position_n_m=subtract(raw.position_n_m, off_n_m),
            q_n_b=_turned(raw.q_n_b, -self._turn_rad),
        )

    def as_reported(self, place_n_m: Vec3) -> Vec3:
        """A place as whoever goes by the autopilot's own words has it."""
        return add(place_n_m, self._off_n_m)

    # --- commands, as the autopilot has them ---

    def fly(self, setpoint: VelocitySetpoint) -> None:
        self._vehicle.fly(self._as_commanded(setpoint))

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        await self._vehicle.start_offboard(self._as_commanded(first))

    def _as_commanded(self, setpoint: VelocitySetpoint) -> VelocitySetpoint:
        """Only the heading: velocities are along north and east, and those did not turn."""
        if not self._turn_rad:
            return setpoint
        return replace(setpoint, yaw_rad=wrapped(setpoint.yaw_rad + self._turn_rad))

    async def wait_armable(self, timeout_s: float) -> None:
        await self._vehicle.wait_armable(timeout_s)

    async def arm(self) -> None:
        await self._vehicle.arm()

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        await self._vehicle.take_off(height_m, timeout_s)

    async def hold(self) -> None:
        await self._vehicle.hold()

    async def land(self, timeout_s: float) -> None:
        await self._vehicle.land(timeout_s)

    # --- what the vehicle is besides ---

    @property
    def lacks(self) -> frozenset[Capability]:
        return lacking(self._vehicle)

    @property
    def ignored(self) -> Mapping[str, int]:
        """Everything that the vehicle did not believe, in words, and its count; nothing where it
        does not say.
        """
        return getattr(self._vehicle, "ignored", {})

    def __getattr__(self, name: str) -> Any:
        """What only some vehicles can do."""
        return getattr(self._vehicle, name)


def _turned(q_n_b: Quat, turn_rad: float) -> Quat:
    """An attitude turned about the vertical."""
    return multiply(quat_from_rpy(0.0, 0.0, turn_rad), q_n_b)
