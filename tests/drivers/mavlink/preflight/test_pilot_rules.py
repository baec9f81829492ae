"""The values that would keep a pilot out, and the autopilot's own fence: by tables, without a
vehicle.
"""

from __future__ import annotations

import math

import pytest

from drivers.mavlink.modes import ARDUPILOT, PX4, AutopilotKind
from drivers.mavlink.preflight.geofence import Geofence, plan_fence
from drivers.mavlink.preflight.pilot_rules import kept_out, names_of
from drivers.mavlink.preflight.wanted import refused
from drivers.mavlink.vehicle import MavsdkVehicleConfig
from missions.ground import rig_library
from path.messages import Role
from tests.every_rig import every_name

FENCE = Geofence(25.0, 6.0)
PX4_OFF = {"GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0, "GF_ACTION": 2.0}
COPTER = {
    "FENCE_RADIUS": 300.0,
    "FENCE_ALT_MAX": 100.0,
    "FENCE_ACTION": 1.0,
    "FENCE_TYPE": 7.0,
    "FENCE_ENABLE": 0.0,
}
PX4_GOOD = {"COM_RC_IN_MODE": 0.0, "RC_MAP_FLTMODE": 5.0, "RC_MAP_KILL_SW": 7.0}
COPTER_GOOD = {
    **dict.fromkeys(names_of(ARDUPILOT), 0.0), "FLTMODE_CH": 5.0, "FS_THR_ENABLE": 3.0, "RC_OPTIONS": 32.0,
    "RC7_OPTION": 31.0,
}  # fmt: skip


@pytest.mark.parametrize("value", [1, 2, 3, 4, 6, 8])
def test_a_rig_that_would_keep_the_radio_out_is_refused_with_the_reason(value: int) -> None:
    assert refused({"COM_RC_IN_MODE": value}, radio=False, companion_id=245)
    with pytest.raises(ValueError, match=f"COM_RC_IN_MODE = {value}: 1 and 4 ignore every radio"):
        MavsdkVehicleConfig("udpin://127.0.0.1:14540", parameters={"COM_RC_IN_MODE": float(value)})


@pytest.mark.parametrize("value", [0, 5, 7])
def test_a_radio_that_comes_first_is_taken(value: int) -> None:
    assert refused({"COM_RC_IN_MODE": value}, radio=True, companion_id=245) == []


def test_other_ways_to_keep_a_pilot_out() -> None:
    for name, bad, good in (("RC_OPTIONS", 33.0, 32.0), ("FENCE_OPTIONS", 1.0, 2.0)):
        assert refused({name: bad}, radio=False, companion_id=245)
        assert not refused({name: good}, radio=True, companion_id=245)


@pytest.mark.parametrize(
    ("kind", "good", "changed", "why"),
    [
        (PX4, PX4_GOOD, {"COM_RC_IN_MODE": 4.0}, "ignore every radio"),
        (PX4, PX4_GOOD, {"COM_RC_IN_MODE": None}, "COM_RC_IN_MODE cannot be read"),
        (PX4, PX4_GOOD, {"RC_MAP_KILL_SW": 0.0}, "kill switch"),
        (PX4, PX4_GOOD, {"RC_MAP_FLTMODE": 0.0}, "mode switch"),
        (ARDUPILOT, COPTER_GOOD, {"FS_THR_ENABLE": 0.0}, "would not be noticed"),
        (ARDUPILOT, COPTER_GOOD, {"RC7_OPTION": 0.0}, "Motor Emergency Stop"),
        (ARDUPILOT, COPTER_GOOD, {"FENCE_OPTIONS": 1.0}, "after a breach"),
    ],
)
def test_what_keeps_a_pilot_out_of_a_vehicle(
    kind: AutopilotKind, good: dict[str, float | None], changed: dict[str, float | None], why: str
) -> None:
    assert kept_out(kind, good) == []
    (told,) = kept_out(kind, {**good, **changed})
    assert why in told


@pytest.mark.parametrize("channel", range(5, 17))
def test_any_channel_may_be_the_switch_that_stops_the_motors(channel: int) -> None:
    first = {**COPTER_GOOD, "RC7_OPTION": 0.0, "FLTMODE_CH": 1.0, "FS_THR_ENABLE": 1.0}
    assert kept_out(ARDUPILOT, {**first, f"RC{channel}_OPTION": 31.0}) == []
    assert f"RC{channel}_OPTION" in names_of(ARDUPILOT)
    assert len(names_of(ARDUPILOT)) == 16
    assert kept_out(PX4, {**PX4_GOOD, "RC_MAP_FLTMODE": 1.0, "RC_MAP_KILL_SW": 1.0}) == []


def test_no_rig_asks_for_a_value_that_keeps_a_pilot_out() -> None:
    names = every_name()
    assert len(names) > 40
    for name in names:
        rig = rig_library.load_unchecked(name)
        for role in Role:
            options = rig.role(role).vehicle.options
            radio = options.get("rc", "required") == "required"
            assert refused(options.get("parameters", {}), radio=radio, companion_id=245) == []


def test_a_fence_that_is_off_or_too_wide_is_drawn_in_around_where_it_stands() -> None:
    plan = plan_fence(PX4, PX4_OFF, FENCE, (3.0, -4.0, -1.5))  # 5 m from the origin, 1.5 m above it
    assert (plan.set_to, plan.problems) == ({"GF_MAX_HOR_DIST": 33.0, "GF_MAX_VER_DIST": 8.0}, ())
    wide = plan_fence(ARDUPILOT, COPTER, FENCE, (0.0, 0.0, 0.0))
    assert wide.set_to == {"FENCE_RADIUS": 28.0, "FENCE_ALT_MAX": 9.0, "FENCE_ENABLE": 1.0}
    assert plan_fence(ARDUPILOT, {**COPTER, **wide.set_to}, FENCE, (0.0, 0.0, 0.0)).set_to == {}


def test_a_bit_of_the_fence_type_that_is_missing_is_set_beside_the_others() -> None:
    assert (
        plan_fence(ARDUPILOT, {**COPTER, "FENCE_TYPE": 4.0}, FENCE, (0.0, 0.0, 0.0)).set_to[
            "FENCE_TYPE"
        ]
        == 7.0
    )


@pytest.mark.parametrize(
    ("kind", "found", "why"),
    [
        (PX4, {**PX4_OFF, "GF_ACTION": 4.0}, "stops the motors"),
        (PX4, {**PX4_OFF, "GF_ACTION": 1.0}, "do nothing"),
        (PX4, {**PX4_OFF, "GF_MAX_HOR_DIST": 20.0}, "inside the script's own fence"),
        (PX4, {**PX4_OFF, "GF_MAX_HOR_DIST": None}, "cannot be read back: GF_MAX_HOR_DIST"),
        (PX4, {}, "cannot be read back"),
        (PX4, PX4_OFF, "it stands outside the script's fence"),
        (ARDUPILOT, {**COPTER, "FENCE_ACTION": 0.0}, "does nothing"),
        (
            ARDUPILOT,
            {**COPTER, "FENCE_ENABLE": 1.0, "FENCE_ALT_MAX": 4.0},
            "FENCE_ALT_MAX is 4 m, inside",
        ),
    ],
)
def test_a_fence_that_is_none_or_a_crews_own_is_not_overridden(
    kind: AutopilotKind, found: dict[str, float | None], why: str
) -> None:
    plan = plan_fence(kind, found, FENCE, (40.0 if found is PX4_OFF else 0.0, 0.0, 0.0))
    assert why in "; ".join(plan.problems)


def test_the_fence_is_never_inside_the_scripts() -> None:
    for away_m in (0.0, 1.2, 7.7):
        plan = plan_fence(PX4, PX4_OFF, FENCE, (away_m, 0.0, 0.4))
        assert plan.set_to["GF_MAX_HOR_DIST"] >= FENCE.radius_m + away_m + 3.0
        assert plan.set_to["GF_MAX_VER_DIST"] >= math.floor(FENCE.height_m + 0.4 + 3.0)


@pytest.mark.parametrize(
    ("stands_n_m", "outside"),
    [
        ((0.0, 24.9, 0.0), False),
        ((0.0, 25.0, 0.0), True),
        ((-15.0, 20.0, 0.0), True),
        ((0.0, 0.0, -5.9), False),
        ((0.0, 0.0, -6.0), True),
    ],
)
def test_it_must_stand_inside_the_script_s_fence(
    stands_n_m: tuple[float, float, float], outside: bool
) -> None:
    problems = plan_fence(PX4, PX4_OFF, FENCE, stands_n_m).problems
    assert bool(problems) is outside
    assert all("it stands outside" in each for each in problems)


@pytest.mark.parametrize(
    ("radius_m", "set_to", "inside"),
    [
        (24.9, {}, True),
        (25.0, {}, False),  # a crew's own, as wide as the script's
        (31.0, {}, False),  # as wide as it would be set, and a step more
        (31.1, {"GF_MAX_HOR_DIST": 28.0}, False),
        (1.0, {}, True),
    ],
)
def test_a_fence_is_left_as_long_as_it_is_neither_inside_the_script_s_nor_far_wider(
    radius_m: float, set_to: dict[str, float], inside: bool
) -> None:
    found = {"GF_MAX_HOR_DIST": radius_m, "GF_MAX_VER_DIST": 9.0, "GF_ACTION": 2.0}
    plan = plan_fence(PX4, found, FENCE, (0.0, 0.0, 0.0))
    assert plan.set_to == set_to and bool(plan.problems) is inside


@pytest.mark.parametrize(
    ("bits", "set_to"),
    [
        (3.0, {}),
        (1.0, {"FENCE_RADIUS": 28.0, "FENCE_TYPE": 3.0}),
        (2.0, {"FENCE_ALT_MAX": 9.0, "FENCE_TYPE": 3.0}),
        (6.0, {"FENCE_ALT_MAX": 9.0, "FENCE_TYPE": 7.0}),
    ],
)
def test_a_ceiling_or_a_circle_that_is_not_switched_on_is_none(
    bits: float, set_to: dict[str, float]
) -> None:
    found = {"FENCE_RADIUS": 28.0, "FENCE_ALT_MAX": 9.0, "FENCE_ACTION": 1.0, "FENCE_ENABLE": 1.0}
    plan = plan_fence(ARDUPILOT, {**found, "FENCE_TYPE": bits}, FENCE, (0.0, 0.0, 0.0))
    assert plan.set_to == set_to and plan.problems == ()
