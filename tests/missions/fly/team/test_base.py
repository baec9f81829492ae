"""The ground of a team, told things in an order that flights seldom have."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from flight.harness.flights import RoleResult
from flight.harness.relay import Pointed
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.team.base import TeamBase
from missions.ground import rig_library
from missions.ground.team_config import team_of
from path.messages import Role


class Place:
    """A field on which every drone that has ended its program stands."""

    def __init__(self) -> None:
        self.flights: dict[str, asyncio.Future[RoleResult]] = {}
        self.left: dict[str, float] = {}
        self.swapped: dict[str, float] = {}

    def begin(self, name: str, program: Any) -> Awaitable[RoleResult]:
        self.flights[name] = asyncio.get_running_loop().create_future()
        return self.flights[name]

    def end(self, name: str, outcome: Outcome) -> None:
        self.flights[name].set_result(
            RoleResult(Role.RECEIVER, outcome, "", responsible=False, landed=True)
        )

    def landed(self, name: str) -> bool:
        return self.flights[name].done()

    def open_leg(self, number: int, sender: str, receiver: str) -> None: ...

    def close_leg(self, number: int) -> None: ...

    def battery(self, name: str) -> float:
        return self.left.get(name, 0.5)

    def swap(self, name: str, battery: float) -> None:
        self.swapped[name] = battery

    def assign(self, name: str, target: int) -> None: ...

    def given_up(self, target: int) -> None: ...

    def point_at(self, target: int) -> Pointed:
        return Pointed((8.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)


def flown(story: Callable[[TeamBase, Place], Awaitable[None]]) -> list[tuple[str, str]]:
    """Returns the lines for those on the ground, with the drone that each is about."""

    async def main() -> None:
        running = asyncio.create_task(base.run(place, stop, lambda *_: None))  # type: ignore[arg-type]
        await story(base, place)
        stop.set()
        for flight in place.flights.values():
            if not flight.done():
                flight.set_result(
                    RoleResult(Role.SENDER, Outcome.INTERRUPTED, "", responsible=False, landed=True)
                )
        await running

    base, place, stop = (
        TeamBase(team_of(rig_library.load("team-sim"), 2, 1)),
        Place(),
        asyncio.Event(),
    )
    run_virtual(main())
    return [(event.drone, event.what) for event in base.events]


async def acquired(base: TeamBase) -> str:
    await asyncio.sleep(30.0)
    (finder,) = (name for name, drone in base.drones.items() if drone.where == "flying")
    base.holds(finder)
    return finder


async def relief_of(base: TeamBase, holder: str) -> str:
    base.ask(holder, 0.6, 300.0)
    await asyncio.sleep(2.0)
    (relief,) = (
        name for name, drone in base.drones.items() if drone.where == "flying" and name != holder
    )
    return relief


def test_a_relief_that_is_down_before_its_sender_knows_is_in_nobody_s_way() -> None:
    """It stands ready again later, and is sent to find the target that its sender had to give
    up.
    """

    async def story(base: TeamBase, place: Place) -> None:
        holder = await acquired(base)
        relief = await relief_of(base, holder)
        place.end(relief, Outcome.MARKER_NOT_FOUND)
        await asyncio.sleep(2.0)
        assert base.drones[relief].where == "swap"
        base.leg_failed(holder, MissionEnd(Outcome.PEER_LOST, "nothing heard"))
        assert base.drones[relief].ways == []
        base.gave_up(holder, "no_relief")
        place.end(holder, Outcome.NO_RELIEF)
        await asyncio.sleep(base.config.swap_s + 30.0)
        assert base.targets[0].finder == relief

    told = flown(story)
    assert [what for _, what in told if what in ("leg failed", "lost", "find")] == [
        "find",
        "leg failed",
        "lost",
        "find",
    ]


def test_a_relief_that_is_still_in_the_air_has_its_way_back() -> None:
    async def story(base: TeamBase, place: Place) -> None:
        holder = await acquired(base)
        relief = await relief_of(base, holder)
        base.leg_failed(holder, MissionEnd(Outcome.PEER_LOST, "nothing heard"))
        assert len(base.drones[relief].ways) == 2
        place.end(relief, Outcome.MARKER_NOT_FOUND)
        await asyncio.sleep(2.0)
        assert base.drones[relief].ways == []

    flown(story)


def test_a_lost_target_to_which_no_ready_drone_can_go_is_told() -> None:
    async def story(base: TeamBase, place: Place) -> None:
        holder = await acquired(base)
        (other,) = set(base.drones) - {holder}
        blocked = base.drones[holder].ways
        base.gave_up(holder, "interrupted")  # and its program never ends: its way stays
        assert blocked
        await asyncio.sleep(120.0)
        assert base.drones[other].where == "ready"

    assert ("", "alarm") in flown(story)


def test_a_drone_on_its_way_home_is_sent_back_to_the_target_that_nobody_has() -> None:
    """Once the one that lost it is down; nobody else is sent meanwhile."""

    async def story(base: TeamBase, place: Place) -> None:
        holder = await acquired(base)
        relief = await relief_of(base, holder)
        base.may_find(relief, 600.0)
        assert base.turned_back(relief) == "no"  # its sender has it
        base.gave_up(holder, "pilot_override")
        base.may_find(relief, 600.0)
        assert base.turned_back(relief) == "no"  # nobody has pointed at it again yet
        await asyncio.sleep(base.config.point_s)
        base.may_find(relief, 20.0)
        assert base.turned_back(relief) == "no"  # its battery
        base.may_find(relief, 600.0)
        assert base.turned_back(relief) == "wait" and base.targets[0].finder == relief
        place.end(holder, Outcome.PILOT_OVERRIDE)
        await asyncio.sleep(2.0)
        assert base.turned_back(relief) == "go"
        base.holds(relief)
        assert base.targets[0].holder == relief and base.drones[relief].ways == []

    flown(story)


def test_who_waits_for_its_way_back_for_too_long_comes_home_and_another_one_is_sent() -> None:
    async def story(base: TeamBase, place: Place) -> None:
        holder = await acquired(base)
        relief = await relief_of(base, holder)
        base.gave_up(holder, "pilot_override")
        await asyncio.sleep(base.config.point_s)
        base.may_find(relief, 600.0)
        base.may_find(relief, 0.0)
        assert (base.turned_back(relief), base.targets[0].finder) == ("no", None)

    flown(story)


def test_the_sender_of_a_relief_that_died_with_the_target_is_sent_back_to_it() -> None:
    """Only once the other one's program is over: until then it may hold the target without having
    said so.
    """

    async def story(base: TeamBase, place: Place) -> None:
        holder = await acquired(base)
        relief = await relief_of(base, holder)
        base.may_find(holder, 300.0)
        await asyncio.sleep(base.config.point_s)
        base.may_find(holder, 300.0)
        assert (base.turned_back(holder), base.targets[0].holder) == ("no", holder)
        place.end(relief, Outcome.CRASHED)
        await asyncio.sleep(1.0)
        base.may_find(holder, 300.0)
        assert base.targets[0].holder is None
        await asyncio.sleep(base.config.point_s)
        base.may_find(holder, 300.0)
        assert base.turned_back(holder) == "go"

    flown(story)


def test_a_relief_that_comes_home_early_by_no_fault_of_its_own_keeps_its_battery() -> None:
    async def story(base: TeamBase, place: Place) -> None:
        for outcome, left, ready_s, kept in (
            (Outcome.PEER_ABORTED, 1.0, 0.0, 1.0),  # it never took off
            (Outcome.PEER_LOST, 0.95, base.config.check_s, 0.95),
            (Outcome.PEER_LOST, 0.80, base.config.swap_s, 1.0),
            (Outcome.CAMERA_LOST, 0.95, base.config.swap_s, 1.0),
        ):
            holder = (
                await acquired(base) if base.targets[0].holder is None else base.targets[0].holder
            )
            assert holder is not None
            relief = await relief_of(base, holder)
            place.left[relief] = left
            place.end(relief, outcome)
            base.leg_failed(holder, MissionEnd(Outcome.PEER_LOST, "nothing heard"))
            if ready_s > 0.0:
                await asyncio.sleep(ready_s - 5.0)
                assert base.drones[relief].where == "swap"
            await asyncio.sleep(10.0)
            assert base.drones[relief].where == "ready" and place.swapped[relief] == kept

    flown(story)
