"""A vehicle driver of one's own, in one file: a rig names it ``copter.py:Copter``. Its far side is an
``Airframe``; a driver of a real one would have a socket or a serial port in its place.
"""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from drivers.interfaces import Capability, FlightMode, VehicleError, VehicleState, VelocitySetpoint
from drivers.rig.parts import PartContext
from path.bounds import Bounds

CLIMB_MPS = 1.0
SILENT_S = 0.5  # without setpoints it lands by itself
LEVEL = (1.0, 0.0, 0.0, 0.0)
STOP = (0.0, 0.0, 0.0)


class Airframe:
    """The far side: it is where its last velocity has brought it."""

    def __init__(self) -> None:
        self.plugged = True
        self.heard = 0
        self.armed = False
        self.mode = FlightMode.HOLD
        self.place_n_m = [0.0, 0.0, 0.0]
        self.velocity_n_mps = (0.0, 0.0, 0.0)
        self._climbs_to_m: float | None = None
        self._seen_s = self._told_s = 0.0

    def tell(self, mode: FlightMode, velocity: tuple[float, float, float], to_m: float = 0) -> None:
        self.step()
        if self.plugged:
            self.heard += 1
            self.mode, self.velocity_n_mps, self._climbs_to_m = mode, velocity, to_m or None
            self._told_s = self._seen_s

    def step(self) -> None:
        now_s = asyncio.get_running_loop().time()
        since_s, self._seen_s = now_s - self._seen_s, now_s
        if self.mode is FlightMode.OFFBOARD and now_s - self._told_s > SILENT_S:
            self.mode, self.velocity_n_mps = FlightMode.LAND, (0.0, 0.0, CLIMB_MPS)
        for axis, speed_mps in enumerate(self.velocity_n_mps):
            self.place_n_m[axis] += speed_mps * since_s
        if self._climbs_to_m is not None and -self.place_n_m[2] >= self._climbs_to_m:
            self._climbs_to_m, self.mode, self.velocity_n_mps = None, FlightMode.HOLD, STOP
        if self.on_ground and self.mode is FlightMode.LAND:
            self.armed, self.velocity_n_mps = False, (0.0, 0.0, 0.0)

    @property
    def on_ground(self) -> bool:
        return self.place_n_m[2] >= -1e-6


@dataclass(frozen=True)
class CopterConfig:
    lost_s: Annotated[float, Bounds(0.1, 30.0)] = 1.5


class Copter:
    Config = CopterConfig
    lacks = frozenset({Capability.GEOFENCE, Capability.PILOT_OVERRIDE})

    def __init__(self, config: CopterConfig, context: PartContext) -> None:
        self._config = config
        self._clock = context.clock
        self.airframe = Airframe()
        self._open = False
        self._state: VehicleState | None = None

    async def __aenter__(self) -> "Copter":
        self._open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._open = False

    @property
    def state(self) -> VehicleState:
        if not self._open:
            raise VehicleError("the copter is not open", "enter it with `async with`")
        self.airframe.step()
        if self.airframe.plugged or self._state is None:
            now_ns = self._clock.now_ns()
            north_m, east_m, down_m = self.airframe.place_n_m
            self._state = VehicleState(
                now_ns, now_ns, (north_m, east_m, down_m), self.airframe.velocity_n_mps, LEVEL,
                self.airframe.armed, not self.airframe.on_ground, True, self.airframe.mode, 0.9,
            )  # fmt: skip
        return self._state

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        return self.state.q_n_b

    async def wait_armable(self, timeout_s: float) -> None:
        await self._until(lambda: self.state.armable, timeout_s)

    async def arm(self) -> None:
        self._heard_of_it()
        self.airframe.tell(FlightMode.HOLD, (0.0, 0.0, 0.0))
        self.airframe.armed = True

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        if not self.state.armed:
            raise VehicleError("it is not armed", "arm it first")
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise VehicleError(f"a height of {height_m} m", "give one above zero")
        self.airframe.tell(FlightMode.TAKEOFF, (0.0, 0.0, -CLIMB_MPS), height_m)
        await self._until(lambda: self.state.mode is FlightMode.HOLD, timeout_s)

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        self._heard_of_it()
        self.airframe.tell(FlightMode.OFFBOARD, first.velocity_n_mps)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        self._heard_of_it()
        if not all(map(math.isfinite, (*setpoint.velocity_n_mps, setpoint.yaw_rad))):
            raise VehicleError("a setpoint that is not finite", "look where it is computed")
        self.airframe.tell(FlightMode.OFFBOARD, setpoint.velocity_n_mps)

    async def hold(self) -> None:
        self._heard_of_it()
        self.airframe.tell(FlightMode.HOLD, (0.0, 0.0, 0.0))

    async def land(self, timeout_s: float) -> None:
        self._heard_of_it()
        self.airframe.tell(FlightMode.LAND, (0.0, 0.0, CLIMB_MPS))
        await self._until(lambda: not self.state.in_air, timeout_s)

    def _heard_of_it(self) -> None:
        """Raise VehicleError when the far side has not been heard for too long, or is closed."""
        silent_s = (self._clock.now_ns() - self.state.heartbeat_ns) * 1e-9
        if silent_s > self._config.lost_s or not self.airframe.plugged:
            raise VehicleError("nothing is heard of the copter", "look at its cable")

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait, but not for a far side that is gone. A command is never sent again."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while not condition() or not self.airframe.plugged:
            self._heard_of_it()
            if loop.time() > end_s:
                raise VehicleError(f"it was not done in {timeout_s:g} s", "see why not")
            await asyncio.sleep(0.02)
