"""A ground station on a port of its own: it sees the vehicle, is answered, and its word on the mode
is a pilot's.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.geodesy import LocalTangent
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import WorldConfig
from hil.world.world import World
from path.messages import Role
from tests.free_ports import free_port

SYSID = 7
STEP_S = 0.005


class Ground:
    """pymavlink's own link, as MAVProxy has it, listening as ground stations do; and a vehicle in
    simulated time.
    """

    def __init__(self) -> None:
        address = ("127.0.0.1", free_port())
        self.script = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.script.bind(("127.0.0.1", 0))
        self.link: Any = mavutil.mavlink_connection(
            f"udpin:{address[0]}:{address[1]}", source_system=255
        )
        self.world = World(WorldConfig(), seed=1)
        self.drone = self.world.drone(Role.SENDER)
        config = MavlinkVehicleConfig(SYSID, self.script.getsockname(), ground=address)
        self.vehicle = MavlinkVehicle(config, self.drone, LocalTangent(47.4, 8.5, 480.0))
        self.now_s = 0.0

    def close(self) -> None:
        self.link.close()
        self.vehicle.close()
        self.script.close()

    def run(self, seconds: float) -> dict[str, list[Any]]:
        """The messages heard meanwhile, by type."""
        heard: dict[str, list[Any]] = {}
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.world.advance(self.now_s)
            self.vehicle.pump(self.now_s)
            while (message := self.link.recv_msg()) is not None:
                heard.setdefault(message.get_type(), []).append(message)
        return heard


@pytest.fixture
def ground() -> Iterator[Ground]:
    made = Ground()
    yield made
    made.close()


def test_it_sees_the_vehicle_without_asking(ground: Ground) -> None:
    heard = ground.run(8.0)
    assert {"HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS"} <= heard.keys()
    assert {message.get_srcSystem() for message in heard["HEARTBEAT"]} == {SYSID}
    assert mavutil.mode_string_v10(heard["HEARTBEAT"][-1]) != ""


def test_parameters_come_as_a_list(ground: Ground) -> None:
    ground.run(0.5)
    ground.link.mav.param_request_list_send(SYSID, 1)
    found = ground.run(0.5)["PARAM_VALUE"]
    assert len({message.param_id for message in found}) == found[0].param_count > 10


def test_missions_and_fences_are_answered(ground: Ground) -> None:
    ground.run(0.5)
    for kind in (
        mavlink.MAV_MISSION_TYPE_MISSION,
        mavlink.MAV_MISSION_TYPE_FENCE,
        mavlink.MAV_MISSION_TYPE_RALLY,
    ):
        ground.link.mav.mission_request_list_send(SYSID, 1, kind)
        ground.link.mav.mission_count_send(SYSID, 1, 3, kind)
        heard = ground.run(0.2)
        assert [(each.count, each.mission_type) for each in heard["MISSION_COUNT"]] == [(0, kind)]
        acks = [(each.type, each.mission_type) for each in heard["MISSION_ACK"]]
        assert acks == [(mavlink.MAV_MISSION_UNSUPPORTED, kind)]


def test_its_mode_is_a_pilots(ground: Ground) -> None:
    ground.run(8.0)
    ground.link.mav.command_long_send(
        SYSID, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0
    )
    ground.run(0.1)
    ground.link.mav.command_long_send(SYSID, 1, mavlink.MAV_CMD_NAV_TAKEOFF, 0, *[float("nan")] * 7)
    ground.run(6.0)
    assert not ground.drone.autopilot.landed
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    # POSCTL
    ground.link.mav.command_long_send(
        SYSID, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, base, 3, 0, 0, 0, 0, 0
    )
    ground.run(0.2)
    assert ground.drone.autopilot.mode is FlightMode.OTHER


def test_whoever_watches_does_not_disturb_the_script(ground: Ground) -> None:
    ground.script.settimeout(0.0)
    ground.run(0.2)
    ground.link.mav.param_request_list_send(SYSID, 1)
    ground.run(0.2)
    mav: Any = mavlink.MAVLink(None)
    heard: set[str] = set()
    with pytest.raises(BlockingIOError):
        while True:
            heard |= {
                message.get_type() for message in mav.parse_buffer(ground.script.recv(2048)) or ()
            }
    assert "HEARTBEAT" in heard
    assert "PARAM_VALUE" not in heard
