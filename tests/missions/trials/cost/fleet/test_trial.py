"""The cost of a team by its size: what is made of the flights' figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.cost.fleet import trial as fleet
from missions.trials.cost.fleet.trial import TeamCost, TeamSize
from missions.trials.shared.trial import TrialRequest, TrialResult

COST = TeamCost(2, 1, 900.0, 10.0, 20.0, 40.0, "committed", 1, 100.0, {})


def result(monkeypatch: pytest.MonkeyPatch, out: Path, *costs: TeamCost) -> TrialResult:
    """Of a trial whose flights cost so much, in turn; that before them is not counted."""
    flown = iter((COST, *costs))

    def fly(request: TrialRequest, size: TeamSize, name: str) -> TeamCost:
        return replace(next(flown), drones=size.drones, targets=size.targets)

    monkeypatch.setattr(fleet, "_fly", fly)
    with open_work(1) as work:
        return fleet.run(TrialRequest(rig_library.load("team-sim"), out, 0, False, work))


def dear(cpu_s_per_drone_hour: float, **more: Any) -> TeamCost:
    return replace(COST, cpu_s_per_drone_hour=cpu_s_per_drone_hour, **more)


def test_a_cost_is_flat_when_no_team_is_far_off_the_middle(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    flat = result(
        monkeypatch, tmp_path, *(dear(cost) for cost in (20.0, 21.0, 24.0, 26.0, 28.0, 30.0, 99.0))
    )
    # the field is not one of those that are compared
    assert flat.summary["off_the_middle"] == pytest.approx(0.2)
    assert [finding.verdict for finding in flat.findings] == ["measured", "met", "met", "met"]
    assert (tmp_path / fleet.PICTURE).read_bytes()[:4] == b"\x89PNG"
    grows = result(
        monkeypatch, tmp_path, *(dear(cost) for cost in (20.0, 21.0, 24.0, 26.0, 28.0, 31.0, 20.0))
    )
    assert grows.findings[1].verdict == "short"


def test_a_field_that_does_not_come_to_its_end_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    lost = dear(20.0, outcome="target_lost", violations={"S9": 2})
    told = result(monkeypatch, tmp_path, *[dear(20.0)] * 6, lost)
    assert [finding.verdict for finding in told.findings] == ["measured", "met", "short", "short"]
    assert told.violations == {"S9": 2}


def test_two_teams_fly_and_are_measured(tmp_path: Path) -> None:
    with open_work(1) as work:
        flown = fleet.run(TrialRequest(rig_library.load("team-sim"), tmp_path, 0, True, work))
    assert [(cost["drones"], cost["targets"]) for cost in flown.summary["teams"]] == [
        (2, 1),
        (3, 1),
    ]
    assert all(cost["cpu_s_per_drone_hour"] > 0.0 for cost in flown.summary["teams"])
    assert not flown.violations
