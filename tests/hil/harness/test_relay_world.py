"""What goes wrong in one leg of a field of many drones, and what of it is left for the others."""

from __future__ import annotations

import math

import pytest

from drivers.interfaces import FlightMode
from drivers.rig.tables import decode_table
from hil.harness.field import fleet_of
from hil.harness.inject import THE_PILOTS, inject_in_leg
from hil.world.config import WorldConfig
from hil.world.fields import NUMBERS
from hil.world.world import PILOT_LANDS_S, Fleet
from missions.ground import rig_library
from missions.ground.team_config import team_of


@pytest.fixture
def world() -> Fleet:
    rig = rig_library.load("team-sim")
    team = team_of(rig, 4, 2)
    made = fleet_of(
        decode_table(rig.world, WorldConfig, rig.where("[world]")), 1, team.drones, team.targets
    )
    for name in made.names:
        made.switch_on(name)
    return made


def test_a_covered_marker_is_the_sender_s_and_clear_again_in_the_next_leg(
    world: Fleet,
) -> None:
    inject_in_leg("marker_hidden", "D1", world, None, ("D1", "D2"), 0)
    assert world.view("D2", "D1").marker_hidden
    assert not world.view("D4", "D3").marker_hidden  # another leg at the same time
    world.uncover("D1", "D2")
    assert not world.view("D3", "D1").marker_hidden


def test_depth_holes_are_of_a_leg_s_two_cameras(world: Fleet) -> None:
    inject_in_leg("depth_holes", "D1", world, None, ("D1", "D2"), 0)
    assert [world.view(name, None).depth_holes for name in world.names] == [
        True,
        True,
        False,
        False,
    ]
    world.uncover("D1", "D2")
    assert not any(world.view(name, None).depth_holes for name in world.names)


def test_drones_stand_where_a_crew_has_measured_and_not_quite(world: Fleet) -> None:
    team = team_of(rig_library.load("team-sim"), 4, 2)
    offs = [
        part - said
        for drone in team.drones
        for part, said in zip(
            world.drone(drone.name).true_position_n_m, reversed(drone.home_m), strict=False
        )
    ]
    assert len(set(offs)) == 8 and 0.01 < math.sqrt(sum(off * off for off in offs) / 8) < 0.15


def test_what_is_done_to_a_drone_is_over_with_its_swap(world: Fleet) -> None:
    inject_in_leg("marker_hidden", "D1", world, None, ("D1", "D2"), 0)
    world.swap("D1")
    assert not world.view("D2", "D1").marker_hidden


@pytest.mark.parametrize("fault", THE_PILOTS)
def test_a_pilot_who_took_a_drone_over_lands_it(world: Fleet, fault: str) -> None:
    autopilot = world.drone("D1").autopilot
    world.advance(12.0)
    autopilot.request_arm(world.time_s, True)
    autopilot.request_takeoff(world.time_s, 2.0)
    world.advance(20.0)
    assert not world.landed("D1")
    inject_in_leg(fault, "D1", world, 1.0 if fault == "rc_lost" else None, ("D2", "D1"), 0)
    world.advance(20.0 + PILOT_LANDS_S - 1.0)
    assert autopilot.mode is (FlightMode.HOLD if fault == "rc_lost" else FlightMode.OTHER)
    assert not world.landed("D1")
    world.advance(20.0 + PILOT_LANDS_S + 15.0)
    assert world.landed("D1")


def test_all_objects_are_those_of_every_target(world: Fleet) -> None:
    numbers = {thing.object_id for thing in world.all_objects}
    assert {0, 100} <= numbers and len(numbers) == len(world.all_objects)
    assert {thing.object_id for thing in world.objects_near("D1")} <= numbers
    world.send_lookalike(1)
    (sent,) = {thing.object_id for thing in world.all_objects} - numbers
    number, which = divmod(sent, NUMBERS)
    assert number == 1 and which > 0  # the second target's, and not that target itself


def test_who_is_in_the_air_is_asked_again_as_time_passes(world: Fleet) -> None:
    autopilot = world.drone("D1").autopilot
    world.advance(12.0)
    assert world.airborne == ()
    autopilot.request_arm(world.time_s, True)
    autopilot.request_takeoff(world.time_s, 2.0)
    world.advance(20.0)
    assert world.airborne == ("D1",)
    world.swap("D1")
    assert world.airborne == ()
