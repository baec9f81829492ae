"""A Tello on the wire: the command, state and video ports of the SDK, for an unmodified djitellopy to talk to.

The drone behind it is the same simulated one as behind MAVLink. It has no thread and no clock: whoever steps the world
calls ``pump`` at 200 Hz. What is answered follows the SDK 2.0 user guide, with ``port``, ``setfps`` and others of SDK
3.0; where a guide only says "error", the texts are those that drones were seen to send.
"""

from __future__ import annotations

import contextlib
import math
import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from drivers.interfaces import FlightMode, VelocitySetpoint
from hil.autopilot_values import OffboardSession
from hil.tello_moves import Move, move_of
from hil.tello_video import TelloVideo
from hil.world import SimDrone
from path.rotation import wrapped, yaw_of

Address = tuple[str, int]

COMMAND_PORT, STATE_PORT, VIDEO_PORT = 8889, 8890, 11111
STATE_PERIOD_S = 0.1
HOVER_M = 0.8  # where an automatic take-off ends
SILENCE_S = 15.0  # without a command for longer it lands
YAW_LEAD_RAD = 0.5  # how far ahead of the nose the heading is commanded, at most
RC_MAX_GAP_S = 0.2


@dataclass(frozen=True, slots=True)
class TelloEmulatorConfig:
    """
    Attributes:
        host: its own address; every emulated Tello needs one of its own.
        command_port: where it listens; 8889 is what djitellopy talks to.
        full_stick_mps, full_stick_dps: speed that 100 of ``rc`` stands for.
        answer_s: from a query until its answer.
        serial: what ``sn?`` answers.
        sdk3: knows ``port``, ``setfps``, ...; an early drone answers "unknown command".
    """

    host: str = "127.0.0.2"
    command_port: int = COMMAND_PORT
    full_stick_mps: float = 1.0
    full_stick_dps: float = 100.0
    answer_s: float = 0.02
    serial: str = "0TQZH77ED00000"
    sdk3: bool = True
    home_yaw_rad: float = 0.0  # heading in which it was switched on: its yaw of zero


@dataclass(slots=True)
class Faults:
    """While set. ``deaf``: commands are lost; ``mute``: they are carried out, but not answered."""

    no_state: bool = False
    garbled_state: bool = False
    deaf: bool = False
    mute: bool = False
    late_s: float = 0.0  # every answer comes so much later
    motor_fault: bool = False  # take-off: "error Motor stop"


class TelloEmulator:
    """One drone. ``pump`` is called with the world's time, which the drone was stepped to.

    Attributes:
        received: commands by their first word, counted.
        sessions: every time the sticks were in use, with the longest gap between two ``rc``.
    """

    def __init__(self, config: TelloEmulatorConfig, drone: SimDrone, video: TelloVideo | None = None) -> None:
        self.config = config
        self.faults = Faults()
        self.received: Counter[str] = Counter()
        self.sessions: list[OffboardSession] = []
        self.tap: Callable[[float, str], None] | None = None
        self._drone = drone
        self._video = video
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((config.host, config.command_port))
        self._now_s = 0.0
        self._client: str | None = None
        self._ports = (STATE_PORT, VIDEO_PORT)
        self._state_due_s = 0.0
        self._answers: list[tuple[float, bytes, Address]] = []
        self._waiting: tuple[str, Address] | None = None  # a motion command under way, who asked
        self._heard_s = 0.0
        self._rc = (0, 0, 0, 0)
        self._rc_s = -math.inf
        self._yaw_goal = 0.0
        self._move: Move | None = None
        self._speed_cm = 50
        self._motors_s = 0.0
        self._ground_d_m = 0.0
        self._pending_takeoff = False
        self._sticks = False
        self._silent = False
        self._commands: dict[str, Callable[[Address], str | None]] = {
            "command": lambda _: "ok",
            "takeoff": self._take_off,
            "land": self._land,
            "emergency": self._emergency,
            "stop": self._stop,
            "streamon": lambda _: self._stream(True),
            "streamoff": lambda _: self._stream(False),
        }
        self._settings: dict[str, Callable[[list[str]], str]] = {
            "speed": self._set_speed,
            "port": self._set_ports,
            "setfps": self._set_fps,
            **dict.fromkeys(("setresolution", "setbitrate", "downvision"), lambda _: "ok"),
        }

    @property
    def address(self) -> Address:
        return self._socket.getsockname()

    @property
    def silent(self) -> bool:
        """Nothing is sent, and whatever comes in is lost."""
        return self._silent

    @silent.setter
    def silent(self, silent: bool) -> None:
        self._silent = silent
        self.faults.no_state = self.faults.deaf = silent
        if self._video is not None:
            self._video.silent = silent

    def close(self) -> None:
        self._close_session(FlightMode.OTHER)
        if self._video is not None:
            self._video.stop()
        self._socket.close()

    def pump(self, now_s: float) -> None:
        """Take all that came in, fly, send what is due."""
        dt, self._now_s = now_s - self._now_s, now_s
        self._receive()
        autopilot = self._drone.autopilot
        if autopilot.armed:
            self._motors_s += dt
        self._climb()
        self._fly(dt)
        self._finish()
        self._send_answers()
        if self._client is not None and now_s >= self._state_due_s:
            self._state_due_s = max(self._state_due_s + STATE_PERIOD_S, now_s)
            self._send_state()

    # --- commands ---

    def _receive(self) -> None:
        while True:
            try:
                data, sender = self._socket.recvfrom(1024)
            except BlockingIOError:
                return
            if self.faults.deaf:
                continue
            text = data.decode("ascii", "replace").strip()
            if self.tap is not None:
                self.tap(self._now_s, text)
            self._take(text, sender)

    def _take(self, text: str, sender: Address) -> None:
        words = text.split()
        word = words[0] if words else ""
        self.received[word] += 1
        if word == "command":
            self._client = sender[0]
        elif self._client is None:
            return  # it is not in SDK mode, and silent
        self._heard_s = self._now_s
        if word == "rc":
            self._take_rc(words[1:])
            return
        answer = self._execute(word, words[1:], sender)
        if answer is not None:
            self._answer(answer, sender)

    def _execute(self, word: str, arguments: list[str], sender: Address) -> str | None:
        """The answer, None when it comes once the motion is over."""
        if word.endswith("?"):
            return self._query(word)
        if word in self._settings and (self.config.sdk3 or word == "speed"):
            return self._settings[word](arguments)
        if word in self._commands and not arguments:
            return self._commands[word](sender)
        return self._start_move(word, arguments, sender)

    def _query(self, word: str) -> str:
        autopilot, down = self._drone.autopilot, self._drone.estimate.position_n_m[2]
        roll, pitch, yaw = self._attitude_deg()
        answers = {
            "battery?": f"{round(100 * autopilot.battery)}",
            "speed?": f"{self._speed_cm:.1f}",
            "time?": f"{int(self._motors_s)}s",
            "height?": f"{round(10 * (self._ground_d_m - down))}dm",
            "temp?": "65~67C",
            "attitude?": f"pitch:{pitch};roll:{roll};yaw:{yaw};",
            "baro?": f"{self._baro_m():.6f}",
            "tof?": f"{10 * self._tof_cm()}mm",
            "wifi?": "90",
            "sdk?": "30" if self.config.sdk3 else "20",
            "sn?": self.config.serial,
        }
        return answers.get(word, f"unknown command: {word}")

    def _take_off(self, sender: Address) -> str | None:
        autopilot = self._drone.autopilot
        if not autopilot.landed or self._waiting is not None:
            return "error"
        if self.faults.motor_fault:
            return "error Motor stop"
        if not autopilot.armed and not autopilot.request_arm(self._now_s, True).accepted:
            return "error No valid imu" if autopilot.battery > autopilot.config.low_battery else "error Auto land"
        self._ground_d_m = self._drone.estimate.position_n_m[2]
        self._pending_takeoff = True
        self._waiting = ("takeoff", sender)
        return None

    def _climb(self) -> None:
        if self._pending_takeoff and self._drone.autopilot.request_takeoff(self._now_s, HOVER_M).accepted:
            self._pending_takeoff = False

    def _land(self, sender: Address) -> str | None:
        autopilot = self._drone.autopilot
        if not autopilot.armed:
            return "error"
        self._let_go(FlightMode.LAND)
        autopilot.request_mode(self._now_s, FlightMode.LAND)
        self._waiting = ("land", sender)
        return None

    def _emergency(self, _: Address) -> None:
        """No answer is promised. The model never stops motors in the air: it lands."""
        self._let_go(FlightMode.OTHER)
        autopilot = self._drone.autopilot
        if not autopilot.request_arm(self._now_s, False).accepted:
            autopilot.request_mode(self._now_s, FlightMode.LAND)

    def _stop(self, _: Address) -> str:
        self._rc = (0, 0, 0, 0)
        self._move = None
        return "ok" if not self._drone.autopilot.landed else "error Not joystick"

    def _stream(self, on: bool) -> str:
        if self._video is None or self._client is None:
            return "error"
        if on:
            self._video.start(self.config.host, (self._client, self._ports[1]))
        else:
            self._video.stop()
        return "ok"

    def _set_ports(self, arguments: list[str]) -> str:
        ports = [_whole(argument, 1025, 65535) for argument in arguments]
        if len(ports) != 2 or ports[0] is None or ports[1] is None:
            return "error"
        self._ports = (ports[0], ports[1])
        return "ok"

    def _set_speed(self, arguments: list[str]) -> str:
        speed = _whole(arguments[0], 10, 100) if len(arguments) == 1 else None
        self._speed_cm = speed or self._speed_cm
        return "ok" if speed is not None else "out of range"

    def _set_fps(self, arguments: list[str]) -> str:
        done = self._video is not None and len(arguments) == 1 and self._video.set_fps(arguments[0])
        return "ok" if done else "error"

    def _start_move(self, word: str, arguments: list[str], sender: Address) -> str | None:
        move = move_of(word, arguments, self._drone.estimate.position_n_m, yaw_of(self._drone.estimate.q_n_b))
        if move is None:
            return f"unknown command: {word}"
        if isinstance(move, str):
            return move
        if self._drone.autopilot.mode not in (FlightMode.HOLD, FlightMode.OFFBOARD) or self._drone.autopilot.landed:
            return "error Motor stop" if self._drone.autopilot.landed else "error Not joystick"
        self._move, self._waiting = move, (word, sender)
        return None

    # --- sticks ---

    def _take_rc(self, arguments: list[str]) -> None:
        """No answer, whatever it says. What is beyond 100 is not taken."""
        sticks = [_whole(value, -100, 100) for value in arguments]
        if len(sticks) != 4 or any(stick is None for stick in sticks):
            return
        a, b, c, d = (int(stick or 0) for stick in sticks)
        self._move = None
        self._rc = (a, b, c, d)
        autopilot = self._drone.autopilot
        if autopilot.landed or autopilot.mode not in (FlightMode.HOLD, FlightMode.OFFBOARD):
            return
        if not self._sticks:
            self._sticks = True
            self._yaw_goal = yaw_of(self._drone.estimate.q_n_b)
            self.sessions.append(OffboardSession(self._now_s))
        else:
            session = self.sessions[-1]
            session.max_gap_s = max(session.max_gap_s, self._now_s - self._rc_s)
        self._rc_s = self._now_s

    def _fly(self, dt: float) -> None:
        """Sticks stay as they are until the next ``rc``: only silence for 15 s ends that."""
        autopilot = self._drone.autopilot
        if autopilot.mode not in (FlightMode.HOLD, FlightMode.OFFBOARD) or autopilot.landed:
            if self._sticks:
                self._close_session(autopilot.mode)
            return
        if self._now_s - self._heard_s > SILENCE_S:
            self._let_go(FlightMode.LAND)
            autopilot.request_mode(self._now_s, FlightMode.LAND)
            return
        if self._sticks:
            self._by_sticks(dt)
        elif self._move is not None:
            move, yaw = self._move, yaw_of(self._drone.estimate.q_n_b)
            velocity = move.velocity(self._drone.estimate.position_n_m, self._speed_cm / 100.0)
            self._command(velocity, yaw + math.copysign(min(abs(move.turn_left(yaw)), 0.3), move.turn_left(yaw)))

    def _by_sticks(self, dt: float) -> None:
        config, yaw = self.config, yaw_of(self._drone.estimate.q_n_b)
        right, forward, up, turn = self._rc
        ahead = self._yaw_goal + math.radians(config.full_stick_dps) * turn / 100.0 * dt
        self._yaw_goal = yaw + max(-YAW_LEAD_RAD, min(YAW_LEAD_RAD, wrapped(ahead - yaw)))
        scale = config.full_stick_mps / 100.0
        c, s = math.cos(yaw), math.sin(yaw)
        north, east = scale * (c * forward - s * right), scale * (s * forward + c * right)
        if self._move is None:
            self._command((north, east, -scale * up), self._yaw_goal)

    def _command(self, velocity: tuple[float, float, float], yaw: float) -> None:
        autopilot = self._drone.autopilot
        autopilot.setpoint(self._now_s, VelocitySetpoint(velocity, yaw))
        if autopilot.mode is not FlightMode.OFFBOARD:
            autopilot.request_mode(self._now_s, FlightMode.OFFBOARD)

    def _let_go(self, mode: FlightMode) -> None:
        self._pending_takeoff, self._move, self._rc = False, None, (0, 0, 0, 0)
        self._close_session(mode)

    def _close_session(self, mode: FlightMode) -> None:
        if self._sticks:
            session = self.sessions[-1]
            session.max_gap_s = max(session.max_gap_s, self._now_s - self._rc_s)
            session.end_s, session.ended_by = self._now_s, mode
        self._sticks = False

    def _finish(self) -> None:
        """Answer the motion command that is over."""
        if self._waiting is None:
            return
        word, sender = self._waiting
        autopilot = self._drone.autopilot
        over = {
            "takeoff": not autopilot.landed and autopilot.mode is FlightMode.HOLD,
            "land": not autopilot.armed,
        }.get(word, self._move is None or self._move.over(self._drone.estimate))
        if over:
            self._waiting, self._move = None, None
            self._answer("ok", sender)
        elif word == "takeoff" and not autopilot.armed:
            self._waiting = None
            self._answer("error Motor stop", sender)

    # --- out ---

    def _answer(self, text: str, to: Address) -> None:
        if not self.faults.mute:
            due_s = self._now_s + self.config.answer_s + self.faults.late_s
            self._answers.append((due_s, f"{text}\r\n".encode(), to))

    def _send_answers(self) -> None:
        due = [each for each in self._answers if each[0] <= self._now_s]
        self._answers = [each for each in self._answers if each[0] > self._now_s]
        for _, data, to in due:
            self._send(data, to)

    def _send(self, data: bytes, to: Address) -> None:
        with contextlib.suppress(OSError):  # nobody listens any more, or a full buffer: lost, as by a radio
            self._socket.sendto(data, to)

    def _send_state(self) -> None:
        if self.faults.no_state or self._client is None:
            return
        text = self.state_text()
        data = text.replace(":", "").encode() if self.faults.garbled_state else text.encode()
        self._send(data, (self._client, self._ports[0]))

    def state_text(self) -> str:
        """One state packet, as of now."""
        drone = self._drone
        roll, pitch, yaw = self._attitude_deg()
        c, s = math.cos(self.config.home_yaw_rad), math.sin(self.config.home_yaw_rad)
        vn, ve, vd = drone.estimate.velocity_n_mps
        x, y, z = (round(10.0 * v) for v in (c * vn + s * ve, c * ve - s * vn, vd))
        height_cm = 10 * round(10.0 * (self._ground_d_m - drone.estimate.position_n_m[2])) if self._flying() else 0
        return (
            f"mid:-1;x:-100;y:-100;z:-100;mpry:0,0,0;pitch:{pitch};roll:{roll};yaw:{yaw};vgx:{x};vgy:{y};vgz:{z};"
            f"templ:65;temph:67;tof:{self._tof_cm()};h:{height_cm};bat:{round(100 * drone.autopilot.battery)};"
            f"baro:{self._baro_m():.2f};time:{int(self._motors_s)};agx:0.00;agy:0.00;agz:-1000.00;\r\n"
        )

    def _flying(self) -> bool:
        return self._drone.autopilot.armed

    def _attitude_deg(self) -> tuple[int, int, int]:
        """Roll, pitch and yaw in whole degrees; yaw from where the nose was when it was switched on."""
        w, x, y, z = self._drone.estimate.q_n_b
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        yaw = wrapped(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) - self.config.home_yaw_rad)
        return round(math.degrees(roll)), round(math.degrees(pitch)), round(math.degrees(yaw))

    def _tof_cm(self) -> int:
        """Down to flat ground, along its own axis; what it says when it stands is 10."""
        height_m = -self._drone.true_position_n_m[2]
        w, x, y, z = self._drone.true_q_n_b
        lean = 1.0 - 2.0 * (x * x + y * y)
        del w, z
        return max(10, round(100.0 * height_m / max(lean, 0.5)))

    def _baro_m(self) -> float:
        return 150.0 - self._drone.estimate.position_n_m[2]


def _whole(text: str, low: int, high: int) -> int | None:
    try:
        value = int(text)
    except ValueError:
        return None
    return value if low <= value <= high else None
