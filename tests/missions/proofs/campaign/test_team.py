"""A campaign of teams: what is drawn can be ordered, and a run is made by its seed."""

from __future__ import annotations

from typing import Any

import pytest

from hil.world.faults import parse_fault
from missions.ground import rig_library
from missions.ground.options.words import LevelName
from missions.ground.team_config import team_of
from missions.proofs.campaign.results import RunLine
from missions.proofs.campaign.run import RunOrder
from missions.proofs.campaign.summary import summarize, table
from missions.proofs.campaign.team_runs import HOSTILE, draw, fly, named

CONFIG = team_of(rig_library.load("team-sim"))


@pytest.mark.parametrize("level", ["none", "lossy", "harsh", "hostile"])
def test_every_drawn_fault_can_be_ordered_and_teams_differ(level: LevelName) -> None:
    plans = [draw(CONFIG, 3, level, number, 2.0) for number in range(60)]
    assert plans == [draw(CONFIG, 3, level, number, 2.0) for number in range(60)]
    kinds: set[str] = set()
    for plan in plans:
        assert (
            2 * plan.targets <= plan.drones <= len(CONFIG.drones)
            and len(plan.moved_m) == plan.targets
        )
        kinds |= {parse_fault(fault.rpartition(":")[2]).name for fault in plan.faults}
    assert {plan.targets for plan in plans} == {1, 2, 3}
    links = {"link_loss", "link_jitter", "link_duplicate", "link_corrupt", "link_reorder"}
    assert (
        kinds
        == {
            "none": set[str](),
            "lossy": links,
            "harsh": links | {"kill_receiver", "kill_sender", "link_out"},
            "hostile": links | {*HOSTILE, "link_out"},
        }[level]
    )


def test_the_target_that_was_observed_least_counts() -> None:
    def summary(**observed: float | None) -> dict[str, Any]:
        return {"outcome": "committed", "observed_percent": observed}

    assert named(summary(A=100.0, B=99.0, C=None, all=99.6)) == "committed"  # C was never named
    assert named(summary(A=100.0, B=98.9, all=99.5)) == "observed < 99 %"
    assert named(summary(A=None, all=None)) == "observed < 99 %"
    assert named({"outcome": "wrong_object"}) == "violated"


def test_a_team_of_a_campaign_flies() -> None:
    number = next(k for k in range(20) if draw(CONFIG, 0, "none", k, 0.01).targets == 1)
    (line,) = fly(RunOrder("sim", 0, (("none", number),), hours=0.01))
    assert (line.number, line.outcome, line.violations) == (number, "committed", ())
    assert line.figures["unobserved_s"] == 0.0 and line.figures["simulated_s"] > 36.0
    assert line.observed_percent == {"A": 100.0}


def test_the_table_says_how_much_of_the_time_each_target_was_observed() -> None:
    lines = [
        RunLine(0, "none", "committed", observed_percent={"A": 100.0, "B": 99.5}),
        RunLine(0, "hostile", "observed < 99 %", observed_percent={"A": 97.0}),
        RunLine(1, "hostile", "committed", observed_percent={"A": 100.0}),
    ]
    said = table(summarize("team", 1, lines, lambda _: ""))
    assert "none     2 of 2, mean 99.75 %, least 99.50 %" in said
    assert "hostile  1 of 2, mean 98.50 %, least 97.00 %" in said
    assert "observed for" not in table(
        summarize("machines", 1, [RunLine(0, "none", "commit")], lambda _: "")
    )
