"""The emulated drones of a ``sitl`` world behind a rig whose drones are Tellos."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.rig.parts import PartSpec, Rig, decode_part
from drivers.tello.camera import TelloCameraConfig
from drivers.tello.config import TelloVehicleConfig
from hil.tello.emulator import TelloEmulator, TelloEmulatorConfig
from hil.tello.video import TelloVideo, TelloVideoConfig
from hil.world.config import WorldConfig
from hil.world.world import SimDrone
from path.messages import Role


def is_tello(spec: PartSpec) -> bool:
    """Return whether a vehicle's spec names the Tello's driver."""
    return spec.factory == "drivers.tello.vehicle:TelloVehicle"


def tello_of(
    rig: Rig,
    role: Role,
    drone: SimDrone,
    world: WorldConfig,
    seed: int,
    arrived: Callable[[float], float],
) -> tuple[TelloEmulator, TelloVideo]:
    """The emulated drone that a role's driver looks for, and the camera in it. Raises RigError.

    ``arrived``: the world's time of an instant of the monotonic clock.
    """
    own = rig.role(role)
    vehicle: TelloVehicleConfig = decode_part(own.vehicle)[1]
    camera: TelloCameraConfig = decode_part(
        PartSpec.from_table(
            own.perception.options["camera"],
            f"{own.perception.where}.camera",
            own.perception.base,
        )
    )[1]
    video = TelloVideo(
        TelloVideoConfig(own.camera.width, own.camera.height, float(camera.rate_hz)), seed
    )
    config = TelloEmulatorConfig(
        host=vehicle.host,
        command_port=vehicle.command_port,
        full_stick_mps=vehicle.full_stick_mps,
        full_stick_dps=vehicle.full_stick_dps,
        home_yaw_rad=math.radians(world.home(role).heading_deg),
    )
    return TelloEmulator(config, drone, video, arrived), video
