"""A vehicle alone, as strangers' programs find it."""

from __future__ import annotations

import asyncio
import io
import math
import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from drivers.beacons.marvelmind import Marvelmind, MarvelmindConfig
from drivers.interfaces import PartError
from missions.fly.stand_in import run
from missions.ground.options.flights import StandInOptions
from path.messages import Role, Vec3
from tests.drivers.link.link_ends import Context, WallClock
from tests.free_ports import free_port

LIMIT_S = 60.0


@contextmanager
def stand_in(*words: str) -> Generator[subprocess.Popen[str]]:
    """The command as a person starts it, ended as a person ends it."""
    command = [sys.executable, "-m", "missions.cli", "stand-in", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        try:
            yield program
        finally:
            program.send_signal(signal.SIGINT)
            program.wait(LIMIT_S)


def told(vehicle: Any, command: int, *params: float) -> int:
    """The answer to a command."""
    filled = (*params, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)[:7]
    vehicle.mav.command_long_send(vehicle.target_system, 1, command, 0, *filled)
    answer = vehicle.recv_match(type="COMMAND_ACK", blocking=True, timeout=LIMIT_S)
    assert answer is not None and answer.command == command
    return answer.result


def armed(vehicle: Any) -> None:
    """Asks until its estimator has settled, as a person would."""
    end_s = time.monotonic() + LIMIT_S
    while told(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) != 0:
        assert time.monotonic() < end_s, "it was never ready to arm"
        time.sleep(0.2)


def height_m(vehicle: Any) -> float:
    message = vehicle.recv_match(type="GLOBAL_POSITION_INT", blocking=True, timeout=LIMIT_S)
    assert message is not None
    return message.relative_alt / 1000.0


def test_a_stranger_takes_a_vehicle_off_and_lands_it_and_there_is_another_one() -> None:
    port = free_port()
    first = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
    second = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port + 1}")
    with stand_in("--port", str(port), "--two") as program:
        for number, vehicle in enumerate((first, second)):
            assert vehicle.wait_heartbeat(timeout=LIMIT_S) is not None
            assert vehicle.target_system == number + 1
        armed(first)
        takeoff = mavlink.MAV_CMD_NAV_TAKEOFF
        nan = float("nan")
        assert told(first, takeoff, nan, 0.0, 0.0, nan, nan, nan, nan) == 0
        while height_m(first) < 1.0:
            pass
        assert told(first, mavlink.MAV_CMD_NAV_LAND) == 0
        while height_m(first) > 0.3:
            pass
        assert height_m(second) < 0.3
        assert program.stdout is not None
        assert (
            program.stdout.readline()
            == f"vehicle 1: MAVLink 2 to UDP port {port} of this computer\n"
        )
    first.close()
    second.close()
    assert program.returncode == 0


def test_a_program_that_is_there_already_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []

    def start(_: str, words: list[str]) -> None:
        started.append(words)

    monkeypatch.setattr(os, "execv", start)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        out = io.StringIO()
        run(StandInOptions(port=port), out)
    assert "a program listens there already" in out.getvalue()
    assert started[0][-1] == str(port)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (StandInOptions(port=65535, two=True), "no port 65536"),
        (StandInOptions(rig="sim-rendered"), "level sim-rendered"),
        (StandInOptions(rig="nowhere"), "nowhere"),
        (StandInOptions("hedgehog", port=5000), "a hedgehog has a serial port"),
        (StandInOptions("tello", "sim"), "its drones are no tellos"),
        (StandInOptions("vehicle", "sitl-tello"), "its drones are no vehicles"),
    ],
)
def test_what_cannot_be_stood_in_for_is_refused(options: StandInOptions, what: str) -> None:
    with pytest.raises(PartError, match=what):
        run(options, io.StringIO())


STOCK = """
import time

import djitellopy

djitellopy.Tello.CONTROL_UDP_PORT = {own}  # other programs of this computer may have 8889
for host in ("127.0.0.2", "127.0.0.3"):
    tello = djitellopy.Tello(host)
    tello.address = (host, {port})
    tello.connect(wait_for_state=False)
    while True:
        try:
            tello.takeoff()
            break
        except djitellopy.tello.TelloException as error:
            if "imu" not in str(error):  # it was switched on a moment ago
                raise
            time.sleep(1.0)
    tello.rotate_clockwise(90)
    tello.land()
    print(host, tello.query_battery() > 50)
"""


def test_a_stock_djitellopy_flies_both_tellos_beside_it() -> None:
    port = free_port()
    with stand_in("tello", "--two", "--port", str(port)) as program:
        switched_on(program)
        words = [sys.executable, "-c", STOCK.format(own=free_port(), port=port)]
        said = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert said.stdout == "127.0.0.2 True\n127.0.0.3 True\n", said.stderr[-2000:]
    assert program.returncode == 0


def test_a_cameras_stream_is_decoded_by_anybody(tmp_path: Path) -> None:
    port = free_port()
    film = tmp_path / "film.h264"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", port))
        listener.settimeout(LIMIT_S)
        with stand_in("camera", "--port", str(port)) as program:
            switched_on(program)
            film.write_bytes(b"".join(listener.recv(4096) for _ in range(60)))
    with av.open(str(film)) as container:
        frame = next(container.decode(video=0))
    assert (frame.width, frame.height) == (640, 480)
    assert frame.to_ndarray(format="gray").std() > 5.0


def test_the_hedgehog_on_the_target_is_read_as_a_real_one_and_moves_as_it_does() -> None:
    with stand_in("hedgehog", "--two", "--seed", "1") as program:
        links = [re.findall(r'ports = \["(.*?)"\]', line) for line in switched_on(program)]
        ports = tuple(link for found in links for link in found)
        assert len(ports) == 2

        async def hear() -> list[tuple[int, Vec3]]:
            context: Any = Context(Role.SENDER, WallClock())
            async with Marvelmind(MarvelmindConfig(ports=ports), context) as hedge:
                fixes = [await hedge.read(LIMIT_S) for _ in range(60)]
            return [(fix.address, fix.position_m) for fix in fixes]

        heard = asyncio.run(hear())
    on_target, on_d1 = ([place for number, place in heard if number == own] for own in (7, 5))
    assert min(len(on_target), len(on_d1)) > 15
    assert math.dist(on_target[0], on_target[-1]) > 0.2  # it drives
    assert statistics.median(abs(each[0]) + abs(each[1]) for each in on_d1) < 0.2  # it stands
    assert not any(Path(port).is_symlink() for port in ports)


def switched_on(program: subprocess.Popen[str]) -> list[str]:
    """What it said until it was."""
    assert program.stdout is not None
    said: list[str] = []
    for line in program.stdout:
        said.append(line)
        if line.startswith("switched on"):
            return said
    raise AssertionError("it ended")
