"""The parts of the MAVSDK driver, without MAVSDK: modes, the local frame, telemetry, the callback
thread's clock.
"""

import asyncio
import json
import math
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import FlightMode, VehicleError
from drivers.mavlink.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, LocalTangent
from drivers.mavlink.modes import ARDUPILOT, PX4, AutopilotKind
from drivers.mavlink.telemetry import TelemetrySlots, ThreadClock
from tests.drivers.mavlink.mavsdk_bench import AHEAD_NS, SYSID, TANGENT, LoopClock, until


def test_modes_of_both_autopilots() -> None:
    assert PX4.mode(4 << 16 | 6 << 24) is FlightMode.LAND
    assert PX4.mode(3 << 16) is FlightMode.OTHER
    assert ARDUPILOT.mode(4) is FlightMode.OFFBOARD
    assert ARDUPILOT.mode(5) is FlightMode.OTHER  # LOITER needs a pilot's sticks
    assert PX4.set_mode == {FlightMode.HOLD: (4, 3), FlightMode.OFFBOARD: (6, 0)}
    assert ARDUPILOT.set_mode == {FlightMode.HOLD: (17, 0), FlightMode.OFFBOARD: (4, 0)}
    names = ("TAKEOFF", "HOLD", "RETURN", "LAND", "OFFBOARD")
    customs = ((4, 2), (4, 3), (4, 5), (4, 6), (6, 0))
    assert PX4.modes == {
        main << 16 | sub << 24: FlightMode[name]
        for name, (main, sub) in zip(names, customs, strict=True)
    }
    copter = {4: "OFFBOARD", 6: "RETURN", 9: "LAND", 17: "HOLD"}
    assert ARDUPILOT.modes == {custom: FlightMode[name] for custom, name in copter.items()}
    assert (PX4.mav_autopilot, ARDUPILOT.mav_autopilot, PX4.unset, ARDUPILOT.unset) == (
        12,
        3,
        None,
        0.0,
    )


def ecef(
    latitude_deg: float, longitude_deg: float, height_m: float
) -> np.ndarray[Any, np.dtype[np.float64]]:
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    normal = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    return np.array(
        [
            (normal + height_m) * math.cos(latitude) * math.cos(longitude),
            (normal + height_m) * math.cos(latitude) * math.sin(longitude),
            (normal * (1.0 - ECCENTRICITY_SQUARED) + height_m) * math.sin(latitude),
        ]
    )


@pytest.mark.parametrize(
    ("latitude", "longitude", "altitude"), [(47.4, 8.5, 480.0), (-33.9, 179.9999, 20.0)]
)
@pytest.mark.parametrize("at", [(100.0, 0.0, 0.0), (0.0, 100.0, -30.0), (-60.0, 80.0, -5.0)])
def test_local_frame_agrees_with_earth_centred_coordinates(
    latitude: float, longitude: float, altitude: float, at: tuple[float, float, float]
) -> None:
    tangent = LocalTangent(latitude, longitude, altitude)
    place = tangent.to_global(*at)
    assert tangent.to_ned(*place) == pytest.approx(at, abs=1e-6)
    f, g = math.radians(latitude), math.radians(longitude)
    north = np.array([-math.sin(f) * math.cos(g), -math.sin(f) * math.sin(g), math.cos(f)])
    east = np.array([-math.sin(g), math.cos(g), 0.0])
    down = -np.array([math.cos(f) * math.cos(g), math.cos(f) * math.sin(g), math.sin(f)])
    away = ecef(*place) - ecef(latitude, longitude, altitude)
    assert (away @ north, away @ east, away @ down) == pytest.approx(at, abs=3e-3)


def test_an_exception_in_a_callback_comes_out_at_the_next_look() -> None:
    async def look() -> None:
        telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT)
        # MAVSDK itself would print it and go on
        telemetry._guarded(telemetry._on_battery)(object(), None)
        with pytest.raises(VehicleError, match=r"telemetry cannot be understood.*system_id"):
            telemetry.state()

    asyncio.run(look())


def test_heartbeats_of_others_are_not_the_vehicles() -> None:
    telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT)

    class Message:
        system_id, component_id, fields_json = (
            SYSID,
            191,
            '{"autopilot":8,"base_mode":0,"custom_mode":0}',
        )

    telemetry._guarded(telemetry._on_heartbeat)(Message(), None)
    telemetry._guarded(telemetry._on_current_mode)(Message(), None)
    # a companion computer on the vehicle's own system id
    assert (telemetry.heartbeat, telemetry.reported_mode) == (None, None)


def test_the_autopilots_count_of_its_resets_is_in_the_state_and_nobody_elses() -> None:
    telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT)

    class Message:
        system_id, component_id, fields_json = (
            SYSID,
            1,
            '{"x":1.0,"q":[1.0,0.0,0.0,0.0],"reset_counter":7}',
        )

    class Other(Message):
        component_id = 197  # of visual odometry on the same vehicle
        fields_json = '{"reset_counter":200}'

    assert telemetry.resets is None
    telemetry._guarded(telemetry._on_odometry)(Message(), None)
    telemetry._guarded(telemetry._on_odometry)(Other(), None)
    assert telemetry.resets == 7


def test_a_mode_is_news_without_a_heartbeat() -> None:
    telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT)
    telemetry.kind = PX4

    class Message:
        system_id, component_id = SYSID, 1

        def __init__(self, fields: str) -> None:
            self.fields_json = fields

    def mode() -> FlightMode:
        return telemetry.mode

    telemetry._on_heartbeat(Message('{"autopilot":12,"base_mode":129,"custom_mode":393216}'))
    assert mode() is FlightMode.OFFBOARD
    beat = telemetry.heartbeat
    telemetry._on_current_mode(
        Message('{"standard_mode":0,"custom_mode":196608,"intended_custom_mode":196608}')
    )
    assert mode() is FlightMode.OTHER  # POSCTL: a pilot's
    assert telemetry.heartbeat is beat  # whose age tells of a lost link
    offboard = Message('{"standard_mode":0,"custom_mode":393216,"intended_custom_mode":393216}')
    telemetry._on_current_mode(offboard)
    # one packet's word against another's
    assert (mode(), telemetry.mode_told) == (FlightMode.OFFBOARD, 1)
    for _ in range(2):
        telemetry._on_current_mode(
            Message('{"standard_mode":0,"custom_mode":196608,"intended_custom_mode":196608}')
        )
    telemetry._on_current_mode(offboard)
    # a PX4 that has landed goes back to OFFBOARD before it tells that it is disarmed
    assert mode() is FlightMode.OTHER


@pytest.mark.parametrize(("kind", "shown_m"), [(PX4, 2.0), (ARDUPILOT, 3.2)])
def test_a_px4_s_height_does_not_step_with_its_altitude(
    kind: AutopilotKind, shown_m: float
) -> None:
    """As seen when PX4 goes over to another of its estimators: 1.2 m more above sea level, and
    above home.
    """
    telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT, height_from_home=True)
    telemetry.kind = kind
    latitude, longitude, _ = TANGENT.to_global(0.0, 0.0, 0.0)
    ned = SimpleNamespace(
        position=SimpleNamespace(north_m=0.0, east_m=0.0, down_m=-1.7),
        velocity=SimpleNamespace(north_m_s=0.0, east_m_s=0.0, down_m_s=0.0),
    )

    def beat(base_mode: int) -> None:
        fields = json.dumps(
            {"autopilot": kind.mav_autopilot, "base_mode": base_mode, "custom_mode": 0}
        )
        telemetry._on_heartbeat(
            SimpleNamespace(system_id=SYSID, component_id=1, fields_json=fields)
        )

    beat(1)
    # before it is armed it stands on the ground, whatever it takes that for
    for down_m in (0.9, 0.3):
        ned.position.down_m = down_m
        telemetry._on_velocity(ned)
    beat(1 | 128)
    ned.position.down_m = -1.7
    telemetry._on_velocity(ned)
    for above_m in (2.0, 3.2):
        telemetry._on_position(
            SimpleNamespace(
                latitude_deg=latitude,
                longitude_deg=longitude,
                absolute_altitude_m=488.0,
                relative_altitude_m=above_m,
            )
        )
    assert telemetry.position is not None
    assert telemetry.position.above_home_m == pytest.approx(shown_m)
    assert telemetry.position.n_m[2] == pytest.approx(-shown_m)


@pytest.mark.parametrize("said", [{}, {"without_gps": True}])
def test_a_vehicle_is_asked_for_the_gps_s_health_unless_it_is_said_to_have_none(
    said: dict[str, bool],
) -> None:
    telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT, **said)
    telemetry.health = dict.fromkeys(
        ("is_armable", "is_local_position_ok", "is_home_position_ok"), True
    )
    assert ("global position" in telemetry.missing()) is not bool(said)
    # it is to know where on earth it is all the same
    assert "position telemetry" in telemetry.missing()


def test_the_callback_threads_clock_follows_the_roles() -> None:
    class Stepping:
        ahead_ns = AHEAD_NS

        def now_ns(self) -> int:
            return time.monotonic_ns() + self.ahead_ns

    role = Stepping()
    clock = ThreadClock(role)

    def together() -> bool:
        clock.follow()
        return abs(role.now_ns() - clock.now_ns()) < 1_000_000

    asyncio.run(until(together))
    role.ahead_ns += 50_000_000
    asyncio.run(until(together))
