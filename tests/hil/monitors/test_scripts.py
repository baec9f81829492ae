"""S7 and S10 from scripted truth: silent while somebody looks and the script obeys, and not when it
does not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivers.interfaces import FlightMode
from flight.config import GuardConfig, MissionConfig
from hil.monitors.monitors import Monitors
from hil.monitors.scripts import NOTICED_S, ScriptMonitor, VehicleTruth, vehicles_of
from hil.world.config import WorldConfig
from hil.world.world import World
from missions.ground import rig_library
from path.config import MethodConfig
from path.messages import Role

D1, D2 = Role.SENDER, Role.RECEIVER
FLYING = VehicleTruth(
    FlightMode.OFFBOARD, True, False, False, 0.9, 0.1, 0.0, (1.0, 0.0, -1.5), True
)


@pytest.fixture
def monitors() -> Monitors:
    return Monitors.of_pair(MethodConfig())


@pytest.fixture
def scripts(monitors: Monitors) -> ScriptMonitor:
    monitors.scripts.on_phase(D1, 0.0, "verify")
    monitors.scripts.on_phase(D2, 0.0, "verify")
    return monitors.scripts


def fly(
    scripts: ScriptMonitor,
    first_s: float,
    last_s: float,
    looks: tuple[Role, ...] = (D1, D2),
    **own: Any,
) -> None:
    """Truth 5 times a second: the sender as told, the receiver as it should be."""
    for step in range(round(first_s * 5), round(last_s * 5)):
        now_s = step / 5
        for role in looks:
            scripts.on_frame(role, now_s)
        told = {"setpoint_s": now_s, **own}
        scripts.on_truth(
            now_s, {D1: replace(FLYING, **told), D2: replace(FLYING, setpoint_s=now_s)}
        )


def test_a_good_run_violates_nothing(monitors: Monitors, scripts: ScriptMonitor) -> None:
    fly(scripts, 0.0, 5.0)
    scripts.on_phase(D1, 5.0, "depart")
    fly(scripts, 5.0, 9.0, looks=(D2,))
    scripts.on_phase(D2, 9.0, "land")
    fly(scripts, 9.0, 15.0, looks=())
    assert not monitors.violations


def test_s7_one_that_looks_is_enough_and_none_is_not(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    fly(scripts, 0.0, 3.0, looks=(D2,))
    assert not monitors.violations
    fly(scripts, 3.0, 5.0, looks=())
    assert dict(monitors.violations) == {"S7": 1}


def test_s7_what_no_camera_sees_nobody_need_look_at(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    scripts.on_death(D2)
    fly(scripts, 0.0, 5.0, looks=(), sees_target=False)
    assert not monitors.violations


@pytest.mark.parametrize(
    "ruled",
    [{"battery": 0.15}, {"position_n_m": (26.0, 0.0, -1.5)}, {"position_n_m": (1.0, 0.0, -7.0)}],
)
def test_s10_a_mission_that_goes_on_against_its_limit(
    monitors: Monitors, scripts: ScriptMonitor, ruled: dict[str, Any]
) -> None:
    fly(scripts, 0.0, NOTICED_S, **ruled)
    assert not monitors.violations  # it may take as long to notice
    fly(scripts, NOTICED_S, 4.0, **ruled)
    assert dict(monitors.violations) == {"S10": 1}


def test_s10_a_mission_that_ends_at_its_limit_obeys(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    fly(scripts, 0.0, 1.0, battery=0.15)
    scripts.on_phase(D1, 1.0, "land")
    fly(scripts, 1.0, 5.0, battery=0.15, mode=FlightMode.LAND)
    assert not monitors.violations


def test_s10_setpoints_to_a_pilots_vehicle(monitors: Monitors, scripts: ScriptMonitor) -> None:
    fly(scripts, 0.0, 1.2, pilot=True, mode=FlightMode.OTHER)
    fly(scripts, 1.2, 5.0, pilot=True, mode=FlightMode.OTHER, setpoint_s=1.0)
    assert not monitors.violations
    fly(scripts, 5.0, 6.0, pilot=True, mode=FlightMode.OTHER)
    assert dict(monitors.violations) == {"S10": 1}


def test_s10_the_mode_changed_under_a_pilot(monitors: Monitors, scripts: ScriptMonitor) -> None:
    fly(scripts, 0.0, 3.0, pilot=True, mode=FlightMode.OTHER, setpoint_s=0.0)
    fly(scripts, 3.0, 4.0, pilot=True, mode=FlightMode.LAND, setpoint_s=0.0)
    assert dict(monitors.violations) == {"S10": 1}
    assert "from its pilot: land" in monitors.details[0]


def test_s10_a_pilots_vehicle_that_its_autopilot_holds_for_want_of_a_radio_was_not_taken(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    theirs: dict[str, Any] = {"pilot": True, "setpoint_s": 0.0}
    fly(scripts, 0.0, 3.0, mode=FlightMode.OTHER, **theirs)
    fly(scripts, 3.0, 8.0, mode=FlightMode.HOLD, failsafe="radio lost", **theirs)
    fly(scripts, 8.0, 9.0, mode=FlightMode.LAND, failsafe="radio lost", **theirs)
    assert not monitors.violations
    fly(scripts, 9.0, 10.0, mode=FlightMode.HOLD, **theirs)
    assert dict(monitors.violations) == {"S10": 1}


def test_s10_a_pilot_may_change_the_mode_once_more(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    fly(
        scripts,
        0.0,
        3.0,
        pilot=True,
        mode=FlightMode.OTHER,
        setpoint_s=0.0,
        pilots_mode=FlightMode.OTHER,
    )
    fly(
        scripts,
        3.0,
        4.0,
        pilot=True,
        mode=FlightMode.LAND,
        setpoint_s=0.0,
        pilots_mode=FlightMode.LAND,
    )
    assert not monitors.violations
    fly(
        scripts,
        4.0,
        5.0,
        pilot=True,
        mode=FlightMode.HOLD,
        setpoint_s=0.0,
        pilots_mode=FlightMode.LAND,
    )
    assert "from its pilot: hold" in monitors.details[0]


def test_s10_a_script_that_flies_on_with_its_motors_stopped(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    fly(scripts, 0.0, 3.0, killed=True, armed=False, setpoint_s=1.0)
    assert not monitors.violations
    fly(scripts, 3.0, 4.0, killed=True, armed=False)
    assert dict(monitors.violations) == {"S10": 1}


def test_s10_a_script_that_arms_a_vehicle_whose_motors_were_stopped(
    monitors: Monitors, scripts: ScriptMonitor
) -> None:
    fly(scripts, 0.0, 3.0, killed=True, armed=True, setpoint_s=0.0)
    assert dict(monitors.violations) == {"S10": 1}


def test_the_truth_about_both_vehicles_before_take_off() -> None:
    rig = rig_library.load("sim")
    vehicles = vehicles_of(World(WorldConfig(), 0), {role: rig.role(role) for role in Role})
    assert {vehicle.armed for vehicle in vehicles.values()} == {False}
    assert all(abs(vehicle.position_n_m[2]) < 0.5 for vehicle in vehicles.values())


def test_s11_a_body_that_touches_a_wall_counts_once_and_one_beside_it_does_not() -> None:
    hall = GuardConfig(corners_m=((-2.0, -2.0), (-2.0, 2.0), (2.0, 2.0), (2.0, -2.0)))
    monitors = Monitors.of_pair(MethodConfig(), MissionConfig(guard=hall))
    monitors.scripts.on_phase(D1, 0.0, "verify")
    monitors.scripts.on_phase(D2, 0.0, "verify")
    fly(monitors.scripts, 0.0, 1.0, position_n_m=(1.8, 0.0, -1.5))
    assert not monitors.violations
    fly(monitors.scripts, 1.0, 2.0, position_n_m=(1.9, 0.0, -1.5))
    fly(monitors.scripts, 2.0, 2.6, position_n_m=(2.1, 0.0, -1.5))
    assert dict(monitors.violations) == {"S11": 1}
