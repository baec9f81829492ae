"""A Tello on the wire: the command, state and video ports of the SDK, for an unmodified djitellopy
to talk to.

The drone behind it is the same simulated one as behind MAVLink. It has no thread and no clock:
whoever steps the world calls ``pump`` at 200 Hz. What is answered follows the SDK 2.0 user guide,
with ``port``, ``setfps`` and others of SDK 3.0; where a guide only says "error", the texts are
those that drones were seen to send. What a query asks for ends with CRLF, "ok" and refusals end
with nothing.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from hil.autopilot.values import OffboardSession
from hil.tello.flight import TelloFlight
from hil.tello.moves import MOVES
from hil.tello.sensors import TelloSensors
from hil.tello.video import TelloVideo
from hil.vehicle.arrival import Address, bound, packets
from hil.world.world import SimDrone
from path.values import frozen

COMMAND_PORT = 8889
STATE_PORT = 8890
VIDEO_PORT = 11111
STATE_PERIOD_S = 0.1
SDK2 = ("speed", "mdirection")  # settings that an early drone knows too


@frozen
class TelloEmulatorConfig:
    """
    Attributes:
        host: its own address; every emulated Tello needs one of its own.
        command_port: where it listens; 8889 is what djitellopy talks to.
        full_stick_mps, full_stick_dps: speed that 100 of ``rc`` stands for.
        home_yaw_rad: heading in which it was switched on: its yaw of zero.
        answer_s: from a query until its answer.
        serial: what ``sn?`` answers.
        sdk3: knows ``port``, ``setfps``, ...; an early drone answers "unknown command".
    """

    host: str = "127.0.0.2"
    command_port: int = COMMAND_PORT
    full_stick_mps: float = 1.0
    full_stick_dps: float = 100.0
    home_yaw_rad: float = 0.0
    answer_s: float = 0.02
    serial: str = "0TQZH77ED00000"
    sdk3: bool = True


@dataclass(slots=True)
class Faults:
    """The faults while they are set.

    Attributes:
        deaf: commands are lost.
        mute: they are carried out, but not answered.
        words: by a command's first word: it is carried out, and this is answered at once in place
            of its own answer.
        beside: sent before every answer.
        state: sent in place of every state packet.
    """

    no_state: bool = False
    garbled_state: bool = False
    deaf: bool = False
    mute: bool = False
    late_s: float = 0.0  # every answer comes so much later
    words: dict[str, bytes] = field(default_factory=dict[str, bytes])
    beside: bytes = b""
    state: bytes = b""


class TelloEmulator:
    """One drone. ``pump`` is called with the world's time, which the drone was stepped to.

    Attributes:
        flight: what it does.
        received: commands by their first word, counted.
        tap: called with (now_s, text) for every command; for tests and logs.
    """

    def __init__(
        self,
        config: TelloEmulatorConfig,
        drone: SimDrone,
        video: TelloVideo | None = None,
        arrived: Callable[[float], float] | None = None,
    ) -> None:
        """``arrived``: the world's time of an instant of the monotonic clock. None: what is read
        came just then.
        """
        self.config = config
        self._arrived = arrived
        self.faults = Faults()
        self.received: Counter[str] = Counter()
        self.tap: Callable[[float, str], None] | None = None
        self._sensors = TelloSensors(drone, config.home_yaw_rad)
        self.flight = TelloFlight(
            drone,
            self._sensors,
            config.full_stick_mps,
            config.full_stick_dps,
        )
        self._video = video
        self._socket = bound((config.host, config.command_port))
        self._now_s = 0.0
        self._heard_s = 0.0
        self._client: str | None = None
        self._ports = (STATE_PORT, VIDEO_PORT)
        self._state_due_s = 0.0
        self._answers: list[tuple[float, bytes, Address]] = []
        self._waiting: tuple[str, Address] | None = None  # a motion command under way, who asked
        self._silent = False
        self._commands: dict[str, Callable[[], str | None]] = {
            "command": lambda: "ok",
            "takeoff": self.flight.take_off,
            "land": self.flight.land,
            "emergency": self.flight.emergency,
            "stop": self.flight.stop,
            "mon": lambda: "ok",
            "moff": lambda: "ok",
            "streamon": lambda: self._stream(True),
            "streamoff": lambda: self._stream(False),
        }
        self._settings: dict[str, Callable[[list[str]], str]] = {
            "speed": self._set_speed,
            "port": self._set_ports,
            "setfps": self._set_fps,
            **dict.fromkeys(("setresolution", "setbitrate", "downvision"), lambda _: "ok"),
            "mdirection": lambda arguments: "ok" if arguments in (["0"], ["1"], ["2"]) else "error",
        }

    @property
    def address(self) -> Address:
        return self._socket.getsockname()

    @property
    def sessions(self) -> list[OffboardSession]:
        return self.flight.sessions

    @property
    def silent(self) -> bool:
        """True while nothing is sent, and whatever comes in is lost."""
        return self._silent

    @silent.setter
    def silent(self, silent: bool) -> None:
        self._silent = silent
        self.faults.no_state = self.faults.deaf = silent
        if self._video is not None:
            self._video.silent = silent

    def close(self) -> None:
        self.flight.close()
        if self._video is not None:
            self._video.stop()
        self._socket.close()

    def pump(self, now_s: float) -> None:
        """Take all that came in, fly, send what is due."""
        dt = now_s - self._now_s
        self._now_s = now_s
        self._receive()
        self.flight.step(now_s, dt, self._heard_s)
        self._finish()
        self._send_answers()
        if self._client is not None and now_s >= self._state_due_s:
            self._state_due_s = max(self._state_due_s + STATE_PERIOD_S, now_s)
            self._send_state(self._client)

    # --- in ---

    def _receive(self) -> None:
        for data, sender, arrival_s in packets(self._socket):
            if self.faults.deaf:
                continue
            text = data.decode("ascii", "replace").strip()
            if self.tap is not None:
                self.tap(self._now_s, text)
            self._take(
                text,
                sender,
                self._now_s if self._arrived is None else self._arrived(arrival_s),
            )

    def _take(
        self,
        text: str,
        sender: Address,
        at_s: float,
    ) -> None:
        words = text.split()
        word = words[0] if words else ""
        self.received[word] += 1
        if word == "command":
            self._client = sender[0]
        elif self._client is None:
            return  # it is not in SDK mode, and silent
        self._heard_s = self._now_s
        if word == "rc":
            self._take_sticks(words[1:], at_s)
            return
        answer = self._execute(word, words[1:])
        if word in self.faults.words:
            self._put_answer(self.faults.words[word], sender)
        elif answer is not None:
            self._answer(answer + ("\r\n" if word.endswith("?") else ""), sender)
        elif word != "emergency":
            self._waiting = (word, sender)

    def _execute(self, word: str, arguments: list[str]) -> str | None:
        """The answer, None when it comes once the motion is over."""
        if word.endswith("?"):
            return self._query(word)
        if word in self._settings and (self.config.sdk3 or word in SDK2):
            return self._settings[word](arguments)
        if word in self._commands and not arguments:
            busy = word == "takeoff" and self._waiting is not None
            return "error" if busy else self._commands[word]()
        return self.flight.move(word, arguments)

    def _query(self, word: str) -> str:
        return self.queries().get(word) or f"unknown command: {word}"

    def queries(self) -> dict[str, str]:
        """Return what it answers to each query that it knows."""
        return {
            "speed?": f"{self.flight.speed_cm:.1f}",
            "sdk?": "30" if self.config.sdk3 else "20",
            "sn?": self.config.serial,
            "hardware?": "TELLO",  # without the expansion board, whose EXT is not known
            **self._sensors.answers(),
        }

    @property
    def words(self) -> set[str]:
        """Return the first words of all commands that it knows, queries left out."""
        return {"rc", *self._commands, *self._settings, *MOVES}

    def _take_sticks(self, arguments: list[str], at_s: float) -> None:
        """No answer, whatever it says. What is beyond 100 is not taken."""
        sticks = [whole for each in arguments if (whole := _whole(each, -100, 100)) is not None]
        if len(sticks) == len(arguments) == 4:
            right, forward, up, clockwise = sticks
            self.flight.sticks(right, forward, up, clockwise, at_s)

    def _stream(self, on: bool) -> str:
        if self._video is None or self._client is None:
            return "error"
        if on:
            self._video.start(self.config.host, (self._client, self._ports[1]))
        else:
            self._video.stop()
        return "ok"

    def _set_ports(self, arguments: list[str]) -> str:
        ports = [whole for each in arguments if (whole := _whole(each, 1025, 65535)) is not None]
        if len(ports) != 2 or len(arguments) != 2:
            return "error"
        self._ports = (ports[0], ports[1])
        return "ok"

    def _set_speed(self, arguments: list[str]) -> str:
        speed = _whole(arguments[0], 10, 100) if len(arguments) == 1 else None
        self.flight.speed_cm = speed or self.flight.speed_cm
        return "ok" if speed is not None else "out of range"

    def _set_fps(self, arguments: list[str]) -> str:
        done = self._video is not None and len(arguments) == 1 and self._video.set_fps(arguments[0])
        return "ok" if done else "error"

    # --- out ---

    def _finish(self) -> None:
        """Answer the motion command that is over."""
        if self._waiting is None:
            return
        word, sender = self._waiting
        answer = self.flight.over(word)
        if answer is not None:
            self._waiting = None
            self._answer(answer, sender)

    def _answer(self, text: str, to: Address) -> None:
        self._put_answer(text.encode(), to)

    def _put_answer(self, data: bytes, to: Address) -> None:
        if self.faults.mute:
            return
        due_s = self._now_s + self.config.answer_s + self.faults.late_s
        if self.faults.beside:
            self._answers.append((due_s, self.faults.beside, to))
        self._answers.append((due_s, data, to))

    def _send_answers(self) -> None:
        due = [each for each in self._answers if each[0] <= self._now_s]
        self._answers = [each for each in self._answers if each[0] > self._now_s]
        for _, data, to in due:
            self._send(data, to)

    def _send_state(self, client: str) -> None:
        if self.faults.no_state:
            return
        text = self._sensors.state_text()
        data = text.replace(":", "") if self.faults.garbled_state else text
        self._send(self.faults.state or data.encode(), (client, self._ports[0]))

    def _send(self, data: bytes, to: Address) -> None:
        # nobody listens any more, or a full buffer: lost, as by a radio
        with contextlib.suppress(OSError):
            self._socket.sendto(data, to)


def _whole(
    text: str,
    low: int,
    high: int,
) -> int | None:
    try:
        value = int(text)
    except ValueError:
        return None
    return value if low <= value <= high else None
