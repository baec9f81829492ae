"""The options of a MAVSDK vehicle in a rig."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from drivers.mavlink.battery import LOWEST_ID
from drivers.mavlink.preflight.wanted import refused
from drivers.mavlink.transport.port import URL
from drivers.rig.parts import PartSpec
from path.bounds import AutopilotValues, Bounds, check_bounds
from path.messages import Vec3
from path.values import frozen


@frozen
class VisionConfig:
    """
    Attributes:
        beacons: who listens, a ``drivers.interfaces.Beacons``.
        address: of the beacon on this drone; ``lever_b_m`` is where it sits in the body (FRD).
        x_heading_deg: where the x axis of the beacons' frame points, clockwise from north.
        zero_n_m: where its zero is, NED from the mission's origin.
        sigma_m: per axis, told to the autopilot.
        least_quality: positions that the system rates below this are not passed on.
    """

    beacons: PartSpec
    address: Annotated[int, Bounds(0, 255, "(an address)")]
    lever_b_m: Annotated[Vec3, Bounds(-3.0, 3.0)] = (0.0, 0.0, 0.0)
    x_heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    zero_n_m: Annotated[Vec3, Bounds(-10000.0, 10000.0)] = (0.0, 0.0, 0.0)
    sigma_m: Annotated[float, Bounds(0.0, 10.0, above=True)] = 0.05
    least_quality: Annotated[float, Bounds(0.0, 100.0, "of 100")] = 50.0


@frozen
class MavsdkVehicleConfig:
    """Options of the vehicle in a rig.

    Attributes:
        url: MAVSDK connection, ``udpin://127.0.0.1:14541``, ``serial:///dev/ttyACM0:921600``, ...
        sysid: the vehicle's MAVLink system id.
        autopilot: refused when the vehicle is another.
        own_sysid: ours. ArduPilot's ground-station failsafe (MAV_GCS_SYSID) watches it.
        telemetry_hz: position, velocity and attitude; three streams of 50 Hz need 9 kB/s.
        heartbeat_hz: asked for, so that mode and arming are not a second late, and a second one
            comes before the pilot's control ends by the word of one; 0 leaves it alone.
        connect_timeout_s: for the first heartbeat, and for the first attitude after it.
        command_timeout_s: for one acknowledgement.
        mode_timeout_s: from an accepted command until telemetry shows it.
        heartbeat_timeout_s: any wait ends with an error when the newest heartbeat is older.
        take_off_tolerance_m: height error at which a take-off is over.
        vision: a beacon's positions for an autopilot without GPS.
        height_from: ``sea_level``: the altitude it says against the origin's. ``home``: what it
            says to be above its home, which must then lie at the origin's altitude. Two GPS differ
            by metres in altitude, two barometers that started on the same ground by decimetres.
        key_file: of MAVLink 2's signatures, 32 bytes, mode 0600, the one that the autopilot was
            given (SETUP_SIGNING); then only what is rightly signed is believed, and all that is
            sent is signed.
        parameters: of the autopilot, without which a companion-driven flight is not safe; checked
            before arming. What they are wanted to be is judged first (``preflight/wanted.py``).
        rc: ``required``: nothing is armed unless a pilot's radio is heard and can take the vehicle.
            ``none``: there is none, and nobody can take it but by a ground station.
        battery_id: of the battery that flies it, as its BATTERY_STATUS says; -1: the lowest of
            those that do not say that they serve a payload or avionics.
        ground_within_m: of the origin's altitude, as far as the vehicle says with ``sea_level``
            while it stands there.
    """

    url: str
    sysid: Annotated[int, Bounds(1, 255, "(an id)")] = 1
    autopilot: Literal["auto", "px4", "ardupilot"] = "auto"
    own_sysid: Annotated[int, Bounds(1, 255, "(an id)")] = 245
    # MAV_COMP_ID_MISSIONPLANNER: a ground station, as the failsafes expect
    own_compid: Annotated[int, Bounds(1, 255, "(an id)")] = 190
    telemetry_hz: Annotated[float, Bounds(1.0, 400.0)] = 50.0
    heartbeat_hz: Annotated[float, Bounds(0.0, 50.0)] = 10.0
    connect_timeout_s: Annotated[float, Bounds(0.1, 300.0)] = 10.0
    command_timeout_s: Annotated[float, Bounds(0.05, 30.0)] = 1.0
    mode_timeout_s: Annotated[float, Bounds(0.05, 60.0)] = 3.0
    heartbeat_timeout_s: Annotated[float, Bounds(0.2, 30.0)] = 1.5
    take_off_tolerance_m: Annotated[float, Bounds(0.01, 5.0)] = 0.3
    offboard_lead_s: Annotated[float, Bounds(0.0, 5.0)] = 0.3
    vision: VisionConfig | None = None
    height_from: Literal["sea_level", "home"] = "sea_level"
    key_file: Path | None = None
    parameters: AutopilotValues = field(default_factory=dict[str, float])
    rc: Literal["required", "none"] = "required"
    battery_id: Annotated[int, Bounds(-1, 255, "(an id; -1: the lowest)")] = LOWEST_ID
    ground_within_m: Annotated[float, Bounds(0.1, 100.0)] = 3.0

    def __post_init__(self) -> None:
        bad = refused(self.parameters, radio=self.rc == "required", companion_id=self.own_sysid)
        if bad:
            raise ValueError(f"parameters: {'; '.join(bad)}")
        check_bounds(self)
        if self.sysid == self.own_sysid:
            raise ValueError("sysid and own_sysid must differ")
        if self.key_file is not None and URL.fullmatch(self.url) is None:
            raise ValueError(
                "key_file: what is signed goes over udpin://HOST:PORT, udpout://HOST:PORT, serial://DEVICE:BAUD"
            )
