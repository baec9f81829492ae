"""The line between the ground of a team and a drone's program in another process: what of targets
goes over it.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from drivers.rig.parts import Rig
from flight.harness.relay import Pointed
from missions.fly.fleet.process import processes_of
from missions.fly.relay.ground import SentTo, TakeOffOrder
from missions.fly.relay.line import FarBase, hear, news_of
from missions.fly.team.base import TeamBase
from missions.fly.team.flight import mission_on
from missions.ground import rig_library
from missions.ground.team_config import team_of

POINTED = Pointed((4.5, -7.0, 0.0), (0.1, 0.2, 0.0), 12.0)


class Field:
    """Of which only this is asked."""

    def __init__(self) -> None:
        self.given: list[int] = []

    def point_at(self, target: int) -> Pointed:
        del target
        return POINTED

    def given_up(self, target: int) -> None:
        self.given.append(target)

    def close_leg(self, number: int) -> None: ...


def twelve(base: TeamBase) -> float:
    del base
    return 12.0


@pytest.fixture
def rig() -> Rig:
    return rig_library.load("team-sitl")


@pytest.fixture
def base(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> TeamBase:
    monkeypatch.setattr(TeamBase, "_now_s", twelve)  # there is no loop here
    made = TeamBase(team_of(rig))
    field: Any = Field()
    made._field = field
    drone = made.drones["D2"]
    drone.target, drone.heading_deg, drone.order = 1, 45.0, TakeOffOrder.FIND
    made.targets[1].place_n_m, made.targets[1].finder = (3.0, 7.0, 0.0), "D2"
    return made


def told(base: TeamBase) -> FarBase:
    far = FarBase("D2", lambda _: None)
    far.on_news(json.loads(json.dumps(news_of(base, "D2"))))
    return far


def test_a_program_knows_its_target_and_where_it_is_pointed_at(base: TeamBase, rig: Rig) -> None:
    far = told(base)
    sent = far.sent_to("D2")
    assert sent is not None and sent == SentTo(1, (3.0, 7.0, 0.0), 45.0)
    assert far.pointed_at("D2") == POINTED
    mission = mission_on(rig_library.mission_of(rig), sent)
    assert (mission.target_id, mission.target.east_m, mission.heading_deg) == (2, 7.0, 45.0)


def test_only_who_is_to_find_is_pointed_at(base: TeamBase) -> None:
    base.drones["D2"].order = TakeOffOrder.RELIEVE
    assert news_of(base, "D2")["pointed"] is None


def test_each_drone_is_called_home_by_itself(base: TeamBase) -> None:
    base.drones["D2"].called_home = True
    assert told(base).called_home("D2")
    assert not base.called_home("D1")


def test_what_a_program_says_of_its_target_comes_to_the_ground(base: TeamBase) -> None:
    words: list[Any] = []
    far = FarBase("D2", words.append)
    far.holds("D2")
    far.follows("D2", (3.5, 7.5, -0.1))
    far.gave_up("D2", "battery")
    for word in words[:2]:
        hear(base, "D2", json.loads(json.dumps(word)))
    assert (base.targets[1].holder, base.targets[1].place_n_m) == ("D2", (3.5, 7.5, -0.1))
    hear(base, "D2", json.loads(json.dumps(words[2])))
    assert base.targets[1].holder is None
    hear(base, "D2", {"event": "something else"})


def test_a_drone_on_its_way_home_asks_and_is_told_to_turn_back(base: TeamBase) -> None:
    words: list[Any] = []
    far = FarBase("D2", words.append)
    far.may_find("D2", 400.0)
    base.targets[1].finder = None
    hear(base, "D2", json.loads(json.dumps(words[0])))
    assert (base.targets[1].finder, base.drones["D2"].turned_back) == ("D2", "wait")
    assert told(base).turned_back("D2") == "go"  # nothing is in its way


def test_a_process_is_told_how_much_of_the_rig_takes_part(
    base: TeamBase, rig: Rig, tmp_path: Any
) -> None:
    base.config = replace(team_of(rig, 2, 1), hours=1.0)
    processes = processes_of(rig, base, tmp_path, False)
    command = processes.command("D2")
    assert command[2:5] == ["missions.fly.fleet.process", "program", str(rig.file)]
    assert command[5:] == ["2/1", "D2", str(tmp_path), "rare"]
    assert processes.guard_command("D2")[3] == "guard"
