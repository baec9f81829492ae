"""A vehicle of the sim levels: talks to the simulated autopilot in this process, as late and as
lossy as a real link.

Telemetry is not pushed: whoever asks gets what would have arrived by the world's present, with the
stamps of its arrival, so that the answer does not depend on how often is asked. Mode, arming and
battery come with heartbeats.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Annotated, Self

from drivers.interfaces import (
    SURE,
    Below,
    Capability,
    FlightMode,
    TakenOver,
    VehicleError,
    VehicleState,
    VelocitySetpoint,
    too_high,
)
from drivers.perception.history import StateHistory
from drivers.rig.parts import PartContext
from hil.autopilot.autopilot import Ack, Autopilot
from hil.world.seam import harness_of
from hil.world.world import VehicleTelemetry
from path.bounds import Bounds, check_bounds
from path.messages import Quat
from path.values import frozen

POLL_S = 0.05
SETTLED_MPS = 0.3
SHORT_BEATS = 10  # in a row that show a hold, and not at the height: it was not the take-off's end
SETPOINT_PERIOD_S = 0.05  # while the vehicle has not shown OFFBOARD yet


@frozen
class SimVehicleConfig:
    """Options of the vehicle in a rig.

    Attributes:
        latency_s: of telemetry and of commands, one way.
        heartbeat_s: period of mode, arming, battery.
        connect_timeout_s: for the first heartbeat.
        command_timeout_s: for one answer.
        mode_timeout_s: from an accepted command until telemetry shows it.
        heartbeat_timeout_s: any wait ends with an error when the newest heartbeat is older.
        take_off_tolerance_m: height error at which a take-off is over.
        max_speed_mps: faster setpoints are refused.
    """

    latency_s: Annotated[float, Bounds(0.0, 2.0)] = 0.004
    heartbeat_s: Annotated[float, Bounds(0.005, 10.0)] = 0.2
    connect_timeout_s: Annotated[float, Bounds(0.1, 300.0)] = 5.0
    command_timeout_s: Annotated[float, Bounds(0.05, 30.0)] = 1.0
    mode_timeout_s: Annotated[float, Bounds(0.05, 60.0)] = 3.0
    heartbeat_timeout_s: Annotated[float, Bounds(0.2, 30.0)] = 1.5
    take_off_tolerance_m: Annotated[float, Bounds(0.01, 5.0)] = 0.3
    max_speed_mps: Annotated[float, Bounds(0.1, 50.0)] = 5.0

    def __post_init__(self) -> None:
        check_bounds(self)


class SimVehicle:
    """The Vehicle Protocol on a drone of ``hil.world.world``. Motion commands are sent once."""

    Config = SimVehicleConfig
    lacks = frozenset({Capability.GEOFENCE})

    def __init__(self, config: SimVehicleConfig, context: PartContext) -> None:
        self._config = config
        self._role = context.role
        self._clock = context.clock
        self._harness = harness_of(
            context.harness, "hil.vehicle.sim_vehicle:SimVehicle", VehicleError
        )
        self._history = StateHistory()
        self._newest: VehicleTelemetry | None = None
        self._beat: VehicleTelemetry | None = None
        self._newest_ns = self._beat_ns = 0
        self._below: Below | None = None
        self._beats = -1
        self._taken_s = self._pulled_s = -math.inf
        self._state: VehicleState | None = None
        self._open = False

    async def __aenter__(self) -> Self:
        self._open = True
        if not await self._poll(lambda: self._beat is not None, self._config.connect_timeout_s):
            self._open = False
            raise VehicleError(
                f"no heartbeat from the {self._role.value}'s vehicle in {self._config.connect_timeout_s:g} s",
                "is its link cut by a fault?",
            )
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close the vehicle. Without setpoints the autopilot holds, then lands."""
        self._open = False

    # --- telemetry ---

    @property
    def state(self) -> VehicleState:
        self._pull()
        if self._state is None:
            self._state = self._combined()
        return self._state

    def attitude_at(self, stamp_ns: int) -> Quat:
        self._pull()
        return self._history.attitude_at(stamp_ns)

    @property
    def _silent(self) -> bool:
        return self._role in self._harness.silent_vehicles

    def _pull(self) -> None:
        """Take what has arrived since the last time."""
        if not self._open:
            return
        world = self._harness.world
        now_s = world.time_s
        if now_s == self._pulled_s:
            return
        self._pulled_s = now_s
        arrived_s = now_s - self._config.latency_s + 1e-9
        if self._silent:
            self._taken_s = now_s
            return
        waiting: list[VehicleTelemetry] = []
        for telemetry in reversed(world.drone(self._role).telemetry):
            if telemetry.time_s <= self._taken_s:
                break
            if telemetry.time_s <= arrived_s:
                waiting.append(telemetry)
        now_ns = self._clock.now_ns() if waiting else 0
        for telemetry in reversed(waiting):
            self._take(telemetry, now_ns - round((arrived_s - telemetry.time_s) * 1e9))
        if waiting:
            self._state = None

    def _take(self, telemetry: VehicleTelemetry, arrival_ns: int) -> None:
        self._take_heartbeat(telemetry, arrival_ns)
        self._newest = telemetry
        self._newest_ns = arrival_ns
        if telemetry.below_m is None:
            self._below = None
        elif self._below is None or self._below.distance_m != telemetry.below_m:
            self._below = Below(arrival_ns, telemetry.below_m)
        self._history.add(arrival_ns, telemetry.estimate.q_n_b)

    def _take_heartbeat(self, telemetry: VehicleTelemetry, arrival_ns: int) -> None:
        beats = math.floor(telemetry.time_s / self._config.heartbeat_s + 1e-6)
        if beats > self._beats:
            self._beat = telemetry
            self._beats = beats
            self._beat_ns = arrival_ns
        self._taken_s = telemetry.time_s

    def _combined(self) -> VehicleState:
        newest = self._newest
        beat = self._beat
        if newest is None or beat is None:
            raise _not_connected()
        estimate = newest.estimate
        return VehicleState(
            stamp_ns=self._newest_ns,
            heartbeat_ns=self._beat_ns,
            position_n_m=newest.position_n_m,
            velocity_n_mps=estimate.velocity_n_mps,
            q_n_b=estimate.q_n_b,
            armed=beat.armed,
            in_air=not beat.landed,
            armable=beat.armable,
            mode=beat.mode,
            battery=beat.battery,
            below=self._below,
        )

    # --- commands ---

    async def wait_armable(self, timeout_s: float) -> None:
        if not await self._until(lambda: self.state.armable, timeout_s):
            reasons = (
                ", ".join(self._harness.world.drone(self._role).autopilot.reasons)
                or "it gives no reason"
            )
            raise VehicleError(
                f"the {self._role.value}'s vehicle is not ready to arm after {timeout_s:g} s: {reasons}",
                "remedy what it names, then start again",
            )

    async def arm(self) -> None:
        await self._do("arm", lambda autopilot, now_s: autopilot.request_arm(now_s, True))
        if not await self._until(
            lambda: self.state.armed or self._killed, self._config.mode_timeout_s
        ):
            raise VehicleError(
                "arming was accepted, but the vehicle is not armed", "see why it disarmed"
            )

        if self._killed:
            raise TakenOver("the motors were stopped as it was armed", "the pilot's kill switch")

    @property
    def _killed(self) -> bool:
        """Whether the newest heartbeat tells that a pilot's switch keeps the motors still."""
        return self._beat is not None and self._beat.killed

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise VehicleError(f"take-off refused: height {height_m} m", "give a height above zero")
        home_down_m = self.state.position_n_m[2]
        sent_ns = await self._do(
            "take off", lambda autopilot, now_s: autopilot.request_takeoff(now_s, height_m)
        )

        def arrived() -> bool:
            state = self.state
            off_m = abs(home_down_m - state.position_n_m[2] - height_m)
            steady = abs(state.velocity_n_mps[2]) <= SETTLED_MPS
            return (
                steady
                and off_m <= self._config.take_off_tolerance_m
                and state.mode is FlightMode.HOLD
            )

        def short() -> bool:
            off_m = abs(home_down_m - self.state.position_n_m[2] - height_m)
            return self.state.mode is FlightMode.HOLD and off_m > self._config.take_off_tolerance_m

        held_short = self._shown_for(short, sent_ns, SHORT_BEATS)

        def ended() -> bool:
            state = self.state
            flying = state.armed and state.mode in (FlightMode.TAKEOFF, FlightMode.HOLD)
            return state.heartbeat_ns > sent_ns and (not flying or held_short())

        if not await self._until(lambda: arrived() or ended(), timeout_s):
            raise VehicleError(
                f"not at {height_m:g} m {timeout_s:g} s after the take-off began", "hold or land"
            )
        if ended():
            if self.state.armed:
                reached_m = home_down_m - self.state.position_n_m[2]
                if self.state.mode is FlightMode.HOLD and reached_m > height_m:
                    raise too_high(reached_m, height_m)
                said = f"take-off ended on the way: mode {self.state.mode.value}"
                raise TakenOver(said, "the pilot has control, or a failsafe acted")
            if self._killed:
                raise TakenOver(
                    "take-off ended on the way: the motors were stopped", "the pilot's kill switch"
                )
            raise VehicleError("take-off ended on the way: disarmed", "see why it disarmed")

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        self._check(first)
        stream = asyncio.create_task(self._stream(first))
        try:
            await asyncio.sleep(SETPOINT_PERIOD_S)  # the autopilot wants setpoints before the mode
            await self._change_mode(FlightMode.OFFBOARD, "enter offboard control")
        finally:
            stream.cancel()
            await asyncio.gather(stream, return_exceptions=True)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        if not self._open:
            raise _not_connected()
        self._check(setpoint)
        world = self._harness.world
        if not self._silent:
            world.drone(self._role).autopilot.setpoint(world.time_s, setpoint)

    async def hold(self) -> None:
        await self._change_mode(FlightMode.HOLD, "hold")

    async def land(self, timeout_s: float) -> None:
        self._check_alive()  # "not armed" must be news
        if not self.state.armed:
            return
        await self._change_mode(FlightMode.LAND, "land", lambda: not self.state.armed)
        over = await self._until(
            lambda: not self.state.armed or self.state.mode is not FlightMode.LAND, timeout_s
        )
        if not over:
            raise VehicleError(
                f"not on the ground {timeout_s:g} s after the landing began",
                "land by remote control",
            )
        if self.state.armed:
            raise TakenOver(
                f"landing ended by a change to mode {self.state.mode.value}",
                "the pilot has control",
            )

    # --- inside ---

    def _check(self, setpoint: VelocitySetpoint) -> None:
        speed = math.hypot(*setpoint.velocity_n_mps)
        if not (math.isfinite(speed) and math.isfinite(setpoint.yaw_rad)):
            raise VehicleError(f"setpoint not sent: {setpoint} is not finite")
        if speed > self._config.max_speed_mps:
            limit = self._config.max_speed_mps
            raise VehicleError(
                f"setpoint not sent: {speed:.2f} m/s is above max_speed_mps = {limit:g}",
                "fly slower",
            )

    def _check_alive(self) -> None:
        if not self._open:
            raise _not_connected()
        age_s = (self._clock.now_ns() - self.state.heartbeat_ns) * 1e-9
        if age_s > self._config.heartbeat_timeout_s:
            raise VehicleError(
                f"the {self._role.value}'s vehicle has been silent for {age_s:.1f} s",
                "take over by remote control; check its link",
            )

    async def _do(self, what: str, send: Callable[[Autopilot, float], Ack]) -> int:
        """One command that must be accepted; the role-clock stamp of its answer. Raises with the
        vehicle's reason.
        """
        self._check_alive()
        await asyncio.sleep(self._config.latency_s)
        if self._silent:
            await asyncio.sleep(self._config.command_timeout_s)
            raise VehicleError(
                f"no answer to the command to {what}: whether the vehicle acts on it is unknown",
                "look at the vehicle before anything else is tried",
            )
        world = self._harness.world
        ack = send(world.drone(self._role).autopilot, world.time_s)
        await asyncio.sleep(self._config.latency_s)
        if not ack.accepted:
            raise VehicleError(
                f"the vehicle refused to {what}: {ack.reason}",
                "remedy what it names, then start again",
            )
        return self._clock.now_ns()

    async def _change_mode(
        self, mode: FlightMode, what: str, or_else: Callable[[], bool] = lambda: False
    ) -> None:
        sent_ns = await self._do(what, lambda autopilot, now_s: autopilot.request_mode(now_s, mode))

        def shown() -> bool:
            return self.state.heartbeat_ns > sent_ns and (self.state.mode is mode or or_else())

        left = self._shown_for(lambda: self.state.mode is not mode, sent_ns, SURE)
        seen = {self.state.mode, mode}
        begun_with = len(seen)

        def settled() -> bool:
            """It is so, or it is plain that it will not be: setpoints then only look like a fight
            for control.
            """
            seen.add(self.state.mode)
            return shown() or (mode is FlightMode.OFFBOARD and left())

        if not await self._until(settled, self._config.mode_timeout_s) or not shown():
            if len(seen) > begun_with:
                raise TakenOver(
                    f"the vehicle agreed to {what}, and was put in mode {self.state.mode.value}",
                    "the pilot has control, or a failsafe acted",
                )
            raise VehicleError(
                f"the vehicle agreed to {what} but is in mode {self.state.mode.value}",
                "the pilot may have control; look at its ground station",
            )

    def _shown_for(
        self, condition: Callable[[], bool], sent_ns: int, beats: int
    ) -> Callable[[], bool]:
        """Return a condition: so it was in that many heartbeats in a row, all younger than a
        command.
        """
        seen: set[int] = set()

        def so() -> bool:
            state = self.state
            if state.heartbeat_ns <= sent_ns:
                return False
            if not condition():
                seen.clear()
                return False
            seen.add(state.heartbeat_ns)
            return len(seen) >= beats

        return so

    async def _stream(self, setpoint: VelocitySetpoint) -> None:
        while True:
            self.fly(setpoint)
            await asyncio.sleep(SETPOINT_PERIOD_S)

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Return whether the condition came true in time. Raises VehicleError when the vehicle
        falls silent.
        """

        def alive_and_true() -> bool:
            self._check_alive()
            return condition()

        return await self._poll(alive_and_true, timeout_s)

    async def _poll(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + timeout_s
        while True:
            self._pull()
            if condition():
                return True
            if loop.time() >= end_s:
                return False
            await asyncio.sleep(POLL_S)


def _not_connected() -> VehicleError:
    return VehicleError("the vehicle is not connected", "enter it with `async with` first")
