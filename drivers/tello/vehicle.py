"""DJI Tello through djitellopy, behind the Vehicle Protocol: flown by its sticks, confirmed by its
state packets.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Self

from drivers.arrivals import Arrivals, too_slow
from drivers.interfaces import Capability, FlightMode, VehicleError, VehicleState, VelocitySetpoint
from drivers.perception.history import StateHistory
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartContext
from drivers.tello.check import drone_findings
from drivers.tello.commands import TelloLink, link_to, said
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.evidence import ON_GROUND_M, FlightEvidence
from drivers.tello.state import DeadReckoning, Placement, TelloReport, quaternion
from drivers.tello.words import CENTRE, refused, sticks
from path.geometry.rotation import wrapped
from path.messages import Vec3

POLL_S = 0.02
RC_PERIOD_S = 0.05
STATE_AGE_S = 1.0  # older, and any wait ends with an error
SECOND_LOOK_S = 0.3  # in which a packet that waits to be read must come
TAKE_OFF_ANSWER_S = 20.0  # it answers once it hovers
OFF_GROUND_M = 0.35
HOVER_S = 0.8  # without climbing or sinking: its own take-off is over, whatever it answers
# after a refusal, or no answer, in which motors that were started show in state packets
JUDGE_S = 5.0
CLIMB_GAIN_HZ = 1.0
CLIMB_MPS = 0.5
SETTLED_MPS = 0.25
LAND_TRIES = 3
LAND_AGAIN_S = 4.0  # without sinking and without being down: it is told again
BLIND_LAND_S = 0.2
USUAL_AGE_S = 0.5  # of state packets, at which a mission ends that does not say another
HOLD_TIMES = 3  # datagrams without an answer, so said again
KEEP_ALIVE_S = 4.0  # of the 15 s of silence after which it lands
YAW_GAIN_HZ = 1.5

_log = logging.getLogger(__name__)


class TelloVehicle:
    """Implements ``drivers.interfaces.Vehicle``.

    Every command is sent once, landing excepted. What it did is taken from state packets (motors'
    clock, height, rangefinder), never from words: an ``ok`` may come and nothing happen, an
    ``error`` may come and it flies. Landing is commanded whatever the script believes, until state
    packets show it down. It is kept awake only while somebody wishes it to fly; else it lands by
    itself after 15 s of silence.

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
        self._evidence = FlightEvidence()
        # the script wishes it to fly: only then is it kept awake in the air
        self._wanted_up = False
        self._keeper: asyncio.Task[None] | None = None
        self._said_error_and_flew = 0
        self._arrivals = Arrivals()
        self._oldest_s = USUAL_AGE_S

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
        """Close. A drone that flies although nobody flies it any more is told to land, blindly."""
        self._armed = self._wanted_up = False
        if self._link is not None and self._state is not None and self._up():
            _log.error("%s: closed while it flies: it is told to land", self._config.host)
            await self._land_blindly()
        if self._keeper is not None:
            self._keeper.cancel()
            await asyncio.gather(self._keeper, return_exceptions=True)
            self._keeper = None
        if self._link is not None:
            link = self._link
            self._link = None
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
    def ignored(self) -> Mapping[str, int]:
        """What came from the drone and was not believed, counted (``drivers.interfaces.Wary``)."""
        link = self._link
        if link is None:
            return {}
        counts = {
            "packets that are no answers (the drone's app protocol)": link.passed_over,
            "state packets that cannot be read": link.bad_reports,
            f"that the thread {link.deaf} has ended: this program hears no Tello any more": int(
                bool(link.deaf)
            ),
            "what the drone said: it said error and flew": self._said_error_and_flew,
        }
        return {what: count for what, count in counts.items() if count}

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the horizontal position by now, per axis."""
        return self._reckoning.position_sigma_m

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        return self._history.attitude_at(stamp_ns)

    def _on_report(self, report: TelloReport) -> None:
        """Take a report on djitellopy's thread: one immutable value replaces the last."""
        reckoning = self._reckoning
        reckoning.add(report)
        q_n_b = quaternion(report.roll_rad, report.pitch_rad, reckoning.heading_rad)
        self._evidence.add(report, reckoning.height_m)
        armed = self._evidence.up(report)
        self._state = VehicleState(
            stamp_ns=report.arrival_ns,
            heartbeat_ns=report.arrival_ns,
            position_n_m=reckoning.position_n_m,
            velocity_n_mps=reckoning.velocity_n_mps,
            q_n_b=q_n_b,
            armed=armed,
            in_air=armed and reckoning.height_m > ON_GROUND_M,
            armable=report.battery >= self._config.min_battery,
            mode=self._mode,
            battery=report.battery,
            position_sigma_m=reckoning.position_sigma_m,
        )
        self._history.add(report.arrival_ns, q_n_b)
        self._arrivals.add(report.arrival_ns)

    def _up(self) -> bool:
        report = self._open_link().report
        return report is not None and self._evidence.up(report)

    def _motors_run(self) -> bool:
        return self._evidence.motors_run(self._now_ns())

    def _now_ns(self) -> int:
        return self._open_link().clock.now_ns()

    def _open_link(self) -> TelloLink:
        if self._link is None:
            raise VehicleError("the drone is not connected", "open it first")
        return self._link

    async def _check_alive(self) -> None:
        """Raise when the newest state packet is too old.

        A program that stood still finds an old one first: those that wait for it are read before it
        judges.
        """
        end_s = time.monotonic() + SECOND_LOOK_S
        while not self._heard():
            if time.monotonic() >= end_s:
                age_s = self._open_link().report_age_s()
                deaf = self._open_link().deaf
                why = f" (the thread {deaf} has ended: start this program again)" if deaf else ""
                raise VehicleError(
                    f"no state packet from the drone for {age_s:.1f} s{why}",
                    "take it by hand; it lands by itself after 15 s",
                )
            await asyncio.sleep(POLL_S)

    def _heard(self) -> bool:
        return self._open_link().report_age_s() <= STATE_AGE_S

    # --- commands ---

    async def wait_armable(self, timeout_s: float) -> None:
        await self._check_alive()  # what it said before it fell silent counts no more
        if await self._until(lambda: self.state.armable and not self._too_slow(), timeout_s):
            return
        if self.state.armable:
            raise VehicleError(
                f"{self._config.host} sends {self._too_slow()}",
                "nearer to the drone, or another Wi-Fi channel",
            )
        raise VehicleError(
            f"battery at {100 * self.state.battery:.0f} %, below {100 * self._config.min_battery:.0f} %",
            "charge it, or change the battery",
        )

    def expect_telemetry(self, oldest_s: float) -> None:
        """Take how old state packets may be in the flight to come: a drone that sends too few is
        not armable.
        """
        self._oldest_s = oldest_s

    def _too_slow(self) -> str:
        return too_slow({"state packets": self._arrivals}, self._now_ns(), self._oldest_s)

    async def arm(self) -> None:
        """Arms by a flag alone: its motors start with the take-off, which is refused until this was
        called.
        """
        await self._check_alive()
        if self._up():
            raise VehicleError(
                "the drone is in the air already, or its motors run", "land it first"
            )
        self._armed = True

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        await self._check_alive()
        if not self._armed:
            raise VehicleError("take-off refused: the drone is not armed", "arm first")
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise VehicleError(f"take-off refused: height {height_m} m", "give a height above zero")
        self._armed = False  # once
        end_s = time.monotonic() + timeout_s
        self._evidence.send_up()
        self._wanted_up = True
        self._set_mode(FlightMode.TAKEOFF)
        try:
            await self._rise(end_s)
            await self._climb(height_m, end_s)
        except BaseException:
            # whoever goes on says so by a command; who does not, lets it land by itself
            self._wanted_up = False
            raise
        self._set_mode(FlightMode.HOLD)

    async def _rise(self, end_s: float) -> None:
        """Say "takeoff" once and wait until it hovers at its own height. Raises VehicleError when
        it stays down.

        State packets decide: it may say "error", or nothing, and fly.
        """
        patience_s = max(0.1, min(TAKE_OFF_ANSWER_S, end_s - time.monotonic()))
        asking = asyncio.create_task(self._open_link().ask("takeoff", patience_s))
        try:
            hovers = self._hovering()
            await self._until(lambda: asking.done() or hovers(), patience_s + 1.0)
        finally:
            if not asking.done():
                asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)
        if asking.cancelled():
            _log.warning("%s: it hovers, and did not answer to the take-off", self._config.host)
            return
        answer = asking.result()
        agreed = answer is not None and answer.lower() == "ok"
        if await self._until(
            lambda: self._reckoning.height_m > OFF_GROUND_M, 2.0 if agreed else JUDGE_S
        ):
            if not agreed:
                await self._rise_unasked(answer, end_s)
            return
        if agreed:
            raise VehicleError(
                "the drone said ok to the take-off, but its rangefinder shows no height",
                "is it held by something?",
            )
        self._evidence.call_off()
        self._set_mode(FlightMode.HOLD)
        if answer is not None:
            raise refused("take off", answer, self.state.battery)
        raise VehicleError(
            "no answer to the command to take off: it seems to stand on the ground",
            "look at the drone before anything else is tried",
        )

    async def _rise_unasked(self, answer: str | None, end_s: float) -> None:
        """Wait for the hover of a drone that climbs although it did not say that it would."""
        self._said_error_and_flew += answer is not None
        _log.warning("%s: it takes off, but %s", self._config.host, said(answer))
        if not await self._until(self._hovering(), max(0.5, end_s - time.monotonic())):
            raise VehicleError(
                f"the drone takes off, but {said(answer)}, and does not come to rest",
                "land, or take it by hand",
            )

    def _hovering(self) -> Callable[[], bool]:
        """Return a condition: off the ground, and neither climbing nor sinking for a while."""
        since_s = math.inf

        def hovers() -> bool:
            nonlocal since_s
            off = self._reckoning.height_m > OFF_GROUND_M and self._motors_run()
            still = off and abs(self.state.velocity_n_mps[2]) < SETTLED_MPS
            since_s = min(since_s, time.monotonic()) if still else math.inf
            return time.monotonic() - since_s > HOVER_S

        return hovers

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        """The sticks are taken: there is no mode to ask for."""
        await self._check_alive()
        if not self._up():
            raise VehicleError(
                "offboard control refused: the drone is not in the air", "take off first"
            )
        self._wanted_up = True
        self._set_mode(FlightMode.OFFBOARD)
        self.fly(first)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        north, east, down = setpoint.velocity_n_mps
        if not all(map(math.isfinite, (north, east, down, setpoint.yaw_rad))):
            raise VehicleError(f"setpoint not sent: {setpoint} is not finite")
        turn_dps = math.degrees(
            YAW_GAIN_HZ * wrapped(setpoint.yaw_rad - self._reckoning.heading_rad)
        )
        limit = self._config.max_yaw_dps
        self._sticks((north, east, down), max(-limit, min(limit, turn_dps)))

    async def hold(self) -> None:
        """Hold by centred sticks. It does not answer to that; that it is still there must be
        news.
        """
        self._wanted_up = True
        sent_ns = self._now_ns()
        for _ in range(HOLD_TIMES):
            self._open_link().send(CENTRE)
            await asyncio.sleep(RC_PERIOD_S)
        while self.state.stamp_ns <= sent_ns:
            await self._check_alive()
            await asyncio.sleep(POLL_S)
        self._set_mode(FlightMode.HOLD)

    async def land(self, timeout_s: float) -> None:
        """Land. Told again while it does not sink, whatever it answers, and blindly when it is not
        heard any more.

        Nothing is said to a drone that state packets show down. One that is not down in time is an
        alarm: it is told once more, and nothing keeps it awake any more.
        """
        self._wanted_up = False
        end_s = time.monotonic() + timeout_s
        try:
            await self._check_alive()  # that it is not flying must be news, too
            if not self._up():
                return
            self._open_link().send(CENTRE)
            self._set_mode(FlightMode.LAND)
            heard, down = await self._come_down(end_s)
        except VehicleError:
            await self._land_blindly()
            raise
        if not down:
            _log.error(
                "%s: not on the ground %g s after the landing began", self._config.host, timeout_s
            )
            await self._land_blindly()
            raise VehicleError(
                f"not on the ground {timeout_s:g} s after the landing began; {said(heard)}",
                "take it by hand",
            )
        self._evidence.call_off()
        self._set_mode(FlightMode.HOLD)

    async def _come_down(self, end_s: float) -> tuple[str | None, bool]:
        """Say "land" whenever it has not sunk for a while, until it is down or time is over.

        Returns its last answer, and whether it is down.
        """
        heard: str | None = None
        while True:
            heard = await self._say_land(end_s) or heard
            quiet_s = time.monotonic()
            while time.monotonic() - quiet_s < LAND_AGAIN_S:
                if await self._until(self._landed, RC_PERIOD_S):
                    return heard, True
                if time.monotonic() >= end_s:
                    return heard, False
                if self._sinking():
                    quiet_s = time.monotonic()

    async def _say_land(self, end_s: float) -> str | None:
        """Say "land" once. Returns its answer, None when none came before it sank or was down."""
        patience_s = max(0.1, min(self._config.answer_s, end_s - time.monotonic()))
        answering = asyncio.create_task(self._open_link().ask("land", patience_s, urgent=True))
        try:
            await self._until(
                lambda: answering.done() or self._landed() or self._sinking(), 2.0 * patience_s
            )
        finally:
            if not answering.done():
                answering.cancel()
            await asyncio.gather(answering, return_exceptions=True)
        return None if answering.cancelled() else answering.result()

    async def _land_blindly(self) -> None:
        for _ in range(LAND_TRIES):
            self._open_link().send("land")
            await asyncio.sleep(BLIND_LAND_S)

    def emergency(self) -> None:
        """Stop the motors, wherever it is: it falls. No script calls this."""
        self._open_link().send("emergency")

    # --- inside ---

    def _set_mode(self, mode: FlightMode) -> None:
        self._mode = mode
        report = self._open_link().report
        state = self._state
        if state is not None and report is not None:
            armed = self._evidence.up(report)
            self._state = replace(state, mode=mode, armed=armed, in_air=armed and state.in_air)

    def _sticks(self, velocity_n_mps: Vec3, turn_dps: float) -> None:
        self._open_link().send(
            sticks(self._config, self._reckoning.heading_rad, velocity_n_mps, turn_dps)
        )

    async def _climb(self, height_m: float, end_s: float) -> None:
        """Climb by the sticks from where the automatic take-off ends to the height, until it is
        steady there.
        """
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
                    f"not at {height_m:g} m in time: at {self._reckoning.height_m:.2f} m",
                    "hold or land",
                )
            await asyncio.sleep(RC_PERIOD_S)

    def _landed(self) -> bool:
        """Return whether it landed, by news: the motors' clock stands, low above the ground."""
        report = self._open_link().report
        if report is None or not self._heard() or self._motors_run():
            return False
        return self._evidence.down(report, self._reckoning.height_m)

    def _sinking(self) -> bool:
        return self.state.velocity_n_mps[2] > 0.15

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end_s = time.monotonic() + timeout_s
        while not condition():
            await self._check_alive()
            if time.monotonic() >= end_s:
                return False
            await asyncio.sleep(POLL_S)
        return True

    async def _keep_alive(self) -> None:
        """Say something while nobody else does, but only while it holds: never in place of a script
        that flies.

        A drone that flies though nobody wishes it to is told nothing: after 15 s of silence it
        lands.
        """
        deaf = ""
        while True:
            await asyncio.sleep(KEEP_ALIVE_S / 4.0)
            link = self._open_link()
            if link.deaf != deaf:
                deaf = link.deaf
                _log.error(
                    "ALARM: the thread %s has ended: no Tello is heard by this program any more",
                    deaf,
                )
            if link.silent_s < KEEP_ALIVE_S or self._mode is not FlightMode.HOLD:
                continue
            try:
                if self._wanted_up:
                    link.send(CENTRE)
                elif not self._up():
                    await link.ask("command", self._config.answer_s)
            except VehicleError as error:
                _log.warning("keep-alive: %s", error)
