"""The harness's connection to a simulator: truth as each autopilot tells it, readiness, and
simulators that fail.
"""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as every_dialect

from drivers.interfaces import FlightMode
from drivers.mavlink.geodesy import LocalTangent
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.autopilot.simulator import Kind
from hil.monitors.scripts import vehicles_of
from hil.vehicle.simulators.followed_world import FollowedWorld, SimulatedVehicle, start_simulators
from hil.vehicle.simulators.link import OWN_SYSID, PREARM_CHECK, SimulatorLink
from hil.vehicle.simulators.process import SimulatorBroken
from hil.vehicle.simulators.truth_follower import TruthFollower
from hil.vehicle.simulators.wire import UdpWire
from hil.world.config import WorldConfig
from hil.world.dynamics import CONTACT, POSITION, VELOCITY
from missions.ground import rig_library
from path.messages import Role

mavlink: Any = every_dialect
SYSID = 5
TANGENT = LocalTangent(47.4, 8.5, 480.0)
TRUE = (3.0, -2.0, -1.5)  # where it is, NED
LATITUDE, LONGITUDE, ALTITUDE = TANGENT.to_global(*TRUE)


class Simulator:
    """Says what a simulator says, on a link that listens for it."""

    def __init__(self, kind: Kind) -> None:
        self.follower = TruthFollower(0.1)
        self.link = SimulatorLink(kind, SYSID, ("127.0.0.1", 0), TANGENT, self.follower)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.mav: Any = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
        assert isinstance(self.link.wire, UdpWire)
        self.address = self.link.wire.address

    def say(self, *messages: Any) -> None:
        for message in messages:
            self.socket.sendto(message.pack(self.mav), self.address)
        self.link.receive()

    def heard(self) -> list[Any]:
        """Returns the messages that the harness sent it."""
        messages: list[Any] = []
        while True:
            try:
                messages += self.mav.parse_buffer(self.socket.recv(4096)) or []
            except BlockingIOError:
                return messages

    def close(self) -> None:
        self.link.close()
        self.socket.close()


@pytest.fixture(params=["px4", "ardupilot"])
def simulator(request: pytest.FixtureRequest) -> Generator[Simulator]:
    made = Simulator(request.param)
    try:
        yield made
    finally:
        made.close()


def truths(kind: str) -> list[Any]:
    latitude, longitude = math.floor(LATITUDE * 1e7), math.floor(LONGITUDE * 1e7)
    if kind == "px4":
        return [
            mavlink.MAVLink_hil_state_quaternion_message(
                0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.1, latitude, longitude, math.floor(ALTITUDE * 1e3),
                50, 0, -20, 0, 0, 0, 0, 0,
            )
        ]  # fmt: skip
    zeros = [0.0] * 9
    speeds = (0.505, 0.0, -0.205)
    return [
        mavlink.MAVLink_sim_state_message(
            1.0,
            0.0,
            0.0,
            0.0,
            *zeros[:8],
            0.1,
            LATITUDE * 1e7,
            LONGITUDE * 1e7,
            ALTITUDE,
            0.0,
            0.0,
            *speeds,
        ),
        mavlink.MAVLink_simstate_message(*zeros, latitude, longitude),
    ]


def readiness() -> list[Any]:
    return [
        mavlink.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3),
        mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_global_position_int_message(0, 474000000, 85000000, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_home_position_message(
            474000000, 85000000, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0
        ),
        mavlink.MAVLink_sys_status_message(0, 0, PREARM_CHECK, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    ]


def test_the_truth_of_both_autopilots_is_the_same(simulator: Simulator) -> None:
    kind = simulator.link._kind  # type: ignore[reportPrivateUsage]
    simulator.say(*truths(kind))
    assert simulator.follower.ready
    row = simulator.follower.row(simulator.follower.newest_s)
    # a leg higher: there stands its origin
    assert row[POSITION] == pytest.approx([3.0, -2.0, -1.6], abs=0.012)
    assert row[VELOCITY] == pytest.approx([0.505, 0.0, -0.205])


def test_it_is_ready_when_nothing_is_missing(simulator: Simulator) -> None:
    kind = simulator.link._kind  # type: ignore[reportPrivateUsage]
    said = [*truths(kind), *readiness()]
    # PX4's truth link carries no heartbeat
    for message in said[len(truths(kind)) + (kind == "px4") :]:
        assert simulator.link.missing != []
        simulator.say(message)
    assert simulator.link.missing == ["truth"]
    simulator.say(*truths(kind))
    assert simulator.link.missing == []


def test_it_asks_for_what_does_not_come_and_never_beats(simulator: Simulator) -> None:
    now_s = time.monotonic()
    simulator.link.ask(now_s)
    assert simulator.heard() == []  # nobody to ask yet
    simulator.say(mavlink.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3))
    simulator.link.ask(now_s)
    asked = simulator.heard()
    truth = {"px4": {115}, "ardupilot": {108, 164}}[simulator.link._kind]  # type: ignore[reportPrivateUsage]
    assert truth < {int(message.param1) for message in asked}
    assert {
        (message.get_type(), message.command, message.get_srcSystem()) for message in asked
    } == {("COMMAND_LONG", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, OWN_SYSID)}
    simulator.link.ask(now_s + 0.01)
    assert simulator.heard() == []  # not again at once


def current_mode(main: int, sub: int) -> Any:
    """CURRENT_MODE as PX4 tells it."""
    return mavlink.MAVLink_current_mode_message(0, main << 16 | sub << 24, 0)


@pytest.mark.parametrize("simulator", ["px4"], indirect=True)
def test_a_px4s_mode_is_known_before_its_next_heartbeat(simulator: Simulator) -> None:
    def asked(now_s: float) -> bool:
        simulator.link.ask(now_s)
        return mavlink.MAVLINK_MSG_ID_CURRENT_MODE in {
            int(message.param1) for message in simulator.heard()
        }

    now_s = time.monotonic()
    simulator.say(*truths("px4"))
    assert asked(now_s) and asked(now_s + 2.0)  # a request may be lost
    for told, mode in (
        (current_mode(6, 0), FlightMode.OFFBOARD),
        (current_mode(4, 3), FlightMode.HOLD),
    ):
        simulator.say(told)
        assert simulator.link.watch.mode is mode
    assert not asked(now_s + 4.0)  # it comes by itself now


def test_what_another_vehicle_says_is_not_its_truth(simulator: Simulator) -> None:
    simulator.mav.srcSystem = SYSID + 1
    simulator.say(*truths(simulator.link._kind))  # type: ignore[reportPrivateUsage]
    assert not simulator.follower.ready


def test_bytes_that_are_no_mavlink_hurt_nothing(simulator: Simulator) -> None:
    simulator.socket.sendto(b"\xfd\x09garbage" * 5, simulator.address)
    simulator.say(*truths(simulator.link._kind))  # type: ignore[reportPrivateUsage]
    simulator.say(*truths(simulator.link._kind))  # type: ignore[reportPrivateUsage]
    assert simulator.follower.ready


# --- whole simulators, scripted ---


@pytest.fixture
def rig() -> Rig:
    """``sitl-ardupilot`` with vehicles whose ports no other test uses."""
    rig = rig_library.load("sitl-ardupilot")
    receiver = {**rig.receiver.vehicle.options, "sysid": 8}
    sender = {**rig.sender.vehicle.options, "sysid": 7}
    return replace(
        rig,
        sender=replace(rig.sender, vehicle=replace(rig.sender.vehicle, options=sender)),
        receiver=replace(rig.receiver, vehicle=replace(rig.receiver.vehicle, options=receiver)),
    )


def started(rig: Rig, folder: Path, ready_s: float) -> None:
    config = decode_table(rig.world, WorldConfig, "world")
    assert config.sender_simulator is not None
    quick = replace(config.sender_simulator, ready_s=ready_s)

    async def run() -> None:
        vehicles = {role: SimulatedVehicle(rig, role, quick, config, folder) for role in Role}
        try:
            await start_simulators(vehicles)
        finally:
            for vehicle in vehicles.values():
                vehicle.close()

    asyncio.run(run())


@pytest.mark.parametrize(
    ("script", "said"),
    [
        (
            "echo cannot open the port; exit 7",
            r"ardupilot of vehicle [78] ended \(exit code 7\): cannot open the port",
        ),
        (
            "echo booting; exec sleep 60",
            "not ready after 3 s: waiting for heartbeat, local position.*booting",
        ),
    ],
)
def test_simulators_that_fail_are_no_missions_failure(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, said: str
) -> None:
    binary = tmp_path / "arducopter"
    binary.write_text(f"#!/bin/sh\n{script}\n")
    binary.chmod(0o755)
    monkeypatch.setenv("PATH_ARDUPILOT", str(binary))
    with pytest.raises(SimulatorBroken, match=said):
        started(rig, tmp_path, ready_s=3.0 if "sleep" in script else 60.0)


def test_the_world_is_where_the_simulators_say(rig: Rig, tmp_path: Path) -> None:
    config = decode_table(rig.world, WorldConfig, "world")
    assert config.sender_simulator is not None
    external = replace(
        config.sender_simulator, url="udp://127.0.0.1:0", truth_url="udp://127.0.0.1:0"
    )
    vehicles = {role: SimulatedVehicle(rig, role, external, config, tmp_path) for role in Role}
    tangent = LocalTangent.at(rig.origin)
    try:
        for vehicle, north in zip(vehicles.values(), (1.0, 4.0), strict=True):
            place = tangent.to_global(north, 0.0, 0.0)
            for height_m in (0.0, 2.0):
                now_s = time.monotonic()
                latitude, longitude, _ = place
                messages = [
                    mavlink.MAVLink_sim_state_message(
                        1.0,
                        0.0,
                        0.0,
                        0.0,
                        *[0.0] * 9,
                        0.0,
                        0.0,
                        place[2] + height_m,
                        0.0,
                        0.0,
                        0.0,
                        0.0,
                        0.0,
                    ),
                    mavlink.MAVLink_simstate_message(
                        *[0.0] * 9, round(latitude * 1e7), round(longitude * 1e7)
                    ),
                ]
                for message in messages:
                    vehicle.link._take(message, now_s)  # type: ignore[reportPrivateUsage]
            vehicle.epoch_s = now_s
        world = FollowedWorld(config, 0, vehicles)
        world.advance(0.01)
        assert world.airborne == tuple(Role)
        assert world.closest(0.0).closest_m == pytest.approx(3.0, abs=0.02)
        assert world.drone(Role.SENDER).true_position_n_m == pytest.approx(
            (1.0, 0.0, -2.1), abs=0.02
        )
        assert world.snapshot().drones[Role.RECEIVER].T_w_b.t == pytest.approx(
            [0.0, 4.0, 2.1], abs=0.02
        )
        assert not world.drone(Role.SENDER).autopilot.armed
        # the monitors find there all that they ask of an embedded one
        seen = vehicles_of(world, {role: rig.role(role) for role in Role})[Role.SENDER]
        assert (seen.pilot, seen.killed, seen.battery, seen.setpoint_s) == (
            False,
            False,
            1.0,
            -math.inf,
        )
        assert world._states[:, CONTACT].tolist() == [0.0, 0.0]  # type: ignore[reportPrivateUsage]
    finally:
        for vehicle in vehicles.values():
            assert vehicle.relay is not None
            vehicle.relay.close()
            vehicle.link.close()
