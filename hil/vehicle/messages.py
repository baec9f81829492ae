"""The telemetry of the embedded vehicle as MAVLink messages, numbered and scaled as PX4 sends
them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.geodesy import LocalTangent
from hil.autopilot.autopilot import Autopilot, Estimate
from hil.world.rangefinder import SimRangefinder
from path.geometry.rotation import rpy_from_quat, yaw_of
from path.messages import Vec3
from path.values import frozen

# px4_custom_mode.h: main mode in bits 16-23, sub mode in bits 24-31. A pilot's mode shows as
# POSCTL.
AUTO = 4
OFFBOARD = 6
AUTO_MODES = {2: FlightMode.TAKEOFF, 3: FlightMode.HOLD, 5: FlightMode.RETURN, 6: FlightMode.LAND}
PILOT_MODES = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 5: "ACRO", 7: "STABILIZED"}
CUSTOM_MODES = {
    **{mode: AUTO << 16 | sub << 24 for sub, mode in AUTO_MODES.items()},
    FlightMode.OFFBOARD: OFFBOARD << 16,
    FlightMode.OTHER: 3 << 16,
}

AVAILABLE_MODES = mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES
STANDARD_MODES = {
    FlightMode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
    FlightMode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
    FlightMode.RETURN: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    FlightMode.OTHER: mavlink.MAV_STANDARD_MODE_POSITION_HOLD,
}
MODE_NAMES = {
    FlightMode.TAKEOFF: "Takeoff",
    FlightMode.HOLD: "Hold",
    FlightMode.RETURN: "Return",
    FlightMode.LAND: "Land",
    FlightMode.OFFBOARD: "Offboard",
    FlightMode.OTHER: "Position",
}
"""As PX4 calls them."""

_ALWAYS_HEALTHY = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
)
_WATCHED = (
    _ALWAYS_HEALTHY
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    | mavlink.MAV_SYS_STATUS_GEOFENCE
)
_LANDED_STATES = {
    FlightMode.TAKEOFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    FlightMode.LAND: mavlink.MAV_LANDED_STATE_LANDING,
}
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
)
# four lithium cells
FULL_MV = 16_800
EMPTY_MV = 13_200


@frozen
class FlightInstant:
    """One instant of a vehicle. ``local_origin_n_m``: where its own local frame began, which is not
    the mission's.
    """

    now_s: float
    autopilot: Autopilot
    estimate: Estimate
    tangent: LocalTangent
    local_origin_n_m: Vec3
    rangefinder: SimRangefinder | None = None

    @property
    def boot_ms(self) -> int:
        """The time of the estimate since the start, ms; it may be older than the message."""
        return int(self.estimate.time_s * 1e3) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        return int(self.estimate.time_s * 1e6)

    @property
    def local_n_m(self) -> Vec3:
        (n, e, d), (n0, e0, d0) = self.estimate.position_n_m, self.local_origin_n_m
        return n - n0, e - e0, d - d0


def heartbeat(flight: FlightInstant) -> Any:
    autopilot = flight.autopilot
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    if autopilot.armed:
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    status = mavlink.MAV_STATE_STANDBY if autopilot.landed else mavlink.MAV_STATE_ACTIVE
    if autopilot.killed:
        status = mavlink.MAV_STATE_FLIGHT_TERMINATION
    kind = mavlink.MAV_TYPE_QUADROTOR
    make = mavlink.MAV_AUTOPILOT_PX4
    return mavlink.MAVLink_heartbeat_message(
        kind, make, base, CUSTOM_MODES[autopilot.mode], status, 3
    )


def current_mode(flight: FlightInstant) -> Any:
    mode = flight.autopilot.mode
    custom_mode = CUSTOM_MODES[mode]
    standard = STANDARD_MODES.get(mode, mavlink.MAV_STANDARD_MODE_NON_STANDARD)
    return mavlink.MAVLink_current_mode_message(standard, custom_mode, custom_mode)


def available_modes(index: int) -> list[Any]:
    """Return what is told of the modes that a ground station may select: of one by its number from
    1 on, or of all by 0.
    """
    modes = list(CUSTOM_MODES.items())
    told = [
        mavlink.MAVLink_available_modes_message(
            len(modes),
            number,
            STANDARD_MODES.get(mode, mavlink.MAV_STANDARD_MODE_NON_STANDARD),
            custom_mode,
            0,
            MODE_NAMES[mode].encode(),
        )
        for number, (mode, custom_mode) in enumerate(modes, 1)
    ]
    return told if index == 0 else told[index - 1 : index]


def sys_status(flight: FlightInstant) -> Any:
    autopilot = flight.autopilot
    healthy = _ALWAYS_HEALTHY
    if autopilot.home_n_m is not None:
        healthy |= mavlink.MAV_SYS_STATUS_SENSOR_GPS
    if autopilot.armable or autopilot.armed:
        healthy |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
    if not autopilot.outside:
        healthy |= mavlink.MAV_SYS_STATUS_GEOFENCE
    there = _WATCHED
    if autopilot.radio_heard:
        there |= mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    healthy |= there & mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    millivolts = _voltage_mv(autopilot)
    percent = round(autopilot.battery * 100.0)
    return mavlink.MAVLink_sys_status_message(
        there, there, healthy, 200, millivolts, -1, percent, 0, 0, 0, 0, 0, 0
    )


def rc_channels(flight: FlightInstant) -> Any:
    """The newest that the receiver heard, however long ago; without signal strength once it is
    gone.
    """
    radio = flight.autopilot.radio
    values = [*radio.channels, *([0xFFFF] * (18 - len(radio.channels)))]
    strength = 254 if flight.autopilot.radio_heard else 0
    message: Any = mavlink.MAVLink_rc_channels_message
    return message(flight.boot_ms, len(radio.channels), *values, strength)


def gps_raw_int(flight: FlightInstant) -> Any:
    latitude, longitude, altitude_m = _global(flight)
    fixed = flight.autopilot.home_n_m is not None
    fix = mavlink.GPS_FIX_TYPE_3D_FIX if fixed else mavlink.GPS_FIX_TYPE_NO_FIX
    satellites = 12 if fixed else 3
    return mavlink.MAVLink_gps_raw_int_message(
        flight.boot_us,
        fix,
        latitude,
        longitude,
        round(altitude_m * 1e3),
        80,
        120,
        0,
        0xFFFF,
        satellites,
    )


def attitude(flight: FlightInstant) -> Any:
    rpy = rpy_from_quat(flight.estimate.q_n_b)
    return mavlink.MAVLink_attitude_message(flight.boot_ms, *rpy, 0.0, 0.0, 0.0)


def attitude_quaternion(flight: FlightInstant) -> Any:
    return mavlink.MAVLink_attitude_quaternion_message(
        flight.boot_ms, *flight.estimate.q_n_b, 0.0, 0.0, 0.0
    )


def local_position_ned(flight: FlightInstant) -> Any:
    position = flight.local_n_m
    velocity = flight.estimate.velocity_n_mps
    return mavlink.MAVLink_local_position_ned_message(flight.boot_ms, *position, *velocity)


def odometry(flight: FlightInstant) -> Any:
    """Place, attitude and velocity again, with the count of the estimator's resets."""
    unknown = [math.nan] * 21
    return mavlink.MAVLink_odometry_message(
        flight.boot_us,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_LOCAL_NED,
        *flight.local_n_m,
        flight.estimate.q_n_b,
        *flight.estimate.velocity_n_mps,
        0.0,
        0.0,
        0.0,
        unknown,
        unknown,
        flight.estimate.resets % 256,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    )


def global_position_int(flight: FlightInstant) -> Any | None:
    """Return the global position, only once there is one, like the real vehicle."""
    home = flight.autopilot.home_n_m
    if home is None:
        return None
    latitude, longitude, altitude_m = _global(flight)
    relative_m = home[2] - flight.estimate.position_n_m[2] + flight.autopilot.altitude_drift_m
    vx, vy, vz = (_int16(v * 1e2) for v in flight.estimate.velocity_n_mps)
    heading_cdeg = round(math.degrees(yaw_of(flight.estimate.q_n_b)) * 1e2) % 36_000
    return mavlink.MAVLink_global_position_int_message(
        flight.boot_ms,
        latitude,
        longitude,
        round(altitude_m * 1e3),
        round(relative_m * 1e3),
        vx,
        vy,
        vz,
        heading_cdeg,
    )


def vfr_hud(flight: FlightInstant) -> Any:
    """What a ground station shows as speed, heading, height above the sea and climb."""
    north_mps, east_mps, down_mps = flight.estimate.velocity_n_mps
    speed_mps = math.hypot(north_mps, east_mps)
    heading = round(math.degrees(yaw_of(flight.estimate.q_n_b))) % 360
    throttle = 50 if flight.autopilot.powered and not flight.autopilot.landed else 0
    return mavlink.MAVLink_vfr_hud_message(
        speed_mps, speed_mps, heading, throttle, _global(flight)[2], -down_mps
    )


def distance_sensor(flight: FlightInstant) -> Any | None:
    """Return what its rangefinder says, of one that has it; out of reach that is its limit, as
    many a sensor says.
    """
    own = flight.rangefinder
    if own is None:
        return None
    most_cm = round(1e2 * own.config.max_m)
    distance_cm = most_cm if own.below_m is None else round(1e2 * own.below_m)
    laser = mavlink.MAV_DISTANCE_SENSOR_LASER
    down = mavlink.MAV_SENSOR_ROTATION_PITCH_270
    covariance_cm2 = max(1, min(254, round((1e2 * own.config.sigma_m) ** 2)))
    return mavlink.MAVLink_distance_sensor_message(
        flight.boot_ms,
        round(1e2 * own.config.min_m),
        most_cm,
        distance_cm,
        laser,
        0,
        down,
        covariance_cm2,
    )


def battery_status(flight: FlightInstant) -> Any:
    cell_mv = _voltage_mv(flight.autopilot) // 4
    voltages = [cell_mv] * 4 + [0xFFFF] * 6
    percent = round(flight.autopilot.battery * 100.0)
    lithium = mavlink.MAV_BATTERY_TYPE_LIPO
    return mavlink.MAVLink_battery_status_message(
        0, 0, lithium, 0x7FFF, voltages, -1, -1, -1, percent
    )


def home_position(flight: FlightInstant) -> Any | None:
    home = flight.autopilot.home_n_m
    if home is None:
        return None
    latitude_deg, longitude_deg, altitude_m = flight.tangent.to_global(*home)
    (n, e, d), (n0, e0, d0) = home, flight.local_origin_n_m
    local = n - n0, e - e0, d - d0
    altitude_m += flight.autopilot.home_altitude_error_m
    place = round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1e3)
    return mavlink.MAVLink_home_position_message(
        *place, *local, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
    )


def extended_sys_state(flight: FlightInstant) -> Any:
    autopilot = flight.autopilot
    landed = _LANDED_STATES.get(autopilot.mode, mavlink.MAV_LANDED_STATE_IN_AIR)
    if autopilot.landed:
        landed = mavlink.MAV_LANDED_STATE_ON_GROUND
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)


def autopilot_version(_flight: FlightInstant) -> Any:
    version = 1 << 24 | 16 << 16 | 255  # 1.16.0, release
    none = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, version, 0, 0, 0, none, none, none, 0, 0, 0
    )


STREAMS: dict[int, tuple[Callable[[FlightInstant], Any | None], float]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: (heartbeat, 2.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: (sys_status, 2.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: (gps_raw_int, 1.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: (attitude, 10.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (attitude_quaternion, 30.0),
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (local_position_ned, 30.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (global_position_int, 10.0),
    mavlink.MAVLINK_MSG_ID_ODOMETRY: (odometry, 10.0),
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: (distance_sensor, 10.0),
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: (rc_channels, 5.0),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: (battery_status, 0.5),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: (home_position, 0.5),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (extended_sys_state, 5.0),
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: (autopilot_version, 0.0),
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE: (current_mode, 0.5),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: (vfr_hud, 4.0),
}
"""Message id: how it is made, and its rate in Hz until another is asked for (0: only on
request).
"""


def _voltage_mv(autopilot: Autopilot) -> int:
    return round(EMPTY_MV + (FULL_MV - EMPTY_MV) * autopilot.battery)


def _global(flight: FlightInstant) -> tuple[int, int, float]:
    """Latitude and longitude in 1e-7 degrees, altitude above mean sea level in metres."""
    latitude_deg, longitude_deg, altitude_m = flight.tangent.to_global(
        *flight.estimate.position_n_m
    )
    return (
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        altitude_m + flight.autopilot.altitude_error_m,
    )


def _int16(value: float) -> int:
    return max(-32_768, min(32_767, round(value)))
