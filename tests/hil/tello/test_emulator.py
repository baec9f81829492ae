"""The emulated Tello answers as the SDK's guides say: over a socket, but with the world's time in
the test's hands.
"""

from __future__ import annotations

import math
import re
import socket
from collections.abc import Callable, Generator
from typing import Any

import pytest

from hil.tello.emulator import TelloEmulator, TelloEmulatorConfig
from hil.tello.video import TelloVideo, TelloVideoConfig
from hil.world.config import WorldConfig
from hil.world.world import World
from path.messages import Role
from tests.free_ports import free_host

STEP_S = 0.005
STATE = re.compile(
    r"mid:-?\d+;x:-?\d+;y:-?\d+;z:-?\d+;mpry:-?\d+,-?\d+,-?\d+;pitch:-?\d+;roll:-?\d+;yaw:-?\d+;"
    r"vgx:-?\d+;vgy:-?\d+;vgz:-?\d+;templ:\d+;temph:\d+;tof:\d+;h:-?\d+;bat:\d+;baro:-?\d+\.\d\d;time:\d+;"
    r"agx:-?\d+\.\d\d;agy:-?\d+\.\d\d;agz:-?\d+\.\d\d;\r\n"
)


class Bench:
    """A drone, and a computer that talks to it."""

    def __init__(self, arrived: Callable[[float], float] | None = None, **config: Any) -> None:
        host = free_host()
        self.world = World(WorldConfig(), seed=1)
        self.drone = self.world.drone(Role.SENDER)
        self.video = TelloVideo(TelloVideoConfig(64, 48))
        self.emulator = TelloEmulator(
            TelloEmulatorConfig(host, **config), self.drone, self.video, arrived
        )
        self.commands = self._socket()
        self.states = self._socket()
        self.advance(4.0)

    def _socket(self) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind(("127.0.0.1", 0))
        made.setblocking(False)
        return made

    def close(self) -> None:
        for each in (self.commands, self.states, self.emulator):
            each.close()

    def advance(self, seconds: float) -> None:
        end_s = self.world.time_s + seconds
        while self.world.time_s < end_s:
            self.world.advance(self.world.time_s + STEP_S)
            self.emulator.pump(self.world.time_s)

    def send(self, command: str) -> None:
        self.commands.sendto(command.encode(), self.emulator.address)

    def answer(self) -> str | None:
        try:
            return self.commands.recv(1024).decode()
        except BlockingIOError:
            return None

    def ask(self, command: str, seconds: float = 0.1) -> str | None:
        """Its answer, None when there is none within so much of the world's time."""
        self.send(command)
        end_s = self.world.time_s + seconds
        while self.world.time_s < end_s:
            self.advance(STEP_S)
            if (answer := self.answer()) is not None:
                return answer.removesuffix("\r\n")
        return None

    def enter(self) -> None:
        assert self.ask("command") == "ok"
        assert self.ask(f"port {self.states.getsockname()[1]} 11199") == "ok"

    def fly(self) -> None:
        self.enter()
        assert self.ask("takeoff", 10.0) == "ok"

    def state(self) -> dict[str, str]:
        """The newest packet, sent by now."""
        newest = b""
        while True:
            try:
                newest = self.states.recv(1024)
            except BlockingIOError:
                break
        return dict(field.split(":") for field in newest.decode().strip().strip(";").split(";"))

    @property
    def height_m(self) -> float:
        return -self.drone.true_position_n_m[2]


@pytest.fixture
def bench() -> Generator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_it_is_silent_until_it_is_put_into_sdk_mode(bench: Bench) -> None:
    assert bench.ask("battery?") is None
    assert bench.ask("takeoff") is None
    assert bench.ask("command") == "ok"
    assert bench.ask("battery?") == "100"


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("command", "ok"),
        ("battery?", "100"),
        ("speed?", "50.0"),
        ("speed 30", "ok"),
        ("speed 9", "out of range"),
        ("speed", "out of range"),
        ("time?", "0s"),
        ("temp?", "65~67C"),
        ("tof?", "100mm"),
        ("wifi?", "90"),
        ("sdk?", "30"),
        ("sn?", "0TQZH77ED00000"),
        ("altitude?", "unknown command: altitude?"),
        ("dance", "unknown command: dance"),
        ("EXT led 255 0 0", "unknown command: EXT"),
        ("hardware?", "TELLO"),
        ("mon", "ok"),
        ("mdirection 2", "ok"),
        ("mdirection 3", "error"),
        ("moff", "ok"),
        ("go 50 0 0 30", "error Motor stop"),
        ("go 50 0 0 101", "out of range"),
        ("go 10 10 10 30", "out of range"),
        ("go 50 0 30", "error"),
        ("go 50 0 0 30 m1", "error No valid marker"),
        ("jump 50 0 80 30 0 m1 m2", "error No valid marker"),
        ("jump 50 0 80", "error"),
        ("curve 50 0 0 100 0 0 30", "error Radius is too large!"),
        ("curve 50 50 0 100 0 0 61", "out of range"),
        ("flip x", "error"),
        ("flip f", "error Motor stop"),
        ("", "unknown command: "),
        ("takeoff now", "unknown command: takeoff"),
        ("land", "error"),
        ("up 50", "error Motor stop"),
        ("up 10", "out of range"),
        ("up high", "error"),
        ("cw 361", "out of range"),
        ("stop", "error Not joystick"),
        ("streamon", "ok"),
        ("streamoff", "ok"),
        ("port 9000 9001", "ok"),
        ("port 80 9001", "error"),
        ("port 9000", "error"),
        ("setfps middle", "ok"),
        ("setfps fast", "error"),
        ("setresolution low", "ok"),
        ("rc 0 0 0 0", None),
        ("rc 1 2 3", None),
        ("rc 0 0 0 101", None),
        ("emergency", None),
    ],
)
def test_answers_on_the_ground(bench: Bench, command: str, answer: str | None) -> None:
    assert bench.ask("command") == "ok"
    assert bench.ask(command) == answer


def test_an_early_firmware_does_not_know_the_newer_commands() -> None:
    bench = Bench(sdk3=False)
    assert bench.ask("command") == "ok"
    assert bench.ask("port 9000 9001") == "unknown command: port"
    assert bench.ask("setfps middle") == "unknown command: setfps"
    assert bench.ask("sdk?") == "20"
    bench.close()


def test_a_take_off_is_answered_when_it_hovers_and_a_landing_when_the_motors_stand(
    bench: Bench,
) -> None:
    bench.enter()
    assert bench.ask("takeoff", 1.0) is None
    assert bench.ask("takeoff") == "error"  # once is enough
    bench.advance(6.0)
    assert bench.answer() == "ok"
    assert bench.height_m == pytest.approx(0.9, abs=0.15)
    assert bench.state()["h"] in ("70", "80")
    assert bench.ask("land", 1.0) is None
    bench.advance(6.0)
    assert bench.answer() == "ok"
    assert bench.drone.on_ground


def test_what_keeps_it_on_the_ground_is_said(bench: Bench) -> None:
    bench.enter()
    bench.emulator.flight.motor_fault = True
    assert bench.ask("takeoff") == "error Motor stop"
    bench.emulator.flight.motor_fault = False
    bench.world.battery(Role.SENDER, 0.05)
    bench.advance(0.1)
    assert bench.ask("takeoff") == "error Auto land"


def test_state_packets_come_ten_times_a_second_in_the_documented_form(bench: Bench) -> None:
    bench.enter()
    bench.advance(1.0)
    packets: list[str] = []
    while True:
        try:
            packets.append(bench.states.recv(1024).decode())
        except BlockingIOError:
            break
    assert len(packets) in (10, 11)
    assert all(STATE.fullmatch(packet) for packet in packets)


@pytest.mark.parametrize(
    ("sticks", "moved"),
    [("30 0 0 0", (0.0, 0.3, 0.0)), ("0 40 0 0", (0.4, 0.0, 0.0)), ("0 0 30 0", (0.0, 0.0, -0.3))],
)
def test_sticks_are_right_forward_and_up_in_centimetres_a_second(
    bench: Bench, sticks: str, moved: tuple[float, float, float]
) -> None:
    bench.fly()
    bench.send(f"rc {sticks}")
    bench.advance(2.0)
    before = bench.drone.true_position_n_m
    bench.advance(1.0)
    way = [b - a for a, b in zip(before, bench.drone.true_position_n_m, strict=True)]
    assert way == pytest.approx(moved, abs=0.12)


def test_the_yaw_stick_turns_clockwise_and_sticks_stay_where_they_are(bench: Bench) -> None:
    bench.fly()
    bench.send("rc 0 0 0 30")
    bench.advance(3.0)
    assert int(bench.state()["yaw"]) == pytest.approx(90, abs=12)


def test_a_relative_move_is_answered_when_it_is_over(bench: Bench) -> None:
    bench.fly()
    height_m = bench.height_m
    assert bench.ask("up 50", 8.0) == "ok"
    assert bench.height_m == pytest.approx(height_m + 0.5, abs=0.15)
    assert bench.ask("cw 90", 8.0) == "ok"
    assert int(bench.state()["yaw"]) == pytest.approx(90, abs=6)


def test_what_is_asked_for_ends_a_line_and_ok_does_not(bench: Bench) -> None:
    bench.enter()
    for command, answer in (
        ("battery?", "100\r\n"),
        ("speed 30", "ok"),
        ("speed 9", "out of range"),
    ):
        bench.send(command)
        bench.advance(0.1)
        assert bench.answer() == answer


@pytest.mark.parametrize("move", ["up 50", "forward 60", "cw 90", "go 60 0 0 50", "flip f"])
def test_a_move_ends_in_a_hover(bench: Bench, move: str) -> None:
    bench.fly()
    assert bench.ask(move, 12.0) == "ok"
    bench.advance(1.0)
    before = bench.drone.true_position_n_m
    bench.advance(8.0)
    assert not bench.drone.on_ground
    assert math.dist(before, bench.drone.true_position_n_m) < 0.5
    assert bench.ask("back 40", 12.0) == "ok"


def test_a_move_that_is_stopped_hovers(bench: Bench) -> None:
    bench.fly()
    bench.send("forward 300")
    bench.advance(1.5)
    assert bench.ask("stop") == "ok"
    bench.advance(8.0)
    assert not bench.drone.on_ground
    assert bench.drone.true_position_n_m[0] < 2.0


def test_places_are_forward_left_and_up_of_the_drone(bench: Bench) -> None:
    bench.fly()
    north, east, down = bench.drone.true_position_n_m
    assert bench.ask("go 100 50 30 60", 15.0) == "ok"
    now = bench.drone.true_position_n_m
    assert now == pytest.approx((north + 1.0, east - 0.5, down - 0.3), abs=0.25)


def test_a_curve_goes_by_its_place_on_the_way(bench: Bench) -> None:
    bench.fly()
    north, east, _ = bench.drone.true_position_n_m
    bench.send("curve 100 100 0 200 0 0 50")
    nearest_m, answer = math.inf, None
    for _ in range(600):
        bench.advance(0.05)
        n, e, _ = bench.drone.true_position_n_m
        nearest_m = min(nearest_m, math.dist((n, e), (north + 1.0, east - 1.0)))
        if (answer := bench.answer()) is not None:
            break
    assert answer == "ok"
    assert nearest_m < 0.3
    assert bench.drone.true_position_n_m[:2] == pytest.approx((north + 2.0, east), abs=0.3)


def test_velocities_are_decimetres_a_second_in_the_axes_of_the_start(bench: Bench) -> None:
    bench.fly()
    assert bench.ask("ccw 90", 8.0) == "ok"
    bench.send("rc 0 60 0 0")
    bench.advance(2.0)
    state = bench.state()
    assert int(state["vgy"]) == pytest.approx(-6, abs=1)
    assert abs(int(state["vgx"])) <= 1


def test_silence_for_fifteen_seconds_lands_it_wherever_it_flies(bench: Bench) -> None:
    bench.fly()
    bench.send("rc 0 20 0 0")
    bench.advance(14.5)
    assert bench.height_m > 0.5
    assert bench.drone.true_velocity_n_mps[0] > 0.1  # the sticks are where they were left
    bench.advance(8.0)
    assert bench.drone.on_ground


def test_the_longest_time_between_two_sticks_is_kept(bench: Bench) -> None:
    bench.fly()
    for pause_s in (0.05, 0.3, 0.05):
        bench.send("rc 0 0 0 0")
        bench.advance(pause_s)
    assert bench.ask("land", 10.0) == "ok"
    (session,) = bench.emulator.sessions
    assert session.max_gap_s == pytest.approx(0.3, abs=0.02)
    assert session.end_s is not None


@pytest.mark.parametrize(
    ("sent_s", "longest_s"), [((0.1, 0.2, 0.3, 0.4), 0.1), ((0.1, 0.35, 0.4), 0.25)]
)
def test_sticks_that_came_while_the_world_stood_still_count_from_then(
    sent_s: tuple[float, ...], longest_s: float
) -> None:
    stamps: list[float] = []
    bench = Bench(lambda _: stamps.pop(0) if stamps else bench.world.time_s)
    bench.fly()
    began_s = bench.world.time_s
    for at_s in (0.0, *sent_s):
        stamps.append(began_s + at_s)
        bench.send("rc 0 0 0 0")
    bench.world.advance(began_s + 0.45)
    bench.emulator.pump(bench.world.time_s)
    (session,) = bench.emulator.sessions
    bench.close()
    assert session.max_gap_s == pytest.approx(longest_s)


def test_faults_lose_commands_answers_and_state_packets(bench: Bench) -> None:
    bench.enter()
    faults = bench.emulator.faults
    faults.mute = True
    assert bench.ask("speed 20") is None
    faults.mute, faults.deaf = False, True
    assert bench.ask("speed 70") is None
    faults.deaf = False
    assert bench.ask("speed?") == "20.0"
    faults.late_s = 0.5
    assert bench.ask("speed?", 0.4) is None
    bench.advance(0.3)
    assert bench.answer() == "20.0\r\n"
    bench.advance(0.2)
    bench.state()
    faults.no_state = True
    bench.advance(0.5)
    with pytest.raises(ValueError, match="dictionary"):
        bench.state()


def test_leaning_and_distance_to_the_ground_are_whole_numbers(bench: Bench) -> None:
    bench.fly()
    assert re.fullmatch(r"pitch:-?\d+;roll:-?\d+;yaw:-?\d+;", bench.ask("attitude?") or "")
    bench.advance(0.2)
    state = bench.state()
    assert abs(int(state["pitch"])) <= 3
    assert int(state["tof"]) == pytest.approx(100 * bench.height_m, abs=6)
    said_m = -bench.world.drone(Role.SENDER).estimate.position_n_m[2]  # as wrong as its barometer
    assert math.isclose(float(state["baro"]), 150.0 + said_m, abs_tol=0.05)
