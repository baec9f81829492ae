"""DJI Tello through djitellopy, behind the Vehicle Protocol: flown by its sticks, confirmed by its state packets."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Self

from drivers.interfaces import Capability, FlightMode, VehicleError, VehicleState, VelocitySetpoint
from drivers.perception.history import StateHistory
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartContext
from drivers.tello.check import drone_findings
from drivers.tello.commands import TelloLink, link_to, said
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.state import DeadReckoning, Placement, TelloReport, quaternion
from drivers.tello.words import CENTRE, refused, sticks
from path.geometry.rotation import wrapped
from path.messages import Vec3

POLL_S = 0.02
RC_PERIOD_S = 0.05
MOTORS_OFF_S = 1.6  # its clock of running motors counts whole seconds: not for so long, and they stand
ON_GROUND_M = 0.25
STATE_AGE_S = 1.0  # older, and any wait ends with an error
SECOND_LOOK_S = 0.3  # in which a packet that waits to be read must come
TAKE_OFF_ANSWER_S = 20.0  # it answers once it hovers
OFF_GROUND_M = 0.35
CLIMB_GAIN_HZ, CLIMB_MPS = 1.0, 0.5
SETTLED_MPS = 0.25
LAND_TRIES = 3
BLIND_LAND_S = 0.2
HOLD_TIMES = 3  # datagrams without an answer, so said again
KEEP_ALIVE_S = 4.0  # of the 15 s of silence after which it lands
YAW_GAIN_HZ = 1.5

_log = logging.getLogger(__name__)


class TelloVehicle:
    """Implements ``drivers.interfaces.Vehicle``.

    Every command is sent once, landing excepted. What it did is taken from state packets, never from an ``ok`` alone.
    ``mode`` is what this driver last commanded: the drone itself does not say.
    """

    Config = TelloVehicleConfig
    lacks = frozenset({Capability.GEOFENCE, Capability.GLOBAL_POSITION, Capability.PILOT_OVERRIDE})

    def __init__(self, config: TelloVehicleConfig, context: PartContext) -> None:
        self._config = config
        self._context = context
        self._link: TelloLink | None = None
        self._history = StateHistory()
        self._reckoning = DeadReckoning(
            Placement(
                config.north_m, config.east_m, math.radians(config.heading_deg), config.placement_sigma_m,
                config.velocity_sigma_mps,
            ),
            config.velocity_frame,
        )  # fmt: skip
        self._state: VehicleState | None = None
        self._mode = FlightMode.HOLD
        self._armed = False  # by the script; a take-off uses it up
        self._flying = False  # from the moment a take-off is sent until the motors stand
        self._motors = (0, 0)  # the newest count of its clock of running motors, and when that changed, ns
        self._keeper: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        link = link_to(self._config, self._context.clock)
        link.on_report = self._on_report
        await link.acquire()
        self._link = link
        if link.report is not None and self._state is None:
            self._on_report(link.report)
        self._keeper = asyncio.create_task(self._keep_alive(), name="tello-keep-alive")
        return self

    async def __aexit__(self, *_: object) -> None:
        self._armed = False
        if self._keeper is not None:
            self._keeper.cancel()
            await asyncio.gather(self._keeper, return_exceptions=True)
            self._keeper = None
        if self._link is not None:
            link, self._link = self._link, None
            link.on_report = None
            await link.release()

    async def examine(self) -> Sequence[Finding]:
        return await drone_findings(self._open_link())

    # --- state ---

    @property
    def state(self) -> VehicleState:
        if self._state is None:
            raise VehicleError("the drone is not connected", "open it first")
        if self._link is not None:
            self._link.clock.follow()
        return self._state

    @property
    def link(self) -> TelloLink:
        """The link to the drone; VehicleError while it is closed."""
        return self._open_link()

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the horizontal position by now, per axis."""
        return self._reckoning.position_sigma_m

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        return self._history.attitude_at(stamp_ns)

    def _on_report(self, report: TelloReport) -> None:
        """Takes a report on djitellopy's thread: one immutable value replaces the last."""
        reckoning = self._reckoning
        reckoning.add(report)
        q_n_b = quaternion(report.roll_rad, report.pitch_rad, reckoning.heading_rad)
        if report.motors_s != self._motors[0]:
            self._motors = report.motors_s, report.arrival_ns
        in_air = reckoning.height_m > ON_GROUND_M and self._flying
        self._state = VehicleState(
            stamp_ns=report.arrival_ns,
            heartbeat_ns=report.arrival_ns,
            position_n_m=reckoning.position_n_m,
            velocity_n_mps=reckoning.velocity_n_mps,
            q_n_b=q_n_b,
            armed=self._flying,
            in_air=in_air,
            armable=report.battery >= self._config.min_battery,
            mode=self._mode,
            battery=report.battery,
            position_sigma_m=reckoning.position_sigma_m,
        )
        self._history.add(report.arrival_ns, q_n_b)

    def _motors_run(self) -> bool:
        return self._now_ns() - self._motors[1] < MOTORS_OFF_S * 1e9

    def _now_ns(self) -> int:
        return self._open_link().clock.now_ns()

    def _open_link(self) -> TelloLink:
        if self._link is None:
            raise VehicleError("the drone is not connected", "open it first")
        return self._link

    async def _check_alive(self) -> None:
        """Raises when the newest state packet is too old.

        A program that stood still finds an old one first: those that wait for it are read before it judges.
        """
        end_s = time.monotonic() + SECOND_LOOK_S
        while not self._heard():
            if time.monotonic() >= end_s:
                age_s = self._open_link().report_age_s()
                raise VehicleError(
                    f"no state packet from the drone for {age_s:.1f} s",
                    "take it by hand; it lands by itself after 15 s",
                )
            await asyncio.sleep(POLL_S)

    def _heard(self) -> bool:
        return self._open_link().report_age_s() <= STATE_AGE_S

    # --- commands ---

    async def wait_armable(self, timeout_s: float) -> None:
        await self._check_alive()  # what it said before it fell silent counts no more
        if await self._until(lambda: self.state.armable, timeout_s):
            return
        raise VehicleError(
            f"battery at {100 * self.state.battery:.0f} %, below {100 * self._config.min_battery:.0f} %",
            "charge it, or change the battery",
        )

    async def arm(self) -> None:
        """Arms by a flag alone: its motors start with the take-off, which is refused until this was called."""
        await self._check_alive()
        if self._flying:
            raise VehicleError("the drone is in the air already", "land it first")
        self._armed = True

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        await self._check_alive()
        if not self._armed:
            raise VehicleError("take-off refused: the drone is not armed", "arm first")
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise VehicleError(f"take-off refused: height {height_m} m", "give a height above zero")
        self._armed = False  # once
        end_s = time.monotonic() + timeout_s
        self._flying = True  # from here on it may be
        self._set_mode(FlightMode.TAKEOFF)
        answer = await self._open_link().ask("takeoff", min(TAKE_OFF_ANSWER_S, timeout_s))
        if answer is not None and answer.lower() != "ok":
            self._flying = self._motors_run()
            self._set_mode(FlightMode.HOLD)
            raise refused("take off", answer, self.state.battery)
        if answer is None:
            up = "it is in the air" if self.state.in_air else "it seems to stand on the ground"
            raise VehicleError(
                f"no answer to the command to take off: {up}", "look at the drone before anything else is tried"
            )
        if not await self._until(lambda: self._reckoning.height_m > OFF_GROUND_M, 2.0):
            raise VehicleError(
                "the drone said ok to the take-off, but its rangefinder shows no height", "is it held by something?"
            )
        await self._climb(height_m, end_s)
        self._set_mode(FlightMode.HOLD)

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        """The sticks are taken: there is no mode to ask for."""
        await self._check_alive()
        if not self._flying:
            raise VehicleError("offboard control refused: the drone is not in the air", "take off first")
        self._set_mode(FlightMode.OFFBOARD)
        self.fly(first)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        north, east, down = setpoint.velocity_n_mps
        if not all(map(math.isfinite, (north, east, down, setpoint.yaw_rad))):
            raise VehicleError(f"setpoint not sent: {setpoint} is not finite")
        turn_dps = math.degrees(YAW_GAIN_HZ * wrapped(setpoint.yaw_rad - self._reckoning.heading_rad))
        limit = self._config.max_yaw_dps
        self._sticks((north, east, down), max(-limit, min(limit, turn_dps)))

    async def hold(self) -> None:
        """Holds by centred sticks. It does not answer to that; that it is still there must be news."""
        sent_ns = self._now_ns()
        for _ in range(HOLD_TIMES):
            self._open_link().send(CENTRE)
            await asyncio.sleep(RC_PERIOD_S)
        while self.state.stamp_ns <= sent_ns:
            await self._check_alive()
            await asyncio.sleep(POLL_S)
        self._set_mode(FlightMode.HOLD)

    async def land(self, timeout_s: float) -> None:
        """Said again when nothing comes of it, and said blindly when the drone is not heard any more."""
        if not self._flying:
            await self._check_alive()  # that it is not flying must be news
            return
        self._open_link().send(CENTRE)
        self._set_mode(FlightMode.LAND)
        end_s = time.monotonic() + timeout_s
        try:
            heard = await self._say_land(end_s)
            down = await self._until(self._landed, max(0.5, end_s - time.monotonic()))
        except VehicleError:
            for _ in range(LAND_TRIES):
                self._open_link().send("land")
                await asyncio.sleep(BLIND_LAND_S)
            raise
        if not down:
            raise VehicleError(
                f"not on the ground {timeout_s:g} s after the landing began; {said(heard)}", "take it by hand"
            )
        self._flying = False
        self._set_mode(FlightMode.HOLD)

    async def _say_land(self, end_s: float) -> str | None:
        """Tells it to land until it says ok, sinks, or has been told often enough.

        Returns what it said, at the landing's end.
        """
        heard: str | None = None
        for _ in range(LAND_TRIES):
            patience_s = max(0.1, min(self._config.answer_s, end_s - time.monotonic()))
            answering = asyncio.create_task(self._open_link().ask("land", patience_s, urgent=True))
            try:
                await self._until(lambda answering=answering: answering.done() or self._landed(), 2.0 * patience_s)
            finally:
                if not answering.done():
                    answering.cancel()
                await asyncio.gather(answering, return_exceptions=True)
            if answering.cancelled():
                return None  # it is down already
            heard = answering.result()
            if (heard is not None and heard.lower() == "ok") or self._sinking():
                break
        return heard

    def emergency(self) -> None:
        """Stop the motors, wherever it is: it falls. No script calls this."""
        self._open_link().send("emergency")

    # --- inside ---

    def _set_mode(self, mode: FlightMode) -> None:
        self._mode = mode
        report = self._open_link().report
        state = self._state
        if state is not None and report is not None:
            self._state = replace(state, mode=mode, armed=self._flying)

    def _sticks(self, velocity_n_mps: Vec3, turn_dps: float) -> None:
        self._open_link().send(sticks(self._config, self._reckoning.heading_rad, velocity_n_mps, turn_dps))

    async def _climb(self, height_m: float, end_s: float) -> None:
        """Climbs by the sticks from where the automatic take-off ends to the height, until it is steady there."""
        tolerance = self._config.take_off_tolerance_m
        steady_since: float | None = None
        while True:
            await self._check_alive()
            off = height_m - self._reckoning.height_m
            climb = max(-CLIMB_MPS, min(CLIMB_MPS, CLIMB_GAIN_HZ * off))
            self._sticks((0.0, 0.0, -climb), 0.0)
            now_s = time.monotonic()
            near = abs(off) < tolerance and abs(self.state.velocity_n_mps[2]) < SETTLED_MPS
            steady_since = (steady_since or now_s) if near else None
            if steady_since is not None and now_s - steady_since > 0.3:
                self._open_link().send(CENTRE)
                return
            if now_s >= end_s:
                self._open_link().send(CENTRE)
                raise VehicleError(
                    f"not at {height_m:g} m in time: at {self._reckoning.height_m:.2f} m", "hold or land"
                )
            await asyncio.sleep(RC_PERIOD_S)

    def _landed(self) -> bool:
        """Returns whether it landed, by news: the motors' clock stands, low above the ground."""
        return self._heard() and not self._motors_run() and self._reckoning.height_m < ON_GROUND_M

    def _sinking(self) -> bool:
        return self.state.velocity_n_mps[2] > 0.15 or self._reckoning.height_m < ON_GROUND_M

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end_s = time.monotonic() + timeout_s
        while not condition():
            await self._check_alive()
            if time.monotonic() >= end_s:
                return False
            await asyncio.sleep(POLL_S)
        return True

    async def _keep_alive(self) -> None:
        """Say something while nobody else does, but only while it holds: never in place of a script that flies."""
        while True:
            await asyncio.sleep(KEEP_ALIVE_S / 4.0)
            link = self._open_link()
            if link.silent_s < KEEP_ALIVE_S or self._mode is not FlightMode.HOLD:
                continue
            try:
                if self._flying:
                    self._open_link().send(CENTRE)
                else:
                    await link.ask("command", self._config.answer_s)
            except VehicleError as error:
                _log.warning("keep-alive: %s", error)
