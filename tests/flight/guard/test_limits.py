"""Each limit ends the mission under its own name, on either side of the limit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from drivers.interfaces import FlightMode, VehicleState
from drivers.mavlink.guard.interfaces import GuardView, Script
from flight.config import GuardConfig
from flight.fence import Fence
from flight.guard.limits import check_separation, check_vehicle, in_doubt
from flight.guard.rules import GuardRules, Limits, ProgramBeat, broken_limit
from flight.outcome import MissionEnd, Outcome

NOW_NS = 100_000_000_000
LIMITS = GuardConfig(
    fence_radius_m=10.0,
    fence_height_m=5.0,
    min_battery=0.2,
    telemetry_age_s=0.5,
    heartbeat_age_s=2.0,
)
GOOD = VehicleState(
    NOW_NS,
    NOW_NS,
    (1.0, 2.0, -1.5),
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    True,
    True,
    True,
    FlightMode.OFFBOARD,
    0.9,
)


def check(**changes: Any) -> None:
    check_vehicle(replace(GOOD, **changes), NOW_NS, LIMITS, FlightMode.OFFBOARD)


def ago(seconds: float) -> int:
    return NOW_NS - round(seconds * 1e9)


@pytest.mark.parametrize(
    ("outcome", "changes", "seen"),
    [
        (Outcome.VEHICLE_LOST, {"stamp_ns": ago(0.6)}, "no telemetry for 0.6 s"),
        (Outcome.VEHICLE_LOST, {"heartbeat_ns": ago(2.1)}, "no heartbeat for 2.1 s"),
        (
            Outcome.PILOT_OVERRIDE,
            {"mode": FlightMode.OTHER},
            "mode is other, the script flew offboard",
        ),
        (Outcome.PILOT_OVERRIDE, {"mode": FlightMode.HOLD}, "mode is hold"),
        (Outcome.PILOT_OVERRIDE, {"armed": False}, "the motors were stopped"),
        (Outcome.GUARD, {"position_n_m": (10.1, 0.0, -1.0)}, "fence"),
        (Outcome.GUARD, {"position_n_m": (-7.2, -7.2, -1.0)}, "fence"),
        (Outcome.GUARD, {"position_n_m": (0.0, 0.0, -5.1)}, "height 5.1 m"),
        (Outcome.GUARD, {"battery": 0.19}, "battery at 19 %"),
        (Outcome.GUARD, {"position_n_m": (math.nan, 0.0, -1.0)}, "fence"),
        (Outcome.GUARD, {"position_n_m": (0.0, 0.0, math.nan)}, "fence"),
        (Outcome.GUARD, {"battery": math.nan}, "battery of an unknown level"),
        (
            Outcome.GUARD,
            {"battery": 0.9, "battery_ns": ago(10.1)},
            "battery at 90 % when it was told last, 10 s ago",
        ),
        (
            Outcome.GUARD,
            {"battery": math.nan, "battery_ns": ago(10.1)},
            "of a level that was never told, 10 s ago",
        ),
        (Outcome.GUARD, {"battery": 0.19, "battery_ns": ago(9.0)}, "battery at 19 %"),
    ],
)
def test_each_limit_ends_the_mission_by_its_name(
    outcome: Outcome, changes: dict[str, Any], seen: str
) -> None:
    with pytest.raises(MissionEnd) as caught:
        check(**changes)
    assert caught.value.outcome is outcome
    assert seen in caught.value.detail


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"stamp_ns": ago(0.5), "heartbeat_ns": ago(2.0)},
        {"position_n_m": (7.0, -7.0, -4.9)},
        {"position_n_m": (0.0, 0.0, 0.2)},  # the estimate may be below the ground
        {"battery": 0.2},
        {"battery": 0.9, "battery_ns": ago(9.9)},  # the last level that was told counts for a while
        {"battery": math.nan, "battery_ns": ago(0.3)},
    ],
)
def test_at_the_limits_the_mission_goes_on(changes: dict[str, Any]) -> None:
    check(**changes)


def test_a_lost_vehicle_is_no_pilot() -> None:
    """The mode of a vehicle that fell silent is as old as the rest of its telemetry."""
    with pytest.raises(MissionEnd) as caught:
        check(stamp_ns=ago(3.0), mode=FlightMode.OTHER)
    assert caught.value.outcome is Outcome.VEHICLE_LOST


@pytest.mark.parametrize("distance_m", [0.69, 0.0, math.nan])
def test_too_near_has_a_name_of_its_own(distance_m: float) -> None:
    with pytest.raises(MissionEnd) as caught:
        check_separation(distance_m, 0.70)
    assert caught.value.outcome is Outcome.TOO_CLOSE
    assert "below 0.70 m" in caught.value.detail


def test_far_enough_is_not() -> None:
    check_separation(0.70, 0.70)


@pytest.mark.parametrize("level", [0.9, 0.2, 0.19, 0.0, math.nan])
@pytest.mark.parametrize("silent_s", [None, 0.0, 0.3, 9.9, 10.1, 60.0])
def test_script_and_guard_judge_a_battery_alike(level: float, silent_s: float | None) -> None:
    told_ns = None if silent_s is None else ago(silent_s)
    view = GuardView(
        NOW_NS,
        NOW_NS,
        True,
        True,
        FlightMode.OFFBOARD,
        GOOD.position_n_m,
        level,
        None,
        battery_ns=told_ns,
    )
    of_guard = broken_limit(
        view,
        ProgramBeat(NOW_NS, Script.CONTROL, NOW_NS),
        NOW_NS,
        GuardRules(),
        Limits(Fence(10.0, 5.0), 0.2, 0.7),
    )
    try:
        check(battery=level, battery_ns=told_ns)
    except MissionEnd as end:
        assert end.detail == of_guard
    else:
        assert of_guard == ""


@pytest.mark.parametrize(
    ("changes", "doubt"),
    [
        ({}, False),
        ({"mode_told": 1}, False),  # of the mode that the script flies one message is enough
        ({"mode": FlightMode.OTHER, "mode_told": 1}, True),
        ({"mode": FlightMode.OTHER, "mode_told": 2}, False),
        ({"armed": False, "armed_told": 1}, True),
        ({"armed": False, "armed_told": 2}, False),
        ({"armed": False, "armed_told": 2, "mode": FlightMode.OTHER, "mode_told": 1}, False),
        ({"armed_told": 1}, False),
    ],
)
def test_in_doubt_is_what_one_message_alone_says_against_the_script(
    changes: dict[str, Any], doubt: bool
) -> None:
    assert in_doubt(replace(GOOD, **changes), FlightMode.OFFBOARD) is doubt
