"""Drones are sent at the least cost in all, and no two ways cross."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from missions.fly.team.airways import Airway, conflict, in_the_way, way_back, way_out
from missions.fly.team.assignment import Airspace, Need, ReadyDrone, assign, clutter_s, cost_of

AREA_M, CLEAR_M = 6.0, 3.0
FREE = Airspace((), CLEAR_M, 4.0, 2.0)


def ways(need: Need, drone: ReadyDrone) -> Sequence[Airway]:
    return (way_out(drone.home_m, need.place_m, AREA_M),)


def need(target: int, east: float, north: float, **more: object) -> Need:
    return Need(target, (east, north), 0.0, **more)  # type: ignore[arg-type]


def test_the_least_in_all_and_not_the_nearest_for_the_first() -> None:
    needs = [need(0, 0.0, 20.0), need(1, 30.0, 20.0)]
    drones = [ReadyDrone("D1", (10.0, 0.0), 1.0), ReadyDrone("D2", (-40.0, 0.0), 1.0)]
    chosen = assign(needs, drones, ways, FREE)
    assert [(choice.target, choice.drone) for choice in chosen] == [(0, "D2"), (1, "D1")]


def test_a_fuller_battery_is_worth_a_longer_way() -> None:
    drones = [ReadyDrone("near", (0.0, 0.0), 0.5), ReadyDrone("full", (20.0, 0.0), 1.0)]
    (choice,) = assign([need(0, 0.0, 30.0)], drones, ways, FREE)
    assert choice.drone == "full"


@pytest.mark.parametrize(("left_s", "served"), [(400.0, 0), (60.0, 1)])
def test_one_drone_for_two_goes_to_the_lost_target_unless_the_other_is_about_to_be_lost(
    left_s: float, served: int
) -> None:
    lost, asking = need(0, 0.0, 60.0), need(1, 0.0, 20.0, urgent_s=left_s)
    (choice,) = assign([lost, asking], [ReadyDrone("D1", (0.0, 0.0), 1.0)], ways, FREE)
    assert choice.target == served


def test_only_those_take_it_that_may() -> None:
    drones = [ReadyDrone("D1", (0.0, 0.0), 1.0), ReadyDrone("D2", (50.0, 0.0), 1.0)]
    (choice,) = assign([need(0, 0.0, 30.0, may=frozenset(("D2",)))], drones, ways, FREE)
    assert choice.drone == "D2"
    assert assign([need(0, 0.0, 30.0, may=frozenset(("D3",)))], drones, ways, FREE) == []


def test_nobody_is_sent_across_the_way_of_another() -> None:
    flown = way_back((-20.0, 10.0), (20.0, 10.0), 0.0), way_out((-20.0, 10.0), (20.0, 10.0), 0.0)
    drones = [ReadyDrone("D1", (0.0, 0.0), 1.0)]
    assert assign([need(0, 0.0, 30.0)], drones, ways, Airspace(flown, CLEAR_M, 4.0, 2.0)) == []


def test_a_new_target_is_looked_at_from_where_no_other_is_behind_it() -> None:
    beside = Need(0, (0.0, 0.0), None, others=((0.0, 3.0),))
    assert clutter_s(beside, 0.0) > clutter_s(beside, 90.0) == 0.0
    _, heading_deg = cost_of(beside, ReadyDrone("D1", (0.0, -20.0), 1.0), FREE)
    assert heading_deg != 0.0


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        # areas
        (
            way_out((0.0, 0.0), (0.0, 40.0), AREA_M),
            way_out((10.0, 0.0), (10.0, 40.0), AREA_M),
            True,
        ),
        (
            way_out((0.0, 0.0), (0.0, 40.0), AREA_M),
            way_out((20.0, 0.0), (20.0, 40.0), AREA_M),
            False,
        ),
        # they cross
        (way_out((0.0, 0.0), (40.0, 40.0), 0.0), way_out((40.0, 0.0), (0.0, 40.0), 0.0), True),
        # one above the other
        (way_out((0.0, 0.0), (40.0, 40.0), 0.0), way_back((40.0, 0.0), (0.0, 40.0), 0.0), False),
        # through a landing
        (way_out((0.0, 0.0), (40.0, 0.0), 0.0), way_back((20.0, 1.0), (20.0, 40.0), 0.0), True),
        # above a take-off
        (way_back((0.0, 0.0), (40.0, 0.0), 0.0), way_out((20.0, 1.0), (20.0, 40.0), 0.0), False),
    ],
)
def test_two_ways_at_once(one: Airway, other: Airway, expected: bool) -> None:
    assert conflict(one, other, CLEAR_M) is conflict(other, one, CLEAR_M) is expected
    assert in_the_way((one,), (other,), CLEAR_M) is expected
