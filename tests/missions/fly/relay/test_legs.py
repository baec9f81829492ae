"""The ground of a relay, on a field that is played."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from flight.harness.flights import RoleResult
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.relay.legs import Base
from missions.ground import rig_library
from missions.ground.team_config import relay_of
from path.messages import Role


class PlayedField:
    """Drones that are in the air from their call until they are told to be down."""

    def __init__(self) -> None:
        self.flying: dict[str, asyncio.Future[RoleResult]] = {}

    def begin(self, name: str, program: Any) -> asyncio.Future[RoleResult]:
        del program
        self.flying[name] = asyncio.get_running_loop().create_future()
        return self.flying[name]

    def down(self, name: str, outcome: Outcome = Outcome.COMMITTED) -> None:
        self.flying.pop(name).set_result(
            RoleResult(Role.RECEIVER, outcome, "", responsible=False, landed=True)
        )

    def landed(self, name: str) -> bool:
        return name not in self.flying

    def battery(self, name: str) -> float:
        del name
        return 0.5

    def open_leg(self, number: int, sender: str, receiver: str) -> None: ...

    def close_leg(self, number: int) -> None: ...

    def swap(self, name: str, battery: float) -> None: ...


@pytest.mark.parametrize("handed_over", [True, False])
def test_the_last_one_comes_home_when_the_other_one_of_its_leg_is_down(handed_over: bool) -> None:
    """Both fly home at one height, and their ways may cross (relay --rig relay-sitl --hours 0.02
    --seed 3: 0.34 m).
    """

    async def main() -> None:
        field: Any = PlayedField()
        no_program: Any = None
        base = Base(relay_of(rig_library.load("relay-sim"), 3), hours=0.01)
        ground = asyncio.ensure_future(base.run(field, asyncio.Event(), no_program))
        await asyncio.sleep(1.0)
        base.holds("D1")
        base.ask("D1", 0.5, 500.0)
        await asyncio.sleep(1.0)
        assert list(field.flying) == ["D1", "D2"]
        await asyncio.sleep(40.0)
        if handed_over:
            base.holds("D2")
        else:
            base.leg_failed("D1", MissionEnd(Outcome.PEER_LOST, ""))
        last, first_home = ("D2", "D1") if handed_over else ("D1", "D2")
        await asyncio.sleep(1.0)
        assert not base.over and list(field.flying) == ["D1", "D2"]
        field.down(first_home)
        await asyncio.sleep(1.0)
        assert base.over and list(field.flying) == [last]
        field.down(last)
        await ground

    run_virtual(main())
