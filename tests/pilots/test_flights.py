"""Flights under a person's hands: those that were found to fail once, and some drawn anew.

Ten thousand of them: ``python -m tests.pilots --seed 1 --flights 10000``.
"""

from __future__ import annotations

import asyncio
from random import Random

import pytest

from drivers.interfaces import FlightMode
from flight.outcome import Outcome
from hil.autopilot.autopilot import Autopilot
from tests.pilots import flight
from tests.pilots.acts import Act, drawn, simpler
from tests.pilots.flight import fly
from tests.pilots.watched import MOVING, Watched

DRAWN = 40

FOUND = {
    # the script waited 3 s for OFFBOARD, sending setpoints, while the pilot held it; then it landed
    # the pilot's vehicle
    "a switch to LAND and back while OFFBOARD is entered": (
        Act(4.53, "switch", 2, 0.2),
        Act(4.53, "mode", 0),
    ),
    "a radio lost at the end of the climb": (Act(2.61, "lost"),),
    "a radio lost a moment sooner": (Act(2.4, "lost"),),
    "a radio lost while OFFBOARD is entered": (Act(3.47, "lost", 0, 5.92), Act(8.22, "mode", 0)),
    # the script waited for a height that a pilot's hold kept it from, and then landed the pilot's
    # vehicle
    "a hold on the way up": (Act(1.4, "mode", 0),),
    "a hold on the way up, and armed again": (Act(2.18, "mode", 0), Act(2.18, "arm")),
    # the switch and the script's command for OFFBOARD cross: no heartbeat tells of the former
    "RETURN as OFFBOARD is commanded": (Act(4.4, "switch", 3),),
    # not to be mistaken for anything: what these are is in tests/pilots/flight.py
    "stopped motors for half a second": (Act(4.32, "kill", 0, 0.56), Act(4.32, "arm")),
    "LAND on the ground as the take-off is sent": (Act(0.47, "mode", 1),),
    "stopped motors as it is armed": (Act(0.5, "kill", 0, 1.0),),
    "sticks and a kill at once": (Act(6.0, "sticks", 0), Act(6.0, "kill")),
    "a ground station that lands it as the script does": (Act(7.6, "mode", 1),),
    "a hold in the landing": (Act(8.4, "mode", 0),),
}


def test_a_flight_that_nobody_touches_comes_to_its_own_end() -> None:
    flown = fly(())
    assert (flown.outcome, flown.wrong, flown.crossed) == ("committed", (), 0)


@pytest.mark.parametrize("acts", FOUND.values(), ids=FOUND.keys())
def test_nobody_fights_for_control_in_what_was_found(acts: tuple[Act, ...]) -> None:
    flown = fly(acts)
    assert flown.wrong == ()
    assert flown.outcome in {each.label for each in Outcome}


@pytest.mark.parametrize("number", range(DRAWN))
def test_nobody_fights_for_control_whatever_a_person_does(number: int) -> None:
    acts = drawn(Random(f"test {number}"))
    flown = fly(acts)
    assert flown.wrong == (), [str(act) for act in acts]


@pytest.mark.parametrize(
    ("act", "outcome"),
    [
        (Act(6.0, "switch", 1), "pilot_override"),
        (Act(6.0, "sticks", 0), "pilot_override"),
        (Act(6.0, "kill"), "pilot_override"),
        (Act(6.0, "lost"), "pilot_override"),
        (Act(6.0, "mode", 0), "pilot_override"),
        (Act(1.4, "mode", 0), "pilot_override"),
        (Act(6.0, "arm"), "committed"),
        (Act(6.0, "disarm"), "committed"),  # refused in the air
    ],
)
def test_each_thing_that_a_person_does_has_its_end(act: Act, outcome: str) -> None:
    assert fly((act,)).outcome == outcome


# --- that it can fail


def test_a_script_that_flies_on_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def blind(*_: object) -> None:
        """See nothing."""

    monkeypatch.setattr("flight.pilot.check_vehicle", blind)
    monkeypatch.setattr("flight.guard.under_guard.UnderGuard.check_hand", blind)
    monkeypatch.setattr("flight.guard.under_guard.UnderGuard.check", blind)
    flown = fly((Act(5.5, "switch", 1),))
    assert any("the script sent setpoint" in what for what in flown.wrong)


def test_a_script_that_takes_the_vehicle_back_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    async def lands(*_: object) -> bool:
        session = sessions[0]
        await session.vehicle.land(20.0)
        return True

    sessions: list[flight.RoleSession] = []
    course = flight._course  # pyright: ignore[reportPrivateUsage]

    async def noted(session: flight.RoleSession) -> None:
        sessions.append(session)
        await course(session)

    async def late(*arguments: object) -> bool:
        await asyncio.sleep(2.0)
        return await lands(*arguments)

    monkeypatch.setattr(flight, "_course", noted)
    monkeypatch.setattr(flight, "bring_down", late)
    flown = fly((Act(5.5, "switch", 1),))
    assert any("request_mode('land',)" in what for what in flown.wrong)


def test_a_vehicle_that_is_left_to_nobody_is_found() -> None:
    noted = Watched()
    assert not noted.has_a_person
    autopilot = Autopilot(flight._world().autopilot, 1)  # pyright: ignore[reportPrivateUsage]
    noted.put_round(autopilot)
    autopilot.request_mode(1.0, FlightMode.LAND, by_pilot=True)
    assert autopilot.mode is FlightMode.LAND and noted.orders == []
    assert FlightMode.LAND not in MOVING


def test_what_is_drawn_is_a_function_of_the_seed_and_what_is_simpler_is_less() -> None:
    acts = drawn(Random("a"))
    assert acts == drawn(Random("a"))
    many = (Act(1.234, "kill", 0, 0.5), Act(2.0, "mode", 3))
    assert (many[1],) in simpler(many) and (Act(1.2, "kill", 0, 0.5), many[1]) in simpler(many)
    assert simpler((Act(1.2, "kill"),)) == []
