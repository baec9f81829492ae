"""The flight of an emulated Tello: automatic take-off and landing, sticks, relative moves."""

from __future__ import annotations

import math

from drivers.interfaces import FlightMode, VelocitySetpoint
from hil.autopilot.values import OffboardSession
from hil.tello.moves import TelloMove, move_of
from hil.tello.sensors import TelloSensors
from hil.world.world import SimDrone
from path.geometry.rotation import wrapped, yaw_of

HOVER_M = 0.8  # where an automatic take-off ends
SILENCE_S = 15.0  # without a command for longer it lands
YAW_LEAD_RAD = 0.5  # how far ahead of the nose the heading is commanded, at most
TURN_RAD = 0.3  # the same, in a relative move
FLYING = (FlightMode.HOLD, FlightMode.OFFBOARD)


class TelloFlight:
    """One drone's. Commands return the SDK's answer, None when it comes once the motion is over
    (``over``).

    Attributes:
        sessions: every time the sticks were in use, with the longest gap between two ``rc``.
        speed_cm: of relative moves.
        motor_fault: a fault: it cannot take off.
    """

    def __init__(
        self,
        drone: SimDrone,
        sensors: TelloSensors,
        full_stick_mps: float,
        full_stick_dps: float,
    ) -> None:
        self._drone = drone
        self._sensors = sensors
        self._stick_mps, self._stick_radps = (
            full_stick_mps / 100.0,
            math.radians(full_stick_dps) / 100.0,
        )
        self._now_s = 0.0
        self._rc = (0, 0, 0, 0)
        self._rc_s = -math.inf
        self._yaw_goal = 0.0
        self._by_rc = False
        self._move: TelloMove | None = None
        self._climbing = False  # told to take off, and the motors do not turn fast enough yet
        self.sessions: list[OffboardSession] = []
        self.speed_cm = 50
        self.motor_fault = False

    def step(
        self,
        now_s: float,
        dt: float,
        heard_s: float,
    ) -> None:
        """Fly until now. ``heard_s``: when the last command came."""
        self._now_s = now_s
        autopilot = self._drone.autopilot
        if autopilot.armed:
            self._sensors.motors_s += dt
        if self._climbing and autopilot.request_takeoff(now_s, HOVER_M).accepted:
            self._climbing = False
        if autopilot.mode not in FLYING or autopilot.landed:
            self._end_session(autopilot.mode)
        elif now_s - heard_s > SILENCE_S:
            self._let_go(FlightMode.LAND)
            autopilot.request_mode(now_s, FlightMode.LAND)
        elif self._move is not None:
            self._move = self._move.after(self._drone.estimate.position_n_m, dt)
            self._fly_move(self._move)
        elif self._by_rc:
            self._fly_sticks(dt)

    # --- commands ---

    def take_off(self) -> str | None:
        autopilot = self._drone.autopilot
        if not autopilot.landed or autopilot.armed:
            return "error"
        if self.motor_fault:
            return "error Motor stop"
        if not autopilot.request_arm(self._now_s, True).accepted:
            return (
                "error No valid imu"
                if autopilot.battery > autopilot.config.low_battery
                else "error Auto land"
            )
        self._sensors.ground_d_m = self._drone.estimate.position_n_m[2]
        self._climbing = True
        return None

    def land(self) -> str | None:
        autopilot = self._drone.autopilot
        if not autopilot.armed:
            return "error"
        self._let_go(FlightMode.LAND)
        autopilot.request_mode(self._now_s, FlightMode.LAND)
        return None

    def emergency(self) -> None:
        """No answer is promised. The model never stops motors in the air: it lands."""
        self._let_go(FlightMode.OTHER)
        autopilot = self._drone.autopilot
        if not autopilot.request_arm(self._now_s, False).accepted:
            autopilot.request_mode(self._now_s, FlightMode.LAND)

    def stop(self) -> str:
        self._rc = (0, 0, 0, 0)
        if self._move is not None:
            self._hover()
        return "error Not joystick" if self._drone.autopilot.landed else "ok"

    def move(self, word: str, arguments: list[str]) -> str | None:
        """``up 50``, ``cw 90``, ..."""
        estimate = self._drone.estimate
        autopilot = self._drone.autopilot
        move = move_of(word, arguments, estimate.position_n_m, yaw_of(estimate.q_n_b))
        if move is None:
            return f"unknown command: {word}"
        if isinstance(move, str):
            return move
        if autopilot.landed:
            return "error Motor stop"
        if autopilot.mode not in FLYING:
            return "error Not joystick"
        self._move = move
        return None

    def sticks(
        self,
        right: int,
        forward: int,
        up: int,
        clockwise: int,
        at_s: float,
    ) -> None:
        """They stay as they are until the next time: only silence for 15 s ends that. ``at_s``:
        when they came.
        """
        self._move = None
        self._rc = (right, forward, up, clockwise)
        autopilot = self._drone.autopilot
        if autopilot.landed or autopilot.mode not in FLYING:
            return
        if self._by_rc:
            self.sessions[-1].note_gap(self._rc_s, at_s)
        else:
            self._by_rc, self._yaw_goal = True, yaw_of(self._drone.estimate.q_n_b)
            self.sessions.append(OffboardSession(at_s))
        self._rc_s = at_s

    def over(self, word: str) -> str | None:
        """The answer to a motion command that is over, None while it goes on."""
        autopilot = self._drone.autopilot
        if word == "takeoff":
            if not autopilot.armed:
                return "error Motor stop"
            return "ok" if not autopilot.landed and autopilot.mode is FlightMode.HOLD else None
        if word == "land":
            return None if autopilot.armed else "ok"
        if self._move is None:
            return "ok"
        if not self._move.over(self._drone.estimate):
            return None
        self._hover()
        return "ok"

    def close(self) -> None:
        self._end_session(FlightMode.OTHER)

    # --- inside ---

    def _hover(self) -> None:
        """After a move, and until the next command: nothing is sent meanwhile, and it stays where
        it is.
        """
        self._move = None
        self._end_session(FlightMode.HOLD)
        self._drone.autopilot.request_mode(self._now_s, FlightMode.HOLD)

    def _fly_move(self, move: TelloMove) -> None:
        estimate = self._drone.estimate
        yaw = yaw_of(estimate.q_n_b)
        turn = max(-TURN_RAD, min(TURN_RAD, move.turn_left(yaw)))
        self._command(move.velocity(estimate.position_n_m, self.speed_cm / 100.0), yaw + turn)

    def _fly_sticks(self, dt: float) -> None:
        yaw = yaw_of(self._drone.estimate.q_n_b)
        right, forward, up, turn = self._rc
        ahead = wrapped(self._yaw_goal + self._stick_radps * turn * dt - yaw)
        self._yaw_goal = yaw + max(-YAW_LEAD_RAD, min(YAW_LEAD_RAD, ahead))
        c = math.cos(yaw)
        s = math.sin(yaw)
        scale = self._stick_mps
        north = scale * (c * forward - s * right)
        east = scale * (s * forward + c * right)
        self._command((north, east, -scale * up), self._yaw_goal)

    def _command(self, velocity: tuple[float, float, float], yaw: float) -> None:
        autopilot = self._drone.autopilot
        autopilot.setpoint(self._now_s, VelocitySetpoint(velocity, yaw))
        if autopilot.mode is not FlightMode.OFFBOARD:
            autopilot.request_mode(self._now_s, FlightMode.OFFBOARD)

    def _let_go(self, mode: FlightMode) -> None:
        self._climbing = False
        self._move = None
        self._rc = (0, 0, 0, 0)
        self._end_session(mode)

    def _end_session(self, mode: FlightMode) -> None:
        if self._by_rc:
            session = self.sessions[-1]
            session.note_gap(self._rc_s, self._now_s)
            session.end_s = self._now_s
            session.ended_by = mode
        self._by_rc = False
