"""Options of a Tello's vehicle in a rig."""

from __future__ import annotations

from typing import Annotated

from drivers.tello.address import TelloAddress
from drivers.tello.state import VelocityFrame
from path.bounds import Bounds, check_bounds
from path.values import frozen


@frozen
class TelloVehicleConfig(TelloAddress):
    """Options of the vehicle in a rig, besides the drone's address.

    Attributes:
        north_m, east_m, heading_deg: where the drone stands when it is connected, and which way it
            looks, clockwise from north: it knows no position of its own, everything is reckoned
            from here.
        placement_sigma_m: how well it was put there.
        velocity_sigma_mps: constant error of the velocity that it reports: the position's error
            grows with it.
        velocity_frame: axes of vgx and vgy: those in which it was switched on, or its present ones.
        full_stick_mps, full_stick_dps: what 100 of ``rc`` makes of it; measure it once
            (docs/tello.md).
        max_yaw_dps: of heading commands.
        take_off_tolerance_m: height error at which a take-off is over.
        min_battery: below, it is not armable.
        answer_s: for one answer to a command that moves nothing.
    """

    north_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 0.0
    east_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 0.0
    heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    placement_sigma_m: Annotated[float, Bounds(0.0, 5.0)] = 0.05
    velocity_sigma_mps: Annotated[float, Bounds(0.0, 5.0)] = 0.03
    velocity_frame: VelocityFrame = "start"
    full_stick_mps: Annotated[float, Bounds(0.05, 20.0)] = 1.0
    full_stick_dps: Annotated[float, Bounds(1.0, 720.0)] = 100.0
    max_yaw_dps: Annotated[float, Bounds(1.0, 360.0)] = 40.0
    take_off_tolerance_m: Annotated[float, Bounds(0.01, 5.0)] = 0.15
    min_battery: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.2
    answer_s: Annotated[float, Bounds(0.05, 60.0)] = 3.0

    def __post_init__(self) -> None:
        TelloAddress.__post_init__(self)
        check_bounds(self)
