"""The trial of hand-overs among obstacles: what it asks of a flight, and what it makes of it."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path

import pytest

from hil.world.world import drawn_obstacles
from missions.ground import rig_library
from missions.ground.rig_library import mission_of
from missions.ground.work import open_work
from missions.trials.flights.obstacles import trial
from missions.trials.flights.obstacles.trial import (
    Flown,
    Order,
    knowing,
    looking,
    not_knowing,
)
from missions.trials.shared.trial import TrialRequest


def test_the_same_obstacles_stand_in_both_worlds_and_one_crew_knows_them() -> None:
    rig = rig_library.load("sim")
    obstacles = drawn_obstacles(rig, 6, 3)
    around = knowing(rig, obstacles)
    straight = not_knowing(rig, obstacles)
    assert around.world["obstacles"] == straight.world["obstacles"]
    assert mission_of(around).fence.obstacles == obstacles
    assert mission_of(straight).fence.obstacles == ()
    assert not mission_of(straight).guard.unmeasured
    seeing = looking(straight)
    assert seeing.world["obstacles"] == straight.world["obstacles"]
    assert mission_of(seeing).guard.unmeasured
    assert mission_of(seeing).fence.obstacles == ()


def test_commits_touches_and_planning_are_told_beside_straight_flights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fly(order: Order) -> Flown:
        touches = order.how == "straight" and order.seed % 2
        outcome = "monitor_violated" if touches else "committed"
        violations = Counter({"S11": 2} if touches else {})
        return Flown(order.how, order.seed, outcome, False, violations)

    monkeypatch.setattr(trial, "fly_order", fly)
    monkeypatch.setattr(trial, "WORLDS", 4)
    with open_work(1, io.StringIO()) as work:
        found = trial.run(TrialRequest(rig_library.load("sim"), tmp_path, 1, False, work))
    told = found.summary
    assert (told["worlds"], told["collisions"], told["collisions_before"]) == (4, 0, 4)
    assert (told["commit_rate"], told["commit_rate_before"]) == (1.0, 0.5)
    assert 0.0 < told["planning_p99_ms"] < 200.0
    assert (told["commit_rate_looking"], told["collisions_looking"]) == (1.0, 0)
    assert not found.violations


def test_a_pair_that_knows_its_obstacles_flies_around_them(tmp_path: Path) -> None:
    """The same world, flown straight, has two touches."""
    rig = rig_library.load("sim")
    rig = knowing(rig, drawn_obstacles(rig, trial.OBSTACLES, 104))
    flown = trial.fly_order(Order(rig, 104, "around", tmp_path / "around"))
    assert flown.outcome == "committed"
    assert not flown.violations
