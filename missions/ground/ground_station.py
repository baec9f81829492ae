"""``--gcs``: where a ground station listens to the vehicles of a simulated world in real time."""

from __future__ import annotations

import ipaddress
import os

from drivers.interfaces import PartError
from drivers.link.udp import address_of
from drivers.rig.parts import Rig
from path.messages import Role


def name_ground_station(rig: Rig, asked: str | None) -> None:
    """For the harness: where a ground station listens. Raises PartError at levels that have no
    MAVLink of ours.
    """
    if asked is None:
        return
    embedded = (
        all("sysid" in rig.role(role).vehicle.options for role in Role)
        and "sender_simulator" not in rig.world
    )
    if rig.level != "sitl" or not embedded:
        raise PartError(
            f"--gcs: rig {rig.name} has no embedded MAVLink vehicles in real time",
            "a real autopilot has a port for its ground station already; at the sim levels there is no MAVLink: "
            "take --rig sitl, relay-sitl, or team-sitl",
        )
    try:
        host, _ = address_of(asked, "--gcs")
    except ValueError as error:
        raise PartError(str(error), "write it as 127.0.0.1:14550") from error
    if not ipaddress.ip_address(host).is_loopback:
        raise PartError(
            f"--gcs {asked}: another computer",
            "let the ground station run on this one: the port is not signed",
        )
    os.environ["PATH_GCS"] = asked
