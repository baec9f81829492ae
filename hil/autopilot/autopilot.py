"""A multicopter autopilot in the manner of PX4: modes, failsafes and acknowledgements, stepped and
without I/O.

The same object flies behind the in-process vehicle and behind the MAVLink endpoint. Nothing here
knows truth except ``truth_on_ground``, which stands for the land detector. Times are seconds of the
world's clock.
"""

from __future__ import annotations

import math
import random

from drivers.interfaces import FlightMode, VelocitySetpoint
from hil.autopilot.guidance import Guidance, limited
from hil.autopilot.radio import (
    EXCEPT_HOLD,
    EXCEPT_OFFBOARD,
    IN_AUTO,
    IN_OFFBOARD,
    LOSS_LANDS,
    LOSS_RETURNS,
    SILENT,
    Radio,
    flown_by,
)
from hil.autopilot.values import (
    HOLD_AT_FENCE,
    LAND_AT_FENCE,
    RETURN_AT_FENCE,
    Ack,
    AutopilotConfig,
    Estimate,
    OffboardSession,
    RateCommand,
    Severity,
    StatusText,
)
from path.messages import Vec3

__all__ = [
    "Ack",
    "Autopilot",
    "AutopilotConfig",
    "Estimate",
    "OffboardSession",
    "RateCommand",
    "Severity",
    "StatusText",
]

OK = Ack(True)
STICKS_MPS = 1.0
AT_FENCE = {
    HOLD_AT_FENCE: FlightMode.HOLD,
    RETURN_AT_FENCE: FlightMode.RETURN,
    LAND_AT_FENCE: FlightMode.LAND,
}


class Autopilot:
    """Modes, arming, failsafes and the position loop of one multicopter.

    Call ``step`` at a steady rate (50 Hz is enough) and the ``request_*`` methods and ``setpoint``
    between steps. Every command is idempotent: MAVSDK resends without saying so. ``status_texts``
    and ``offboard_sessions`` only grow; readers keep their own index.
    """

    def __init__(self, config: AutopilotConfig, seed: int) -> None:
        self.config = config
        self.mode = FlightMode.HOLD
        self.armed = False
        self.landed = True
        self.battery = 1.0
        self.pilot_in_control = False
        self.pilots_mode: FlightMode | None = None  # the newest that a pilot selected
        # of what it takes for its altitude above the sea; its local frame has none of it
        self.altitude_error_m = 0.0
        self._home_error_m = 0.0  # as it was when home was set
        # which of its own holds it or brings it down, until somebody changes the mode
        self.failsafe = ""
        self.killed = False  # by the pilot's switch: the motors stand still
        self.radio = Radio()
        self.home_n_m: Vec3 | None = None
        self.reasons: tuple[str, ...] = ("starting",)
        self.status_texts: list[StatusText] = []
        self.offboard_sessions: list[OffboardSession] = []
        self._settle_s = config.settle_s * random.Random(seed).uniform(0.9, 1.1)
        self._boot_s: float | None = None
        self._now_s = 0.0
        self._estimate = Estimate(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        self._armed_s = 0.0
        self._contact_s: float | None = None
        self._landed_s: float | None = None  # since when on the ground after a flight
        self._setpoint = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
        self._setpoint_s = -math.inf
        self._offboard_lost_s: float | None = None
        self._companion_s: float | None = None  # when a ground station was last heard
        self._pilot = SILENT  # what was last heard of the radio
        self._killed_s = 0.0
        self.outside = False  # its own fence
        self._radio_lost_s: float | None = None  # since when it holds because of that
        self._radio_optional = False  # it was armed without one
        # the low battery has made it land already; the pilot may still take over
        self._battery_landing = False
        self._guidance = Guidance(config)

    @property
    def armable(self) -> bool:
        return not self.reasons

    @property
    def home_altitude_error_m(self) -> float:
        return self._home_error_m

    @property
    def altitude_drift_m(self) -> float:
        """Of what it takes for its height above home: its own fence is kept by that, as PX4's
        is.
        """
        return self.altitude_error_m - self._home_error_m

    @property
    def powered(self) -> bool:
        """Armed, and no kill switch keeps the motors still. PX4 goes on calling itself armed while
        one does.
        """
        return self.armed and not self.killed

    @property
    def radio_heard(self) -> bool:
        """A pilot's radio counts, and is there."""
        return self._pilot.heard

    @property
    def _battery_low(self) -> bool:
        return self.battery <= self.config.low_battery

    @property
    def newest_setpoint_s(self) -> float:
        """The instant of the newest setpoint; minus infinity before the first."""
        return self._setpoint_s

    @property
    def setpoint_gap_s(self) -> float:
        """Longest time between setpoints in any OFFBOARD session so far."""
        return max((session.max_gap_s for session in self.offboard_sessions), default=0.0)

    # --- commands ---

    def set_battery(self, fraction: float) -> None:
        """Charge left, 0..1 (a fault, or a harness that starts with a used battery)."""
        self.battery = min(1.0, max(0.0, fraction))

    def kill(self, now_s: float) -> None:
        """The motors stop at once and for good, wherever the vehicle is, and it is disarmed. The
        mode stays.
        """
        self.killed = True
        self.armed = False
        self._end_session(now_s)
        self.say(now_s, Severity.CRITICAL, "Kill switch engaged")

    def request_arm(self, now_s: float, arm: bool, force: bool = False) -> Ack:
        """Arm or disarm. ``force`` skips no check of arming; disarming by it stops the motors, in
        the air too.
        """
        if arm == self.armed:
            return OK
        if arm:
            if self.reasons:
                return self._refuse(now_s, f"Arming denied: {self.reasons[0]}")
            self._arm(now_s)
            return OK
        if not self.landed and not force:
            return self._refuse(now_s, "Disarming denied: in the air")
        self._disarm(now_s, "by force" if force else "by command")
        return OK

    def request_takeoff(self, now_s: float, height_m: float) -> Ack:
        """Climb to ``height_m`` above home, then HOLD by itself. NaN: the default height."""
        height_m = self.config.default_takeoff_m if math.isnan(height_m) else height_m
        if self.mode is FlightMode.TAKEOFF and height_m == self._guidance.climb_to_m:
            return OK
        if not self.armed:
            return self._refuse(now_s, "Takeoff denied: not armed")
        if self._battery_low:
            return self._refuse(now_s, "Takeoff denied: battery low")
        if not self.landed:
            return self._refuse(now_s, "Takeoff denied: already in the air")
        if not 0.0 < height_m <= self.config.max_height_m:
            return self._refuse(
                now_s,
                f"Takeoff denied: height {height_m:g} m outside 0..{self.config.max_height_m:g}",
            )
        self._guidance.climb_to_m = height_m
        self._landed_s = None
        self.failsafe = ""
        self._enter(now_s, FlightMode.TAKEOFF)
        return OK

    def request_mode(self, now_s: float, mode: FlightMode, by_pilot: bool = False) -> Ack:
        """Change the mode. OFFBOARD wants a setpoint younger than ``offboard_loss_s``; OTHER is the
        pilot's alone.
        """
        if mode is FlightMode.TAKEOFF:
            return self.request_takeoff(now_s, math.nan)
        if mode is FlightMode.OTHER and not by_pilot:
            return self._refuse(now_s, "Mode denied: only a pilot selects it")
        if mode is FlightMode.OFFBOARD and now_s - self._setpoint_s > self.config.offboard_loss_s:
            return self._refuse(now_s, "Offboard denied: no recent setpoint")
        if self._battery_landing and not by_pilot and mode is not FlightMode.LAND:
            return self._refuse(now_s, "Mode denied: battery low, landing")
        self.failsafe = "" if by_pilot or mode is not self.mode else self.failsafe
        if by_pilot:
            self.pilot_in_control = True
            self.pilots_mode = mode
            self.say(now_s, Severity.INFO, f"Pilot selected {mode.value}")
        if mode is not self.mode or self._offboard_lost_s is not None:
            self._enter(now_s, mode)
        return OK

    def request_reposition(self, now_s: float, goal_n_m: Vec3) -> Ack:
        """Go to a place and hold there, in the air."""
        if self.landed or not self.armed:
            return self._refuse(now_s, "Reposition denied: not in the air")
        answer = self.request_mode(now_s, FlightMode.HOLD)
        if answer.accepted:
            self._guidance.hold_at(goal_n_m)
        return answer

    def setpoint(self, now_s: float, setpoint: VelocitySetpoint) -> bool:
        """Take a setpoint; False (ignored, not counted as arrived) when it has a non-finite
        number.
        """
        if not all(map(math.isfinite, (*setpoint.velocity_n_mps, setpoint.yaw_rad))):
            return False
        self._note_gap(now_s)
        self._setpoint = setpoint
        self._setpoint_s = now_s
        return True

    def companion_heard(self, now_s: float) -> None:
        """A ground station's heartbeat came."""
        self._companion_s = now_s

    def step(self, now_s: float, estimate: Estimate, truth_on_ground: bool) -> RateCommand:
        """Advance to ``now_s``: failsafes, then the position loop of the mode. Times must not go
        back.
        """
        if self._boot_s is None:
            self._boot_s = self._now_s = now_s
            self._guidance.enter(now_s, estimate)
        dt = now_s - self._now_s
        self._now_s = now_s
        self._estimate = estimate
        self._drain_battery(dt)
        self._check_health(now_s)
        self._detect_ground(now_s, truth_on_ground)
        self._obey_pilot(now_s)
        if self.powered:
            self._failsafes(now_s)
        elif self.armed and now_s - self._killed_s >= self.config.radio.kill_disarm_s:
            self._disarm(now_s, "by the kill switch")
        return self._command(now_s)

    # --- state changes ---

    def say(self, now_s: float, severity: Severity, text: str) -> None:
        """A status text, which every listener is sent."""
        self.status_texts.append(StatusText(now_s, severity, text))

    def _refuse(self, now_s: float, reason: str) -> Ack:
        self.say(now_s, Severity.CRITICAL, reason)
        return Ack(False, reason)

    def _arm(self, now_s: float) -> None:
        self.armed = True
        self._armed_s = now_s
        self._landed_s = None
        self.pilot_in_control = False
        self.pilots_mode = None
        self._radio_optional = not self._pilot.heard
        self.home_n_m = self._estimate.position_n_m
        self._home_error_m = self.altitude_error_m
        if self.mode is not FlightMode.OFFBOARD:
            self._enter(now_s, FlightMode.HOLD)
        self.say(now_s, Severity.INFO, "Armed")

    def _disarm(self, now_s: float, why: str) -> None:
        self.armed = False
        self._landed_s = None
        self.failsafe = ""
        self._enter(now_s, FlightMode.HOLD)
        self.say(now_s, Severity.INFO, f"Disarmed {why}")

    def _enter(self, now_s: float, mode: FlightMode) -> None:
        self._end_session(now_s, mode)
        self.mode = mode
        self._offboard_lost_s = None
        self._radio_lost_s = None
        self._guidance.enter(now_s, self._estimate)
        if mode is FlightMode.OFFBOARD:
            self.offboard_sessions.append(OffboardSession(now_s))

    @property
    def _open_session(self) -> OffboardSession | None:
        last = self.offboard_sessions[-1] if self.offboard_sessions else None
        return last if last is not None and last.end_s is None else None

    def _end_session(self, now_s: float, mode: FlightMode | None = None) -> None:
        """``mode``: that ended it; None: its motors were stopped, and nobody owes it a setpoint."""
        session = self._open_session
        if session is not None:
            self._note_gap(now_s)
            session.end_s = now_s
            session.ended_by = mode

    def _note_gap(self, now_s: float) -> None:
        session = self._open_session
        if session is not None and self.armed:
            session.note_gap(max(self._setpoint_s, session.start_s), now_s)

    # --- the pilot's radio ---

    def _obey_pilot(self, now_s: float) -> None:
        pilot = self._pilot = self.radio.step(now_s, self.config.radio)
        if pilot.kill is not None:
            self.killed = pilot.kill
            self._killed_s = now_s
            if self.killed:
                self._end_session(now_s)
            self.say(
                now_s, Severity.CRITICAL, f"Kill switch {'engaged' if pilot.kill else 'disengaged'}"
            )
        if pilot.mode is not None:
            self.request_mode(now_s, pilot.mode, by_pilot=True)
        elif pilot.moved and self.armed and self._yields_to_sticks():
            self.request_mode(now_s, FlightMode.OTHER, by_pilot=True)
        if pilot.heard:
            self._radio_optional = False

    def _yields_to_sticks(self) -> bool:
        """Not while a failsafe waits with its action, as PX4 does not either."""
        if self.mode is FlightMode.OTHER or self._radio_lost_s is not None:
            return False
        bit = IN_OFFBOARD if self.mode is FlightMode.OFFBOARD else IN_AUTO
        return bool(self.config.radio.override & bit)

    def _watch_radio(self, now_s: float) -> None:
        """Without the radio: hold, and after a while what ``loss_act`` says."""
        config = self.config.radio
        mode = self.mode
        if (
            self._pilot.heard
            or self._radio_optional
            or self.landed
            or mode in (FlightMode.LAND, FlightMode.RETURN)
        ):
            return
        bit = {FlightMode.OFFBOARD: EXCEPT_OFFBOARD, FlightMode.OTHER: 0}.get(mode, EXCEPT_HOLD)
        if self._radio_lost_s is None:
            if config.loss_except & bit or config.in_mode == 4:
                return
            self._enter(now_s, FlightMode.HOLD)
            self._radio_lost_s = now_s
            self.failsafe = "radio lost"
            self.say(now_s, Severity.CRITICAL, "Manual control lost, holding")
        elif now_s - self._radio_lost_s >= config.act_after_s and config.loss_act in (
            LOSS_LANDS,
            LOSS_RETURNS,
        ):
            self._enter(
                now_s, FlightMode.LAND if config.loss_act == LOSS_LANDS else FlightMode.RETURN
            )
            self.say(now_s, Severity.CRITICAL, f"Manual control lost, {self.mode.value}")

    def _watch_fence(self, now_s: float) -> None:
        """On the way out, and once: a pilot may fly on, or come back."""
        fence = self.config.fence
        home = self.home_n_m
        if home is None:
            return
        north, east, down = (
            here - there for here, there in zip(self._estimate.position_n_m, home, strict=True)
        )
        wide = fence.radius_m > 0.0 and math.hypot(north, east) > fence.radius_m
        high = fence.height_m > 0.0 and -down + self.altitude_drift_m > fence.height_m
        before = self.outside
        self.outside = wide or high
        if (
            before
            or not self.outside
            or self.landed
            or self.mode is FlightMode.LAND
            or fence.action not in AT_FENCE
        ):
            return
        self._enter(now_s, AT_FENCE[fence.action])
        self.failsafe = "outside the autopilot's fence"
        self.say(now_s, Severity.CRITICAL, f"Geofence breached, {self.mode.value}")

    # --- what happens by itself ---

    def _drain_battery(self, dt: float) -> None:
        if self.armed:
            self.set_battery(
                self.battery - dt / self.config.endurance_s * (0.1 if self.landed else 1.0)
            )

    def _check_health(self, now_s: float) -> None:
        assert self._boot_s is not None
        checks = (
            (now_s - self._boot_s < self._settle_s, "position estimate is settling"),
            (self._battery_low, "battery low"),
            (self.killed, "kill switch engaged"),
            (bool(self.config.arming_fault), self.config.arming_fault),
        )
        self.reasons = tuple(reason for failed, reason in checks if failed)
        if self.home_n_m is None and not self.reasons:
            self.home_n_m = self._estimate.position_n_m
            self._home_error_m = self.altitude_error_m

    def _detect_ground(self, now_s: float, contact: bool) -> None:
        if not contact:
            self._contact_s = self._landed_s = None
            self.landed = False
            return
        if self._contact_s is None:
            self._contact_s = now_s
        if not self.landed and now_s - self._contact_s >= self.config.land_detect_s:
            self.landed = True
            self._landed_s = now_s
            self.say(now_s, Severity.INFO, "Landing detected")

    def _failsafes(self, now_s: float) -> None:
        config = self.config
        if self.landed:
            if self._landed_s is None and self.mode in (FlightMode.LAND, FlightMode.RETURN):
                self._landed_s = now_s
            if self._landed_s is not None and now_s - self._landed_s >= config.land_disarm_s:
                self._disarm(now_s, "by landing")
            elif self._idle(now_s):
                self._disarm(now_s, "by auto preflight disarming")
        elif self._battery_low and not self._battery_landing:
            self.say(now_s, Severity.CRITICAL, "Low battery, landing")
            self._enter(now_s, FlightMode.LAND)
        self._battery_landing = self._battery_low and not self.landed
        self._watch_setpoints(now_s)
        self._watch_radio(now_s)
        self._watch_fence(now_s)
        heard_s = self._companion_s
        lost = heard_s is not None and now_s - heard_s > config.companion_loss_s
        if lost and not self.landed and self.mode is not FlightMode.LAND:
            self._enter(now_s, FlightMode.LAND)
            self.say(now_s, Severity.CRITICAL, "No ground station, landing")

    def _watch_setpoints(self, now_s: float) -> None:
        """OFFBOARD without setpoints holds, and lands when nobody speaks up for
        ``offboard_land_s``.
        """
        config = self.config
        self._note_gap(now_s)
        if self.mode is FlightMode.OFFBOARD and now_s - self._setpoint_s > config.offboard_loss_s:
            self._enter(now_s, FlightMode.HOLD)
            self._offboard_lost_s = now_s
            self.say(now_s, Severity.CRITICAL, "No offboard setpoints, holding")
        elif (
            self._offboard_lost_s is not None
            and now_s - self._offboard_lost_s >= config.offboard_land_s
        ):
            self._enter(now_s, FlightMode.LAND)
            self.say(now_s, Severity.CRITICAL, "No offboard setpoints, landing")

    def _idle(self, now_s: float) -> bool:
        """Armed on the ground for ``idle_disarm_s`` without having flown, and not about to."""
        waiting = self._landed_s is None and self.mode is not FlightMode.TAKEOFF
        return waiting and now_s - self._armed_s >= self.config.idle_disarm_s

    def _command(self, now_s: float) -> RateCommand:
        if not self.powered:
            return RateCommand(None, self._guidance.yaw_rad, False)
        assert self.home_n_m is not None
        velocity = None
        yaw = self._guidance.yaw_rad
        if self.mode is FlightMode.TAKEOFF and self._guidance.height_reached(
            self._estimate, self.home_n_m
        ):
            self._enter(now_s, FlightMode.HOLD)
            self._guidance.hold_height(self.home_n_m)
        if self.mode is FlightMode.OFFBOARD:
            limits = (
                self.config.max_horizontal_mps,
                self.config.max_up_mps,
                self.config.max_down_mps,
            )
            stale = now_s - self._setpoint_s > self.config.setpoint_stale_s
            wanted = (0.0, 0.0, 0.0) if stale else self._setpoint.velocity_n_mps
            velocity = limited(wanted, *limits)
            yaw = self._setpoint.yaw_rad
        elif (
            self.mode is FlightMode.OTHER
            and (asked := flown_by(self._pilot.sticks, yaw, STICKS_MPS)) is not None
        ):
            velocity = asked
            self._guidance.enter(now_s, self._estimate)  # where the sticks are let go of it stays
        else:
            velocity = self._guidance.velocity(now_s, self.mode, self._estimate, self.home_n_m)
        climbing = velocity is not None and velocity[2] < 0.0
        if self.landed and not (
            climbing and self.mode in (FlightMode.TAKEOFF, FlightMode.OFFBOARD)
        ):
            velocity = None  # on the ground only these two modes lift off
        return RateCommand(velocity, yaw, True)
