"""``--gcs``: which rigs have vehicles that a ground station can watch, and that each of theirs is
heard there.
"""

from __future__ import annotations

import socket
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import PartError
from flight.harness.fleet import pair_of
from hil.harness.realtime.parts import embedded_vehicle
from hil.harness.realtime.relay_world import field_of
from hil.world.config import WorldConfig
from hil.world.world import World
from missions.fly.fleet import command as fleet
from missions.ground import rig_library
from missions.ground.ground_station import name_ground_station
from missions.ground.options.flights import HandoffOptions, RelayOptions, TeamOptions
from path.messages import Role

USUAL = "127.0.0.1:14550"


@pytest.fixture(autouse=True)
def nobody_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test names for the processes of a run is forgotten after it."""
    monkeypatch.setenv("PATH_GCS", "")


def test_what_flies_many_refuses_one_where_there_is_no_mavlink_of_ours() -> None:
    with pytest.raises(PartError, match="rig team has no embedded MAVLink vehicles"):
        fleet.run(TeamOptions(gcs=USUAL))
    with pytest.raises(PartError, match="rig relay has no embedded MAVLink vehicles"):
        fleet.run(RelayOptions(gcs=USUAL))
    for name in ("sitl-px4", "sitl-tello", "hitl"):
        with pytest.raises(PartError, match=f"rig {name} has no embedded MAVLink vehicles"):
            name_ground_station(rig_library.load(name), USUAL)


@pytest.mark.parametrize(
    ("asked", "what"), [("10.0.0.1:14550", "another computer"), ("14550", "--gcs"), ("::", "--gcs")]
)
def test_an_address_that_is_none_or_of_another_computer_is_refused(asked: str, what: str) -> None:
    with pytest.raises(PartError, match=what):
        name_ground_station(rig_library.load(HandoffOptions().rig), asked)


@pytest.mark.parametrize(("name", "targets"), [("relay-sitl", 1), ("team-sitl", 2)])
def test_it_hears_every_vehicle_of_a_relay_and_of_a_team(name: str, targets: int) -> None:
    rig = rig_library.load(name)
    heard: set[int] = set()
    mav: Any = mavlink.MAVLink(None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(60.0)
        name_ground_station(rig, f"127.0.0.1:{ground.getsockname()[1]}")
        for drone in field_of(rig, 3, targets).drones:
            own = pair_of(rig, drone, drone).receiver
            vehicle = embedded_vehicle(
                rig, own, World(WorldConfig(), seed=1).drone(Role.SENDER), lambda _: 0.0
            )
            try:
                vehicle.pump(0.0)
            finally:
                vehicle.close()
            messages = mav.parse_buffer(ground.recv(2048)) or ()
            heard |= {
                message.get_srcSystem() for message in messages if message.get_type() == "HEARTBEAT"
            }
    assert heard == {1, 2, 3}
