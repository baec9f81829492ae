"""Commands to a vehicle, and the waits until its telemetry shows what they were for."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.interfaces import SURE, FlightMode, TakenOver, VehicleError, too_high
from drivers.mavlink.modes import CUSTOM_MODE_ENABLED, PX4, AutopilotKind
from drivers.mavlink.session import ACCEPTED, RESULTS, MavsdkSession
from drivers.mavlink.telemetry import TelemetrySlots
from drivers.mavlink.vehicle_config import MavsdkVehicleConfig

# MAV_CMD
NAV_LAND = 21
NAV_TAKEOFF = 22
DO_SET_MODE = 176
SETTLED_MPS = 0.3
# PX4 ends a take-off up to 0.8 m before the height (NAV_MC_ALT_RAD), which it may have wrong
STOPPED_SHORT_M = 2.0
DISARM_NEWS_S = 1.5  # PX4 beats once a second
TEXT_WAIT_S = 0.5  # STATUSTEXT may come before or after the refusal it explains
SAFE_TRIES = 3  # what only ends motion, or starts none, is resent when no acknowledgement came


class Manoeuvres:
    """Changes of mode, take-offs and landings, each from its command to its end. All raise
    VehicleError.

    ``kind``: the autopilot's, once it is known.
    """

    def __init__(
        self,
        session: MavsdkSession,
        telemetry: TelemetrySlots,
        config: MavsdkVehicleConfig,
    ) -> None:
        self._session = session
        self._telemetry = telemetry
        self._config = config
        self._clock = telemetry.clock
        self.kind: AutopilotKind = PX4

    async def do(
        self,
        what: str,
        command: int,
        params: tuple[float | None, ...],
        tries: int = 1,
    ) -> None:
        """One command that must be accepted. Raises with the vehicle's own reason."""
        sent_ns = self._clock.now_ns()
        result = await self._session.command(command, params, tries)
        if result == ACCEPTED:
            return
        if result is None:
            raise VehicleError(
                f"no answer to the command to {what}: whether the vehicle acts on it is unknown",
                "look at the vehicle before anything else is tried",
            )
        telemetry = self._telemetry
        await self._session.until(lambda: bool(telemetry.texts_since(sent_ns)), TEXT_WAIT_S)
        reasons = telemetry.texts_since(sent_ns) or [
            f"{name} missing" for name in telemetry.missing()
        ]
        answer = RESULTS[result] if result < len(RESULTS) else f"result {result}"
        raise VehicleError(
            f"the vehicle refused to {what} ({answer}): {' | '.join(reasons) or 'it gave no reason'}",
            "remedy what it names, then start again",
        )

    async def change_mode(
        self,
        mode: FlightMode,
        what: str,
        tries: int = 1,
    ) -> None:
        sent_ns = self._clock.now_ns()
        before = self._telemetry.mode
        main, sub = self.kind.set_mode[mode]
        await self.do(what, DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(main), float(sub)), tries)
        await self._until_mode(mode, before, sent_ns, what)

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        """Climb to a height above where it stands, and wait until it is there."""
        if self.kind is PX4:
            # An older one climbs no less than this. It is not what is flown: PX4 looks at its
            # parameters once a second, and has acknowledged a height and climbed to the one it had
            # before.
            await self._session.set_float_parameter("MIS_TAKEOFF_ALT", height_m)
            await self.do("take off", NAV_TAKEOFF, (*[None] * 6, self._altitude_m() + height_m))
            there = FlightMode.HOLD
        else:
            await self.do("take off", NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m))
            there = FlightMode.OFFBOARD
        await self._climb(height_m, there, timeout_s)

    async def land(self, timeout_s: float) -> None:
        """Land and wait until it is disarmed."""
        telemetry = self._telemetry
        climbs = telemetry.mode is FlightMode.TAKEOFF

        def held() -> bool:
            """A PX4 whose take-off is over in this very moment goes on to hold, over a landing that
            it acknowledged.
            """
            return climbs and telemetry.mode is FlightMode.HOLD and telemetry.mode_told >= SURE

        await self._begin_landing(held)
        if held():
            await self._begin_landing(lambda: False)
        await self._until_down(self._clock.now_ns() + int(timeout_s * 1e9), timeout_s)

    async def _until_mode(
        self,
        mode: FlightMode,
        before: FlightMode,
        sent_ns: int,
        what: str,
        or_else: Callable[[], bool] = lambda: False,
    ) -> None:
        """Wait until a report younger than the command shows the mode.

        An older one may still show the last but one. A mode that is neither this one nor that of
        before the command is somebody's who took it meanwhile.
        """
        telemetry = self._telemetry
        expected = {before, mode}
        others: set[FlightMode] = set()

        def shown() -> bool:
            reported = telemetry.reported_mode
            if telemetry.mode not in expected and telemetry.mode_told >= SURE:
                others.add(telemetry.mode)
            return reported is not None and reported.arrival_ns > sent_ns and telemetry.mode is mode

        if not await self._session.until(lambda: shown() or or_else(), self._config.mode_timeout_s):
            if others:
                raise TakenOver(
                    f"the vehicle agreed to {what}, and was put in mode {telemetry.mode.value}",
                    "the pilot has control, or a failsafe acted",
                )
            texts = " | ".join(telemetry.texts_since(sent_ns)) or "it gives no reason"
            raise VehicleError(
                f"the vehicle agreed to {what} but is in mode {telemetry.mode.value}: {texts}",
                "the pilot may have control; look at its ground station",
            )

    def _altitude_m(self) -> float:
        """Of where it stands, as it says itself, whatever that is above the sea in truth. Raises
        VehicleError.
        """
        position = self._telemetry.position
        if position is None or not math.isfinite(position.altitude_m):
            raise VehicleError(
                "take-off refused: the vehicle tells no altitude", "see its ground station"
            )
        return position.altitude_m

    async def _climb(
        self,
        height_m: float,
        there: FlightMode,
        timeout_s: float,
    ) -> None:
        """Wait until at the height and steady.

        A pilot's mode, a hold, a landing or disarming on the way ends it with an error.
        """
        telemetry = self._telemetry
        config = self._config
        expected = {FlightMode.TAKEOFF, FlightMode.HOLD, there}
        # The heartbeat may still show the mode before the take-off.
        grace_ns = self._clock.now_ns() + int(config.mode_timeout_s * 1e9)

        def arrived() -> bool:
            position = telemetry.position
            return (
                position is not None
                and abs(position.above_home_m - height_m) <= config.take_off_tolerance_m
                and abs(telemetry.velocity_n_mps[2]) <= SETTLED_MPS
                and telemetry.mode is there
            )

        def held() -> bool:
            position = telemetry.position
            short = position is not None and height_m - position.above_home_m > STOPPED_SHORT_M
            return short and telemetry.mode is FlightMode.HOLD

        def high() -> bool:
            position = telemetry.position
            above = position is not None and position.above_home_m - height_m > STOPPED_SHORT_M
            settled = abs(telemetry.velocity_n_mps[2]) <= SETTLED_MPS
            return above and settled and telemetry.mode is there

        def ended() -> bool:
            late = self._clock.now_ns() > grace_ns
            other = telemetry.mode not in expected and telemetry.mode_told >= SURE
            return not self._telemetry.state().armed or (late and (held() or high() or other))

        if not await self._session.until(lambda: arrived() or ended(), timeout_s):
            raise VehicleError(
                f"not at {height_m:g} m {timeout_s:g} s after the take-off began", "hold or land"
            )
        if ended():
            if self._telemetry.state().armed:
                position = telemetry.position
                if position is not None and high():
                    raise too_high(position.above_home_m, height_m)
                said = f"take-off ended on the way: mode {telemetry.mode.value}"
                raise TakenOver(said, "the pilot has control, or a failsafe acted")
            heartbeat = telemetry.heartbeat
            if heartbeat is not None and not heartbeat.disarmed:
                raise TakenOver(
                    "take-off ended on the way: the motors were stopped", "the pilot's kill switch"
                )
            raise VehicleError(
                "take-off ended on the way: disarmed",
                "a failsafe acted, or it was never off the ground",
            )

    async def _begin_landing(self, or_else: Callable[[], bool]) -> None:
        sent_ns = self._clock.now_ns()
        before = self._telemetry.mode
        unset = self.kind.unset
        await self.do("land", NAV_LAND, (0.0, 0.0, 0.0, unset, unset, unset, 0.0), SAFE_TRIES)
        await self._until_mode(
            FlightMode.LAND,
            before,
            sent_ns,
            "land",
            lambda: not self._telemetry.state().armed or or_else(),
        )

    async def _until_down(self, end_ns: int, timeout_s: float) -> None:
        """Wait until it is disarmed.

        Having landed, PX4 goes back to the mode before it, and tells so up to a heartbeat before it
        tells that it is disarmed. So a mode of a script's is another's only when it stays armed.
        """
        session = self._session
        telemetry = self._telemetry

        def down() -> bool:
            return not self._telemetry.state().armed

        def lands() -> bool:
            return telemetry.mode is FlightMode.LAND

        def pilots() -> bool:
            return telemetry.mode is FlightMode.OTHER and telemetry.mode_told >= SURE

        while not down():
            left_s = (end_ns - self._clock.now_ns()) * 1e-9
            if not await session.until(lambda: down() or not lands(), left_s):
                what = f"not on the ground {timeout_s:g} s after the landing began"
                raise VehicleError(what, "land by remote control")
            await session.until(lambda: down() or lands() or pilots(), DISARM_NEWS_S)
            if not (down() or lands()):
                raise TakenOver(
                    f"landing ended by a change to mode {telemetry.mode.value}",
                    "the pilot has control",
                )
