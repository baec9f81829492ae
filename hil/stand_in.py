"""A vehicle without a flight: an embedded autopilot in a world of its own, for any program that
speaks MAVLink.

    python -m hil.stand_in RIG_FILE SEED PORT [PORT]

flies the rig's sender, and its receiver where there is a second port, until Ctrl-C.
``path-handoff stand-in`` starts it.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Sequence
from contextlib import ExitStack

from drivers.mavlink.geodesy import LocalTangent
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.vehicle.alone import run_alone
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import WorldConfig
from hil.world.world import World
from path.messages import Role

HOST = "127.0.0.1"


def vehicles_of(
    rig: Rig, world: World, ports: Sequence[int], stack: ExitStack
) -> list[MavlinkVehicle]:
    """Return a vehicle for each port, which sends there from a free one, closed with the stack."""
    origin = rig.origin
    tangent = LocalTangent.at(origin)
    vehicles: list[MavlinkVehicle] = []
    for number, (role, port) in enumerate(zip(Role, ports, strict=False)):
        config = MavlinkVehicleConfig(number + 1, (HOST, port))
        vehicle = MavlinkVehicle(config, world.drone(role), tangent)
        stack.callback(vehicle.close)
        vehicles.append(vehicle)
    return vehicles


def main() -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rig = load_rig(sys.argv[1])
    seed = int(sys.argv[2])
    ports = [int(port) for port in sys.argv[3:]]
    world = World(decode_table(rig.world, WorldConfig, rig.where("world")), seed)
    with ExitStack() as stack, contextlib.suppress(KeyboardInterrupt):
        vehicles = vehicles_of(rig, world, ports, stack)
        sys.stdout.write("switched on; Ctrl-C switches off\n")
        sys.stdout.flush()
        run_alone(world, vehicles)


if __name__ == "__main__":
    main()
