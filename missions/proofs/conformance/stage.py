"""A vehicle on the bench with its driver open, and what every check does with it. Times are the
vehicle's own.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from drivers.interfaces import FlightMode, PartError, Vehicle, VelocitySetpoint
from drivers.mavlink.bench import CommandAnswer, VehicleBench
from drivers.mavlink.modes import CUSTOM_MODE_ENABLED, KINDS
from path.geometry.rotation import yaw_of

Value = float | str | None
Values = dict[str, Value]

POLL_S = 0.01
ANSWER_S = 3.0
READY_S = 90.0
TAKE_OFF_S = 40.0
LAND_S = 60.0
STATION = 251  # the bench's second ground station
RESULTS = (
    "accepted",
    "temporarily rejected",
    "denied",
    "unsupported",
    "failed",
    "in progress",
    "cancelled",
)
# MAV_CMD
ARM = 400
TAKE_OFF = 22
SET_MODE = 176
# with which disarming stops the motors in the air; only ever sent to a simulated vehicle
FORCE = 21196.0


class FlightStage:
    """The tools that a flight of the suite works with."""

    def __init__(self, bench: VehicleBench) -> None:
        self.bench = bench
        self.heard = bench.heard
        self.kind = next(kind for kind in KINDS if kind.name == bench.kind)
        self._vehicle: Vehicle | None = None

    @property
    def vehicle(self) -> Vehicle:
        assert self._vehicle is not None
        return self._vehicle

    @vehicle.setter
    def vehicle(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.bench.watch(vehicle)

    @property
    def now_s(self) -> float:
        return self.bench.now_s

    @property
    def armed(self) -> bool:
        """Return whether it is armed, by the newest heartbeat, whether or not the driver hears
        it.
        """
        return bool(self.heard.shown) and self.heard.shown[-1].armed

    @property
    def height_m(self) -> float:
        return self.bench.instants[-1].height_m if self.bench.instants else 0.0

    @property
    def yaw_rad(self) -> float:
        return yaw_of(self.bench.instants[-1].q_n_b)

    async def until(
        self,
        condition: Callable[[], bool],
        limit_s: float,
        each: Callable[[], None] = lambda: None,
    ) -> float | None:
        """Seconds until it came true, None when it did not within ``limit_s``. Raises PartError of
        the bench.
        """
        start_s = self.now_s
        while not condition():
            self.bench.check()
            if self.now_s - start_s > limit_s:
                return None
            each()
            await asyncio.sleep(POLL_S)
        return self.now_s - start_s

    async def wait(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        await self.until(lambda: False, seconds, each)

    async def order(self, command: int, *params: float) -> str:
        """Command it as a second ground station; the answer in words."""
        sent_s = self.now_s
        self.bench.order(command, *params)
        await self.until(lambda: self.answer(command, sent_s, (STATION, 0)) is not None, ANSWER_S)
        answer = self.answer(command, sent_s, (STATION, 0))
        return "no answer" if answer is None else in_words(answer)

    async def order_mode(self, mode: FlightMode) -> str:
        main, sub = self.kind.set_mode[mode]
        return await self.order(SET_MODE, float(CUSTOM_MODE_ENABLED), float(main), float(sub))

    async def order_take_off(self, height_m: float) -> str:
        unset = math.nan if self.kind.unset is None else self.kind.unset
        # PX4 takes the height from a parameter: what it is given as altitude would be above mean
        # sea level.
        above = unset if self.kind.name == "px4" else height_m
        return await self.order(TAKE_OFF, 0.0, 0.0, 0.0, unset, unset, unset, above)

    def answer(
        self,
        command: int,
        since_s: float,
        to: tuple[int, ...] | None = None,
    ) -> CommandAnswer | None:
        """The first acknowledgement of a command since then."""
        own = (
            each
            for each in self.heard.answers
            if each.command == command and each.time_s >= since_s
        )
        return next((each for each in own if to is None or each.to in to), None)

    def texts(self, since_s: float) -> str:
        """Return the vehicle's important texts since then, each once."""
        said = [
            text
            for time_s, severity, text in self.heard.texts
            if time_s >= since_s and severity <= 4
        ]
        return " | ".join(dict.fromkeys(said)) or "nothing"

    async def ready(self) -> None:
        """Wait until it is on the ground, disarmed, and ready to be armed. Raises VehicleError."""
        await self.vehicle.wait_armable(READY_S)

    async def up(self, height_m: float) -> None:
        """Fly to a height and hold."""
        await self.ready()
        await self.vehicle.arm()
        await self.vehicle.take_off(height_m, TAKE_OFF_S)

    async def down(self) -> None:
        """Bring it to the ground, disarmed, whatever came before. Raises PartError when it cannot
        be.
        """
        self.bench.cut = False
        since_s = self.now_s
        if await self.until(lambda: self._heard_since(since_s), ANSWER_S) is None:
            raise PartError("the driver does not hear the vehicle any more")
        if self.armed:
            await self.vehicle.land(LAND_S)

    def _heard_since(self, since_s: float) -> bool:
        """Two heartbeats have come, so that the driver has taken the first."""
        return len(self.heard.shown) > 1 and self.heard.shown[-2].time_s > since_s

    async def fly(
        self,
        velocity_n_mps: tuple[float, float, float],
        yaw_rad: float,
        seconds: float,
    ) -> float:
        """Setpoints for some time; the moment of the first."""
        setpoint = VelocitySetpoint(velocity_n_mps, yaw_rad)
        start_s = self.now_s
        await self.wait(seconds, lambda: self.vehicle.fly(setpoint))
        return start_s


def in_words(answer: CommandAnswer) -> str:
    return RESULTS[answer.result] if answer.result < len(RESULTS) else f"result {answer.result}"
